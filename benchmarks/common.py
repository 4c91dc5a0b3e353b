"""Description of the computer and closed-form records, shared by the benchmarks."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fluxobs.machines import RotatingMachine
from fluxobs.machines.model.frames import angle_error, wrap
from fluxobs.simulation.closed_form.signals import steady, vectors

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parent.parent
#: Measured logs for development; not part of the project.
MEASURED = Path(os.environ.get("FLUXOBS_DATA", ROOT.parent / "shared" / "data")) / "itmo_spmsm"


def machine_line() -> str:
    """Return a text with processor, cores and Python version, to print with the results."""
    model = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        model = names[0].split(":")[1].strip() if names else model
    return f"{model}, {os.cpu_count()} cores, Python {platform.python_version()}"


def heading(title: str) -> None:
    print(f"\n{title}\n    on {machine_line()}")


@dataclass(frozen=True)
class Drive:
    """A machine at constant speed and current, with exact integrals."""

    machine: RotatingMachine
    omega: float  # electrical, rad/s
    current: complex  # in the rotor frame, d + jq [A]
    sample_time: float
    theta0: float = 1.0

    def samples(self, rows: int) -> tuple[Array, Array, Array, Array]:
        """Return (true angle, current, volt-seconds ∫(u - R i) dt, mean voltage).

        Vectors have the shape (rows, 2). Volt-seconds and mean voltage cover the interval that ends
        at the row.
        """
        start = self.theta0 - self.omega * self.sample_time
        true = steady(self.machine, self.sample_time, self.omega, rows, self.current, start)
        theta, current = wrap(true.theta_e[1:]), vectors(true.current[1:])
        return theta, current, vectors(true.volt_seconds), vectors(true.voltage)


def degrees_error(estimated: Array, true: Array, half_turn: bool = False) -> Array:
    return np.asarray(np.degrees(angle_error(estimated, true, half_turn)))
