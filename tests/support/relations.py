"""Relations between flux and current that do not occur in any machine."""

from __future__ import annotations

import numpy as np

from fluxobs import QuadraticConstraint


def random_constraint(rng: np.random.Generator, n: int) -> QuadraticConstraint:
    Q1, Q2, Q3 = rng.standard_normal((3, n, n))
    E, C = rng.standard_normal((2, n))
    return QuadraticConstraint(Q1, Q2, Q3, E, C, d=rng.standard_normal())


#: Functions of the library whose machines have no quadratic relation.
WITHOUT_RELATION = (
    "interior_pmsm",
    "maglev_1dof",
    "switched_reluctance",
    "saturated_switched_reluctance",
)
