"""Closed-form records for the tests: exact currents, volt-seconds and voltages, then spoilt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fluxobs.machines import InteriorPMSM, Machine, SurfacePMSM, SynchronousReluctance, example

Array = NDArray[np.float64]


def vectors(z: NDArray[np.complex128]) -> Array:
    return np.stack([z.real, z.imag], axis=-1)


def wrapped_degrees(angle: Array) -> Array:
    return np.degrees((np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi)


@dataclass(frozen=True)
class Samples:
    """Rows of a record; voltage and volt-seconds belong to the interval that ends at each row."""

    sample_time: float
    theta: Array
    flux: Array
    current: Array  # measured: with bias and noise
    voltage: Array
    volt_seconds: Array  # ∫ (-R i_m + u_m) dt with the biases, without the noise
    drift: Array


def rotating(
    machine: Machine,
    sample_time: float,
    speed: Array | float,
    rows: int,
    i_dq: complex = 3j,
    current_bias: complex = 0,
    voltage_bias: complex = 0,
    noise: float = 0.0,
    theta0: float = 0.7,
    seed: int = 0,
) -> Samples:
    """Constant rotor-frame current; `speed` [rad/s] a number, or one for every row.

    The speed is constant over each interval, so every integral is a closed form.
    """
    h = sample_time
    omega = np.broadcast_to(np.asarray(speed, float), (rows,)).copy()
    theta = theta0 + np.concatenate([[0.0], np.cumsum(omega * h)])
    turn = np.exp(1j * theta)
    if isinstance(machine, SurfacePMSM):
        flux_dq = machine.L_s * i_dq + (machine.psi_f or 0.0)
    elif isinstance(machine, InteriorPMSM):
        flux_dq = machine.L_d * i_dq.real + 1j * machine.L_q * i_dq.imag + (machine.psi_f or 0.0)
    else:
        assert isinstance(machine, SynchronousReluctance)
        flux_dq = machine.L_d * i_dq.real + 1j * machine.L_q * i_dq.imag
    moving = np.abs(omega) > 1e-9
    safe = np.where(moving, omega, 1.0)
    integral = i_dq * np.where(moving, np.diff(turn) / (1j * safe), h * turn[1:])
    volt_seconds = flux_dq * np.diff(turn)
    voltage = (volt_seconds + machine.R_s * integral) / h + voltage_bias
    drift = machine.R_s * current_bias - voltage_bias
    rng = np.random.default_rng(seed)
    white = rng.standard_normal(rows) + 1j * rng.standard_normal(rows)
    current = i_dq * turn[1:] + current_bias + noise * white
    return Samples(
        h,
        theta[1:],
        vectors(flux_dq * turn[1:]),
        vectors(current),
        vectors(voltage),
        vectors(volt_seconds - h * drift),
        np.array([drift.real, drift.imag]),
    )


SERVO = example("servo-400w")
MACHINES = {name: example(name) for name in ("servo-400w", "pmsm-2kw2", "ipm-2kw2", "synrm-6kw7")}
#: A current in the rotor frame that suits each machine.
CURRENTS = {"servo-400w": 6j, "pmsm-2kw2": 4j, "ipm-2kw2": 4j, "synrm-6kw7": 8 + 10j}
