"""One log of many: what a worker does, and the row that comes of it."""

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
from ..estimation import Result
from ..estimation.estimate import estimate
from ..estimation.learning import UNSEEN, parameters
from ..machines import Machine, as_machine
from .sources import Source

#: Folders of a result: estimates, and what is known of each log.
ESTIMATES, LOGS = "estimates", "logs"
#: Columns of the summary table, in SI; one row a log. Parameters that a log does not tell are null.
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
    """How logs are estimated.

    Attributes
    ----------
    machine : str
        A machine file or name; ``{drive}`` in it stands for the drive's name.
    options : str
        JSON of the other arguments of :func:`fluxobs.estimate`.
    """

    machine: str
    options: str

    def machine_of(self, source: Source) -> str:
        return self.machine.replace("{drive}", source.drive)


@dataclass(frozen=True)
class LogTask:
    """The work on a log; as a function it is sent to the workers.

    Attributes
    ----------
    folder : str
        Of the results; all workers see it by this name.
    settings : Settings
    """

    folder: str
    settings: Settings

    def __call__(self, source: Source) -> dict[str, Any]:
        """Estimate a log, write its estimates and its row; returns the row. Never raises: what goes
        wrong is in the row."""
        started = time.perf_counter()
        kept = Kept.of(Path(self.folder), source)
        stamp = source.stamp()
        row = begun(source)
        machine = None
        try:
            machine = as_machine(self.settings.machine_of(source))
            row["machine"] = self.settings.machine_of(source)
            with source.local() as place:
                content = hash_file(place)
                if kept.has(content, self.settings, machine):
                    return kept.renewed(stamp)
                row |= self._estimated(place, source, machine, kept)
                if hash_file(place) != content or source.stamp() != stamp:
                    raise FluxobsError(
                        f"{source}: the log changed while it was read; estimate it again when it "
                        f"is complete"
                    )
            row["content"] = content
            key = key_of(content, self.settings, machine)
        except FluxobsError as error:
            row["failed"] = str(error)
        except MemoryError:
            row["failed"] = f"{source}: no memory left; take fewer workers"
        except Exception as error:  # one log never stops the others
            row["failed"] = f"{source}: {type(error).__name__}: {error}"
        if row["failed"] is not None:
            key = key_of("", self.settings, machine)
            with suppress(OSError):  # estimates of earlier content
                kept.estimates.unlink(missing_ok=True)
        row["seconds"] = time.perf_counter() - started
        try:
            kept.write(row, stamp, key)
        except FluxobsError as error:
            row["failed"] = row["failed"] or str(error)
        return row

    def _estimated(
        self, place: Path, source: Source, machine: Machine, kept: Kept
    ) -> dict[str, Any]:
        try:
            kept.estimates.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FluxobsError(f"{kept.estimates}: cannot be written: {error.strerror}") from None
        options = json.loads(self.settings.options)
        result = estimate(place, machine, out=kept.estimates, force=True, **options)
        return told(result)


def readable(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row as a person reads it: a name in it commands no terminal, and is text."""
    return {key: visible(value) if isinstance(value, str) else value for key, value in row.items()}


def begun(source: Source) -> dict[str, Any]:
    """A row of which only the log is known."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row |= {"log": source.name, "drive": source.drive, "time": source.time()}
    return row


def told(result: Result) -> dict[str, Any]:
    """What a run says, as columns."""
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
    checked = result.checked
    if checked is not None and checked.mistakes:
        row["mistakes"] = "\n".join(str(one) for one in checked.mistakes)
    if facts["drift"] is not None:
        row |= dict(zip(("drift_alpha", "drift_beta"), facts["drift"], strict=True))
    if facts["error"] is not None:
        row |= {"error_rms": facts["error"]["rms"], "error_most": facts["error"]["most"]}
    adaptive, learnt = result.adaptive, result.learnt
    if adaptive is not None and learnt is not None and result.statistics.valid:
        for one in parameters(adaptive, learnt):
            if one.told:
                row |= {NAMES[one.name]: one.value, f"{NAMES[one.name]}_std": one.std}
        std = max(learnt.offset_std)
        if adaptive.offset_std > 0 and std <= UNSEEN * adaptive.offset_std:
            row |= dict(zip(("offset_alpha", "offset_beta"), learnt.offset, strict=True))
            row["offset_std"] = std
    return row


@dataclass(frozen=True)
class Kept:
    """What is kept of a log in the folder of the results."""

    estimates: Path
    note: Path

    @classmethod
    def of(cls, folder: Path, source: Source) -> Kept:
        return cls(
            folder / ESTIMATES / f"{source.name}.parquet", folder / LOGS / f"{source.name}.json"
        )

    def read(self) -> dict[str, Any] | None:
        """The note of an earlier run: stamp, key and row; None if there is none that reads."""
        try:
            found: dict[str, Any] = json.loads(self.note.read_text(encoding="utf-8"))
            return found if set(found) == {"stamp", "key", "row"} else None
        except (OSError, ValueError):
            return None

    def has(self, content: str, settings: Settings, machine: Machine) -> bool:
        """Whether this very content was estimated with these settings."""
        found = self.read()
        wanted = key_of(content, settings, machine)
        return found is not None and found["key"] == wanted and self.estimates.exists()

    def renewed(self, stamp: str) -> dict[str, Any]:
        """The row that is there; only the stamp changed."""
        found = self.read()
        assert found is not None
        row = row_of(found["row"])
        self.write(row, stamp, found["key"])
        return row

    def write(self, row: dict[str, Any], stamp: str, key: str) -> None:
        """Write the note."""
        when = row["time"]
        text = row | {"time": None if when is None else when.isoformat()}
        try:
            self.note.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FluxobsError(f"{self.note}: cannot be written: {error.strerror}") from None
        note = {"stamp": stamp, "key": key, "row": text}
        write_text(self.note, json.dumps(note, ensure_ascii=False, indent=1) + "\n")


def row_of(kept: dict[str, Any]) -> dict[str, Any]:
    """A row from its note."""
    when = kept.get("time")
    return {name: kept.get(name) for name in COLUMNS} | {
        "time": None if when is None else datetime.fromisoformat(when)
    }


def key_of(content: str, settings: Settings, machine: Machine | None) -> str:
    """Stands for a log, its machine, the settings, and the program; a log that failed has no
    content, and no machine if that is what failed."""
    parts = (content, repr(machine), settings.options, version("fluxobs"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
