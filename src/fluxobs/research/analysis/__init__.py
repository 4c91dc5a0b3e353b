"""Excitation, identifiability, error bounds and stability along a trajectory."""

from .bounds import bound_on_record, decay_rate, peak_gain, robust_bound
from .conditions import (
    ObservabilityCertificate,
    certify_observability,
    gradient_excitation,
    relation_gradients,
)
from .excitation import Excitation, excitation, persistency
from .gain_limits import large_gain_sum, small_gain_rates
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
    "ObservabilityCertificate",
    "balanced_basis",
    "balanced_gain",
    "balanced_repaired",
    "bound_on_record",
    "certify_observability",
    "compare_invisible",
    "decay_rate",
    "excitation",
    "floquet_multipliers",
    "gradient_excitation",
    "immersion_gramian",
    "invisible_from_constraint",
    "large_gain_sum",
    "largest_exponent",
    "observability_gramian",
    "over_gain",
    "peak_gain",
    "persistency",
    "relation_gradients",
    "robust_bound",
    "small_gain_rates",
    "weighted_mean",
]
