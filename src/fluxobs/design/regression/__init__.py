"""Lemma 1: the constraint as a linear regression, in continuous time and exact on samples."""

from .filtered import FilteredRegression, Filters
from .regressors import Parametrisation, Regressors, residual
from .sampled import SampledRegression

__all__ = [
    "FilteredRegression",
    "Filters",
    "Parametrisation",
    "Regressors",
    "SampledRegression",
    "residual",
]
