"""Distributions of the quantities over the drives of a campaign, as inverse distributions.

Each draw starts from a point of the unit cube. Random numbers, Sobol' points, grids and the search
for the worst case all use the same distributions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from scipy.special import ndtr, ndtri

from ..core.arrays import Array
from ..core.validation import Number, Table
from ..errors import UsageError

#: Kinds of distributions, named like the fields of their numbers.
KINDS = ("fixed", "uniform", "log", "normal", "lognormal", "choice", "grid")


def _as_table(value: Any) -> Any:
    """Return the table of a fixed distribution for a bare number."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return {"fixed": value}
    if not isinstance(value, Mapping | Distribution):
        raise ValueError(f"give a number, or a table as {{ uniform = [0.9, 1.1] }}, got {value!r}")
    return value


NumberPair = Annotated[list[Number], Field(min_length=2, max_length=2)]
NumberList = Annotated[list[Number], Field(min_length=1)]


class Distribution(Table):
    """A distribution: exactly one field must be given, besides `within`.

    Parameters
    ----------
    fixed : number
        The value in every drive.
    uniform, log : [least, most]
        Uniform, or uniform in the logarithm (both > 0).
    normal : [mean, standard deviation]
    lognormal : [median, standard deviation of the logarithm]
    choice : list of numbers
        All equally likely.
    grid : list of numbers
        The scenarios run through all combinations with the other grids; their number is a multiple
        of the number of combinations.
    within : [least, most], optional
        Truncates a normal or lognormal distribution.
    """

    fixed: Number | None = None
    uniform: NumberPair | None = None
    log: NumberPair | None = None
    normal: NumberPair | None = None
    lognormal: NumberPair | None = None
    choice: NumberList | None = None
    grid: NumberList | None = None
    within: NumberPair | None = None

    @model_validator(mode="after")
    def _check_fields(self) -> Distribution:
        kinds = [name for name in KINDS if getattr(self, name) is not None]
        if len(kinds) != 1:
            raise ValueError(f"give one of {', '.join(KINDS)}, got {', '.join(kinds) or 'none'}")
        for name in ("uniform", "log", "within"):
            numbers = getattr(self, name)
            if numbers is not None and not numbers[0] < numbers[1]:
                raise ValueError(f"{name} = [least, most] must be ascending, got {numbers}")
        if self.log is not None and not self.log[0] > 0:
            raise ValueError(f"log = [least, most] must be positive, got {self.log}")
        for name in ("normal", "lognormal"):
            numbers = getattr(self, name)
            if numbers is not None and not numbers[1] > 0:
                raise ValueError(
                    f"{name}: the standard deviation must be positive, got {numbers[1]}"
                )
        if self.lognormal is not None and not self.lognormal[0] > 0:
            raise ValueError(f"lognormal: the median must be positive, got {self.lognormal[0]}")
        if self.within is not None and not (self.normal or self.lognormal):
            raise ValueError("within applies only to normal and lognormal")
        if self.within is not None and not self._share() > 1e-9:
            raise ValueError(f"within = {self.within} cuts off the whole distribution")
        return self

    @property
    def varies(self) -> bool:
        """Whether the quantity can differ between drives."""
        return self.fixed is None

    def at(self, u: Array) -> Array:
        """Return the quantile at u in (0, 1); a choice or grid returns the value at share u."""
        if self.fixed is not None:
            return np.full_like(u, self.fixed)
        if self.uniform is not None:
            return np.asarray(self.uniform[0] + (self.uniform[1] - self.uniform[0]) * u)
        if self.log is not None:
            lower, upper = np.log(self.log)
            return np.asarray(np.exp(lower + (upper - lower) * u))
        values = self.choice or self.grid
        if values is not None:
            index = np.minimum((u * len(values)).astype(int), len(values) - 1)
            return np.asarray(np.asarray(values, float)[index])
        z = self._normal_quantile(u)
        if self.normal is not None:
            return self.normal[0] + self.normal[1] * z
        assert self.lognormal is not None
        return np.asarray(self.lognormal[0] * np.exp(self.lognormal[1] * z))

    def _limits(self) -> tuple[float, float]:
        """Return the limits of the truncation, in standard deviations from the mean."""
        if self.within is None:
            return -np.inf, np.inf
        if self.normal is not None:
            lower, upper = ((x - self.normal[0]) / self.normal[1] for x in self.within)
            return lower, upper
        assert self.lognormal is not None
        median, width = self.lognormal
        with np.errstate(divide="ignore"):
            lower, upper = (np.log(max(x, 0.0) / median) / width for x in self.within)
        return float(lower), float(upper)

    def _share(self) -> float:
        lower, upper = self._limits()
        return float(ndtr(upper) - ndtr(lower))

    def _normal_quantile(self, u: Array) -> Array:
        """Return the quantile of the truncated standard normal distribution."""
        lower, upper = self._limits()
        return np.asarray(np.clip(ndtri(ndtr(lower) + u * self._share()), lower, upper))


#: A distribution in a specification; a bare number is a fixed value.
DistributionField = Annotated[Distribution, BeforeValidator(_as_table)]


def correlator(names: Sequence[str], correlations: Mapping[str, float]) -> Array:
    """Return the Cholesky factor that gives standard normal numbers these correlations.

    Parameters
    ----------
    names : sequence of str
        Names of the quantities, in order.
    correlations : mapping
        Maps "a, b" to the correlation of their normal scores (a Gaussian copula).

    Raises
    ------
    UsageError
        A quantity does not vary, or no joint distribution has these correlations.
    """
    matrix, pairs = np.eye(len(names)), set()
    for pair, value in correlations.items():
        quantities = [quantity.strip() for quantity in pair.split(",")]
        if len(quantities) != 2 or quantities[0] == quantities[1]:
            raise UsageError(f'correlation {pair!r}: name two quantities, "R_s, psi_f"')
        for quantity in quantities:
            if quantity not in names:
                raise UsageError(
                    f"correlation {pair!r}: {quantity!r} is not drawn at random under vary"
                )
        if frozenset(quantities) in pairs:
            raise UsageError(f"correlation {pair!r}: it is given twice")
        pairs.add(frozenset(quantities))
        if not -1 < value < 1:
            raise UsageError(f"correlation {pair!r} must be between -1 and 1, got {value:g}")
        entry = tuple(names.index(quantity) for quantity in quantities)
        matrix[entry] = matrix[entry[::-1]] = value
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        raise UsageError("correlation: no joint distribution has all these correlations") from None


def correlated(points: Array, factor: Array) -> Array:
    """Return points of the unit cube with correlated normal scores, (..., quantities)."""
    return np.asarray(ndtr(ndtri(points) @ factor.T))
