"""Scenarios to rows: simulates them, runs the observers, scores."""

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
from .draws import Scenario, scenarios
from .drives import Cell, cell_of
from .in_loop import in_loop
from .observed import NOISE, Candidate, ObservedRecord, Parameters, candidate, observe
from .quantities import QUANTITIES
from .simulated import Simulated, lanes_for, simulated
from .specification import Specification

#: Receives one observer on one scenario: for who wants the record, not the row.
Watch = Callable[[Simulated, Candidate, ObservedRecord], None]


def rows_of(
    specification: Specification, first: int, last: int, watch: Watch | None = None
) -> pl.DataFrame:
    """Rows of the scenarios `first` to `last`, exclusive, of one machine; one for each observer, in
    the order of their numbers."""
    drawn = scenarios(specification, first, last)
    rows = rows_for(specification, drawn, watch)
    order = {one.name: k for k, one in enumerate(specification.observers)}
    rows.sort(key=lambda row: (row["number"], order[row["observer"]]))
    return pl.DataFrame(rows, schema=schema(specification))


def rows_for(
    specification: Specification, drawn: list[Scenario], watch: Watch | None = None
) -> list[dict[str, Any]]:
    """Rows of given scenarios of one machine, in no particular order."""
    cell = cell_of(specification, drawn[0].machine)
    candidates = [
        candidate(table, cell, noise_of(specification) * cell.current)
        for table in specification.observers
    ]
    run = _open if specification.loop == "open" else _closed
    out = []
    for one, by, found in run(specification, drawn, cell, candidates):
        out.append(_row(specification, one, by, found, cell))
        if watch is not None and found is not None:
            watch(one, by, found)
    return out


def noise_of(specification: Specification) -> float:
    """Current noise that the observers assume, as a share of the rated current: the middle of what
    the specification says, as a designer would set it."""
    given = specification.vary.get("noise")
    middle = 0.0 if given is None else float(given.at(np.array([0.5]))[0])
    return max(middle, NOISE / 2)


Observed = Iterator[tuple[Simulated, Candidate, ObservedRecord | None]]


def _open(
    specification: Specification, drawn: list[Scenario], cell: Cell, candidates: list[Candidate]
) -> Observed:
    """Every observer on the record of a drive with an encoder."""
    lanes = lanes_for(specification, cell.rated.sample_time)
    for batch in _batches(simulated(specification, drawn, lanes), lanes):
        good = [one for one in batch if one.trace is not None]
        yield from ((one, by, None) for one in batch if one.trace is None for by in candidates)
        if not good:
            continue
        filled = good + good[:1] * (lanes - len(good))
        records = [record_of(one, cell.rated.sample_time) for one in filled]
        voltage = np.stack([record.interval_voltage() for record in records])
        current = np.stack([record.current for record in records])
        true = [true_parameters(one, cell) for one in good]
        for by in candidates:
            wanted = len(good) if by.compiled else lanes
            found = observe(by, voltage[:wanted], current[:wanted], true)
            yield from ((one, by, f) for one, f in zip(good, found, strict=False))


def _closed(
    specification: Specification, drawn: list[Scenario], cell: Cell, candidates: list[Candidate]
) -> Observed:
    """Every observer in the loop of its own drive."""
    lanes = lanes_for(specification, cell.rated.sample_time)
    for by in candidates:
        for one in simulated(specification, drawn, lanes, in_loop(by, cell)):
            found = None
            if one.trace is not None:
                trace = one.trace
                std = trace.std if by.compiled else None
                found = ObservedRecord(trace.angle, trace.seen_speed, trace.valid, std, {})
            yield one, by, found


def _batches(stream: Iterator[Simulated], size: int) -> Iterator[list[Simulated]]:
    while batch := list(islice(stream, size)):
        yield batch


def record_of(one: Simulated, sample_time: float) -> Record:
    """What a log of the drive would hold, with the true angle."""
    trace = one.trace
    assert trace is not None
    theta_e = np.asarray(trace.theta_e)
    return Record(sample_time, trace.voltage, trace.current, theta_e=theta_e)


def true_parameters(one: Simulated, cell: Cell) -> Parameters:
    """What an observer should find of a drive."""
    assert one.drive is not None
    motor, inverter = one.drive.plant.motor, one.drive.inverter
    link = one.scenario.values.get("dc_link", 1.0) * cell.rated.dc_link
    lost = float(inverter.dead_time) / cell.rated.sample_time * link + float(inverter.drop)
    return Parameters(float(motor.R_s), float(motor.psi_f), lost)


def _row(
    specification: Specification,
    one: Simulated,
    by: Candidate,
    found: ObservedRecord | None,
    cell: Cell,
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "number": one.scenario.number,
        "machine": one.scenario.machine,
        "observer": by.table.name,
        "failed": one.failed or None,
    }
    for name in specification.vary:
        neutral = QUANTITIES[name].neutral if name in QUANTITIES else 1.0
        row[name] = one.scenario.values.get(name, neutral)
    if one.trace is None or found is None:
        return row
    h, start = cell.rated.sample_time, specification.course.score_from
    theta_e = np.asarray(one.trace.theta_e)
    t = np.asarray(np.arange(len(theta_e)) * h, float)
    speed = true_speed(cell.machine, theta_e, one.trace.speed, h)
    row |= scores.measures(t, one.trace, speed, found, cell.machine, start)
    if specification.loop == "closed":
        row |= scores.loop_measures(t, one.trace, start)
    return row
