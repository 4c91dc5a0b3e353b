"""How a quantity varies over the drives of a campaign: an inverse distribution for each.

Every draw starts from a point of the unit cube, so that random numbers, Sobol' points, a grid and
the search for the worst case all use the same distributions.
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

#: Kinds of distributions, by the word that gives their numbers.
KINDS = ("fixed", "uniform", "log", "normal", "lognormal", "choice", "grid")


def _listed(given: Any) -> Any:
    """A number is a fixed value."""
    if isinstance(given, int | float) and not isinstance(given, bool):
        return {"fixed": given}
    if not isinstance(given, Mapping | Distribution):
        raise ValueError(f"give a number, or a table as {{ uniform = [0.9, 1.1] }}, got {given!r}")
    return given


Two = Annotated[list[Number], Field(min_length=2, max_length=2)]
Some = Annotated[list[Number], Field(min_length=1)]


class Distribution(Table):
    """One distribution; exactly one of the fields but `within` is given.

    Parameters
    ----------
    fixed : number
        The same in every drive.
    uniform, log : [least, most]
        Uniform, or uniform in the logarithm (both > 0).
    normal : [mean, standard deviation]
    lognormal : [median, standard deviation of the logarithm]
    choice : list of numbers
        Each as likely as the others.
    grid : list of numbers
        Each with each of every other grid, in turn; the scenarios are a multiple of all places.
    within : [least, most], optional
        Cuts off a normal or lognormal distribution.
    """

    fixed: Number | None = None
    uniform: Two | None = None
    log: Two | None = None
    normal: Two | None = None
    lognormal: Two | None = None
    choice: Some | None = None
    grid: Some | None = None
    within: Two | None = None

    @model_validator(mode="after")
    def _one(self) -> Distribution:
        given = [name for name in KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give one of {', '.join(KINDS)}, got {', '.join(given) or 'none'}")
        for name in ("uniform", "log", "within"):
            pair = getattr(self, name)
            if pair is not None and not pair[0] < pair[1]:
                raise ValueError(f"{name} = [least, most] must rise, got {pair}")
        if self.log is not None and not self.log[0] > 0:
            raise ValueError(f"log = [least, most] must be positive, got {self.log}")
        for name in ("normal", "lognormal"):
            pair = getattr(self, name)
            if pair is not None and not pair[1] > 0:
                raise ValueError(f"{name}: the standard deviation must be positive, got {pair[1]}")
        if self.lognormal is not None and not self.lognormal[0] > 0:
            raise ValueError(f"lognormal: the median must be positive, got {self.lognormal[0]}")
        if self.within is not None and not (self.normal or self.lognormal):
            raise ValueError("within is for normal and lognormal")
        if self.within is not None and not self._share() > 1e-9:
            raise ValueError(f"within = {self.within} leaves nothing of the distribution")
        return self

    @property
    def varies(self) -> bool:
        """Whether drives can differ by it."""
        return self.fixed is None

    def at(self, u: Array) -> Array:
        """Quantile at u in (0, 1); a grid takes the u-th of its values."""
        if self.fixed is not None:
            return np.full_like(u, self.fixed)
        if self.uniform is not None:
            return np.asarray(self.uniform[0] + (self.uniform[1] - self.uniform[0]) * u)
        if self.log is not None:
            low, high = np.log(self.log)
            return np.asarray(np.exp(low + (high - low) * u))
        listed = self.choice or self.grid
        if listed is not None:
            at = np.minimum((u * len(listed)).astype(int), len(listed) - 1)
            return np.asarray(np.asarray(listed, float)[at])
        z = self._standard(u)
        if self.normal is not None:
            return self.normal[0] + self.normal[1] * z
        assert self.lognormal is not None
        return np.asarray(self.lognormal[0] * np.exp(self.lognormal[1] * z))

    def _limits(self) -> tuple[float, float]:
        """The cut-off in standard deviations from the mean."""
        if self.within is None:
            return -np.inf, np.inf
        if self.normal is not None:
            low, high = ((x - self.normal[0]) / self.normal[1] for x in self.within)
            return low, high
        assert self.lognormal is not None
        median, width = self.lognormal
        with np.errstate(divide="ignore"):
            low, high = (np.log(max(x, 0.0) / median) / width for x in self.within)
        return float(low), float(high)

    def _share(self) -> float:
        low, high = self._limits()
        return float(ndtr(high) - ndtr(low))

    def _standard(self, u: Array) -> Array:
        """Standard normal quantile, cut off."""
        low, high = self._limits()
        return np.asarray(np.clip(ndtri(ndtr(low) + u * self._share()), low, high))


#: A distribution in a specification; a bare number is a fixed value.
Given = Annotated[Distribution, BeforeValidator(_listed)]


def correlator(names: Sequence[str], correlations: Mapping[str, float]) -> Array:
    """Cholesky factor that gives standard normal numbers these correlations.

    Parameters
    ----------
    names : sequence of str
        The quantities, in order.
    correlations : mapping
        "a, b" to the correlation of their normal scores (a Gaussian copula).

    Raises
    ------
    UsageError
        A name does not vary, or no joint distribution has these correlations.
    """
    matrix, given = np.eye(len(names)), set()
    for pair, value in correlations.items():
        words = [word.strip() for word in pair.split(",")]
        if len(words) != 2 or words[0] == words[1]:
            raise UsageError(f'correlation {pair!r}: name two quantities, "R_s, psi_f"')
        for word in words:
            if word not in names:
                raise UsageError(
                    f"correlation {pair!r}: {word!r} does not vary by a continuous distribution"
                )
        if frozenset(words) in given:
            raise UsageError(f"correlation {pair!r}: it is given twice")
        given.add(frozenset(words))
        if not -1 < value < 1:
            raise UsageError(f"correlation {pair!r} must be between -1 and 1, got {value:g}")
        at = tuple(names.index(word) for word in words)
        matrix[at] = matrix[at[::-1]] = value
    try:
        return np.asarray(np.linalg.cholesky(matrix))
    except np.linalg.LinAlgError:
        raise UsageError("correlation: no joint distribution has all of these together") from None


def correlated(points: Array, factor: Array) -> Array:
    """Points of the unit cube with correlated normal scores, (..., quantities)."""
    return np.asarray(ndtr(ndtri(points) @ factor.T))
