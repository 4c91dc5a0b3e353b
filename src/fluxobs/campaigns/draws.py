"""Scenarios by their numbers: what is drawn depends on seed and number alone, on nothing else."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..core.arrays import Array
from .distributions import correlated, correlator
from .quantities import QUANTITIES
from .specification import Specification

#: Streams of random numbers of one scenario.
POINT, COURSE, NOISE = 0, 1, 2


@dataclass(frozen=True)
class Scenario:
    """One drive of a campaign.

    Attributes
    ----------
    number : int
        From 0; scenario `number` belongs to machine ``number // scenarios`` of the specification.
    machine : str
    values : dict
        Every quantity that is not neutral, by name.
    seed : int
        Of the campaign.
    like : int, optional
        The scenario whose course and noise it has; default its own.
    """

    number: int
    machine: str
    values: dict[str, float]
    seed: int
    like: int | None = None

    def generator(self, stream: int) -> np.random.Generator:
        """Random numbers of one kind, the same wherever and whenever they are drawn."""
        return generator(self.seed, self.number if self.like is None else self.like, stream)


def generator(seed: int, number: int, stream: int) -> np.random.Generator:
    """Random numbers of a scenario; independent of those of all other scenarios."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, stream)))


def total(specification: Specification) -> int:
    """Number of all scenarios."""
    return specification.scenarios * len(specification.machines)


def scenarios(specification: Specification, first: int, last: int) -> list[Scenario]:
    """Scenarios `first` to `last`, exclusive, all of one machine."""
    machine = specification.machines[first // specification.scenarios]
    cube = points(specification, first, last)
    return [
        Scenario(number, machine, at_point(specification, point, number), specification.seed)
        for number, point in zip(range(first, last), cube, strict=True)
    ]


def at_point(specification: Specification, point: Array, number: int = 0) -> dict[str, float]:
    """Values at a point of the unit cube, (varied,), and at a number's place in the grids."""
    values = {name: one.fixed for name, one in specification.vary.items() if not one.varies}
    factor = correlator(specification.varied, specification.correlation)
    u = correlated(point, factor) if specification.correlation else point
    for name, at in zip(specification.varied, u, strict=True):
        values[name] = float(specification.vary[name].at(np.asarray([at]))[0])
    values |= _grid(specification, number % specification.scenarios)
    return {
        name: value
        for name, value in values.items()
        if value is not None and not (name in QUANTITIES and QUANTITIES[name].neutral == value)
    }


def points(specification: Specification, first: int, last: int) -> Array:
    """Points of the open unit cube, (scenarios, varied)."""
    varied = len(specification.varied)
    if not varied:
        return np.empty((last - first, 0))
    if specification.sampling == "sobol":
        from scipy.stats.qmc import Sobol

        # All places of a grid share a point: half of an axis follows from an index's parity.
        index = np.arange(first, last) % specification.scenarios // specification.places
        sequence = Sobol(varied, seed=np.random.default_rng(specification.seed))
        if index[0]:
            sequence.fast_forward(int(index[0]))
        count = int(index[-1] - index[0])  # SciPy warns of a first draw that is no power of two
        points = sequence.random(1 << count.bit_length())[index - index[0]]
    else:
        points = np.array(
            [
                generator(specification.seed, number, POINT).random(varied)
                for number in range(first, last)
            ]
        )
    return np.asarray(np.clip(points, 1e-12, 1 - 1e-12))


def _grid(specification: Specification, index: int) -> dict[str, float]:
    """Place of the `index`-th scenario of a machine in the product of all grids."""
    lists = [specification.vary[name].grid or [] for name in specification.grids]
    if not lists:
        return {}
    place = index % specification.places
    chosen = next(itertools.islice(itertools.product(*lists), place, None))
    return dict(zip(specification.grids, chosen, strict=True))
