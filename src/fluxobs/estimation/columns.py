"""Turn the estimates of an observer for a batch of rows into the columns of the output file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..logs.log import Log
from ..logs.time.aligned import Aligned
from ..machines import Machine, RotatingMachine
from ..observers import AdaptiveEstimate, Estimate, ImmersionEstimate, ImmersionObserver
from ..observers.derived import derived, derived_outputs
from ..observers.for_log import AnyObserver
from ..observers.outputs import in_files
from ..smoothing.estimate import SmoothedEstimate

#: A position of the immersed observer is valid only if its standard deviation is below this share
#: of the position's span: 3°, or 5 % of the gap. The compiled observer has the same limit
#: (STD_LIMIT).
POSITION_STD = 0.05


@dataclass(frozen=True, eq=False)
class EstimateRows:
    """The columns of a batch of rows of a run.

    Attributes
    ----------
    columns : dict
        The columns of the output file: name → values.
    valid : (rows,) ndarray of bool
    error : (rows,) ndarray, optional
        Position error; None if the log has no true position.
    innovation : (rows,) ndarray, optional
        None if the observer is not a compiled one.
    more : dict
        Columns that only pictures and summary use: truth, raw (the truth channel), adapting.
    """

    columns: dict[str, NDArray[Any]]
    valid: NDArray[np.bool_]
    error: Array | None
    innovation: Array | None
    more: dict[str, Array]


def rows_of(
    log: Log, machine: Machine, observer: AnyObserver, batch: Aligned, estimates: Any
) -> EstimateRows:
    """Return the columns for a `batch` of the log, from the `estimates` of `observer`."""
    more: dict[str, Array] = {}
    if isinstance(estimates, Estimate):
        columns, valid = _compiled(machine, batch, estimates)
        innovation = estimates.innovation
        if isinstance(estimates, AdaptiveEstimate):
            more["adapting"] = estimates.adapting.astype(float)
    elif isinstance(estimates, SmoothedEstimate):
        columns, valid = _smoothed(machine, batch, estimates)
        innovation = estimates.innovation
        more["adapting"] = np.ones(len(valid))
    else:
        assert isinstance(observer, ImmersionObserver)
        columns, valid = _immersed(machine, observer, batch, estimates)
        innovation = None
    error = None
    if batch.truth is not None and log.truth is not None:
        more["raw"] = batch.truth
    if batch.truth is not None and log.true is not None and is_position(log, machine):
        position = machine.position_output.name
        more["truth"] = machine.true_position(log.true.channel, batch.truth)
        error = machine.position_error(columns[position], more["truth"])
        columns[f"{position}_error"] = error
    return EstimateRows(columns, valid, error, innovation, more)


def joined_rows(parts: list[EstimateRows]) -> EstimateRows:
    """Join consecutive rows."""
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    return EstimateRows(
        {name: np.concatenate([part.columns[name] for part in parts]) for name in first.columns},
        np.concatenate([part.valid for part in parts]),
        _joined([part.error for part in parts]),
        _joined([part.innovation for part in parts]),
        {name: np.concatenate([part.more[name] for part in parts]) for name in first.more},
    )


def _joined(parts: list[Array | None]) -> Array | None:
    present = [part for part in parts if part is not None]
    return np.concatenate(present) if present else None


def is_position(log: Log, machine: Machine) -> bool:
    """Whether the truth of a log is a position, not a speed or Hall signals."""
    return log.true is not None and log.true.channel in machine.position_output.truths


def _compiled(
    machine: Machine, batch: Aligned, estimates: Estimate | SmoothedEstimate
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
    columns: dict[str, NDArray[Any]] = {"t": batch.t}
    for output in in_files(type(estimates)):
        value = getattr(estimates, output.name)
        columns |= zip(
            output.columns(machine.ports), value.T if output.vector else [value], strict=True
        )
    valid = columns.pop("valid")
    columns |= derived(machine, estimates, batch.current)
    marks = np.zeros(len(batch.t), np.int64) if batch.marks is None else batch.marks
    return columns | {"quality": marks, "valid": valid}, estimates.valid


def _smoothed(
    machine: Machine, batch: Aligned, estimates: SmoothedEstimate
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
    assert isinstance(machine, RotatingMachine)
    columns, valid = _compiled(machine, batch, estimates)
    factor = 1.5 * machine.n_p
    last = {
        "torque_std": factor * estimates.torque_std,
        "quality": columns.pop("quality"),
        "valid": columns.pop("valid"),
    }
    return columns | {"torque": factor * estimates.torque} | last, valid


def _immersed(
    machine: Machine, observer: ImmersionObserver, batch: Aligned, estimates: ImmersionEstimate
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
    current = batch.current - estimates.current_bias
    position, length = machine.position(estimates.flux, current)
    std = machine.position_std(estimates.flux, estimates.flux_std, current)
    certain = std < POSITION_STD * machine.position_span
    long_enough = length > machine.shortest * float(observer.flux_base[0])
    valid = estimates.valid & np.isfinite(position) & certain & long_enough
    bias_wanted = "current-bias" in observer.immersion.unknowns
    columns: dict[str, NDArray[Any]] = {"t": batch.t}
    for output in in_files(ImmersionEstimate):
        match output.name:
            case "noise_share":  # the larger of both ports' shares
                columns["noise_share"] = estimates.noise_share.max(axis=1)
            case "valid":
                columns["valid"] = valid
            case "current_bias" | "current_bias_std" | "current_bias_valid" if not bias_wanted:
                pass
            case "current_bias_valid":
                columns["current_bias_valid"] = valid & estimates.current_bias_valid
            case _:
                values = getattr(estimates, output.name).T
                columns |= zip(output.columns(machine.ports), values, strict=True)
        if output.name == "flux_std":
            name = machine.position_output.name
            columns |= {name: position, f"{name}_std": std}
    return columns, valid


def column_units(machine: Machine) -> dict[str, str]:
    """Return the SI unit of each column that an estimate may have; "" if it is dimensionless."""
    units = {"t": "s"}
    for kind in (Estimate, AdaptiveEstimate, SmoothedEstimate, ImmersionEstimate):
        for output in in_files(kind):
            units |= dict.fromkeys(output.columns(machine.ports), output.unit)
    units |= {output.name: output.unit for output in derived_outputs(machine)}
    units["torque_std"] = units.get("torque", "")
    position = machine.position_output.name
    unit = units.get(position, "m")  # a rotating machine's is an output
    units |= dict.fromkeys((position, f"{position}_std", f"{position}_error"), unit)
    return units
