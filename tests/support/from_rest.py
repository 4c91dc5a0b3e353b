"""Drives that start from rest with injection, in C: motor, inverter, control, observer."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np

import fluxobs
from fluxobs.machines import InteriorPMSM, SynchronousReluctance

from .at_rest import RATED_SPEED
from .at_rest import H as SAMPLE_TIME
from .compiling import build_program
from .firmware import HARNESS, firmware_objects

#: R is assumed 20 % too large.
RESISTANCE = 1.2


def build(
    machine: InteriorPMSM | SynchronousReluctance, folder: Path, L_d: float = 1.0, L_q: float = 1.0
) -> Path:
    """Return the program for an observer that assumes these multiples of the inductances."""
    given = machine.with_values(
        R_s=RESISTANCE * machine.R_s, L_d=L_d * machine.L_d, L_q=L_q * machine.L_q
    )
    unknowns = ("drift", "resistance", "inverter")
    fluxobs.export(given, SAMPLE_TIME, folder / "motor", unknowns=unknowns)
    motor, program = folder / "motor", folder / "at_rest"
    sources = [*motor.glob("*obs*.c")]
    sources += [motor / "runtime" / f"fluxobs_{name}.c" for name in ("inject", "seed")]
    objects = firmware_objects(sources, includes=[motor, motor / "runtime"])
    options = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    options += [f"-I{motor}", f"-I{motor / 'runtime'}"]
    return build_program(["gcc"], options, [HARNESS / "at_rest.c", *objects], program)


def drive(
    machine: InteriorPMSM | SynchronousReluctance,
    seed: int,
    L_d: float = 1.0,
    L_q: float = 1.0,
    saturation: float = 0.1,
    **more: float,
) -> dict[str, float]:
    """Return the parameters of a drive (tests/firmware/at_rest.c).

    Full load from the start, dead time of 1.5 % of the period, offsets of 1 %, noise of 0.2 %, 12
    bits of ± 5 rated currents. `saturation` is the change of the difference of the inductances at
    ± 30 % of the rated current along d.
    """
    rng = np.random.default_rng(seed)
    rated = machine.rated_current
    assert rated is not None
    psi, apart = machine.magnet_flux or 0.0, machine.L_q - machine.L_d
    active = psi if psi > 0 else -apart * 0.5 * rated
    return {
        **{"R": machine.R_s, "L_d": machine.L_d, "L_q": machine.L_q, "psi": psi},
        **{"pole_pairs": machine.n_p, "saturation": saturation / 0.3 * max(apart, 0) / machine.L_d},
        **{"J": 0.015, "load": 1.5 * machine.n_p * active * rated * (1 if psi > 0 else 0.7)},
        **{"link": 540.0, "dead_time": 1.5e-6, "drop": 1.0, "sample_time": SAMPLE_TIME},
        **{"rated_current": rated, "rated_speed": RATED_SPEED, "noise": 0.002 * rated, "bits": 12},
        **dict(zip(("offset_alpha", "offset_beta"), rng.normal(0, 0.01, 2) * rated, strict=True)),
        **{"theta": rng.uniform(-3, 3), "seed": seed, "hold": 2.0, "duration": 6.0, "speed": 0.01},
        **{"given_L_d": L_d * machine.L_d, "given_L_q": L_q * machine.L_q, "voltage": 250.0},
        **{"current": 0.05 * rated, "bias": (0.3 if psi > 0 else 0.5) * rated},
        **{"std": np.radians(1.5), "inject": 1.0, **more},
    }


def run(program: Path, values: dict[str, float]) -> dict[str, float]:
    """Run a drive; return what the program prints."""
    given = "\n".join(f"{name} {float(value)!r}" for name, value in values.items())
    done = subprocess.run([program], input=given, capture_output=True, text=True, check=True)
    lines = (line.split() for line in done.stdout.strip().split("\n"))
    return {name: float(value) for name, value in lines}
