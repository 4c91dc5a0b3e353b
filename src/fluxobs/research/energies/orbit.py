"""Periodic orbits of a system under periodic control, by Newton's method on the period map."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from .integrate import Control, Trajectory, integrate
from .system import ElectromechanicalSystem, State

#: A period ends where it began, to this share of the state's scale.
CLOSED = 1e-9
#: Relative step of the differences, and Newton steps at most.
_STEP, _MOST = 1e-5, 20


class PeriodicOrbit(NamedTuple):
    """One period.

    Attributes
    ----------
    trajectory : Trajectory
        From 0 to the period, both ends included.
    multipliers : (states,) ndarray of complex
        Floquet multipliers of the closed loop: the orbit attracts if all are inside the unit
        circle.
    """

    trajectory: Trajectory
    multipliers: NDArray[np.complex128]


def periodic_orbit(
    system: ElectromechanicalSystem,
    control: Control,
    period: float,
    samples: int,
    guess: State,
    scale: State,
    **options: Any,
) -> PeriodicOrbit:
    """Finds the orbit near a guess.

    Parameters
    ----------
    system, control
        As for :func:`integrate`; `control` has this period.
    period : float
        [s].
    samples : int
        Steps of the trajectory a period.
    guess : State
        State at t = 0.
    scale : State
        Sizes of the states.
    **options
        Passed to :func:`integrate`.

    Raises
    ------
    ModelError
        No orbit was found, or the simulation failed.
    """
    t = np.arange(samples + 1) * (period / samples)
    sizes = np.concatenate([np.asarray(part, float) for part in scale])
    cuts = np.cumsum([len(np.asarray(part)) for part in scale])[:-1]

    def along(x: NDArray[np.float64]) -> Trajectory:
        start = State(*(jnp.asarray(part) for part in np.split(x * sizes, cuts)))
        return integrate(system, control, t, start, scale=scale, **options)

    def end(found: Trajectory) -> NDArray[np.float64]:
        parts = (found.flux[-1], found.position[-1], found.momentum[-1])
        return np.asarray(np.concatenate(parts) / sizes)

    x = np.concatenate([np.asarray(part, float) for part in guess]) / sizes
    for _ in range(_MOST):
        found = along(x)
        gap = end(found) - x
        slopes = [
            (end(along(x + _STEP * one)) - end(along(x - _STEP * one))) / (2 * _STEP)
            for one in np.eye(len(x))
        ]
        jacobian = np.array(slopes).T
        if np.abs(gap).max() < CLOSED:
            return PeriodicOrbit(found, np.linalg.eigvals(jacobian).astype(complex))
        # Least squares: a multiplier of one leaves a direction open.
        x = x + np.linalg.lstsq(np.eye(len(x)) - jacobian, gap, rcond=1e-12)[0]
    raise ModelError(
        f"{system.name}: no orbit of {period:g} s near the guess; after {_MOST} Newton steps its "
        f"ends still differ by {np.abs(gap).max():.2g} of the scale"
    )
