"""Position and velocity of a levitated body from its flux."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..core.arrays import Array
from ..machines import MagLev2DOF
from .requirements import require_positive


class TrackerState(NamedTuple):
    """Position [m], velocity [m/s] and last force [N] (None before the first sample)."""

    position: float = 0.0
    velocity: float = 0.0
    force: float | None = None


@dataclass(frozen=True)
class LevitationTracker:
    """Luenberger observer for position and velocity, driven by the estimated force.

    The position follows from flux and current by ``q = g - k_1 i_1/φ_1 = k_2 i_2/φ_2 - g``; least
    squares combine the two equations. The model is ``q̈ = (D²/J)(F_1 - F_2)``, F = c φ²/(2k).

    Parameters
    ----------
    machine : MagLev2DOF
    sample_time : float
        Sample time [s], > 0.
    bandwidth : float
        Magnitude of both poles [rad/s], > 0.
    """

    machine: MagLev2DOF
    sample_time: float
    bandwidth: float = 200.0

    def __post_init__(self) -> None:
        for name in ("sample_time", "bandwidth"):
            require_positive(name, getattr(self, name))

    def run(self, flux: ArrayLike, current: ArrayLike) -> tuple[Array, Array]:
        """Return (position [m], velocity [m/s]), each of shape (rows,).

        In rows where flux and current give no position, the position is predicted.

        Parameters
        ----------
        flux, current : (rows, 2) array_like
            Estimated core fluxes [Wb] and unbiased currents [A].
        """
        phi, i = np.asarray(flux, float), np.asarray(current, float)
        measured, _ = self.machine.position(phi, i)
        usable = np.isfinite(measured) & (np.abs(measured) < self.machine.g)
        start = measured[np.argmax(usable)] if usable.any() else 0.0
        state, track = TrackerState(float(start), 0.0, None), np.empty((len(phi), 2))
        for k in range(len(phi)):
            state = self.step(state, phi[k], i[k])
            track[k] = state.position, state.velocity
        return track[:, 0], track[:, 1]

    def step(self, state: TrackerState, flux: Array, current: Array) -> TrackerState:
        """Process one sample: estimated core fluxes (2,) [Wb] and unbiased currents (2,) [A]."""
        m, h = self.machine, self.sample_time
        force = m.c_1 * flux[0] ** 2 / (2 * m.k_1) - m.c_2 * flux[1] ** 2 / (2 * m.k_2)
        force = force if np.isfinite(force) else 0.0  # no force if the flux is missing
        q, velocity = state.position, state.velocity
        if state.force is not None:
            acceleration = m.D**2 / m.J * (state.force + force) / 2
            q, velocity = q + h * velocity + h * h / 2 * acceleration, velocity + h * acceleration
        measured, _ = m.position(flux, current)
        if np.isfinite(measured) and abs(measured) < m.g:
            # Double pole at e^{-h bandwidth} for a double integrator.
            pole = np.exp(-h * self.bandwidth)
            error = float(measured) - q
            q, velocity = q + (1 - pole**2) * error, velocity + (1 - pole) ** 2 / h * error
        return TrackerState(q, velocity, float(force))
