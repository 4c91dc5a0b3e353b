"""Closed-form records for the tests: exact currents, volt-seconds and voltages, then spoilt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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


def driven(
    machine: Machine,
    sample_time: float,
    speed: Array,
    i_dq: Array,
    *,
    R_s: float | None = None,
    psi_f: float | None = None,
    inverter: float = 0.0,
    smoothing: float = 0.1,
    voltage_bias: complex = 0,
    noise: float = 0.0,
    theta0: float = 0.7,
    seed: int = 0,
) -> Samples:
    """Any course of speed and rotor-frame current, one of each a row; straight between rows.

    The machine's true R_s and psi_f may be others than in `machine`, and `inverter` volts a phase
    are lost against the sign of its current, tanh(i / smoothing). Integrals by the midpoint rule
    over 16 parts of each interval.
    """
    parts, rows, h = 16, len(speed), sample_time
    k = np.arange((rows - 1) * parts + 1) / parts
    R = machine.R_s if R_s is None else R_s
    psi = (getattr(machine, "psi_f", None) or 0.0) if psi_f is None else psi_f
    L_d = getattr(machine, "L_d", machine.position_inductance)
    L_q = machine.position_inductance
    middle = (k[1:] + k[:-1]) / 2
    omega = np.interp(middle, np.arange(rows), speed)
    theta = theta0 + np.concatenate([[0.0], np.cumsum(omega) * h / parts])
    fine = np.interp(k, np.arange(rows), i_dq.real) + 1j * np.interp(k, np.arange(rows), i_dq.imag)
    flux = (L_d * fine.real + 1j * L_q * fine.imag + psi) * np.exp(1j * theta)
    half = (theta[1:] + theta[:-1]) / 2
    between = (fine[1:] + fine[:-1]) / 2 * np.exp(1j * half)
    mean = between.reshape(rows - 1, parts).mean(axis=1)
    lost = np.zeros(rows - 1, complex)
    for phase in range(3):
        turn = np.exp(2j * np.pi / 3 * phase)
        sign = np.tanh((between * turn.conj()).real / smoothing)
        lost += 2 / 3 * turn * sign.reshape(rows - 1, parts).mean(axis=1)
    voltage = np.diff(flux[::parts]) / h + R * mean + inverter * lost + voltage_bias
    rng = np.random.default_rng(seed)
    white = noise * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    current = fine[::parts] * np.exp(1j * theta[::parts]) + white
    before = np.array([np.nan + 1j * np.nan])
    volt_seconds = np.concatenate([before, h * (voltage - R * mean)])
    return Samples(
        h,
        theta[::parts],
        vectors(flux[::parts]),
        vectors(current),
        vectors(np.concatenate([before, voltage])),
        vectors(volt_seconds),
        vectors(np.array(-voltage_bias, complex)),
    )


PMSM = MACHINES["pmsm-2kw2"]
#: Sample time of the courses [s].
COURSE_TIME = 1.25e-4


def profile(*knots: tuple[float, float]) -> Array:
    """Straight lines through (time [s], value), a value every COURSE_TIME."""
    t, values = zip(*knots, strict=True)
    return np.asarray(np.interp(np.arange(0, t[-1], COURSE_TIME), t, values), float)


def course(**given: Any) -> Samples:
    """The 2.2 kW servo at half speed with steps of load, and a reversal under load."""
    speed = profile((0, 0), (0.3, 236), (1.2, 236), (1.6, -236), (2.5, -236))
    steps = ((0, 1), (0.6, 1), (0.61, 6), (1.0, 6), (1.01, 2), (1.9, 2), (1.91, -5), (2.5, -5))
    return driven(PMSM, COURSE_TIME, speed, 1j * profile(*steps), noise=0.02, **given)


def log_columns(samples: Samples) -> dict[str, Array]:
    """Columns of a log with lag 0: the voltage of row k acts from k to k + 1."""
    u = np.concatenate([samples.voltage[1:], samples.voltage[-1:]])
    return {
        "t": np.arange(len(u)) * samples.sample_time,
        "u_alpha": u[:, 0],
        "u_beta": u[:, 1],
        "i_alpha": samples.current[:, 0],
        "i_beta": samples.current[:, 1],
    }
