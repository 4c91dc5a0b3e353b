"""Repeat one scenario; return its row, its record and an interactive report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..errors import UsageError
from ..logs.record import Record
from ..machines import RotatingMachine
from ..observers.unknowns import AUTO
from ..presentation import Result
from ..presentation.estimate import estimate
from .columns import schema
from .draws import scenarios, total
from .drives import cell_of
from .observed import UNKNOWNS, Candidate, ObservedRecord
from .rows import record_of, rows_for
from .simulated import Simulated
from .specification import ADAPTIVE, PLAIN, REPORTED, WHOLE_LOG, ObserverTable, Specification


@dataclass(frozen=True, eq=False)
class Rerun:
    """A scenario with one observer, simulated again.

    Attributes
    ----------
    number : int
    table : ObserverTable
    machine : RotatingMachine
        The machine that the observer assumes.
    record : Record
        The log of the drive, with the true angle.
    row : dict
        Row of the scenario, as in the dataset.
    """

    number: int
    table: ObserverTable
    machine: RotatingMachine
    record: Record
    row: dict[str, Any]

    @property
    def frame(self) -> pl.DataFrame:
        """Return the record as columns that `fluxobs estimate` reads."""
        u, i = self.record.voltage, self.record.current
        return pl.DataFrame(
            {
                "t": np.arange(len(i)) * self.record.sample_time,
                "u_alpha": u[:, 0],
                "u_beta": u[:, 1],
                "i_alpha": i[:, 0],
                "i_beta": i[:, 1],
                "theta_e": self.record.theta_e,
            }
        )

    def estimate(self) -> Result:
        """Estimate from the record as from a log: filtered, with the unknowns of the observer.

        The noise is estimated from the record, not taken from the specification.

        Raises
        ------
        UsageError :func:`fluxobs.estimate` cannot run this observer.
        """
        check_estimated(self.table)
        unknowns = {
            PLAIN: ("drift",),
            ADAPTIVE: self.table.unknowns or UNKNOWNS,
            WHOLE_LOG: (AUTO,),
        }[self.table.kind]
        return estimate(
            self.record,
            self.machine,
            unknowns=unknowns,
            causal=self.table.kind != WHOLE_LOG,
            memory=self.table.memory,
        )


def check_estimated(table: ObserverTable) -> None:
    """Raise UsageError if :func:`fluxobs.estimate` cannot run this observer."""
    if table.kind not in REPORTED:
        raise UsageError(
            f"{table.name} has no report; choose an observer of kind {', '.join(REPORTED)}, or "
            f"give --record"
        )


def rerun(
    specification: Specification, numbers: Sequence[int], observer: str | None = None
) -> list[Rerun]:
    """Simulate scenarios again with one observer; group the scenarios by machine.

    Parameters
    ----------
    numbers : sequence of int
    observer : str, optional
        Name of the observer; default the specification's first observer.

    Raises
    ------
    UsageError
        There is no such scenario or observer.
    """
    table = specification.observer(observer)
    single_observer = specification.model_copy(update={"observers": [table]})
    by_machine: dict[int, list[int]] = {}
    for number in sorted(set(numbers)):
        if not 0 <= number < total(specification):
            raise UsageError(f"no scenario {number}; give 0 to {total(specification) - 1}")
        by_machine.setdefault(number // specification.scenarios, []).append(number)
    reruns: list[Rerun] = []
    for machine_numbers in by_machine.values():
        drawn = [scenarios(specification, number, number + 1)[0] for number in machine_numbers]
        records: dict[int, tuple[Record, Candidate]] = {}

        def store_record(
            drive: Simulated, observer: Candidate, _: ObservedRecord, records: Any = records
        ) -> None:
            h = cell_of(specification, drive.scenario.machine).rated.sample_time
            records[drive.scenario.number] = record_of(drive, h), observer

        rows = pl.DataFrame(
            rows_for(single_observer, drawn, store_record), schema=schema(specification)
        )
        for row in rows.iter_rows(named=True):
            if row["failed"] is not None:
                raise UsageError(f"scenario {row['number']} cannot be simulated: {row['failed']}")
            record, candidate = records[row["number"]]
            reruns.append(Rerun(row["number"], table, candidate.believed, record, row))
    return sorted(reruns, key=lambda repeated: repeated.number)


def write_record(repeated: Rerun, path: Path) -> None:
    """Write the record as a Parquet file, atomically."""
    from ..core.engine import write_part

    write_part(repeated.frame, path)
