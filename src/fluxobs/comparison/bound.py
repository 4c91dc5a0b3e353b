"""Cramér–Rao bound of the position error, with unknown magnet flux, drift and motion.

The bound applies to machines with one inductance. Each sample measures the current with noise σ.
The bound assumes nothing about the rotor's motion. Each sample then gives one radial equation, ``|λ
- L i| = ψ``, with noise L σ. In the tangential direction only the present sample measures the
present angle, also with noise L σ. The current noise also enters the flux through R. Derivation:
docs/theory.md, section 12.
"""

from __future__ import annotations

import numpy as np

from ..core.arrays import Array


def position_bound(
    theta_e: Array,
    length: Array,
    sample_time: float,
    inductance: float,
    resistance: float,
    noise: float,
    drift_prior: float,
) -> Array:
    """Return the smallest standard deviation of the position at each sample [rad], (rows,).

    Parameters
    ----------
    theta_e : (rows,) ndarray
        True angle [rad].
    length : (rows,) ndarray
        True length of the position vector λ - L i [Wb].
    sample_time : float
        Sample time [s].
    inductance, resistance : float
        L of the position vector [H], R [Ω].
    noise : float
        Std of a current component [A], > 0.
    drift_prior : float
        Prior std of the drift [V].

    Returns
    -------
    (rows,) ndarray
        At most π/√3, the standard deviation of a uniformly distributed angle.
    """
    h, r = sample_time, (inductance * noise) ** 2
    psi = float(np.median(np.abs(length)))
    P = np.diag([psi**2, psi**2, drift_prior**2, drift_prior**2, psi**2])
    F = np.eye(5)
    F[0, 2] = F[1, 3] = h
    Q = np.zeros((5, 5))
    Q[0, 0] = Q[1, 1] = (h * resistance * noise) ** 2
    std = np.empty(len(theta_e))
    cross_covariance = h * resistance * inductance * noise**2  # of flux increment and measurement
    for k, (angle, radius) in enumerate(zip(theta_e, length, strict=True)):
        c, s = np.cos(angle), np.sin(angle)
        g = np.array([c, s, 0.0, 0.0, -1.0])
        Pg = P @ g
        innovation_variance = g @ Pg + r
        posterior = P - np.outer(Pg, Pg) / innovation_variance
        variance_across = (
            s * s * posterior[0, 0] - 2 * s * c * posterior[0, 1] + c * c * posterior[1, 1]
        )
        std[k] = np.sqrt(variance_across + r) / max(abs(radius), 1e-9 * psi)
        # Predict the next sample. Flux increment and measurement share the noise along e(φ).
        gain = F @ Pg + cross_covariance * np.array([c, s, 0.0, 0.0, 0.0])
        P = F @ P @ F.T + Q - np.outer(gain, gain) / innovation_variance
        P = (P + P.T) / 2
    return np.asarray(np.minimum(std, np.pi / np.sqrt(3)))
