"""The log of the demonstration: made here, from a closed form, shipped as demo_data/log.csv.

A servo motor (machine "servo-400w") runs up, is loaded, and reverses through zero. Position and
currents are prescribed, smooth functions; flux linkage follows from the machine's equations and the
true voltages from its change, so there is no integrator whose error would stand in the data. Then
comes what a real drive adds: the inverter takes dead time and device drops from the commanded
voltage, sensors have offsets, noise and the steps of their converter.

``python -m fluxobs.demo FILE`` writes it anew.
"""

from __future__ import annotations

import sys
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .frames import clarke
from .machines import SurfacePMSM, example

Array = NDArray[np.float64]

MACHINE = "servo-400w"
SAMPLE_TIME = 2e-4  # s
DURATION = 2.0  # s
CURRENT_OFFSET = (0.15, -0.10)  # A, about 1 % of the rated current
VOLTAGE_OFFSET = (-0.12, 0.08)  # V
CURRENT_NOISE = 0.02  # A
CURRENT_STEP = 0.01  # A: a 12-bit converter over ±20 A
VOLTAGE_STEP = 0.005  # V: resolution of the modulator
INVERTER_VOLTAGE = 0.15  # V a phase, dead time and device drops left after compensation
SEED = 20261121


def _smooth(t: Array, *knots: tuple[float, float]) -> Array:
    """Through the knots (time, value) with level ends and half cosines between."""
    out = np.full_like(t, knots[0][1])
    for (t0, y0), (t1, y1) in pairwise(knots):
        share = np.clip((t - t0) / (t1 - t0), 0.0, 1.0)
        out += (y1 - y0) * (1 - np.cos(np.pi * share)) / 2
    return out


def generate() -> dict[str, Array]:
    """Columns of the log: t, u_alpha, u_beta, i_alpha, i_beta, theta_e (the truth)."""
    machine = example(MACHINE)
    assert isinstance(machine, SurfacePMSM)
    assert machine.psi_f is not None
    rows, inner = round(DURATION / SAMPLE_TIME), 16
    h = SAMPLE_TIME / inner
    t = np.asarray(np.arange(rows * inner + 1) * h)
    speed = _smooth(t, (0.0, 350.0), (0.3, 350.0), (0.6, 900.0), (1.0, 900.0), (1.5, -500.0))
    angle = 0.8 + np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * h)])
    i_q = _smooth(t, (0.3, 1.0), (0.4, 6.0), (0.6, 2.0), (0.8, 2.0), (0.81, 9.0), (1.0, 9.0))
    i_q += _smooth(t, (1.0, 0.0), (1.1, -14.0), (1.5, -14.0), (1.6, -11.0))
    turn = np.exp(1j * angle)
    current = 1j * i_q * turn
    flux = machine.L_s * current + machine.psi_f * turn
    # Simpson's rule over the sixteen parts of every sample.
    weights = np.array([1, 4, 2, 4, 2, 4, 2, 4, 2, 4, 2, 4, 2, 4, 2, 4]) * h / 3
    integral = current[:-1].reshape(rows, inner) @ weights + current[inner::inner] * h / 3
    voltage = (np.diff(flux[::inner]) + machine.R_s * integral) / SAMPLE_TIME

    mean = integral / SAMPLE_TIME
    phases = (mean * np.exp(-2j * np.pi / 3 * k) for k in range(3))
    drop = clarke(*(np.tanh(phase.real / 0.2) for phase in phases))
    command = np.stack([voltage.real, voltage.imag], axis=1) + INVERTER_VOLTAGE * drop
    measured = np.stack([current[:-1:inner].real, current[:-1:inner].imag], axis=1)
    noise = np.random.default_rng(SEED).normal(0.0, CURRENT_NOISE, measured.shape)
    command = _quantise(command + VOLTAGE_OFFSET, VOLTAGE_STEP)
    measured = _quantise(measured + CURRENT_OFFSET + noise, CURRENT_STEP)
    truth = np.angle(turn[:-1:inner])
    return {
        "t": np.round(np.arange(rows) * SAMPLE_TIME, 7),
        "u_alpha": command[:, 0],
        "u_beta": command[:, 1],
        "i_alpha": measured[:, 0],
        "i_beta": measured[:, 1],
        "theta_e": np.round(truth, 5),
    }


def _quantise(values: Array, step: float) -> Array:
    return np.asarray(np.round(values / step) * step)


def log_file() -> Traversable:
    """The shipped log."""
    return resources.files(__package__) / "demo_data" / "log.csv"


def write(path: str | Path) -> None:
    """Writes the log as CSV."""
    columns = generate()
    digits = {"t": 4, "u_alpha": 3, "u_beta": 3, "i_alpha": 2, "i_beta": 2, "theta_e": 5}
    lines = [",".join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = (f"{v:.{digits[n]}f}" for n, v in zip(columns, row, strict=True))
        lines.append(",".join(cells))
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write(sys.argv[1])
