"""Library of machines as energies; some machines satisfy a quadratic relation, some do not."""

from collections.abc import Callable

from ....machines import MagLev2DOF, example
from ..system import ElectromechanicalSystem
from .electrostatic import differential_actuator, differential_relation
from .levitation import (
    four_pole_bearing,
    maglev_1dof,
    maglev_2dof,
    maglev_as_printed,
    maglev_biased,
    maglev_leakage,
    three_coils,
)
from .reluctance import affine_pair, saturated_switched_reluctance, switched_reluctance
from .rotating import (
    doubly_fed,
    five_phase_pmsm,
    interior_pmsm,
    surface_pmsm,
    synchronous_reluctance,
    wound_field,
)


def knospe() -> ElectromechanicalSystem:
    """Return the levitation benchmark of the paper's Section V-B."""
    machine = example("maglev-knospe")
    assert isinstance(machine, MagLev2DOF)
    return maglev_2dof(machine)


#: Every machine of the library, with typical parameters.
LIBRARY: tuple[Callable[[], ElectromechanicalSystem], ...] = (
    surface_pmsm,
    interior_pmsm,
    synchronous_reluctance,
    five_phase_pmsm,
    wound_field,
    doubly_fed,
    maglev_1dof,
    knospe,
    maglev_leakage,
    maglev_biased,
    four_pole_bearing,
    three_coils,
    affine_pair,
    switched_reluctance,
    saturated_switched_reluctance,
    differential_actuator,
)

__all__ = [
    "LIBRARY",
    "affine_pair",
    "differential_actuator",
    "differential_relation",
    "doubly_fed",
    "five_phase_pmsm",
    "four_pole_bearing",
    "interior_pmsm",
    "knospe",
    "maglev_1dof",
    "maglev_2dof",
    "maglev_as_printed",
    "maglev_biased",
    "maglev_leakage",
    "saturated_switched_reluctance",
    "surface_pmsm",
    "switched_reluctance",
    "synchronous_reluctance",
    "three_coils",
    "wound_field",
]
