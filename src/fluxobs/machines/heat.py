"""Temperature coefficients of a machine's parameters."""

from __future__ import annotations

#: Reference temperature of the coefficients and of the parameters in machine files [°C].
COLD = 20.0
#: Relative change of copper's resistance [1/K] (IEC 60028).
COPPER = 0.00393
#: Relative change of the resistance of a cast aluminium cage [1/K].
CAGE = 0.0040
#: Relative change of the flux of NdFeB magnets [1/K] (their datasheets: -0.09 to -0.12 %).
NEODYMIUM = -0.0011
