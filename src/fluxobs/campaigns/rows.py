"""From scenarios to rows: simulate the drives, run the observers, score the estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import numpy as np
import polars as pl

from ..comparison.scoring import true_speed
from ..logs.record import Record
from . import scores
from .columns import schema
from .draws import LOST, Scenario, scenarios
from .drives import Cell, cell_of
from .in_loop import in_loop
from .observed import NOISE, Candidate, ObservedRecord, Parameters, candidate, observe
from .quantities import QUANTITIES
from .simulated import Simulated, lanes_for, simulated
from .specification import Specification

#: Receives the record of one scenario with one observer.
Watch = Callable[[Simulated, Candidate, ObservedRecord], None]


def rows_of(
    specification: Specification, first: int, last: int, watch: Watch | None = None
) -> pl.DataFrame:
    """Return the rows of scenarios `first` to `last`, exclusive, of one machine.

    The table has one row per observer, sorted by number and observer.
    """
    drawn = scenarios(specification, first, last)
    rows = rows_for(specification, drawn, watch)
    order = {table.name: k for k, table in enumerate(specification.observers)}
    rows.sort(key=lambda row: (row["number"], order[row["observer"]]))
    return pl.DataFrame(rows, schema=schema(specification))


def rows_for(
    specification: Specification, drawn: list[Scenario], watch: Watch | None = None
) -> list[dict[str, Any]]:
    """Return the rows of scenarios of one machine, unsorted."""
    cell = cell_of(specification, drawn[0].machine)
    candidates = [
        candidate(table, cell, noise_of(specification) * cell.current)
        for table in specification.observers
    ]
    observe_all = _observe_open if specification.loop == "open" else _observe_closed
    rows = []
    for drive, observer, record in observe_all(specification, drawn, cell, candidates):
        rows.append(_row(specification, drive, observer, record, cell))
        if watch is not None and record is not None:
            watch(drive, observer, record)
    return rows


def noise_of(specification: Specification) -> float:
    """Return the current noise that the observers assume, as a share of the rated current.

    A designer would choose this value: the median of the specification's distribution.
    """
    noise = specification.vary.get("noise")
    median = 0.0 if noise is None else float(noise.at(np.array([0.5]))[0])
    return max(median, NOISE / 2)


Observed = Iterator[tuple[Simulated, Candidate, ObservedRecord | None]]


def _observe_open(
    specification: Specification, drawn: list[Scenario], cell: Cell, candidates: list[Candidate]
) -> Observed:
    """Run each observer on the records of drives with an encoder."""
    lanes = lanes_for(specification, cell.rated.sample_time)
    for batch in _batches(simulated(specification, drawn, lanes), lanes):
        succeeded = [drive for drive in batch if drive.trace is not None]
        yield from (
            (drive, observer, None)
            for drive in batch
            if drive.trace is None
            for observer in candidates
        )
        if not succeeded:
            continue
        padded = succeeded + succeeded[:1] * (lanes - len(succeeded))
        records = [record_of(drive, cell.rated.sample_time) for drive in padded]
        voltage = np.stack([record.interval_voltage() for record in records])
        current = np.stack([record.current for record in records])
        parameters = [true_parameters(drive, cell) for drive in succeeded]
        for observer in candidates:
            count = len(succeeded) if observer.compiled else lanes
            observed = observe(observer, voltage[:count], current[:count], parameters)
            for drive, record in zip(succeeded, observed, strict=False):
                yield drive, observer, record


def _observe_closed(
    specification: Specification, drawn: list[Scenario], cell: Cell, candidates: list[Candidate]
) -> Observed:
    """Run each observer in the loop of its own drives."""
    lanes = lanes_for(specification, cell.rated.sample_time)
    for observer in candidates:
        for drive in simulated(specification, drawn, lanes, in_loop(observer, cell)):
            record = None
            if drive.trace is not None:
                trace = drive.trace
                std = trace.std if observer.compiled else None
                record = ObservedRecord(trace.angle, trace.seen_speed, trace.valid, std, {})
            yield drive, observer, record


def _batches(stream: Iterator[Simulated], size: int) -> Iterator[list[Simulated]]:
    while batch := list(islice(stream, size)):
        yield batch


def record_of(drive: Simulated, sample_time: float) -> Record:
    """Return the log of a simulated drive, with the true angle and without the lost samples."""
    trace = drive.trace
    assert trace is not None
    theta_e = np.asarray(trace.theta_e)
    current, share = trace.current, drive.scenario.values.get("lost", 0.0)
    if share > 0:
        lost = drive.scenario.generator(LOST).random(len(theta_e)) < share
        current = np.where(lost, np.nan, np.asarray(current))
    return Record(sample_time, trace.voltage, current, lag=0.0, theta_e=theta_e)


def true_parameters(drive: Simulated, cell: Cell) -> Parameters:
    """Return the true parameters of a simulated drive."""
    assert drive.drive is not None
    motor, inverter = drive.drive.plant.motor, drive.drive.inverter
    dc_link = drive.scenario.values.get("dc_link", 1.0) * cell.rated.dc_link
    lost_voltage = float(inverter.dead_time) / cell.rated.sample_time * dc_link + float(
        inverter.drop
    )
    return Parameters(float(motor.R_s), float(motor.psi_f), lost_voltage)


def _row(
    specification: Specification,
    drive: Simulated,
    observer: Candidate,
    record: ObservedRecord | None,
    cell: Cell,
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "number": drive.scenario.number,
        "machine": drive.scenario.machine,
        "observer": observer.table.name,
        "failed": drive.failed or None,
    }
    for name in specification.vary:
        neutral = QUANTITIES[name].neutral if name in QUANTITIES else 1.0
        row[name] = drive.scenario.values.get(name, neutral)
    if drive.trace is None or record is None:
        return row
    sample_time, start = cell.rated.sample_time, specification.course.score_from
    theta_e = np.asarray(drive.trace.theta_e)
    t = np.asarray(np.arange(len(theta_e)) * sample_time, float)
    speed = true_speed(cell.machine, theta_e, drive.trace.speed, sample_time)
    row |= scores.measures(t, drive.trace, speed, record, cell.machine, start)
    if specification.loop == "closed":
        row |= scores.loop_measures(t, drive.trace, start)
    return row
