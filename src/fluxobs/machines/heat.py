"""Temperature coefficients of a machine's parameters."""

from __future__ import annotations

#: Temperature for which machine files give parameters, the coefficients' reference [°C].
COLD = 20.0
#: Change of the resistance of copper [1/K] (IEC 60028).
COPPER = 0.00393
#: Change of the resistance of a cast aluminium cage [1/K].
CAGE = 0.0040
#: Change of the flux of NdFeB magnets [1/K] (their datasheets: -0.09 to -0.12 %).
NEODYMIUM = -0.0011
