"""The main job: a log in; flux, position, speed, drift and their standard deviations out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import polars as pl

from ..logs.for_machine import open_for
from ..logs.read import Source
from ..machines import Machine, RotatingMachine
from ..machines.files import as_machine
from ..observers import AdaptiveObserver, LogObserver
from ..observers.adaptive import Learnt
from ..observers.unknowns import ALL, AUTO, read_unknowns
from ..output import ahead, check_out, write_rows
from ..validation import number
from .columns import rows_of
from .learning import learn, learning_parts, needed
from .prepare import prepare
from .result import Result
from .statistics import Statistics
from .truth import TruthSamples


def estimate(
    log: Source,
    machine: Machine | str | Path,
    *,
    out: str | Path | None = None,
    keep: bool = True,
    force: bool = False,
    unknowns: str | Sequence[str] = "auto",
    causal: bool = False,
    memory: float | None = None,
    priors: Mapping[str, float] | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **layout: Any,
) -> Result:
    """Estimate flux, position, speed and drift of a recorded log, with standard deviations.

    With `out` rows are streamed: neither log nor estimates need to fit into memory. The numbers do
    not depend on the size of the batches. `out` appears only when it is complete.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, or a path, or the name of a shipped machine
    out : path, optional
        Ends in .parquet or .csv. Without it the estimates stay in memory.
    keep : bool
        If false, estimates that are not written are not kept either: for the summary alone.
    force : bool
        Overwrite `out` if it exists.
    unknowns : "auto", or str or sequence of {"drift", "resistance", "inverter", "asymmetry", \
            "current-bias"}
        Constant or slow unknowns. With resistance, inverter or asymmetry the adaptive observer
        runs; with current-bias the readable one, 0.25 ms per row. "auto": all that the adaptive
        observer finds, if the log tells resistance or inverter, else drift.
    causal : bool
        The adaptive observer learns from the whole log, then estimates with what it has learnt.
        If true it learns as it goes: what firmware would have known at the time.
    memory : float, optional
        Memory of the least squares [s]; default: that of the kind of machine.
    priors : mapping of {"resistance", "inverter", "asymmetry", "psi_f"} to float, optional
        Standard deviations of the machine file's values [Ω], [V], [1], [Wb], if the defaults of
        :meth:`AdaptiveObserver.for_machine` do not fit.
    progress : callable, optional
        Called with the number of rows done and the number of all rows.
    layout : optional
        record, preset, frame, lag, columns, unit, truth, and more: as for
        :func:`fluxobs.read_log`.

    Returns
    -------
    Result
        ``result["theta_e"]``, ``.estimates``, ``.summary``, ``.warnings``, ``.counts``,
        ``.plot()``, ``.write(path)``.

    Raises
    ------
    FluxobsError
        The input is unusable, the unknowns cannot be told apart, or `out` cannot be written; the
        message says what, where, and the remedy.

    Examples
    --------
    >>> import fluxobs
    >>> result = fluxobs.estimate(fluxobs.demo_log(), "servo-400w")
    >>> round(float(result["resistance"][-1]), 3)  # 0.360 is true
    0.36
    """
    machine = as_machine(machine)
    if memory is not None:
        memory = number("memory", memory, "s")
    chosen, stds = read_unknowns(unknowns), dict(priors or {})
    opened = open_for(log, machine, **layout)
    path = None if out is None else check_out(out, opened.path, force)
    automatic, done, total = chosen == (AUTO,), 0, len(opened)
    if automatic:
        chosen = ALL if isinstance(machine, RotatingMachine) else ("drift",)
    run = prepare(opened, machine, chosen, memory, stds)
    learnt: Learnt | None = None
    state: Any = None
    if isinstance(run.observer, AdaptiveObserver) and (automatic or not causal):
        ahead_of = sum(last - first for first, last in learning_parts(run.log))

        def tell(rows: int) -> None:
            nonlocal done
            done += rows
            if progress is not None:
                progress(done, ahead_of + total)

        state, learnt = learn(run, run.observer, tell)
        if automatic:
            plain = prepare(opened, machine, ("drift",), memory, {})
            if not needed(run.observer, learnt, plain):
                chosen, stds, learnt, state, run = ("drift",), {}, None, None, plain
    statistics = Statistics(total)
    if opened.true is not None and opened.layout.fit_truth and run.plain_outputs:
        statistics.truth = TruthSamples(total, opened.true.channel)
    observer: LogObserver[Any, Any] = run.observer
    if state is None or causal:
        state = observer.init()

    def frames() -> Iterator[pl.DataFrame]:
        nonlocal state
        for part in ahead(run.log.aligned(size=run.batch)):
            state, found = observer.resume(state, part.voltage, part.current)
            rows = rows_of(run.log, machine, run.observer, part, found)
            statistics.add(rows)
            if progress is not None:
                progress(done + statistics.rows, done + total)
            yield pl.DataFrame(rows.columns)

    made = frames()
    first = next(made)
    everything = chain([first], made)
    table = None
    if path is not None:
        write_rows(path, dict(first.schema), everything)
    elif keep:
        table = pl.concat(everything)
    else:
        for _ in everything:
            pass
    if isinstance(run.observer, AdaptiveObserver):
        learnt = run.observer.learnt(state)
    return Result(
        run.log,
        machine,
        run.observer,
        run.scales,
        chosen,
        stds,
        statistics,
        observer.counts(state),
        learnt,
        automatic,
        causal,
        table,
        path,
    )
