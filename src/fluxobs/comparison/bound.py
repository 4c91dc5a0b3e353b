"""Least position error of an observer that does not know magnet flux, drift or motion.

Cramér–Rao bound, for machines with one inductance. Each sample measures the current with noise σ.
The position is free: the bound assumes nothing about the rotor's motion. Each sample then gives one
radial equation, ``|λ - L i| = ψ``, accurate to L σ. Across it, only the present sample tells the
present angle, with noise L σ. The same noise also enters the flux, through R. Derivation:
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
    """Standard deviation of the position at each sample [rad], (rows,).

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
        Limited to that of a uniformly distributed angle, π/√3.
    """
    h, r = sample_time, (inductance * noise) ** 2
    psi = float(np.median(np.abs(length)))
    P = np.diag([psi**2, psi**2, drift_prior**2, drift_prior**2, psi**2])
    F = np.eye(5)
    F[0, 2] = F[1, 3] = h
    Q = np.zeros((5, 5))
    Q[0, 0] = Q[1, 1] = (h * resistance * noise) ** 2
    out = np.empty(len(theta_e))
    shared = h * resistance * inductance * noise**2  # covariance of flux step and measurement
    for k, (angle, size) in enumerate(zip(theta_e, length, strict=True)):
        c, s = np.cos(angle), np.sin(angle)
        g = np.array([c, s, 0.0, 0.0, -1.0])
        Pg = P @ g
        seen = g @ Pg + r
        now = P - np.outer(Pg, Pg) / seen
        across = s * s * now[0, 0] - 2 * s * c * now[0, 1] + c * c * now[1, 1]
        out[k] = np.sqrt(across + r) / max(abs(size), 1e-9 * psi)
        # Predict the next sample; flux step and measurement share their noise along e(φ).
        gain = F @ Pg + shared * np.array([c, s, 0.0, 0.0, 0.0])
        P = F @ P @ F.T + Q - np.outer(gain, gain) / seen
        P = (P + P.T) / 2
    return np.asarray(np.minimum(out, np.pi / np.sqrt(3)))
