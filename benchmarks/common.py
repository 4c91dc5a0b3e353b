"""What the benchmarks share: the machine they ran on, and closed-form records."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fluxobs.model.frames import angle_error, wrap

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parent.parent
#: Measured logs for development; not part of the project.
MEASURED = Path(os.environ.get("FLUXOBS_DATA", ROOT.parent / "shared" / "data")) / "itmo_spmsm"


def machine_line() -> str:
    """Processor, cores and Python, to stand beside every number."""
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
    """Closed form of a surface PMSM at constant speed and current: every integral is exact."""

    R_s: float
    L_s: float
    psi_f: float
    omega: float  # electrical, rad/s
    current: complex  # in the rotor frame, d + jq [A]
    sample_time: float
    theta0: float = 1.0

    def samples(self, rows: int) -> tuple[Array, Array, Array, Array]:
        """True angle, current, volt-seconds ∫(u - R i) and mean voltage over the interval that
        ends at each row; vectors (rows, 2)."""
        theta = self.theta0 + self.omega * self.sample_time * np.arange(-1, rows)
        turn = np.exp(1j * theta)
        flux = (self.L_s * self.current + self.psi_f) * turn
        integral = self.current * np.diff(turn) / (1j * self.omega)
        volt_seconds = np.diff(flux)
        voltage = (volt_seconds + self.R_s * integral) / self.sample_time
        current = self.current * turn[1:]
        return wrap(theta[1:]), vectors(current), vectors(volt_seconds), vectors(voltage)


def vectors(z: NDArray[np.complex128]) -> Array:
    return np.stack([z.real, z.imag], axis=-1)


def degrees_error(estimated: Array, true: Array, half_turn: bool = False) -> Array:
    return np.asarray(np.degrees(angle_error(estimated, true, half_turn)))
