"""The task of a worker: estimate one of many logs and return its row."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import polars as pl

from ..core.hashing import hash_file
from ..core.output import write_text
from ..core.printable import visible
from ..errors import FluxobsError
from ..estimation.learning import UNSEEN, parameters
from ..machines import Machine, as_machine
from ..presentation import Result
from ..presentation.estimate import estimate
from .sources import Source

#: Folders of the results: estimates, and a note on each log.
ESTIMATES, LOGS = "estimates", "logs"
#: Columns of the summary table, in SI, one row per log. Unidentifiable parameters are null.
COLUMNS: dict[str, Any] = {
    "log": pl.String,
    "drive": pl.String,
    "time": pl.Datetime("us", "UTC"),
    "machine": pl.String,
    "rows": pl.Int64,
    "sample_time": pl.Float64,
    "duration": pl.Float64,
    "lag": pl.Float64,
    "unknowns": pl.String,
    "valid": pl.Float64,
    "first_valid": pl.Float64,
    "resistance": pl.Float64,
    "resistance_std": pl.Float64,
    "psi_f": pl.Float64,
    "psi_f_std": pl.Float64,
    "inverter_voltage": pl.Float64,
    "inverter_voltage_std": pl.Float64,
    "offset_alpha": pl.Float64,
    "offset_beta": pl.Float64,
    "offset_std": pl.Float64,
    "drift_alpha": pl.Float64,
    "drift_beta": pl.Float64,
    "error_rms": pl.Float64,
    "error_most": pl.Float64,
    "mistakes": pl.String,
    "warnings": pl.String,
    "failed": pl.String,
    "content": pl.String,
    "seconds": pl.Float64,
}
#: Names of the adaptive observer's parameters in the table.
NAMES = {"magnet flux": "psi_f", "resistance": "resistance", "inverter": "inverter_voltage"}


@dataclass(frozen=True)
class Settings:
    """Machine and options with which logs are estimated.

    Attributes
    ----------
    machine : str
        A machine file or name; ``{drive}`` in it is replaced by the drive's name.
    options : str
        JSON of the other arguments of :func:`fluxobs.estimate`.
    """

    machine: str
    options: str

    def machine_of(self, source: Source) -> str:
        return self.machine.replace("{drive}", source.drive)


@dataclass(frozen=True)
class LogTask:
    """A task that estimates one log; it is sent to the workers.

    Attributes
    ----------
    folder : str
        Folder of the results; all workers see it under this path.
    settings : Settings
    """

    folder: str
    settings: Settings

    def __call__(self, source: Source) -> dict[str, Any]:
        """Estimate a log, write its estimates and its row, and return the row.

        Never raises: errors are in the row.
        """
        started = time.perf_counter()
        stored = StoredLog.of(Path(self.folder), source)
        stamp = source.stamp()
        row = new_row(source)
        machine = None
        try:
            machine = as_machine(self.settings.machine_of(source))
            row["machine"] = self.settings.machine_of(source)
            with source.local() as path:
                content = hash_file(path)
                if stored.is_current(content, self.settings, machine):
                    return stored.restamp(stamp)
                row |= self._estimate(path, source, machine, stored)
                if hash_file(path) != content or source.stamp() != stamp:
                    raise FluxobsError(
                        f"{source}: the log changed while it was read; estimate it again once it "
                        f"is complete"
                    )
            row["content"] = content
            key = key_of(content, self.settings, machine)
        except FluxobsError as error:
            row["failed"] = str(error)
        except OSError as error:
            row["failed"] = f"{source}: {(error.strerror or str(error)).lower()}"
        except MemoryError:
            row["failed"] = f"{source}: out of memory; use fewer workers"
        except Exception as error:  # one log must not stop the other logs
            row["failed"] = f"{source}: {type(error).__name__}: {error}"
        if row["failed"] is not None:
            key = key_of("", self.settings, machine)
            with suppress(OSError):  # estimates of earlier content
                stored.estimates.unlink(missing_ok=True)
        row["seconds"] = time.perf_counter() - started
        try:
            stored.write(row, stamp, key)
        except FluxobsError as error:
            row["failed"] = row["failed"] or str(error)
        return row

    def _estimate(
        self, path: Path, source: Source, machine: Machine, stored: StoredLog
    ) -> dict[str, Any]:
        try:
            stored.estimates.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FluxobsError(f"{stored.estimates}: cannot be written: {error.strerror}") from None
        options = json.loads(self.settings.options)
        result = estimate(path, machine, out=stored.estimates, force=True, **options)
        return summarise(result)


def readable(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with printable text: no control characters, no invalid UTF-8."""
    return {key: visible(value) if isinstance(value, str) else value for key, value in row.items()}


def new_row(source: Source) -> dict[str, Any]:
    """Return a row with log, drive and time only."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row |= {"log": source.name, "drive": source.drive, "time": source.time()}
    return row


def summarise(result: Result) -> dict[str, Any]:
    """Return the columns of an estimation's result."""
    facts = result.facts
    row: dict[str, Any] = {
        "rows": facts["rows"],
        "sample_time": facts["sample_time"],
        "duration": facts["rows"] * facts["sample_time"],
        "lag": facts["lag"],
        "unknowns": ",".join(facts["unknowns"]),
        "valid": facts["valid_share"],
        "first_valid": facts["first_valid"],
        "warnings": "\n".join(facts["warnings"]) or None,
    }
    findings = result.checked
    if findings is not None and findings.mistakes:
        row["mistakes"] = "\n".join(str(mistake) for mistake in findings.mistakes)
    if facts["drift"] is not None:
        row |= dict(zip(("drift_alpha", "drift_beta"), facts["drift"], strict=True))
    if facts["error"] is not None:
        row |= {"error_rms": facts["error"]["rms"], "error_most": facts["error"]["most"]}
    adaptive, learnt = result.adaptive, result.learnt
    if adaptive is not None and learnt is not None and result.statistics.valid:
        for parameter in parameters(adaptive, learnt):
            if parameter.told:
                row |= {
                    NAMES[parameter.name]: parameter.value,
                    f"{NAMES[parameter.name]}_std": parameter.std,
                }
        std = max(learnt.offset_std)
        if adaptive.offset_std > 0 and std <= UNSEEN * adaptive.offset_std:
            row |= dict(zip(("offset_alpha", "offset_beta"), learnt.offset, strict=True))
            row["offset_std"] = std
    return row


@dataclass(frozen=True)
class StoredLog:
    """Files of one log in the folder of the results: estimates and note."""

    estimates: Path
    note: Path

    @classmethod
    def of(cls, folder: Path, source: Source) -> StoredLog:
        return cls(
            folder / ESTIMATES / f"{source.name}.parquet", folder / LOGS / f"{source.name}.json"
        )

    def read(self) -> dict[str, Any] | None:
        """Read the note of an earlier run (stamp, key and row); None if missing or malformed."""
        try:
            note: dict[str, Any] = json.loads(self.note.read_text(encoding="utf-8"))
            return note if set(note) == {"stamp", "key", "row"} else None
        except (OSError, ValueError):
            return None

    def is_current(self, content: str, settings: Settings, machine: Machine) -> bool:
        """Return whether this content was estimated with these settings."""
        note = self.read()
        expected = key_of(content, settings, machine)
        return note is not None and note["key"] == expected and self.estimates.exists()

    def restamp(self, stamp: str) -> dict[str, Any]:
        """Return the stored row, and store the new stamp."""
        note = self.read()
        assert note is not None
        row = row_of(note["row"])
        self.write(row, stamp, note["key"])
        return row

    def write(self, row: dict[str, Any], stamp: str, key: str) -> None:
        """Write the note of a log."""
        time = row["time"]
        text = row | {"time": None if time is None else time.isoformat()}
        try:
            self.note.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FluxobsError(f"{self.note}: cannot be written: {error.strerror}") from None
        note = {"stamp": stamp, "key": key, "row": text}
        write_text(self.note, json.dumps(note, ensure_ascii=False, indent=1) + "\n")


def row_of(stored: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a note."""
    time = stored.get("time")
    return {name: stored.get(name) for name in COLUMNS} | {
        "time": None if time is None else datetime.fromisoformat(time)
    }


def key_of(content: str, settings: Settings, machine: Machine | None) -> str:
    """Return a hash of log, machine, settings and version of fluxobs.

    For a failed log, the content is empty; an unreadable machine is None.
    """
    fields = (content, repr(machine), settings.options, version("fluxobs"))
    return hashlib.sha256("\n".join(fields).encode()).hexdigest()
