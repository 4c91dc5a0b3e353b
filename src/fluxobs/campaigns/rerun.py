"""One scenario again, alone: its row, its record, and an interactive report of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..errors import UsageError
from ..estimation import Result
from ..estimation.estimate import estimate
from ..logs.record import Record
from ..machines import RotatingMachine
from .columns import schema
from .draws import scenarios, total
from .drives import cell_of
from .observed import UNKNOWNS, Candidate, ObservedRecord
from .rows import record_of, rows_for
from .simulated import Simulated
from .specification import ADAPTIVE, PLAIN, ObserverTable, Specification


@dataclass(frozen=True, eq=False)
class Rerun:
    """A scenario with one observer, simulated again.

    Attributes
    ----------
    number : int
    table : ObserverTable
    machine : RotatingMachine
        As the observer believes it.
    record : Record
        What a log of the drive would hold, with the true angle.
    row : dict
        Equal to the dataset's.
    """

    number: int
    table: ObserverTable
    machine: RotatingMachine
    record: Record
    row: dict[str, Any]

    @property
    def frame(self) -> pl.DataFrame:
        """The record as columns that `fluxobs estimate` reads."""
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
        """The record as a log, with the observer that has the same unknowns and learns as it goes.

        It takes its noise from the record, not from the specification.

        Raises
        ------
        UsageError
            The observer is none that :func:`fluxobs.estimate` runs.
        """
        check_estimated(self.table)
        adaptive = self.table.kind == ADAPTIVE
        return estimate(
            self.record,
            self.machine,
            unknowns=(self.table.unknowns or UNKNOWNS) if adaptive else ("drift",),
            causal=adaptive,
            memory=self.table.memory,
        )


def check_estimated(table: ObserverTable) -> None:
    """Raise UsageError if :func:`fluxobs.estimate` does not run this observer."""
    if table.kind not in (PLAIN, ADAPTIVE):
        raise UsageError(
            f"a report recomputes with {PLAIN} or {ADAPTIVE}, not with {table.name}: take their "
            f"report, or --record"
        )


def rerun(
    specification: Specification, numbers: Sequence[int], observer: str | None = None
) -> list[Rerun]:
    """Simulate scenarios again, with one observer each; all of one machine are done at once.

    Parameters
    ----------
    numbers : sequence of int
    observer : str, optional
        Its name; default the first of the specification.

    Raises
    ------
    UsageError
        There is no such scenario or observer.
    """
    table = specification.observer(observer)
    alone = specification.model_copy(update={"observers": [table]})
    by_machine: dict[int, list[int]] = {}
    for number in sorted(set(numbers)):
        if not 0 <= number < total(specification):
            raise UsageError(f"no scenario {number}: they are 0 to {total(specification) - 1}")
        by_machine.setdefault(number // specification.scenarios, []).append(number)
    out: list[Rerun] = []
    for some in by_machine.values():
        drawn = [scenarios(specification, number, number + 1)[0] for number in some]
        records: dict[int, tuple[Record, Candidate]] = {}

        def watch(
            one: Simulated, by: Candidate, found: ObservedRecord, records: Any = records
        ) -> None:
            h = cell_of(specification, one.scenario.machine).rated.sample_time
            records[one.scenario.number] = record_of(one, h), by

        rows = pl.DataFrame(rows_for(alone, drawn, watch), schema=schema(specification))
        for row in rows.iter_rows(named=True):
            if row["failed"] is not None:
                raise UsageError(f"scenario {row['number']} cannot be simulated: {row['failed']}")
            record, by = records[row["number"]]
            out.append(Rerun(row["number"], table, by.believed, record, row))
    return sorted(out, key=lambda one: one.number)


def write_record(one: Rerun, path: Path) -> None:
    """Write the record as a Parquet file, whole or not at all."""
    from ..core.engine import write_part

    write_part(one.frame, path)
