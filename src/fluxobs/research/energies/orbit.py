"""Periodic orbits of a system under periodic control, by Newton's method on the period map."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...errors import ModelError
from .integrate import Control, Trajectory, integrate
from .system import ElectromechanicalSystem, State

#: A period is closed if its ends differ by less than this share of the state's scale.
CLOSED = 1e-9
#: Relative step of the finite differences; largest number of Newton steps.
_STEP, _MAX_STEPS = 1e-5, 20


class PeriodicOrbit(NamedTuple):
    """One period of a trajectory.

    Attributes
    ----------
    trajectory : Trajectory
        Samples from 0 to the period, including both ends.
    multipliers : (states,) ndarray of complex
        Floquet multipliers of the closed loop. The orbit attracts if all multipliers are inside the
        unit circle.
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
    """Find the periodic orbit near a guess.

    Parameters
    ----------
    system, control
        Arguments of :func:`integrate`; `control` must have this period.
    period : float
        [s].
    samples : int
        Steps of the trajectory per period.
    guess : State
        State at t = 0.
    scale : State
        Sizes of the states.
    **options
        Passed to :func:`integrate`.

    Raises
    ------
    ModelError
        If no orbit is found or the simulation fails.
    """
    t = np.arange(samples + 1) * (period / samples)
    sizes = np.concatenate([np.asarray(size, float) for size in scale])
    cuts = np.cumsum([len(np.asarray(size)) for size in scale])[:-1]

    def simulate(x: NDArray[np.float64]) -> Trajectory:
        start = State(*(jnp.asarray(values) for values in np.split(x * sizes, cuts)))
        return integrate(system, control, t, start, scale=scale, **options)

    def end(trajectory: Trajectory) -> NDArray[np.float64]:
        states = (trajectory.flux[-1], trajectory.position[-1], trajectory.momentum[-1])
        return np.asarray(np.concatenate(states) / sizes)

    x = np.concatenate([np.asarray(values, float) for values in guess]) / sizes
    for _ in range(_MAX_STEPS):
        trajectory = simulate(x)
        gap = end(trajectory) - x
        slopes = [
            (end(simulate(x + _STEP * unit)) - end(simulate(x - _STEP * unit))) / (2 * _STEP)
            for unit in np.eye(len(x))
        ]
        jacobian = np.array(slopes).T
        if np.abs(gap).max() < CLOSED:
            return PeriodicOrbit(trajectory, np.linalg.eigvals(jacobian).astype(complex))
        # Use least squares, because a multiplier of one makes the equations singular.
        x = x + np.linalg.lstsq(np.eye(len(x)) - jacobian, gap, rcond=1e-12)[0]
    raise ModelError(
        f"{system.name}: no orbit of {period:g} s near the guess; after {_MAX_STEPS} Newton steps "
        f"its ends still differ by {np.abs(gap).max():.2g} of the scale"
    )
