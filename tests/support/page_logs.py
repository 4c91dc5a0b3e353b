"""Logs of every shipped machine for tests of the page."""

from pathlib import Path

import numpy as np
import polars as pl

from fluxobs import LeastSquaresObserver
from fluxobs.machines import RotatingMachine, example
from fluxobs.research.paper.levitation import SCENARIOS, record
from fluxobs.simulation.closed_form.firmware_record import firmware_record

SAMPLE_TIME = 1e-4


def written(name: str, folder: Path) -> Path:
    """Write a log of a shipped machine, with gaps, spikes and offsets; return its path."""
    machine, path = example(name), folder / f"{name}.csv"
    columns = _turning(machine) if isinstance(machine, RotatingMachine) else _levitated(machine)
    pl.DataFrame(columns).fill_nan(None).write_csv(path)
    return path


def _turning(machine: RotatingMachine) -> dict[str, np.ndarray]:
    observer = LeastSquaresObserver.for_machine(machine, sample_time=SAMPLE_TIME)
    run = firmware_record(machine, observer)
    voltage = np.roll(run.voltage, -1, axis=0)  # in a log, a row's voltage acts after this row
    return {
        "t": SAMPLE_TIME * np.arange(len(voltage)),
        "u_alpha": voltage[:, 0],
        "u_beta": voltage[:, 1],
        "i_alpha": run.current[:, 0],
        "i_beta": run.current[:, 1],
        "theta_e": run.theta_e,
    }


def _levitated(machine) -> dict[str, np.ndarray]:
    drive, rows = record(SCENARIOS["S5"], quick=True), 1500
    current, sums = drive.current[: rows + 1], np.cumsum(drive.volt_seconds, axis=0)[: rows + 1]
    mean = (current[:-1] + current[1:]) / 2
    voltage = (np.diff(sums, axis=0) / drive.h + mean @ machine.R.T) @ np.linalg.inv(machine.B.T)
    return {
        "t": drive.t[:rows],
        "u_1": voltage[:, 0],
        "u_2": voltage[:, 1],
        "i_1": current[:rows, 0],
        "i_2": current[:rows, 1],
        "y": drive.trajectory.position[:rows, 0],
    }
