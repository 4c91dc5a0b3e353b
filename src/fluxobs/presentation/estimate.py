"""Estimate flux, position, speed and drift from a log, with standard deviations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from ..core.output import check_out, write_rows
from ..core.validation import number
from ..estimation.passes import Passes
from ..logs.for_machine import open_for
from ..logs.read import Source
from ..machines import MachineSource
from ..machines.files import as_machine
from ..observers.unknowns import read_unknowns
from .result import Result

if TYPE_CHECKING:
    from typing import Unpack

    from ..logs.meaning.options import ReadOptions


def estimate(
    log: Source,
    machine: MachineSource,
    *,
    out: str | Path | None = None,
    keep: bool = True,
    force: bool = False,
    unknowns: str | Sequence[str] = "auto",
    causal: bool = False,
    memory: float | None = None,
    priors: Mapping[str, float] | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **layout: Unpack[ReadOptions],
) -> Result:
    """Estimate flux, position, speed and drift of a recorded log, with standard deviations.

    With `out`, rows are streamed, so log and estimates need not fit into memory. The numbers do not
    depend on the batch size. The file `out` appears only when it is complete.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, or a path, or the name of a machine that comes with fluxobs
    out : path, optional
        Output file, .parquet or .csv. Without `out`, the estimates stay in memory.
    keep : bool
        If false, discard estimates that are not written; only the summary remains.
    force : bool
        Overwrite `out` if it exists.
    unknowns : "auto", or str or sequence of {"drift", "resistance", "inverter", "asymmetry", \
            "current-bias"}
        Constant or slow unknowns. With resistance, inverter or asymmetry, the adaptive observer
        runs; with current-bias, the immersed observer runs, in Python, at 0.25 ms per row. "auto"
        means all unknowns of the adaptive observer. In both directions every assumption is in the
        standard deviations, whichever observer starts.
    causal : bool
        By default, each row is estimated from the record before and behind it. If true, the
        observer learns while it estimates, as in firmware.
    memory : float, optional
        Memory of the least squares [s]. The default depends on the kind of machine.
    priors : mapping of str to float, optional
        Standard deviations of what the estimate assumes: resistance [Ω], inverter [V],
        asymmetry [1], psi_f [Wb], and unless `causal` also offset [A], lag [samples], current_gain,
        voltage_gain, iron_loss, L_d, L_q, saturation, harmonics, R_R, L_M, voltage_scale,
        current_scale [1], tilt [rad]. :mod:`fluxobs.smoothing.assumptions` has the defaults.
    progress : callable, optional
        Called with the number of finished rows and the number of all rows.
    layout : optional
        Arguments of :func:`fluxobs.read_log`: record, preset, frame, lag, columns, unit, truth, and
        more.

    Returns
    -------
    Result
        A table with a row per row of the log; each column has shape (rows,) and most have their
        standard deviation as a column ``_std``. Of a machine that turns: t [s]; theta_e, electrical
        rotor angle [rad], -π to π; speed_e and speed_mech [rad/s]; flux_alpha, flux_beta and psi_f
        [Wb]; torque [Nm]; drift_alpha, drift_beta and inverter_voltage [V]; resistance [Ω]; valid
        [bool], whether theta_e_std can be trusted; quality [int], the marks of
        :mod:`fluxobs.logs.quality.marks`; with a true angle also theta_e_error [rad].
        ``result["theta_e"]`` is a column; ``.summary``, ``.warnings``, ``.plot()`` and
        ``.write(path)`` show and store it.

    Raises
    ------
    FluxobsError
        The input is unusable, the unknowns are not identifiable together, or `out` cannot be
        written; the message says what is wrong, where, and what to do.

    Examples
    --------
    >>> import fluxobs
    >>> result = fluxobs.estimate(fluxobs.demo_log(), "servo-400w")
    >>> round(float(result["resistance"][-1]), 2)  # the true value is 0.36
    0.36
    """
    machine = as_machine(machine)
    if memory is not None:
        memory = number("memory", memory, "s")
    unknown_names = read_unknowns(unknowns)
    opened_log = open_for(log, machine, **layout)
    path = None if out is None else check_out(out, opened_log.path, force)
    passes = Passes.begun(
        opened_log, machine, unknown_names, memory, dict(priors or {}), causal, progress
    )
    tables = (pl.DataFrame(rows.columns) for rows in passes.rows(progress))
    first_table = next(tables)
    all_tables = chain([first_table], tables)
    table = None
    if path is not None:
        write_rows(path, dict(first_table.schema), all_tables, force)
    elif keep:
        table = pl.concat(all_tables)
    else:
        for _ in all_tables:
            pass
    return Result(**passes.found(), table=table, path=path)
