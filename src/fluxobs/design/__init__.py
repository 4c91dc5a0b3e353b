"""Design tools: machines as energies, the paper's observers, analysis, simulation.

Needs the extra "design" (JAX, equinox, diffrax). Importing it switches JAX to float64; single
precision is refused. Nothing outside this folder loads JAX.
"""

from importlib.util import find_spec

from ..errors import FluxobsError

_missing = [name for name in ("jax", "equinox", "diffrax") if find_spec(name) is None]
if _missing:
    raise FluxobsError(
        f"{', '.join(_missing)} not installed: this needs the extra, pip install 'fluxobs[design]'"
    )

from . import precision  # noqa: E402, F401  # before anything else: float64
from .energies.blondel_park import BlondelPark, blondel_park  # noqa: E402
from .energies.discovery import (  # noqa: E402
    Discovery,
    FeatureDiscovery,
    check_constraint,
    discover_constraint,
    discover_in_features,
)
from .energies.integrate import Trajectory, integrate  # noqa: E402
from .energies.orbit import PeriodicOrbit, periodic_orbit  # noqa: E402
from .energies.system import (  # noqa: E402
    ElectromechanicalSystem,
    Power,
    State,
    inertia,
    linear_magnetics,
)
from .relation_observer import RelationEstimate, RelationObserver  # noqa: E402

__all__ = [
    "BlondelPark",
    "Discovery",
    "ElectromechanicalSystem",
    "FeatureDiscovery",
    "PeriodicOrbit",
    "Power",
    "RelationEstimate",
    "RelationObserver",
    "State",
    "Trajectory",
    "blondel_park",
    "check_constraint",
    "discover_constraint",
    "discover_in_features",
    "inertia",
    "integrate",
    "linear_magnetics",
    "periodic_orbit",
]
