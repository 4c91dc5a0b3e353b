"""How well a smoothed record fits, and what it learnt."""

from __future__ import annotations

import numpy as np

from ..logs.quality.marks import BRIDGE_OFF, NO_CURRENT
from ..machines.model.flux_map import LinearMap
from ..smoothing.assumptions import ITEMS, Calibration, with_scale
from ..smoothing.record import Assumed, SmoothedRecord, SmoothingModel
from .course import CONVERGED_MISFIT

#: A learnt deviation of more prior standard deviations contradicts the machine or the layout: no
#: row is valid. Of 318 drives with every error at once none has more than 5.4
#: (benchmarks/whole_log.py); with two phases exchanged, an inductance has 10.
CONTRADICTION = 6.0
#: The same for constant inductances of a machine with saliency: the machine saturates, and its
#: inductances differ from row to row. Of 44 saturated drives with such a file,
#: 2 have a valid row beyond 10°, 1 beyond 20° (benchmarks/whole_log.py --file).
SATURATED = 2.7
#: The same for the sag of the DC link. Of 56 drives without sag 95 % have less than 1.5, of 12 with
#: 5 to 12 % of sag 10 have more (benchmarks/faults.py --kind "link sag").
SAGGED = 3.5
#: The same for the magnet flux, whose prior is a quarter: with a quarter of the flux or less, the
#: search ended in another minimum (benchmarks/faults.py --kind "open loop").
WEAK = 3.0
#: The same for the only inductance of a machine, if it is too small: saturation leaves two thirds.
#: With a sagging link an inductance of 0.4 to 0.65 fits (benchmarks/faults.py --kind "link sag").
SMALL = 3.3


def typical_std(record: SmoothedRecord) -> float:
    """Return the median standard deviation of the position [rad]."""
    return float(np.median(record.outputs["theta_e_std"]))


def rank(record: SmoothedRecord) -> tuple[bool, float]:
    """Return a key: records that fit come first, then those with small standard deviations.

    A record without an angle fits as well, since its standard deviations contain everything.
    """
    fits = record.misfit < CONVERGED_MISFIT
    return (not fits, typical_std(record) if fits else record.misfit)


def doubts_bridge(record: SmoothedRecord) -> bool:
    """Whether rows without a current do not fit: their voltages may not be the machine's."""
    idle = record.marks & NO_CURRENT > 0
    return bool((idle & (record.outputs["doubtful"] > 0) & (record.marks & BRIDGE_OFF == 0)).any())


def limit_of(model: SmoothingModel, name: str, deviation: float = 0.0) -> float:
    """Return the deviation of an assumption that contradicts its prior, in standard deviations.

    The limit may depend on the sign of the deviation.
    """
    if name == "link_sag":
        return SAGGED
    if name == "psi_f":
        return WEAK
    if name == "L_d" and model.numbers["one_inductance"] and deviation < 0:
        return SMALL
    constant = not model.numbers["one_inductance"] and model.map["kind"] == LinearMap.code
    return SATURATED if constant and name in ("L_d", "L_q") else CONTRADICTION


def contradiction(model: SmoothingModel, assumed: Assumed) -> str:
    """Return the item of the assumption that contradicts its prior most; empty if none does."""
    ratios = {
        name: abs(assumed.deviations[name])
        / model.stds[name]
        / limit_of(model, name, assumed.deviations[name])
        for name in model.active
    }
    if not ratios or not max(ratios.values()) > 1:
        return ""
    # Inductances and lag follow the sag of a link that the log does not show.
    sagged = ratios.get("link_sag", 0.0) > 1
    worst = "link_sag" if sagged else max(ratios, key=lambda name: ratios[name])
    return next(item.name for item in ITEMS if worst in item.assumptions)


def inverter_loss(model: SmoothingModel, assumed: Assumed) -> tuple[float, float]:
    """Return the inverter's loss of a phase and its standard deviation [V]."""
    names = ("inverter_hard", "inverter_soft")
    value = model.numbers["inverter_voltage"] + sum(assumed.deviations[name] for name in names)
    at = [n for n, name in enumerate(model.active) if name in names]
    variance = float(assumed.covariance[np.ix_(at, at)].sum()) if at else 0.0
    return value, float(np.sqrt(max(variance, 0.0)))


def inductance_error(
    model: SmoothingModel, assumed: Assumed, axis: str, calibration: Calibration
) -> tuple[float, float]:
    """Return the error of L_d or L_q at half the rated current, and its standard deviation [1]."""
    scale, saturation = f"L_{axis}", f"saturation_{axis}"
    left = 1 / (1 + assumed.deviations[saturation] / 2)
    value = (1 + assumed.deviations[scale]) * left
    slopes = {scale: left, saturation: -value * left / 2}
    slope = np.array([slopes.get(name, 0.0) for name in model.active])
    prior = np.array([model.stds[name] for name in model.active]) @ np.abs(slope)
    std = np.sqrt(slope @ assumed.covariance @ slope)
    if prior == 0:
        return value - 1, 0.0
    return value - 1, float(with_scale(std, value, calibration.ratio, prior))
