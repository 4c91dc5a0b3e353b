"""Scenarios by number: all draws depend only on the campaign's seed and the scenario's number."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..core.arrays import Array
from .distributions import correlated, correlator
from .quantities import QUANTITIES
from .specification import Specification

#: Independent streams of random numbers of one scenario.
POINT, COURSE, NOISE, LOST = 0, 1, 2, 3


@dataclass(frozen=True)
class Scenario:
    """One drive of a campaign.

    Attributes
    ----------
    number : int
        Counted from 0; scenario `number` belongs to machine ``number // scenarios`` of the
        specification.
    machine : str
    values : dict
        The quantities that differ from their neutral value, by name.
    seed : int
        Seed of the campaign.
    like : int, optional
        Number of the scenario whose course and noise are used; default `number`.
    """

    number: int
    machine: str
    values: dict[str, float]
    seed: int
    like: int | None = None

    def generator(self, stream: int) -> np.random.Generator:
        """Return the generator of one stream; its numbers are the same on every call."""
        return generator(self.seed, self.number if self.like is None else self.like, stream)


def generator(seed: int, number: int, stream: int) -> np.random.Generator:
    """Return the generator of a scenario's stream, independent of all other scenarios."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, stream)))


def total(specification: Specification) -> int:
    """Return the number of scenarios of all machines."""
    return specification.scenarios * len(specification.machines)


def scenarios(specification: Specification, first: int, last: int) -> list[Scenario]:
    """Draw scenarios `first` to `last`, exclusive, all of one machine."""
    machine = specification.machines[first // specification.scenarios]
    cube = points(specification, first, last)
    return [
        Scenario(number, machine, at_point(specification, point, number), specification.seed)
        for number, point in zip(range(first, last), cube, strict=True)
    ]


def at_point(specification: Specification, point: Array, number: int = 0) -> dict[str, float]:
    """Return the quantities at `point` of the unit cube and at the grid place of `number`."""
    values = {
        name: distribution.fixed
        for name, distribution in specification.vary.items()
        if not distribution.varies
    }
    factor = correlator(specification.varied, specification.correlation)
    u = correlated(point, factor) if specification.correlation else point
    for name, coordinate in zip(specification.varied, u, strict=True):
        values[name] = float(specification.vary[name].at(np.asarray([coordinate]))[0])
    values |= _grid_values(specification, number % specification.scenarios)
    return {
        name: value
        for name, value in values.items()
        if value is not None and not (name in QUANTITIES and QUANTITIES[name].neutral == value)
    }


def points(specification: Specification, first: int, last: int) -> Array:
    """Return points of the open unit cube; shape (scenarios, varied)."""
    varied = len(specification.varied)
    if not varied:
        return np.empty((last - first, 0))
    if specification.sampling == "sobol":
        from scipy.stats.qmc import Sobol

        # All grid places use the same point. With an own point for each, a place would get points
        # of one half of an axis: the parity of a Sobol' index decides the half.
        index = np.arange(first, last) % specification.scenarios // specification.places
        sequence = Sobol(varied, seed=np.random.default_rng(specification.seed))
        if index[0]:
            sequence.fast_forward(int(index[0]))
        count = int(index[-1] - index[0])  # SciPy warns unless the first draw is a power of two
        points = sequence.random(1 << count.bit_length())[index - index[0]]
    else:
        points = np.array(
            [
                generator(specification.seed, number, POINT).random(varied)
                for number in range(first, last)
            ]
        )
    return np.asarray(np.clip(points, 1e-12, 1 - 1e-12))


def _grid_values(specification: Specification, index: int) -> dict[str, float]:
    """Return the grid values of the `index`-th scenario of a machine."""
    lists = [specification.vary[name].grid or [] for name in specification.grids]
    if not lists:
        return {}
    position = index % specification.places
    chosen = next(itertools.islice(itertools.product(*lists), position, None))
    return dict(zip(specification.grids, chosen, strict=True))
