"""Records for the tests: signals of fluxobs.simulation.closed_form, with errors added."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fluxobs.machines import RotatingMachine, SurfacePMSM, example
from fluxobs.simulation.closed_form import signals
from fluxobs.simulation.closed_form.signals import Signals, between_rows, inverter_loss, vectors

Array = NDArray[np.float64]

SERVO = example("servo-400w")
MACHINES = {name: example(name) for name in ("servo-400w", "pmsm-2kw2", "ipm-2kw2", "synrm-6kw7")}
#: Typical current of each machine, in the rotor frame.
CURRENTS = {"servo-400w": 6j, "pmsm-2kw2": 4j, "ipm-2kw2": 4j, "synrm-6kw7": 8 + 10j}
PMSM = MACHINES["pmsm-2kw2"]
#: Sample time of :func:`course` and :func:`profile` [s].
COURSE_TIME = 1.25e-4
#: Number of integration steps per sample in :func:`driven`.
PARTS = 16
_T = 1e-3 * np.arange(200)
#: Channels of a small log; the tests that use it are about other contents of a file.
SMALL_LOG = {
    "t": _T,
    "u_alpha": np.cos(_T),
    "u_beta": np.sin(_T),
    "i_alpha": np.cos(_T),
    "i_beta": np.sin(_T),
}


def wrapped_degrees(angle: Array) -> Array:
    return np.degrees((np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi)


@dataclass(frozen=True)
class Samples:
    """Rows of a record; voltage and volt-seconds belong to the interval that ends at each row."""

    sample_time: float
    theta: Array
    flux: Array
    current: Array  # as measured, with bias and noise
    voltage: Array
    volt_seconds: Array  # ∫ (-R i_m + u_m) dt with biases, without noise
    drift: Array


def white(rows: int, seed: int) -> NDArray[np.complex128]:
    rng = np.random.default_rng(seed)
    return np.asarray(rng.standard_normal(rows) + 1j * rng.standard_normal(rows))


def steady(
    machine: RotatingMachine,
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
    """Return a record at constant rotor-frame current; `speed` [rad/s] is a number or an array."""
    true = signals.steady(machine, sample_time, speed, rows, i_dq, theta0)
    drift = machine.R_s * current_bias - voltage_bias
    return Samples(
        sample_time,
        true.theta_e[1:],
        vectors(true.flux[1:]),
        vectors(true.current[1:] + current_bias + noise * white(rows, seed)),
        vectors(true.voltage + voltage_bias),
        vectors(true.volt_seconds - sample_time * drift),
        vectors(np.array(drift, complex)),
    )


def driven(
    machine: RotatingMachine,
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
    """Return a record with this speed and rotor-frame current, both linear between rows.

    The true R_s and psi_f may differ from the values in `machine`. The inverter loses `inverter`
    volts per phase, with the sign tanh(i / smoothing) of the phase current.
    """
    changes = {"R_s": R_s, "psi_f": psi_f}
    machine = machine.with_values(**{k: v for k, v in changes.items() if v is not None})
    true: Signals = signals.driven(
        machine,
        sample_time,
        between_rows(speed, PARTS),
        between_rows(np.asarray(i_dq, complex), PARTS),
        PARTS,
        theta0,
    )
    loss = inverter_loss(true.mean_current, inverter, smoothing)
    before = np.array([np.nan + 1j * np.nan])  # unknown before the first row
    volt_seconds = true.volt_seconds + sample_time * (loss + voltage_bias)
    return Samples(
        sample_time,
        true.theta_e,
        vectors(true.flux),
        vectors(true.current + noise * white(len(speed), seed)),
        vectors(np.concatenate([before, true.voltage + loss + voltage_bias])),
        vectors(np.concatenate([before, volt_seconds])),
        vectors(np.array(-voltage_bias, complex)),
    )


def profile(*knots: tuple[float, float]) -> Array:
    """Return one value every COURSE_TIME, linear between the knots (time [s], value)."""
    t, values = zip(*knots, strict=True)
    return np.asarray(np.interp(np.arange(0, t[-1], COURSE_TIME), t, values), float)


def course(**options: Any) -> Samples:
    """Record the 2.2 kW servo at half speed with load steps, and a reversal under load."""
    speed = profile((0, 0), (0.3, 236), (1.2, 236), (1.6, -236), (2.5, -236))
    steps = ((0, 1), (0.6, 1), (0.61, 6), (1.0, 6), (1.01, 2), (1.9, 2), (1.91, -5), (2.5, -5))
    return driven(PMSM, COURSE_TIME, speed, 1j * profile(*steps), noise=0.02, **options)


def log_columns(samples: Samples) -> dict[str, Array]:
    """Return the columns of a log with lag 0: the voltage of row k acts from k to k + 1."""
    u = np.concatenate([samples.voltage[1:], samples.voltage[-1:]])
    return {
        "t": np.arange(len(u)) * samples.sample_time,
        "u_alpha": u[:, 0],
        "u_beta": u[:, 1],
        "i_alpha": samples.current[:, 0],
        "i_beta": samples.current[:, 1],
    }


def held(
    machine: SurfacePMSM,
    sample_time: float,
    speed: float,
    current_q: Callable[[Array], Array],
    seconds: float,
    current_bias: complex = 0.0,
    voltage_bias: complex = 0.0,
    noise: float = 0.0,
    seed: int = 0,
) -> Samples:
    """Return a record of a surface machine at constant speed; each sample's voltage is held.

    The record is the exact solution of the differential equation. Each voltage brings i_q to the
    reference at the end of its sample.
    """
    R, L, psi = machine.R_s, machine.L_s, machine.psi_f
    rows = round(seconds / sample_time)
    theta = speed * sample_time * np.arange(rows)
    reference = 1j * current_q(sample_time * np.arange(rows)) * np.exp(1j * theta)
    decay = np.exp(-R / L * sample_time)
    forced = -1j * speed * psi / (R + 1j * speed * L) * np.exp(1j * theta)
    current, voltage = np.full(rows, reference[0]), np.zeros(rows, complex)
    for k in range(1, rows):
        free = (current[k - 1] - forced[k - 1]) * decay + forced[k]
        voltage[k] = (reference[k] - free) * R / (1 - decay)
        current[k] = free + voltage[k] / R * (1 - decay)
    flux = L * current + psi * np.exp(1j * theta)
    drift = R * current_bias - voltage_bias
    volt_seconds = np.diff(flux, prepend=flux[0]) - sample_time * drift
    return Samples(
        sample_time,
        theta,
        vectors(flux),
        vectors(current + current_bias + noise * white(rows, seed)),
        vectors(voltage + voltage_bias),
        vectors(volt_seconds),
        vectors(np.array(drift, complex)),
    )
