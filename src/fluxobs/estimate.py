"""The main job: a log in; flux, position, speed, drift and their standard deviations out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from .errors import FluxobsError
from .frames import angle_error
from .logs import Aligned, Log
from .machines import RotatingMachine
from .observers import (
    AdaptiveEstimate,
    AdaptiveObserver,
    Estimate,
    LeastSquaresObserver,
    SampleCounts,
)
from .observers.adaptive import RESISTANCE_MOST
from .observers.least_squares import MEMORY
from .scales import Scales, guess_psi_f, measure_scales, observer_for
from .tally import Tally
from .unknowns import adapts, check_adapted
from .writing import Schema, ahead, check_out, write_rows

Array = NDArray[np.float64]

_COLUMNS = (
    "t",
    "flux_alpha",
    "flux_beta",
    "psi_f",
    "theta_e",
    "theta_e_tracked",
    "speed_e",
    "drift_alpha",
    "drift_beta",
    "theta_e_std",
)
#: Further ones of the adaptive observer.
_ADAPTIVE_COLUMNS = (
    "psi_f_std",
    "drift_std",
    "resistance",
    "resistance_std",
    "inverter_voltage",
    "inverter_voltage_std",
    "theta_e_other",
    "weight_other",
)


@dataclass(frozen=True, eq=False)
class Result:
    """All that a summary or a picture needs; the rows themselves are in the file."""

    log: Log
    machine: RotatingMachine
    observer: LeastSquaresObserver
    scales: Scales
    tally: Tally
    counts: SampleCounts
    adaptive: AdaptiveObserver | None = None  # in which `observer` ran


def position_error(machine: RotatingMachine, estimated: Array, true: Array) -> Array:
    """Estimated minus true angle, wrapped; modulo half a turn where the machine is."""
    return angle_error(estimated, true, machine.half_turn_ambiguous)


def prepare(
    log: Log, machine: RotatingMachine, memory: float = MEMORY
) -> tuple[LeastSquaresObserver, Scales]:
    """First pass over the log, and the observer chosen from machine and log."""
    if memory < 10 * log.sample_time:
        raise FluxobsError(
            f"{log.table.path}: a row every {log.sample_time:.6g} s is too slow for a memory of "
            f"{memory:g} s, which takes ten rows at least. Is t in ms? --scale t=1e-3"
        )
    scales = measure_scales(log)
    psi_f = getattr(machine, "psi_f", None)
    try:
        if psi_f is None and machine.flux_base(None, 1.0) is None:
            psi_f = guess_psi_f(log, machine, scales, memory)
        return observer_for(log, machine, scales, memory, psi_f), scales
    except ValueError as error:
        raise FluxobsError(str(error)) from None


def check_priors(
    plain: LeastSquaresObserver,
    machine: RotatingMachine,
    scales: Scales,
    priors: Mapping[str, float],
) -> None:
    """FluxobsError where a standard deviation is beyond sense, in a wrong unit most likely."""
    for name, most, words in (
        ("resistance", RESISTANCE_MOST * machine.R_s, f"{RESISTANCE_MOST:g} times R_s"),
        ("inverter", scales.voltage, "the voltage in this log"),
        ("psi_f", plain.flux_base, "the magnet flux itself"),
    ):
        if priors.get(name, 0.0) > most > 0:
            raise FluxobsError(
                f"--prior {name}={priors[name]:g}: a standard deviation, in SI units; this is more "
                f"than {words}, {most:.3g}"
            )


def adapt(
    plain: LeastSquaresObserver,
    machine: RotatingMachine,
    scales: Scales,
    unknowns: tuple[str, ...],
    priors: Mapping[str, float],
) -> AdaptiveObserver:
    """The adaptive observer around one that was chosen for a log."""
    check_adapted(machine, unknowns, priors)
    check_priors(plain, machine, scales, priors)
    try:
        return AdaptiveObserver.for_machine(
            machine,
            sample_time=plain.sample_time,
            unknowns=unknowns,
            memory=plain.memory,
            psi_f=plain.flux_base,
            rated_current=machine.rated_current or scales.current,
            current_noise=plain.current_noise,
            drift_prior=plain.drift_prior,
            psi_f_std=priors.get("psi_f"),
            resistance_std=priors.get("resistance"),
            inverter_std=priors.get("inverter"),
        )
    except ValueError as error:
        raise FluxobsError(str(error)) from None


def estimate(
    log: Log,
    machine: RotatingMachine,
    out: str | Path,
    memory: float = MEMORY,
    progress: Callable[[int], Any] = lambda rows: None,
    unknowns: tuple[str, ...] = ("drift",),
    priors: Mapping[str, float] | None = None,
) -> Result:
    """Runs the observer over a log and writes a row a sample.

    Streams: neither log nor estimates need fit into memory, and the numbers do not depend on how
    they are cut. `out` appears only when complete.

    Parameters
    ----------
    log : Log
    machine : Machine
    out : path
        Ends in .parquet or .csv.
    memory : float
        Of the least squares [s].
    progress : callable
        Called with the number of rows done so far.
    unknowns : tuple of {"drift", "resistance", "inverter"}
        What is not known.
    priors : mapping of {"resistance", "inverter", "psi_f"} to float
        Standard deviations of what the machine file says [Ω], [V], [Wb], where the defaults of
        :meth:`AdaptiveObserver.for_machine` do not fit.

    Returns
    -------
    Result

    Raises
    ------
    FluxobsError
        Unusable input, or an `out` that cannot be written.
    """
    out = check_out(out, log.table.path)
    plain, scales = prepare(log, machine, memory)
    adaptive = None
    if adapts(unknowns):
        adaptive = adapt(plain, machine, scales, unknowns, priors or {})
    observer = adaptive or plain
    tally = Tally(len(log))
    state = observer.init()

    def rows() -> Iterator[pl.DataFrame]:
        nonlocal state
        for part in ahead(log.aligned()):
            state, estimated = observer.resume(state, part.voltage, part.current)
            error = (
                None
                if part.truth is None
                else position_error(machine, estimated.theta_e, part.truth)
            )
            tally.add(part, estimated, error)
            progress(tally.rows)
            yield _frame(part, estimated, error)

    names = _COLUMNS if adaptive is None else _COLUMNS + _ADAPTIVE_COLUMNS
    schema: Schema = dict.fromkeys(names, pl.Float64)
    schema["valid"] = pl.Boolean
    if log.truth is not None:
        schema["theta_e_error"] = pl.Float64
    write_rows(out, schema, rows())
    return Result(log, machine, plain, scales, tally, observer.counts(state), adaptive)


def _frame(rows: Aligned, estimate: Estimate, error: Array | None) -> pl.DataFrame:
    columns: dict[str, NDArray[Any]] = {
        "t": rows.t,
        "flux_alpha": estimate.flux[:, 0],
        "flux_beta": estimate.flux[:, 1],
        "psi_f": estimate.psi_f,
        "theta_e": estimate.theta_e,
        "theta_e_tracked": estimate.theta_e_tracked,
        "speed_e": estimate.speed_e,
        "drift_alpha": estimate.drift[:, 0],
        "drift_beta": estimate.drift[:, 1],
        "theta_e_std": estimate.theta_e_std,
    }
    if isinstance(estimate, AdaptiveEstimate):
        columns |= {name: getattr(estimate, name) for name in _ADAPTIVE_COLUMNS}
    columns["valid"] = estimate.valid
    if error is not None:
        columns["theta_e_error"] = error
    return pl.DataFrame(columns)
