"""Estimate many logs: write one file and one row per log, and a table of all rows."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import polars as pl

from ..core.engine import LOCAL, compute, locked, write_part
from ..core.output import make_folder, write_rows, write_text
from ..errors import FluxobsError, UsageError
from ..machines import Machine, as_machine
from ..machines.files import example_names
from .log_task import (
    COLUMNS,
    ESTIMATES,
    LOGS,
    LogTask,
    Settings,
    StoredLog,
    key_of,
    new_row,
    readable,
    row_of,
)
from .sources import Source, shared, sources

#: Files in the folder of the results: description of the folder, summary table in two formats.
MARK, TABLE, TEXT = "fleet.json", "summary.parquet", "summary.csv"


@dataclass(frozen=True, eq=False)
class Fleet:
    """Results of an estimation of many logs.

    Attributes
    ----------
    folder : Path
    table : polars.DataFrame
        One row per log, including earlier runs in the folder, with the columns of
        :data:`fluxobs.fleets.log_task.COLUMNS`.
    """

    folder: Path
    table: pl.DataFrame

    @property
    def failed(self) -> pl.DataFrame:
        """Rows of the logs that could not be estimated."""
        return self.table.filter(pl.col("failed").is_not_null())


def estimate_many(
    logs: Sequence[str | Path],
    machine: str | Path,
    out: str | Path,
    *,
    drive: str | None = None,
    retry: Literal["none", "failed", "all"] = "none",
    workers: int | None = None,
    scheduler: str = LOCAL,
    progress: Callable[[int, int], Any] = lambda finished, total: None,
    **options: Any,
) -> Fleet:
    """Estimate many logs; a log that cannot be estimated gets a row with the reason.

    Parameters
    ----------
    logs : sequence of str or Path
        Files, patterns, folders, and URLs of these (extra "cloud").
    machine : str or Path
        A machine file or name; ``{drive}`` in it is replaced by the name of the drive.
    out : path
        Folder of the results. Logs already estimated with the same machine and settings are
        skipped, unless their content changed.
    drive : str, optional
        Regular expression that finds the drive in a log's path; default the log's folder.
    retry : {"none", "failed", "all"}
        Which unchanged logs to estimate again.
    workers, scheduler
        See :func:`fluxobs.core.engine.compute`.
    progress : callable
        Called with the numbers of finished logs and of all logs.
    options : optional
        Further arguments of :func:`fluxobs.estimate`, including the layout.

    Raises
    ------
    FluxobsError
        No log is found, the folder holds other files, or the folder cannot be written.
    """
    root = _read_root(Path(out))
    log_sources = sources(logs, drive, root)
    if retry not in ("none", "failed", "all"):
        raise UsageError(f"retry {retry!r}: give none, failed or all")
    settings = Settings(_absolute(str(machine)), _json(options))
    if "{drive}" not in settings.machine:
        as_machine(settings.machine)  # report a wrong name only once
    folder = _open_folder(Path(out), shared([source.address for source in log_sources]))
    with locked(folder):
        for name in (ESTIMATES, LOGS):
            make_folder(folder / name)
        machine_of = cache(as_machine)  # cached per run, since machine files change
        due = [
            source for source in log_sources if _is_due(folder, source, settings, retry, machine_of)
        ]
        finished = len(log_sources) - len(due)
        progress(finished, len(log_sources))
        new_rows: dict[str, dict[str, Any]] = {}
        task = LogTask(str(folder), settings)
        for source, row in compute(due, task, workers, scheduler, _row_of_dead_worker):
            new_rows[source.name] = row
            finished += 1
            progress(finished, len(log_sources))
        rows = [readable(row) for row in _rows(folder, log_sources, new_rows)]
        table = pl.DataFrame(rows, schema=COLUMNS, orient="row")
        write_part(table, folder / TABLE)
        write_rows(folder / TEXT, dict(table.schema), iter([table]))
    return Fleet(folder, table)


def open_fleet(folder: str | Path) -> Fleet:
    """Open the results of an earlier estimation of many logs.

    Raises
    ------
    FluxobsError
        The folder holds no results, or the results cannot be read.
    """
    path = Path(folder) / TABLE
    if not path.exists():
        raise FluxobsError(
            f"{folder}: holds no {TABLE}; `fluxobs estimate LOGS… --out {folder}` creates it"
        )
    try:
        with path.open("rb") as file:  # Polars would read a path as a UTF-8 pattern
            return Fleet(Path(folder), pl.read_parquet(file))
    except (OSError, pl.exceptions.PolarsError) as error:
        raise FluxobsError(f"{path}: cannot be read: {error}") from None


def _absolute(machine: str) -> str:
    """Return a shipped machine's name unchanged, and a path as absolute, for workers elsewhere."""
    return machine if machine in example_names() else str(Path(machine).absolute())


def _json(options: dict[str, Any]) -> str:
    try:
        return json.dumps(options, sort_keys=True, default=_path)
    except TypeError as error:
        raise UsageError(f"options of many logs must be text or numbers: {error}") from None


def _path(value: Any) -> str:
    if isinstance(value, Path):
        return str(value.absolute())
    raise TypeError(f"{type(value).__name__} {value!r}")


def _read_root(out: Path) -> str | None:
    """Return the common folder of the logs of earlier runs; None without earlier runs."""
    try:
        return str(json.loads((out / MARK).read_text(encoding="utf-8"))["root"])
    except (OSError, ValueError, KeyError):
        return None


def _open_folder(out: Path, root: str) -> Path:
    """Create the folder of the results, or open it if it holds results."""
    folder = make_folder(out).resolve()
    if (folder / MARK).exists():
        return folder
    if any(path.name != ".lock" for path in folder.iterdir()):
        raise FluxobsError(f"{out}: is not empty and holds no such results; choose another --out")
    write_text(folder / MARK, json.dumps({"root": root}, indent=1) + "\n")
    return folder


def _is_due(
    folder: Path,
    source: Source,
    settings: Settings,
    retry: str,
    machine_of: Callable[[str], Machine],
) -> bool:
    """Return whether to process a log: it is new or due again, or stamp or settings changed."""
    stored = StoredLog.of(folder, source)
    stored_note = stored.read()
    if stored_note is None or retry == "all":
        if retry == "all":
            stored.note.unlink(missing_ok=True)
        return True
    failed = stored_note["row"].get("failed") is not None
    if failed and retry == "failed":
        return True
    if not failed and not (stored.estimates.exists() and stored_note["stamp"]):
        return True
    try:
        machine = machine_of(settings.machine_of(source))
    except FluxobsError:
        machine = None
    key = key_of("" if failed else stored_note["row"]["content"], settings, machine)
    return bool(stored_note["stamp"] != source.stamp() or stored_note["key"] != key)


def _row_of_dead_worker(source: Source) -> dict[str, Any]:
    """Return the row of a log whose worker repeatedly died."""
    message = "its worker died five times, probably out of memory; use fewer workers"
    return new_row(source) | {"failed": f"{source}: {message}"}


def _rows(
    folder: Path, log_sources: Sequence[Source], new_rows: dict[str, dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of all logs in the folder, including earlier runs, sorted by name."""
    drives = {source.name: source.drive for source in log_sources}
    stored = {
        path.relative_to(folder / LOGS).as_posix() for path in (folder / LOGS).rglob("*.json")
    }
    for name in sorted(drives.keys() | {path.removesuffix(".json") for path in stored}):
        row = new_rows.get(name)
        if row is None:
            note = StoredLog.of(folder, Source("", name, "")).read()
            if note is None:
                continue
            row = row_of(note["row"])
        yield row | {"drive": drives.get(name, row["drive"])}
