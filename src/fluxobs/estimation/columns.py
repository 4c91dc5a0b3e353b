"""Turns what an observer returned for some rows of a log into the columns that are written."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..logs.aligned import Aligned
from ..logs.log import Log
from ..machines import Machine
from ..observers import AdaptiveEstimate, Estimate, ImmersionEstimate, ImmersionObserver
from ..observers.derived import derived
from ..observers.for_log import AnyObserver
from ..observers.outputs import in_files

#: A position from the immersed observer's flux is not valid if its standard deviation is larger:
#: 3°, or this share of the gap, as in the compiled observer (STD_LIMIT).
POSITION_STD = 0.05


@dataclass(frozen=True, eq=False)
class EstimateRows:
    """Rows of a run.

    Attributes
    ----------
    columns : dict
        As written: name → values.
    valid : (rows,) ndarray of bool
    error : (rows,) ndarray, optional
        Position error, if there is a truth.
    innovation : (rows,) ndarray, optional
        Only from the compiled observers.
    more : dict
        For pictures and summary, but not written: truth, raw (the truth channel), adapting.
    """

    columns: dict[str, NDArray[Any]]
    valid: NDArray[np.bool_]
    error: Array | None
    innovation: Array | None
    more: dict[str, Array]


def rows_of(
    log: Log, machine: Machine, observer: AnyObserver, part: Aligned, found: Any
) -> EstimateRows:
    """Make columns of what `observer` returned for `part` of a log."""
    more: dict[str, Array] = {}
    if isinstance(found, Estimate):
        columns, valid = _compiled(machine, part, found)
        innovation = found.innovation
        if isinstance(found, AdaptiveEstimate):
            more["adapting"] = found.adapting.astype(float)
    else:
        assert isinstance(observer, ImmersionObserver)
        columns, valid = _immersed(machine, observer, part, found)
        innovation = None
    error = None
    if part.truth is not None and log.truth is not None:
        more["raw"] = part.truth
    if part.truth is not None and log.true is not None and is_position(log, machine):
        where = machine.position_output.name
        more["truth"] = machine.true_position(log.true.channel, part.truth)
        error = machine.position_error(columns[where], more["truth"])
        columns[f"{where}_error"] = error
    return EstimateRows(columns, valid, error, innovation, more)


def is_position(log: Log, machine: Machine) -> bool:
    """Whether the truth of a log is the position itself, not a speed or Hall signals."""
    return log.true is not None and log.true.channel in machine.position_output.truths


def _compiled(
    machine: Machine, part: Aligned, found: Estimate
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
    columns: dict[str, NDArray[Any]] = {"t": part.t}
    for one in in_files(type(found)):
        value = getattr(found, one.name)
        columns |= zip(one.columns(machine.ports), value.T if one.vector else [value], strict=True)
    valid = columns.pop("valid")
    columns |= derived(machine, found, part.current)
    return columns | {"valid": valid}, found.valid


def _immersed(
    machine: Machine, observer: ImmersionObserver, part: Aligned, found: ImmersionEstimate
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_]]:
    current = part.current - found.current_bias
    where, length = machine.position(found.flux, current)
    std = machine.position_std(found.flux, found.flux_std, current)
    near = std < POSITION_STD * machine.position_span
    longer = length > machine.shortest * float(observer.flux_base[0])
    valid = found.valid & np.isfinite(where) & near & longer
    biased = "current-bias" in observer.immersion.unknowns
    columns: dict[str, NDArray[Any]] = {"t": part.t}
    for one in in_files(ImmersionEstimate):
        match one.name:
            case "noise_share":  # of the worse port
                columns["noise_share"] = found.noise_share.max(axis=1)
            case "valid":
                columns["valid"] = valid
            case "current_bias" | "current_bias_std" | "current_bias_valid" if not biased:
                pass
            case "current_bias_valid":
                columns["current_bias_valid"] = valid & found.current_bias_valid
            case _:
                values = getattr(found, one.name).T
                columns |= zip(one.columns(machine.ports), values, strict=True)
        if one.name == "flux_std":
            name = machine.position_output.name
            columns |= {name: where, f"{name}_std": std}
    return columns, valid
