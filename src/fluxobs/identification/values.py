"""Identified values with their units, as results and machine files show them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..machines import RotatingMachine
from .mechanics import UNITS as MECHANICS

UNITS = {"R_s": "Ω", "R_R": "Ω", "psi_f": "Wb", "psi_R": "Wb", "inverter": "V", "lag": "samples"}
UNITS |= MECHANICS
UNITS |= dict.fromkeys(("L_s", "L_d", "L_q", "L_sigma", "L_M"), "H")
ADVICE = (
    "Record a log with steps of load at several speeds, a run-up from standstill, or both "
    "directions: the effect of the resistance depends on the current, that of the inverter on the "
    "current's sign, that of the magnet on the speed, and that of a lag on current and speed"
)


@dataclass(frozen=True)
class Parameter:
    """One parameter: given value, identified value, standard deviation (None if held)."""

    name: str
    unit: str
    given: float | None
    value: float
    std: float | None


def in_the_file(parameters: Iterable[Parameter]) -> dict[str, tuple[float, float]]:
    """Return the fitted parameters: name in the machine file → (value, standard deviation)."""
    return {
        "inverter_voltage" if p.name == "inverter" else p.name: (p.value, p.std)
        for p in parameters
        if p.std is not None and p.name not in ("lag", *MECHANICS)
    }


def given_value(machine: RotatingMachine, name: str) -> float | None:
    """Return the value of a parameter in the machine file, which has no mechanics."""
    if name in MECHANICS:
        return None
    value: float | None = getattr(machine, "inverter_voltage" if name == "inverter" else name)
    return value


def weighted_mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the mean of independent values with standard deviations, and its deviation."""
    weights = [1 / std**2 for _, std in values]
    products = (weight * value for weight, (value, _) in zip(weights, values, strict=True))
    return sum(products) / sum(weights), sum(weights) ** -0.5


def common_mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the mean of values from logs of one drive, and its standard deviation.

    The logs share sensors, inverter and machine file, so their errors are not independent: the
    standard deviation is that of the values, and at least that of their scatter.
    """
    mean, _ = weighted_mean(values)
    weights = np.array([1 / std**2 for _, std in values])
    share = weights / weights.sum()
    own = float(share @ np.array([std for _, std in values]))
    if len(values) < 2:
        return mean, own
    scatter = share @ (np.array([value for value, _ in values]) - mean) ** 2
    return mean, float(np.hypot(own, np.sqrt(scatter / (len(values) - 1))))
