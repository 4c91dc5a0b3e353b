"""A log through the readable least squares: levitated bodies, and machines with current bias.

The C core knows two ports, one relation and drift; everything else comes here, slower (about
0.25 ms a row); nothing is half-written and the log streams.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from .errors import FluxobsError
from .estimate import position_error
from .immersion import Immersion, Unknown
from .logs import Aligned, Log
from .machines import Machine, MagLev2DOF, RotatingMachine
from .observers.least_squares import MODEL_ERROR
from .observers.reference import ImmersionEstimate, ImmersionObserver, describe_invisible
from .records import lag_in_words
from .scales import LEAST_NOISE, VOLTAGE_OFFSET, Scales, measure_scales
from .writing import Schema, ahead, check_out, write_rows

Array = NDArray[np.float64]

#: A current bias of this share of the rated current is ordinary.
CURRENT_OFFSET = 0.02
#: A position is none beyond this standard deviation: 3°, or this share of the gap.
SPREAD = 0.05
#: A standard deviation above this share of the prior: not seen.
SEEN = 0.25
#: Rows kept for the picture.
THIN_ROWS = 4000


@dataclass
class Kept:
    """Sums for the summary, and thinned rows for the picture."""

    rows: int = 0
    valid: int = 0
    first_valid: float | None = None
    start: float = 0.0
    drift: Array = field(default_factory=lambda: np.zeros(2))
    current_bias: Array = field(default_factory=lambda: np.zeros(2))
    current_bias_std: Array = field(default_factory=lambda: np.zeros(2))
    scored: int = 0
    error: float = 0.0
    error_squared: float = 0.0
    error_max: float = 0.0
    thin: list[pl.DataFrame] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class ReferenceResult:
    """All that a summary or a picture needs; the rows themselves are in the file."""

    log: Log
    machine: Machine
    observer: ImmersionObserver
    scales: Scales
    kept: Kept
    bad: int
    restarts: int


def check_unknowns(machine: Machine, unknowns: Sequence[Unknown]) -> None:
    """FluxobsError where the machine's relation cannot tell these apart, naming what is hidden."""
    immersion = Immersion((machine.constraint,), tuple(unknowns), machine.R)
    invisible = immersion.invisible()
    if invisible.shape[1] == 0:
        return
    advice = "Run with --unknowns drift"
    if isinstance(machine, RotatingMachine):
        advice += (
            ": the flux returned is then off by L times the current bias, while λ - L i, hence "
            "position and speed, is free of it"
        )
    raise FluxobsError(
        f"{' and '.join(unknowns)} cannot both be found for kind {machine.kind}: "
        f"{describe_invisible(invisible)}. {advice}"
    )


def observer_for(
    machine: Machine,
    unknowns: Sequence[Unknown],
    sample_time: float,
    memory: float,
    scales: Scales,
) -> ImmersionObserver:
    """Observer with everything chosen from the machine and the sizes of a log."""
    rated = machine.rated_current or scales.current
    base = machine.flux_base(getattr(machine, "psi_f", None), rated)
    if base is None:
        raise FluxobsError(f"psi_f is missing in the machine ({machine.kind}); a rough value does")
    noise = max(scales.current_noise, LEAST_NOISE * rated)
    drift = VOLTAGE_OFFSET * scales.voltage * np.abs(machine.B).max()
    size = np.abs(machine.constraint.Q1).max() * base**2
    residual = float(np.hypot(machine.constraint_noise(base, rated, noise), MODEL_ERROR * size))
    bias = CURRENT_OFFSET * rated
    if "current-bias" in unknowns:
        drift = max(drift, bias * np.abs(machine.R).max())
    return ImmersionObserver(
        Immersion((machine.constraint,), tuple(unknowns), machine.R),
        machine.R,
        machine.B,
        sample_time,
        memory,
        flux_base=np.full(2, base),
        constraint_noise=np.array([residual]),
        drift_prior=np.full(2, drift),
        current_bias_prior=np.full(2, bias),
        current_noise=noise,
        voltage_noise=scales.voltage_noise if isinstance(machine, MagLev2DOF) else 0.0,
    )


def estimate(
    log: Log,
    machine: Machine,
    unknowns: Sequence[Unknown],
    out: str | Path,
    memory: float | None = None,
    progress: Callable[[int], Any] = lambda rows: None,
) -> ReferenceResult:
    """Runs the readable least squares over a log and writes a row a sample.

    Parameters
    ----------
    log : Log
    machine : Machine
    unknowns : sequence of {"drift", "current-bias"}
    out : path
        Ends in .parquet or .csv.
    memory : float, optional
        [s]; default that of the machine's kind.
    progress : callable
        Called with the number of rows done so far.

    Raises
    ------
    FluxobsError
        Unknowns that cannot be told apart, unusable input, or an `out` that cannot be written.
    """
    out = check_out(out, log.table.path)
    check_unknowns(machine, unknowns)
    check_truth(log, machine)
    memory = machine.memory if memory is None else memory
    if memory < 10 * log.sample_time:
        raise FluxobsError(
            f"{log.table.path}: a row every {log.sample_time:.6g} s is too slow for a memory of "
            f"{memory:g} s, which takes ten rows at least. Give a longer --memory; or is t in ms? "
            f"--scale t=1e-3"
        )
    scales = measure_scales(log)
    observer = observer_for(machine, unknowns, log.sample_time, memory, scales)
    state, kept = observer.init(), Kept()
    stride = max(1, len(log) // THIN_ROWS)

    def rows() -> Iterator[pl.DataFrame]:
        nonlocal state
        for part in ahead(log.aligned(size=2000)):
            state, found = observer.resume(state, part.voltage, part.current)
            frame = _frame(machine, observer, part, found)
            _keep(kept, frame, found, stride)
            progress(kept.rows)
            yield frame

    names = _columns(machine, observer, log.truth is not None)
    schema: Schema = dict.fromkeys(names, pl.Float64)
    schema["valid"] = pl.Boolean
    write_rows(out, schema, rows())
    return ReferenceResult(log, machine, observer, scales, kept, state.bad, state.restarts)


def check_truth(log: Log, machine: Machine) -> None:
    """FluxobsError where the machine has no such position to be scored by."""
    for channel in log.layout.truth:
        if (channel == "position") != isinstance(machine, MagLev2DOF):
            right = "position" if isinstance(machine, MagLev2DOF) else "theta_e or theta_mech"
            raise FluxobsError(f"--truth {channel}: kind {machine.kind} has {right}")


def _suffixes(machine: Machine) -> tuple[str, str]:
    return ("alpha", "beta") if isinstance(machine, RotatingMachine) else ("1", "2")


def _columns(machine: Machine, observer: ImmersionObserver, truth: bool) -> list[str]:
    a, b = _suffixes(machine)
    names = ["t", f"flux_{a}", f"flux_{b}", f"flux_{a}_std", f"flux_{b}_std"]
    where = "theta_e" if isinstance(machine, RotatingMachine) else "position"
    names += [where, f"{where}_std", f"drift_{a}", f"drift_{b}"]
    if "current-bias" in observer.immersion.unknowns:
        names += [f"current_bias_{a}", f"current_bias_{b}"]
        names += [f"current_bias_{a}_std", f"current_bias_{b}_std"]
    names += ["noise_share", "valid"]
    return [*names, f"{where}_error"] if truth else names


def _frame(
    machine: Machine, observer: ImmersionObserver, rows: Aligned, found: ImmersionEstimate
) -> pl.DataFrame:
    current = rows.current - found.current_bias
    if isinstance(machine, MagLev2DOF):
        where, length = machine.position(found.flux, current)
        gaps = np.stack([machine.g - where, machine.g + where], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.linalg.norm(found.flux * gaps * found.flux_std, axis=-1) / length**2
        error = None if rows.truth is None else where - rows.truth
        least = 0.0
    elif isinstance(machine, RotatingMachine):
        x = found.flux - machine.position_inductance * current
        where, length = np.arctan2(x[:, 1], x[:, 0]), np.hypot(*x.T)
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.linalg.norm(found.flux_std, axis=-1) / np.sqrt(2) / length
        least = machine.shortest * float(observer.flux_base[0])
        error = None if rows.truth is None else position_error(machine, where, rows.truth)
    else:
        raise FluxobsError(f"kind {machine.kind} has no read-out of its position")
    columns: list[NDArray[Any]] = [rows.t, *found.flux.T, *found.flux_std.T, where, spread]
    columns += [*found.drift.T]
    if "current-bias" in observer.immersion.unknowns:
        columns += [*found.current_bias.T, *found.current_bias_std.T]
    gap = machine.g if isinstance(machine, MagLev2DOF) else 1.0
    valid = found.valid & np.isfinite(where) & (spread < SPREAD * gap) & (length > least)
    columns += [found.noise_share.max(axis=1), valid]
    if error is not None:
        columns.append(error)
    names = _columns(machine, observer, error is not None)
    return pl.DataFrame(dict(zip(names, columns, strict=True)))


def _keep(kept: Kept, frame: pl.DataFrame, found: ImmersionEstimate, stride: int) -> None:
    t, valid = frame["t"].to_numpy(), frame["valid"].to_numpy()
    if kept.rows == 0:
        kept.start = float(t[0])
    if kept.first_valid is None and valid.any():
        kept.first_valid = float(t[np.argmax(valid)])
    kept.valid += int(valid.sum())
    kept.drift = kept.drift + found.drift[valid].sum(axis=0)
    kept.current_bias = kept.current_bias + found.current_bias[valid].sum(axis=0)
    kept.current_bias_std = kept.current_bias_std + found.current_bias_std[valid].sum(axis=0)
    name = next((name for name in frame.columns if name.endswith("_error")), None)
    if name is not None:
        error = frame[name].to_numpy()[valid]
        error = error[np.isfinite(error)]
        kept.scored += len(error)
        kept.error += float(error.sum())
        kept.error_squared += float((error**2).sum())
        kept.error_max = max(kept.error_max, float(np.abs(error).max(initial=0.0)))
    kept.thin.append(frame[-kept.rows % stride :: stride])
    kept.rows += len(t)


def summarise(result: ReferenceResult) -> tuple[str, list[str]]:
    """One paragraph, and one sentence a warning."""
    kept, log, machine = result.kept, result.log, result.machine
    head = (
        f"{kept.rows} samples, {kept.rows * log.sample_time:.4g} s at {1 / log.sample_time:.6g} "
        f"Hz; {lag_in_words(log.layout.lag)}. Unknown: "
        f"{' and '.join(result.observer.immersion.unknowns)}; memory {result.observer.memory:g} s."
    )
    warnings = []
    if result.bad:
        warnings.append(f"{result.bad} rows without a current or a voltage (the last one held).")
    if result.restarts:
        warnings.append(
            f"Started anew {result.restarts} ×: samples contradicted all before. Something that "
            f"should be constant has jumped, or the assumed noise is too small."
        )
    if not kept.valid:
        warnings.append(
            "The flux was never known: too little excitation for the noise, or machine data, "
            "column scale or --lag are wrong."
        )
        return head, warnings
    if kept.valid < 0.5 * kept.rows:
        warnings.append(
            f"The flux is known on {kept.valid / kept.rows:.1%} of the rows only: little "
            f"excitation for the noise. "
            + (
                "--unknowns drift asks for less."
                if "current-bias" in result.observer.immersion.unknowns
                else "A longer --memory may see weaker excitation."
            )
        )
    drift, bias = kept.drift / kept.valid, kept.current_bias / kept.valid
    offset = -np.linalg.solve(machine.B, drift)
    first = (kept.first_valid or 0.0) - kept.start
    sentences = [
        head,
        f"The flux is known on {kept.valid / kept.rows:.1%} of the rows, first {first:.3g} s "
        f"after the start. The flux integral would drift by ({drift[0]:+.4g}, {drift[1]:+.4g}) V, "
        f"as much as voltage offsets of ({offset[0]:+.3g}, {offset[1]:+.3g}) V.",
    ]
    if "current-bias" in result.observer.immersion.unknowns:
        std = kept.current_bias_std / kept.valid
        seen = (std < SEEN * result.observer.current_bias_prior).all()
        assumed = result.observer.immersion.unknowns == ("current-bias",)
        sentences.append(
            f"Current bias: {bias[0]:+.4g} ± {std[0]:.2g} and {bias[1]:+.4g} ± {std[1]:.2g} A (σ)"
            f"{', if the voltage has no offset' if assumed else ''}."
            if seen
            else "Current bias: not seen."
        )
        if not seen:
            warnings.append(
                "The current bias was hardly seen by this log, and what is taken for it disturbs "
                "the rest: --unknowns drift ignores it, which costs little."
            )
    if kept.scored:
        rms, mean = np.sqrt(kept.error_squared / kept.scored), kept.error / kept.scored
        scale, unit = (180 / np.pi, "°") if isinstance(machine, RotatingMachine) else (1e6, " µm")
        sentences.append(
            f"Against the true position, on {kept.scored} valid rows: error "
            f"{scale * rms:.3g}{unit} rms, {scale * kept.error_max:.3g}{unit} at most, mean "
            f"{scale * mean:.3g}{unit}."
        )
    return " ".join(sentences), warnings


def report(result: ReferenceResult, path: Path) -> None:
    """Picture: flux with ±2σ, position, drift, current bias or noise share."""
    import matplotlib as mpl

    from .plots import BLUE, GREY, ORANGE, STYLE, check_path, write

    check_path(path)
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    whole = pl.concat(result.kept.thin)
    t, valid = whole["t"].to_numpy(), whole["valid"].to_numpy()
    a, b = _suffixes(result.machine)
    rotating = isinstance(result.machine, RotatingMachine)
    where, scale, unit = ("theta_e", 180 / np.pi, "°") if rotating else ("position", 1e6, "µm")
    last = f"current_bias_{a}" in whole.columns
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(4, 1, figsize=(9, 9), layout="constrained", sharex=True)

        def pair(axis: Any, name: str, factor: float = 1.0) -> None:
            for suffix, colour in ((a, BLUE), (b, ORANGE)):
                column = f"{name}_{suffix}"
                value = np.where(valid, factor * whole[column].to_numpy(), np.nan)
                axis.plot(t, value, color=colour, label=suffix)
                if f"{column}_std" in whole.columns:
                    band = 2 * factor * whole[f"{column}_std"].to_numpy()
                    axis.fill_between(t, value - band, value + band, color=colour, alpha=0.2, lw=0)
            axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)

        pair(axes[0], "flux", 1e3 if rotating else 1e6)
        axes[0].set_title(f"Flux [{'mWb' if rotating else 'µWb'}], band ±2σ")
        position = np.where(valid, scale * whole[where].to_numpy(), np.nan)
        axes[1].plot(t, position, color=BLUE)
        axes[1].set_title(f"{'Electrical angle' if rotating else 'Position'} [{unit}]")
        pair(axes[2], "drift")
        axes[2].set_title("Drift [V]")
        if last:
            pair(axes[3], "current_bias")
            axes[3].set_title("Current bias [A], band ±2σ")
        else:
            axes[3].semilogy(t, np.maximum(whole["noise_share"].to_numpy(), 1e-12), color=GREY)
            axes[3].set_title(
                "Share of flux information that is noise; to be known: below 0.1, and σ below 5 %"
            )
        axes[3].set_xlabel("t [s]")
        axes[3].set_xlim(t[0], t[-1])
        figure.suptitle(
            f"{result.log.table.path.name}  ·  {result.machine.kind}  ·  flux known on "
            f"{result.kept.valid / result.kept.rows:.1%} of {result.kept.rows} rows",
            fontsize=10,
        )
        write(figure, path)
        plt.close(figure)
