"""Excitation, identifiability, error bounds and stability along a trajectory."""

from .bounds import bound_on_record, decay_rate, peak_gain, robust_bound
from .excitation import Excitation, excitation, persistency
from .identifiability import (
    compare_invisible,
    immersion_gramian,
    invisible_from_constraint,
    observability_gramian,
)
from .stability import GainStudy, floquet_multipliers, largest_exponent, over_gain, weighted_mean
from .tuning import balanced_basis, balanced_gain, balanced_repaired

__all__ = [
    "Excitation",
    "GainStudy",
    "balanced_basis",
    "balanced_gain",
    "balanced_repaired",
    "bound_on_record",
    "compare_invisible",
    "decay_rate",
    "excitation",
    "floquet_multipliers",
    "immersion_gramian",
    "invisible_from_constraint",
    "largest_exponent",
    "observability_gramian",
    "over_gain",
    "peak_gain",
    "persistency",
    "robust_bound",
    "weighted_mean",
]
