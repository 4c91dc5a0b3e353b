"""Generate the demonstration log in closed form; demo_log.csv is the shipped copy.

A servo motor (machine "servo-400w") accelerates, is loaded, and reverses through zero. Position and
currents are prescribed smooth functions. The machine's equations give the flux linkage, and its
change gives the true voltages without integration errors. The errors of a real drive are then
added: the inverter's dead time and device drops, and the sensors' offsets, noise and quantisation.

``python -m fluxobs.simulation.closed_form.demo FILE`` writes the log.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...core.arrays import Array
from ...core.output import write_text
from ...logs import Log, read_log
from ...machines import example, rotating
from ...machines.model.frames import wrap
from .sensors import Sensor, Steps
from .signals import driven, inverter_loss, vectors

#: The shipped log.
LOG = Path(__file__).with_name("demo_log.csv")
MACHINE = "servo-400w"
SAMPLE_TIME = 2e-4  # In seconds.
DURATION = 2.0  # In seconds.
CURRENT_OFFSET = (0.15, -0.10)  # In ampere, about 1 % of the rated current.
VOLTAGE_OFFSET = (-0.12, 0.08)  # In volt.
CURRENT_NOISE = 0.02  # In ampere.
CURRENT_STEP = 0.01  # In ampere, the step of a 12-bit converter over ±20 A.
VOLTAGE_STEP = 0.005  # In volt, the resolution of the modulator.
INVERTER_VOLTAGE = 0.15  # In volt per phase; dead time and drops after compensation.
KNEE = 0.2  # In ampere; the sign of a phase current is tanh(i / KNEE).
SEED = 20261121


def smooth(t: Array, *knots: tuple[float, float]) -> Array:
    """Interpolate knots (time, value) by half cosines; the value is constant outside the knots."""
    curve = np.full_like(t, knots[0][1])
    for (t0, y0), (t1, y1) in pairwise(knots):
        share = np.clip((t - t0) / (t1 - t0), 0.0, 1.0)
        curve += (y1 - y0) * (1 - np.cos(np.pi * share)) / 2
    return curve


def generate() -> dict[str, Array]:
    """Return the log's columns t, u_alpha, u_beta, i_alpha, i_beta and theta_e (the truth)."""
    machine = rotating(example(MACHINE))
    rows, parts = round(DURATION / SAMPLE_TIME), 16
    t = np.asarray(np.arange(rows * parts + 1) * SAMPLE_TIME / parts)
    speed = smooth(t, (0.0, 350.0), (0.3, 350.0), (0.6, 900.0), (1.0, 900.0), (1.5, -500.0))
    i_q = smooth(t, (0.3, 1.0), (0.4, 6.0), (0.6, 2.0), (0.8, 2.0), (0.81, 9.0), (1.0, 9.0))
    i_q += smooth(t, (1.0, 0.0), (1.1, -14.0), (1.5, -14.0), (1.6, -11.0))
    true = driven(machine, SAMPLE_TIME, speed, 1j * i_q, parts, theta0=0.8)

    command = vectors(true.voltage + inverter_loss(true.mean_current, INVERTER_VOLTAGE, KNEE))
    times = np.arange(rows) * SAMPLE_TIME
    voltage = Sensor(Steps(np.array([VOLTAGE_OFFSET])), quantum=VOLTAGE_STEP)
    current = Sensor(Steps(np.array([CURRENT_OFFSET])), CURRENT_NOISE, CURRENT_STEP)
    u = voltage.measure(times, command, SEED)
    i = current.measure(times, vectors(true.current[:-1]), SEED)
    return {
        "t": np.round(times, 7),
        "u_alpha": u[:, 0],
        "u_beta": u[:, 1],
        "i_alpha": i[:, 0],
        "i_beta": i[:, 1],
        "theta_e": np.round(wrap(true.theta_e[:-1]), 5),
    }


def demo_log() -> Log:
    """Open the shipped log of the machine "servo-400w", with its true angle.

    Examples
    --------
    >>> len(demo_log())
    10000
    """
    return read_log(LOG, truth={"theta_e": "theta_e"})


def write(path: str | Path) -> None:
    """Write the log as CSV."""
    columns = generate()
    digits = {"t": 4, "u_alpha": 3, "u_beta": 3, "i_alpha": 2, "i_beta": 2, "theta_e": 5}
    lines = [",".join(columns)]
    for row in zip(*columns.values(), strict=True):
        cells = (f"{v:.{digits[n]}f}" for n, v in zip(columns, row, strict=True))
        lines.append(",".join(cells))
    write_text(Path(path), "\n".join(lines) + "\n")


if __name__ == "__main__":
    write(sys.argv[1])
