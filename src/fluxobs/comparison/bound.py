"""Cramér–Rao bounds of the position error, with unknown magnet flux, drift and motion.

:func:`position_bound` is the bound from the samples up to now, for machines with one inductance.
Each sample measures the current with noise σ. The bound assumes nothing about the rotor's motion.
Each sample then gives one radial equation, ``|λ - L i| = ψ``, with noise L σ. In the tangential
direction only the present sample measures the present angle, also with noise L σ. The current noise
also enters the flux through R. Derivation: docs/theory.md, section 12.

:func:`two_sided_bound` is the bound from all samples of a record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..machines.rotating import SynchronousMachine

#: Weights of the current now and of the three before in the mean current of the last interval: the
#: cubic through the samples, which the observers integrate.
CUBIC = (9 / 24, 19 / 24, -5 / 24, 1 / 24)


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
    # State: flux, drift, ψ, and the noises of the last three samples, the newest first.
    h, L, n = sample_time, inductance, 11
    psi = float(np.median(np.abs(length)))
    P = np.diag([psi**2, psi**2, drift_prior**2, drift_prior**2, psi**2, *[noise**2] * 6])
    F = np.zeros((n, n))
    F[:5, :5] = np.eye(5)
    F[7:, 5:9] = np.eye(4)
    entry = np.zeros((n, 2))  # of the noise of the next sample
    entry[5:7] = np.eye(2)
    for axis in (0, 1):
        F[axis, 2 + axis] = h
        F[axis, 5 + axis :: 2] = -h * resistance * np.array(CUBIC[1:])
        entry[axis, axis] = -h * resistance * CUBIC[0]
    Q = noise**2 * entry @ entry.T
    std = np.empty(len(theta_e))
    for k, (angle, radius) in enumerate(zip(theta_e, length, strict=True)):
        c, s = np.cos(angle), np.sin(angle)
        radial, across = np.zeros(n), np.zeros(n)
        radial[[0, 1, 4, 5, 6]] = c, s, -1.0, -L * c, -L * s
        across[[0, 1, 5, 6]] = -s, c, L * s, -L * c
        gain = P @ radial
        P = P - np.outer(gain, gain) / (radial @ gain)
        std[k] = np.sqrt(across @ P @ across) / max(abs(radius), 1e-9 * psi)
        P = F @ P @ F.T + Q
        P = (P + P.T) / 2
    return np.asarray(np.minimum(std, np.pi / np.sqrt(3)))


@dataclass(frozen=True)
class Unknowns:
    """What a bound from both sides assumes to be unknown.

    Attributes
    ----------
    current_noise : float
        Std of a current component [A], > 0.
    drift_std : float
        Prior std of a component of the drift [V].
    drift_walk : float
        Std of the drift's change in a second [V/√s].
    voltage_walk : float or (rows,) ndarray
        Variance that a white voltage error adds to a flux component in a second [Wb^2/s].
    psi_std, resistance_std : float
        Prior stds of magnet flux [Wb] and resistance [Ω]; 0: known.
    """

    current_noise: float
    drift_std: float
    drift_walk: float = 0.0
    voltage_walk: float | Array = 0.0
    psi_std: float = 0.0
    resistance_std: float = 0.0


def two_sided_bound(
    machine: SynchronousMachine,
    theta_e: Array,
    current: Array,
    sample_time: float,
    unknowns: Unknowns,
) -> Array:
    """Return the smallest standard deviation of the position from all samples of a record [rad].

    Parameters
    ----------
    machine : SynchronousMachine
        Also with saliency or a flux map.
    theta_e : (rows,) ndarray
        True angle [rad].
    current : (rows, 2) ndarray
        True current in αβ [A].
    sample_time : float
        [s].
    unknowns : Unknowns

    Returns
    -------
    (rows,) ndarray
        At most π/√3. In rotor coordinates each sample has one residual along the auxiliary flux;
        the angle is the residual across it (docs/theory.md, section 16). A Kalman filter runs
        forwards, an information filter backwards.
    """
    h, n, noise = sample_time, len(theta_e), unknowns.current_noise
    rotor = np.exp(1j * theta_e)
    i = (current[:, 0] + 1j * current[:, 1]) / rotor
    flux, by_d, by_q = _flux_and_slopes(machine, i)
    auxiliary = flux + 1j * (i.real * by_q - i.imag * by_d)
    size = np.abs(auxiliary)
    along = auxiliary / size
    variance = noise**2 * (_dot(along, by_d) ** 2 + _dot(along, by_q) ** 2)
    across_noise = noise**2 * (_dot(1j * along, by_d) ** 2 + _dot(1j * along, by_q) ** 2)
    walk = np.zeros((n, 6, 6))
    change = h * np.broadcast_to(unknowns.voltage_walk, (n,)) + (h * machine.R_s * noise) ** 2
    walk[:, 0, 0] = walk[:, 1, 1] = change
    walk[:, 2, 2] = walk[:, 3, 3] = h * unknowns.drift_walk**2
    transition = np.tile(np.eye(6), (n, 1, 1))
    transition[:, 0, 2] = transition[:, 1, 3] = h
    transition[:, 0, 5], transition[:, 1, 5] = -h * current[:, 0], -h * current[:, 1]

    def rows(direction: NDArray[np.complex128]) -> Array:
        """Return the derivatives of the residual along a direction of the rotor."""
        stator = direction * rotor
        zero = np.zeros(n)
        return np.stack([stator.real, stator.imag, zero, zero, -direction.real, zero], axis=1)

    measured, across = rows(along), rows(1j * along)
    scale = float(np.median(size))
    prior = [scale, scale, unknowns.drift_std, unknowns.drift_std]
    P = np.diag(np.square([*prior, unknowns.psi_std, unknowns.resistance_std]))
    before = np.empty((n, 6, 6))  # covariance given samples up to k
    for k in range(n):
        if k > 0:
            P = transition[k] @ P @ transition[k].T + walk[k]
        gain = P @ measured[k]
        P = P - np.outer(gain, gain) / (measured[k] @ gain + variance[k])
        before[k] = P
    information = np.zeros((6, 6))  # of the samples behind k
    std = np.empty(n)
    for k in reversed(range(n)):
        smoothed = before[k] @ np.linalg.inv(np.eye(6) + information @ before[k])
        std[k] = np.sqrt(across[k] @ smoothed @ across[k] + across_noise[k]) / size[k]
        total = information + np.outer(measured[k], measured[k]) / variance[k]
        total = np.linalg.inv(np.eye(6) + total @ walk[k]) @ total
        information = transition[k].T @ total @ transition[k]
        information = (information + information.T) / 2
    return np.asarray(np.minimum(std, np.pi / np.sqrt(3)))


def _dot(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> Array:
    return np.asarray((a * b.conj()).real)


def _flux_and_slopes(
    machine: SynchronousMachine, current: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the flux and its derivatives by i_d and i_q."""
    step = 1e-4 * (machine.rated_current or float(np.abs(current).max()) or 1.0)
    slopes = [
        (machine.flux_dq(current + side) - machine.flux_dq(current - side)) / (2 * step)
        for side in (step, 1j * step)
    ]
    return machine.flux_dq(current), slopes[0], slopes[1]
