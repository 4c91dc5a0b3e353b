"""Measured records join the benchmark by a recipe: where they are, and how to read them.

A recipe is TOML: `source` and `licence` of the files, the pattern `files` below the folder of the
user, what is `unverified`, and the tables `machine` (a machine file), `drive` (ratings, as in a
campaign), and `log` (fields of :class:`fluxobs.Layout`, with a measured angle as truth).
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pydantic import ValidationError

from ..campaigns.specification import DriveTable
from ..core.arrays import Array
from ..core.input_files import read_toml
from ..core.validation import Table, complaints, nearest
from ..errors import FluxobsError
from ..logs import Log, read_log
from ..machines import RotatingMachine, machine_from, rotating
from ..machines.saving import write_machine
from .suite import Entry, Suite, new_folder, write_index

#: Channels of a measured angle.
ANGLES = ("theta_mech", "theta_e")


class Recipe(Table):
    """How to read measured records; see the module."""

    source: str
    licence: str
    files: str
    unverified: list[str]
    machine: dict[str, Any]
    drive: DriveTable
    log: dict[str, Any]


def recipe_names() -> list[str]:
    """Return the names of the shipped recipes."""
    folder = resources.files(__package__) / "recipes"
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))


def read_recipe(text: str) -> tuple[str, Recipe]:
    """Return name and recipe of a file, or of a shipped recipe.

    Raises
    ------
    FluxobsError
        There is no such recipe, or it is malformed.
    """
    path = Path(text)
    if path.suffix != ".toml":
        if text not in recipe_names():
            raise FluxobsError(
                f"no recipe {text!r}{nearest(text, recipe_names())}; or give a file .toml"
            )
        path = Path(str(resources.files(__package__) / "recipes" / f"{text}.toml"))
    try:
        return path.stem, Recipe(**read_toml(path, FluxobsError))
    except ValidationError as error:
        names = list(Recipe.model_fields)
        raise FluxobsError(f"{path}: {complaints(error, names, 'recipe')}") from None


def write_measured(
    folder: Path,
    name: str,
    recipe: Recipe,
    data: Path,
    progress: Callable[[int, int], Any] | None = None,
) -> Suite:
    """Write a suite of the measured records that a recipe finds below a folder.

    Raises
    ------
    FluxobsError
        There are no such files, a file cannot be read, or has no angle; the suite exists.
    """
    files = sorted(data.glob(recipe.files)) or sorted(data.glob(Path(recipe.files).name))
    if not files:
        raise FluxobsError(f"{data}: no {recipe.files}; get the files from {recipe.source}")
    machine = rotating(machine_from(recipe.machine, source=name), "a benchmark")
    new_folder(folder)
    write_machine(folder / "machines" / f"{name}.toml", machine, [f"Recipe {name}"], {}, True)
    entries = []
    for n, path in enumerate(files):
        log = read_log(path, **recipe.log)
        record, theta = log.to_record(), _angle(log, machine)
        u, i = record.voltage.T, record.current.T
        columns = {"t": record.t, "u_alpha": u[0], "u_beta": u[1], "i_alpha": i[0], "i_beta": i[1]}
        entry = Entry(f"{name}-{path.stem}", name, "measured", name, record.sample_time)
        pl.DataFrame(columns).write_parquet(folder / "logs" / f"{entry.name}.parquet")
        pl.DataFrame({"theta_e": theta}).write_parquet(folder / "truth" / f"{entry.name}.parquet")
        entries.append(entry)
        if progress is not None:
            progress(n + 1, len(files))
    ratings = {name: recipe.drive.model_dump() | {"sample_time": entries[0].sample_time}}
    return write_index(Suite(folder, 0, tuple(entries), ratings))


def _angle(log: Log, machine: RotatingMachine) -> Array:
    """Return the measured electrical angle of all rows [rad]."""
    channel = log.truth[0] if log.truth is not None else "none"
    if channel not in ANGLES:
        raise FluxobsError(f"{log.path}: a recipe needs a measured angle as truth ({channel})")
    angle = np.concatenate([batch.truth for batch in log.aligned() if batch.truth is not None])
    return np.asarray(angle * (machine.n_p if channel == "theta_mech" else 1))
