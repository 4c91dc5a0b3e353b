"""The command line, in this process to test its interface, or as a separate process."""

from __future__ import annotations

import contextlib
import io
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from fluxobs.cli import main

#: Columns of the plain observer's estimates, in order.
SMOOTHED = [
    *("t", "flux_alpha", "flux_beta", "flux_alpha_std", "flux_beta_std", "psi_f", "psi_f_std"),
    *("theta_e", "theta_e_std", "speed_e", "speed_e_std", "drift_alpha", "drift_beta", "drift_std"),
    *("resistance", "resistance_std", "inverter_voltage", "inverter_voltage_std"),
    *("torque", "speed_mech", "torque_std", "quality", "valid"),
]
COLUMNS = [
    "t",
    "flux_alpha",
    "flux_beta",
    "psi_f",
    "theta_e",
    "theta_e_tracked",
    "speed_e",
    "drift_alpha",
    "drift_beta",
    "theta_e_std",
    "torque",
    "speed_mech",
    "quality",
    "valid",
]


@dataclass(frozen=True)
class Done:
    """Result of a command, with the fields of subprocess.run."""

    returncode: int
    stdout: str
    stderr: str


def fluxobs(*arguments: object, folder: Path) -> Done:
    """Run `fluxobs ARGUMENTS` in a folder, through the entry point. Uncaught errors propagate."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        with (
            mock.patch.object(sys, "argv", ["fluxobs", *map(str, arguments)]),
            contextlib.chdir(folder),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            try:
                main()
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return Done(code, out.getvalue(), err.getvalue())


def process(*arguments: object, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run `python -m fluxobs ARGUMENTS` in a folder."""
    return subprocess.run(
        [sys.executable, "-m", "fluxobs", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=folder,
        encoding="utf-8",
        check=False,
    )
