"""The main job: a log in; flux, position, speed, drift and their standard deviations out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import polars as pl

from ..core.output import check_out, write_rows
from ..core.validation import number
from ..logs.for_machine import open_for
from ..logs.read import Source
from ..machines import Machine
from ..machines.files import as_machine
from ..observers.unknowns import read_unknowns
from .result import Result
from .two_passes import Passes


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
    chosen = read_unknowns(unknowns)
    opened = open_for(log, machine, **layout)
    path = None if out is None else check_out(out, opened.path, force)
    passes = Passes.begun(opened, machine, chosen, memory, dict(priors or {}), causal, progress)
    made = (pl.DataFrame(rows.columns) for rows in passes.rows(progress))
    first = next(made)
    everything = chain([first], made)
    table = None
    if path is not None:
        write_rows(path, dict(first.schema), everything, force)
    elif keep:
        table = pl.concat(everything)
    else:
        for _ in everything:
            pass
    return Result(**passes.found(), table=table, path=path)
