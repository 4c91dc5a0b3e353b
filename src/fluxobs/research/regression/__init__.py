"""Lemma 1 writes the constraint as a linear regression: continuous, or exact on samples."""

from .filtered import FilteredRegression, Filters
from .periodic import Orbit, between, periodic_regression
from .regressors import Parametrisation, Regressors, residual
from .sampled import SampledRegression

__all__ = [
    "FilteredRegression",
    "Filters",
    "Orbit",
    "Parametrisation",
    "Regressors",
    "SampledRegression",
    "between",
    "periodic_regression",
    "residual",
]
