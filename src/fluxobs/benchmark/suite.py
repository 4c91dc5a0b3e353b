"""The suite: a versioned folder of logs, machine files and truth, made from a seed."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..core.arrays import Array
from ..core.output import make_folder, write_text
from ..errors import FluxobsError
from ..machines import RotatingMachine, as_machine, rotating
from ..machines.files import copy_example
from .draws import COURSES, ERRORS, MACHINES
from .drives import simulated

#: Version of the suite: scores of different versions cannot be compared.
VERSION = 1
#: Seed of the public suite.
PUBLIC_SEED = 1
INDEX = "index.json"


@dataclass(frozen=True)
class Entry:
    """A record of the suite.

    Attributes
    ----------
    name, machine, course, errors : str
    sample_time : float
        [s].
    """

    name: str
    machine: str
    course: str
    errors: str
    sample_time: float


@dataclass(frozen=True)
class Suite:
    """A folder of records.

    Attributes
    ----------
    folder : path
    seed : int
        0 for measured records.
    entries : tuple of Entry
    ratings : dict
        Ratings of the drives of machines that are not shipped, as in a campaign.
    """

    folder: Path
    seed: int
    entries: tuple[Entry, ...]
    ratings: dict[str, dict[str, float]]

    @property
    def measured(self) -> bool:
        """Whether the records are measured."""
        return bool(self.ratings)

    @property
    def title(self) -> str:
        """Name of the suite in tables."""
        what = "measured" if self.measured else f"seed {self.seed}"
        return f"Suite {VERSION}, {what}, {len(self.entries)} records"

    def machine_file(self, entry: Entry) -> Path:
        """Return the machine file of a record, which the entrant knows."""
        return self.folder / "machines" / f"{entry.machine}.toml"

    def machine(self, entry: Entry) -> RotatingMachine:
        """Return the machine of a record, as its file describes it."""
        return rotating(as_machine(self.machine_file(entry)), "a benchmark")

    def log(self, entry: Entry) -> tuple[Array, Array]:
        """Return voltages and currents, (rows, 2): commanded from the row on, measured at it."""
        table = pl.read_parquet(self.folder / "logs" / f"{entry.name}.parquet")
        voltage = table.select("u_alpha", "u_beta").to_numpy()
        return voltage, table.select("i_alpha", "i_beta").to_numpy()

    def truth(self, entry: Entry) -> dict[str, Array]:
        """Return theta_e [rad] of the rows, and speed_e [rad/s] and torque [N m] if simulated."""
        table = pl.read_parquet(self.folder / "truth" / f"{entry.name}.parquet")
        return {name: table[name].to_numpy() for name in table.columns}


def write_suite(
    folder: Path,
    seed: int = PUBLIC_SEED,
    drives: int = 1,
    progress: Callable[[int, int], Any] | None = None,
) -> Suite:
    """Simulate the suite into a new folder.

    Parameters
    ----------
    folder : path
    seed : int
        1 is the public suite; whoever judges takes another.
    drives : int
        Drives of each machine, course and kind of errors.

    Raises
    ------
    FluxobsError
        The folder cannot be written, or contains a suite already.
    """
    new_folder(folder)
    entries: list[Entry] = []
    cells = [(m, c, e) for m in MACHINES for c in COURSES for e in ERRORS]
    for n, (machine, course, errors) in enumerate(cells):
        copy_example(machine, folder / "machines")
        for k, drive in enumerate(simulated(machine, course, drives, seed, ERRORS[errors])):
            name = "-".join([machine, course, errors, str(k)]).replace(" ", "-")
            t = drive.sample_time * np.arange(len(drive.voltage))
            log = {"t": t, "u_alpha": drive.voltage.real, "u_beta": drive.voltage.imag}
            log |= {"i_alpha": drive.current.real, "i_beta": drive.current.imag}
            truth = {"theta_e": drive.theta, "speed_e": drive.speed_e, "torque": drive.torque}
            for place, columns in (("logs", log), ("truth", truth)):
                path = folder / place / f"{name}.parquet"
                pl.DataFrame(columns).write_parquet(path, compression="zstd")
            entries.append(Entry(name, machine, course, errors, drive.sample_time))
        if progress is not None:
            progress(n + 1, len(cells))
    return write_index(Suite(folder, seed, tuple(entries), {}))


def new_folder(folder: Path) -> None:
    """Create the folder of a suite; FluxobsError if it contains anything but an unfinished one."""
    make_folder(folder, INDEX, force=False)
    parts = ("logs", "truth", "machines")
    other = sorted(entry.name for entry in folder.iterdir() if entry.name not in parts)
    if other:
        raise FluxobsError(f"{folder}: contains {other[0]}; give a new folder for the suite")
    for name in parts:
        (folder / name).mkdir(exist_ok=True)


def write_index(suite: Suite) -> Suite:
    """Write the index, the last file of a suite: a suite with an index is complete."""
    records = [asdict(entry) for entry in suite.entries]
    index = {"version": VERSION, "seed": suite.seed, "ratings": suite.ratings, "records": records}
    write_text(suite.folder / INDEX, json.dumps(index, indent=1) + "\n")
    return suite


def read_suite(folder: Path) -> Suite:
    """Read a suite.

    Raises
    ------
    FluxobsError
        The folder contains no complete suite, or one of another version.
    """
    path = folder / INDEX
    malformed = FluxobsError(f"{path}: malformed; make the suite again in a new folder")
    try:
        index = json.loads(path.read_text("utf-8"))
        version = int(index["version"])
    except FileNotFoundError:
        raise FluxobsError(f"{folder}: no suite; make one with --seed in a new folder") from None
    except (OSError, ValueError, TypeError, KeyError):
        raise malformed from None
    if version != VERSION:
        raise FluxobsError(
            f"{folder}: suite of version {version}; this program scores version {VERSION}"
        )
    try:
        entries = tuple(Entry(**record) for record in index["records"])
        seed, ratings = int(index["seed"]), dict(index["ratings"])
    except (ValueError, TypeError, KeyError):
        raise malformed from None
    return Suite(folder, seed, entries, ratings)
