"""Many logs estimated: every log to its file, a row for each, and a table of all."""

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
    Kept,
    LogTask,
    Settings,
    begun,
    key_of,
    readable,
    row_of,
)
from .sources import Source, shared, sources

#: Files of a result: marks the folder; the summary table, twice.
MARK, TABLE, TEXT = "fleet.json", "summary.parquet", "summary.csv"


@dataclass(frozen=True, eq=False)
class Fleet:
    """What an estimation of many logs left.

    Attributes
    ----------
    folder : Path
    table : polars.DataFrame
        A row a log, those of earlier runs in the folder too, with the columns of
        :data:`fluxobs.fleets.log_task.COLUMNS`.
    """

    folder: Path
    table: pl.DataFrame

    @property
    def failed(self) -> pl.DataFrame:
        """The logs that could not be estimated."""
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
    progress: Callable[[int, int], Any] = lambda done, total: None,
    **options: Any,
) -> Fleet:
    """Estimate many logs; one that cannot be estimated is a row that says so.

    Parameters
    ----------
    logs : sequence of str or Path
        Files, patterns, folders, and URLs of these (extra "cloud").
    machine : str or Path
        A machine file or name; ``{drive}`` in it stands for the name of the drive.
    out : path
        Folder of the results. Logs that were done with the same machine and settings are not done
        again, unless their content changed.
    drive : str, optional
        Regular expression that finds the drive in a log's path; default the log's folder.
    retry : {"none", "failed", "all"}
        What is done again although nothing changed.
    workers, scheduler
        See :func:`fluxobs.core.engine.compute`.
    progress : callable
        Called with the number of logs done, and of all.
    options : optional
        Further arguments of :func:`fluxobs.estimate`, layout included.

    Raises
    ------
    FluxobsError
        No log is meant, the folder holds something else, or nothing can be written there.
    """
    known = _root(Path(out))
    meant = sources(logs, drive, known)
    if retry not in ("none", "failed", "all"):
        raise UsageError(f"retry {retry!r}: none, failed or all")
    settings = Settings(_absolute(str(machine)), _json(options))
    if "{drive}" not in settings.machine:
        as_machine(settings.machine)  # wrong for one is wrong for all
    folder = _folder(Path(out), shared([one.address for one in meant]))
    with locked(folder):
        for name in (ESTIMATES, LOGS):
            make_folder(folder / name)
        machine_of = cache(as_machine)  # files may change until the next run
        todo = [one for one in meant if _is_due(folder, one, settings, retry, machine_of)]
        done = len(meant) - len(todo)
        progress(done, len(meant))
        fresh: dict[str, dict[str, Any]] = {}
        work = LogTask(str(folder), settings)
        for source, row in compute(todo, work, workers, scheduler, _lost):
            fresh[source.name] = row
            done += 1
            progress(done, len(meant))
        rows = [readable(row) for row in _rows(folder, meant, fresh)]
        table = pl.DataFrame(rows, schema=COLUMNS, orient="row")
        write_part(table, folder / TABLE)
        write_rows(folder / TEXT, dict(table.schema), iter([table]))
    return Fleet(folder, table)


def open_fleet(folder: str | Path) -> Fleet:
    """What an earlier estimation of many logs left.

    Raises
    ------
    FluxobsError
        The folder holds none.
    """
    place = Path(folder) / TABLE
    if not place.exists():
        raise FluxobsError(
            f"{folder}: holds no {TABLE}; `fluxobs estimate LOGS… --out {folder}` makes it"
        )
    try:
        with place.open("rb") as file:  # Polars takes a name for a pattern, and for text
            return Fleet(Path(folder), pl.read_parquet(file))
    except (OSError, pl.exceptions.PolarsError) as error:
        raise FluxobsError(f"{place}: cannot be read: {error}") from None


def _absolute(machine: str) -> str:
    """The name of a shipped machine as it is; a path so that all workers find it."""
    return machine if machine in example_names() else str(Path(machine).absolute())


def _json(options: dict[str, Any]) -> str:
    try:
        return json.dumps(options, sort_keys=True, default=_path)
    except TypeError as error:
        raise UsageError(f"an option of many logs must be text or numbers: {error}") from None


def _path(value: Any) -> str:
    if isinstance(value, Path):
        return str(value.absolute())
    raise TypeError(f"{type(value).__name__} {value!r}")


def _root(out: Path) -> str | None:
    """What the logs of earlier runs in a folder shared."""
    try:
        return str(json.loads((out / MARK).read_text(encoding="utf-8"))["root"])
    except (OSError, ValueError, KeyError):
        return None


def _folder(out: Path, root: str) -> Path:
    """The folder of the results, new or used before for the same."""
    folder = make_folder(out).resolve()
    if (folder / MARK).exists():
        return folder
    if any(path.name != ".lock" for path in folder.iterdir()):
        raise FluxobsError(f"{out}: is not empty and holds no such results; give another --out")
    write_text(folder / MARK, json.dumps({"root": root}, indent=1) + "\n")
    return folder


def _is_due(
    folder: Path,
    source: Source,
    settings: Settings,
    retry: str,
    machine_of: Callable[[str], Machine],
) -> bool:
    """Whether a log has to be looked at: it is new, its stamp or its settings changed, or it is to
    be retried."""
    kept = Kept.of(folder, source)
    note = kept.read()
    if note is None or retry == "all":
        if retry == "all":
            kept.note.unlink(missing_ok=True)
        return True
    failed = note["row"].get("failed") is not None
    if failed and retry == "failed":
        return True
    if not failed and not (kept.estimates.exists() and note["stamp"]):
        return True
    try:
        machine = machine_of(settings.machine_of(source))
    except FluxobsError:
        machine = None
    key = key_of("" if failed else note["row"]["content"], settings, machine)
    return bool(note["stamp"] != source.stamp() or note["key"] != key)


def _lost(source: Source) -> dict[str, Any]:
    """The row of a log whose worker always dies."""
    what = "its worker died five times, as one does that has no memory left; take fewer workers"
    return begun(source) | {"failed": f"{source}: {what}"}


def _rows(
    folder: Path, meant: Sequence[Source], fresh: dict[str, dict[str, Any]]
) -> Iterator[dict[str, Any]]:
    """Rows of all logs that the folder knows, those of earlier runs too, by name."""
    drives = {source.name: source.drive for source in meant}
    kept = {path.relative_to(folder / LOGS).as_posix() for path in (folder / LOGS).rglob("*.json")}
    for name in sorted(drives.keys() | {one.removesuffix(".json") for one in kept}):
        row = fresh.get(name)
        if row is None:
            note = Kept.of(folder, Source("", name, "")).read()
            if note is None:
                continue
            row = row_of(note["row"])
        yield row | {"drive": drives.get(name, row["drive"])}
