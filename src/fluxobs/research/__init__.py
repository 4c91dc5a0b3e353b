"""The paper's mathematics: machines as energies, relations, regression, observers, analysis.

Needs the extra "design" (JAX, equinox, diffrax).
"""

from ..simulation import precision  # noqa: F401  # first: enables float64
from .energies.blondel_park import BlondelPark, blondel_park
from .energies.discovery import (
    Discovery,
    FeatureDiscovery,
    check_constraint,
    discover_constraint,
    discover_in_features,
)
from .energies.integrate import Trajectory, integrate
from .energies.orbit import PeriodicOrbit, periodic_orbit
from .energies.position import PositionVisibility, position_visibility, velocity_from_flux
from .energies.system import (
    ElectromechanicalSystem,
    Power,
    State,
    inertia,
    linear_magnetics,
)
from .relation_observer import RelationEstimate, RelationObserver
from .relation_smoother import SmoothedRecord, integrated_flux, smooth_record

__all__ = [
    "BlondelPark",
    "Discovery",
    "ElectromechanicalSystem",
    "FeatureDiscovery",
    "PeriodicOrbit",
    "PositionVisibility",
    "Power",
    "RelationEstimate",
    "RelationObserver",
    "SmoothedRecord",
    "State",
    "Trajectory",
    "blondel_park",
    "check_constraint",
    "discover_constraint",
    "discover_in_features",
    "inertia",
    "integrate",
    "integrated_flux",
    "linear_magnetics",
    "periodic_orbit",
    "position_visibility",
    "smooth_record",
    "velocity_from_flux",
]
