"""Position and velocity of a levitated body from its flux."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ObserverError
from ..machines import MagLev2DOF

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LevitationTracker:
    """Luenberger observer for position and velocity, driven by the estimated force.

    It measures the position from flux and current, ``q = g - k_1 i_1/φ_1 = k_2 i_2/φ_2 - g``, both
    weighted by least squares; the model is ``q̈ = (D²/J)(F_1 - F_2)``, F = c φ²/(2k).

    Parameters
    ----------
    machine : MagLev2DOF
    sample_time : float
        [s], > 0.
    bandwidth : float
        Both poles [rad/s], > 0.
    """

    machine: MagLev2DOF
    sample_time: float
    bandwidth: float = 200.0

    def __post_init__(self) -> None:
        for name in ("sample_time", "bandwidth"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ObserverError(f"{name} must be positive and finite, got {value}")

    def run(self, flux: ArrayLike, current: ArrayLike) -> tuple[Array, Array]:
        """Position [m] and velocity [m/s], (rows,) each; rows without a position are predicted.

        Parameters
        ----------
        flux, current : (rows, 2) array_like
            Estimated core fluxes [Wb], unbiased currents [A].
        """
        m, h = self.machine, self.sample_time
        phi = np.asarray(flux, float)
        measured, _ = m.position(phi, np.asarray(current, float))
        force = m.c_1 * phi[:, 0] ** 2 / (2 * m.k_1) - m.c_2 * phi[:, 1] ** 2 / (2 * m.k_2)
        acceleration = np.nan_to_num(m.D**2 / m.J * force)  # zero where the flux is missing
        # Double pole at e^{-h bandwidth} for a double integrator.
        pole = np.exp(-h * self.bandwidth)
        gain, gain_velocity = 1 - pole**2, (1 - pole) ** 2 / h
        usable = np.isfinite(measured) & (np.abs(measured) < m.g)
        q = measured[np.argmax(usable)] if usable.any() else 0.0
        velocity, out = 0.0, np.empty((len(phi), 2))
        for k in range(len(phi)):
            if k > 0:
                push = (acceleration[k - 1] + acceleration[k]) / 2
                q, velocity = q + h * velocity + h * h / 2 * push, velocity + h * push
            if usable[k]:
                error = measured[k] - q
                q, velocity = q + gain * error, velocity + gain_velocity * error
            out[k] = q, velocity
        return out[:, 0], out[:, 1]
