"""Write machine files and the tables of their flux maps."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..core.output import check_new, write_text
from .contract import Machine
from .file_text import machine_text
from .saturation import COLUMNS, FluxPoints


def check_machine_file(out: Path, force: bool, option: str = "--out") -> None:
    """Raise FluxobsError if a machine file cannot be written, or must not be overwritten."""
    check_new(out, (".toml",), force, option)


def write_machine(
    path: Path,
    machine: Machine,
    head: Sequence[str],
    found: Mapping[str, tuple[float, float]],
    force: bool,
) -> None:
    """Write a machine file, and the table of its flux map beside it unless the table exists.

    Raises
    ------
    FluxobsError
        A file exists and `force` is not given, or cannot be written.
    """
    check_machine_file(path, force)
    flux_map = None
    if isinstance(points := getattr(machine, "flux_map", None), FluxPoints):
        flux_map = json.dumps(_save_table(path, points, force), ensure_ascii=False)
    write_text(path, machine_text(machine, head, found, flux_map))


def _save_table(path: Path, points: FluxPoints, force: bool) -> str:
    """Copy the table if it is in another folder; return its path relative to the machine file."""
    source, folder = Path(points.source).resolve(), path.parent.resolve()
    if source.is_file() and source.is_relative_to(folder):
        return source.relative_to(folder).as_posix()
    copy = path.with_name(f"{path.stem}-map.csv")
    check_new(copy, (".csv",), force)
    i, psi = points.current, points.flux
    rows = np.column_stack([i.real, i.imag, psi.real, psi.imag]).tolist()
    lines = [COLUMNS, *(map(repr, row) for row in rows)]  # repr keeps every digit
    write_text(copy, "".join(",".join(line) + "\n" for line in lines))
    return copy.name
