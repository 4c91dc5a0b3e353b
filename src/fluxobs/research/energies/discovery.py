"""Check Assumption 1 of the paper and discover relations, using only the energies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array
from ...errors import ModelError
from ...machines.model.constraint import QuadraticConstraint, invisible_offsets
from .system import ElectromechanicalSystem

#: Singular value, as a share of the largest, below which a relation is exact (with :data:`GAP`).
FLOOR = 1e-9
#: Factor by which the singular values must fall at the edge of the null space.
GAP = 1e10
#: A relation whose singular value is below this share holds approximately: another parameter or
#: sample range would give an exact relation. Machines without any relation have values above 1e-3.
NEAR = 1e-5
#: If halving a range changes the size of an approximate relation by more than this factor, the
#: range decides whether the relation holds; otherwise a parameter decides.
RANGE_DECIDES = 0.8
#: Relative residual on other states above which a relation is rejected.
HELD_OUT = 1e-9
#: Coefficients below this share of a relation's largest coefficient are rounding errors.
ROUNDING = 1e-8


@dataclass(frozen=True, eq=False)
class Polynomial:
    """A relation ``Σ c_k Π x_j^e_kj = 0`` in x = (λ, i), or in features.

    Attributes
    ----------
    exponents : (terms, 2n) ndarray of int
    coefficients : (terms,) ndarray
    names : tuple of str
        Names of the variables; empty for λ1 … λn, i1 … in.
    """

    exponents: NDArray[np.int_]
    coefficients: Array
    names: tuple[str, ...] = ()

    @property
    def degree(self) -> int:
        return int(self.exponents.sum(axis=1).max())

    @property
    def degree_in_flux(self) -> int:
        """Degree in λ: 1 is linear, 2 is quadratic. Observers cannot use a higher degree."""
        n = self.exponents.shape[1] // 2
        return int(self.exponents[:, :n].sum(axis=1).max())

    def terms(self, flux: Array, current: Array) -> Array:
        """Return the values (..., terms) of all terms."""
        x = np.concatenate([flux, current], axis=-1)[..., None, :]
        return np.asarray(self.coefficients * np.prod(x**self.exponents, axis=-1))

    def __str__(self) -> str:
        n = self.exponents.shape[1] // 2
        names = self.names or tuple(f"{kind}{j + 1}" for kind in "λi" for j in range(n))
        terms = []
        for exponents, coefficient in zip(self.exponents, self.coefficients, strict=True):
            factors = [
                name + ("" if e == 1 else "²³⁴"[e - 2])
                for name, e in zip(names, exponents, strict=True)
                if e
            ]
            terms.append(f"{coefficient:+.4g} {' '.join(factors)}".strip())
        return " ".join(terms) + " = 0"


@dataclass(frozen=True, eq=False)
class Approximate:
    """A relation that holds approximately.

    Attributes
    ----------
    relation : Polynomial
    size : float
        Rms of the relation over the largest rms of a combination of its monomials, scaled to rms
        one.
    """

    relation: Polynomial
    size: float


@dataclass(frozen=True, eq=False)
class Discovery:
    """Relations between flux and current that hold at any position.

    Attributes
    ----------
    name : str
        Name of the system.
    relations : tuple of QuadraticConstraint
        All independent quadratic relations that involve the flux.
    affine : tuple of Polynomial
        Linear relations between flux and current (a winding plane without magnets). They are
        removed first, because every product with a linear relation would be a quadratic relation.
    higher : tuple of Polynomial
        Relations of degree 3 or 4 that do not follow from quadratic relations; found only on
        request.
    approximate : tuple of Approximate
        Relations that hold, or may hold, only approximately, with their sizes.
    warning : str
        Says which relations are doubtful and what would decide; empty if no relation is doubtful.
    margin : float
        Factor by which the singular values fall at the edge of the null space; a measure of
        certainty. If there is a null space, the factor is at least 1e10 and usually around 1e13.
        Otherwise it is the largest factor between neighbouring values, which is too small.
    smallest : float
        Smallest singular value over the largest; without relations, the distance from a relation.
    residual : float
        Largest relative residual on states not used to find the relations.
    invisible : (2n, k) ndarray
        Offsets of (λ, i) that change no quadratic relation.
    """

    name: str
    relations: tuple[QuadraticConstraint, ...]
    affine: tuple[Polynomial, ...]
    higher: tuple[Polynomial, ...]
    approximate: tuple[Approximate, ...]
    warning: str
    margin: float
    smallest: float
    residual: float
    invisible: Array

    def __bool__(self) -> bool:
        return bool(self.relations)


def relative_residual(constraint: QuadraticConstraint, flux: Array, current: Array) -> Array:
    """Return |w| (...) divided by the sum of the magnitudes of its terms."""
    c = constraint
    flux, current = np.asarray(flux, float), np.asarray(current, float)
    size = (
        np.einsum("...i,ij,...j", abs(flux), abs(c.Q1), abs(flux))
        + np.einsum("...i,ij,...j", abs(flux), abs(c.Q2), abs(current))
        + np.einsum("...i,ij,...j", abs(current), abs(c.Q3), abs(current))
        + abs(flux) @ abs(c.E)
        + abs(current) @ abs(c.C)
        + abs(c.d)
    )
    return np.asarray(np.abs(c.residual(flux, current)) / np.maximum(size, 1e-300))


def check_constraint(
    system: ElectromechanicalSystem,
    constraint: QuadraticConstraint | Iterable[QuadraticConstraint],
    samples: int = 1000,
    tolerance: float = 1e-9,
    seed: int = 0,
) -> float:
    """Check that relations hold for a system at any position.

    Parameters
    ----------
    system : ElectromechanicalSystem
    constraint : QuadraticConstraint, or several
    samples : int
        Number of random states, drawn from the ranges of the system.
    tolerance : float
        Limit of the residual relative to the sum of the terms' magnitudes.

    Returns
    -------
    float
        Largest relative residual.

    Raises
    ------
    ModelError
        If a relation does not hold. The message gives the residual and the state.
    """
    relations = [constraint] if isinstance(constraint, QuadraticConstraint) else list(constraint)
    if not relations:
        raise ModelError("no relation to check")
    flux, current, position = _sample(system, samples, seed)
    worst = 0.0
    for number, relation in enumerate(relations):
        if relation.n != system.n_E:
            raise ModelError(
                f"{system.name}: the relation has {relation.n} ports, the system has {system.n_E}"
            )
        residual = relative_residual(relation, flux, current)
        at = int(np.argmax(residual))
        worst = max(worst, float(residual[at]))
        if not residual[at] <= tolerance:
            which = f"relation {number + 1}" if len(relations) > 1 else "the relation"
            raise ModelError(
                f"{system.name}: {which} does not hold: relative residual {residual[at]:.3g} "
                f"at flux {flux[at].round(6).tolist()}, position {position[at].round(6).tolist()}; "
                f"median {np.median(residual):.3g} over {samples} random states"
            )
    return worst


def discover_constraint(
    system: ElectromechanicalSystem,
    degree: int = 2,
    ports: Sequence[int] | None = None,
    seed: int = 0,
) -> Discovery:
    """Find all quadratic relations between flux and current that hold at any position.

    The function draws random states, computes currents by differentiation, and finds the null space
    of the monomials ``{λλ, λi, ii, λ, i, 1}`` by singular values (docs/theory.md, section 9).

    Parameters
    ----------
    system : ElectromechanicalSystem
    degree : {2, 3, 4}
        Highest degree of the relations to find.
    ports : sequence of int, optional
        Numbers of the measured ports, from 0; default all.
    seed : int
        Seed of the random states.

    Returns
    -------
    Discovery

    Raises
    ------
    ModelError
        If degree or ports are invalid.
    """
    if degree not in (2, 3, 4):
        raise ModelError(f"degree must be 2, 3 or 4, got {degree}")
    if not isinstance(system, ElectromechanicalSystem):
        raise ModelError(
            f"system must be an ElectromechanicalSystem, got {type(system).__name__}; see "
            f"fluxobs.research.energies.library"
        )
    ports = list(range(system.n_E)) if ports is None else list(ports)
    every = set(range(system.n_E))
    if not ports or len(set(ports)) < len(ports) or not set(ports) <= every:
        raise ModelError(f"ports must be some of 0 … {system.n_E - 1}, each once, got {ports}")
    n = len(ports)
    size = 40 * sum(1 for _ in combinations_with_replacement(range(2 * n + 1), degree))
    flux, current, _ = _sample(system, size + 500, seed)
    x = np.concatenate([flux[:, ports], current[:, ports]], axis=1)
    scale = _rms(x)
    x, held_out = x[:size] / scale, x[size:] / scale

    free, affine, approximate = _without_affine(x, scale)
    doubtful = _affine_exponents(x.shape[1]) if approximate else _exponents(x.shape[1], free, 2)

    def relative(of: ElectromechanicalSystem) -> Array:
        flux, current, _ = _sample(of, size, seed)
        columns = np.concatenate([flux[:, ports], current[:, ports]], axis=1)
        return _null_space(_monomials(columns / scale, doubtful)).relative

    by_degree: list[tuple[NDArray[np.int_], Array]] = []  # exponents, null vectors
    margin = smallest = 0.0
    for d in range(2, degree + 1):
        exponents = _exponents(x.shape[1], free, d)
        space = _null_space(_monomials(x, exponents))
        null = space.vectors
        if d == 2:
            margin, smallest = space.margin, float(space.relative[-1])
            # The square of an almost exact affine relation would look exact.
            if approximate:
                null = null[:, :0]
            else:
                approximate = _approximate(space, exponents, scale)
        null = _without_products(null, exponents, by_degree, d)
        if null.shape[1]:
            by_degree.append((exponents, _reduced(null, _no_flux(exponents))))

    quadratic, higher = [], []
    residual = 0.0
    for exponents, null in by_degree:
        for vector in null.T:
            used = np.abs(vector) > ROUNDING * np.abs(vector).max()
            polynomial = Polynomial(exponents[used], vector[used])
            if polynomial.degree_in_flux == 0:
                continue
            terms = polynomial.terms(held_out[:, :n], held_out[:, n:])
            residual = max(residual, float((np.abs(terms.sum(-1)) / np.abs(terms).sum(-1)).max()))
            coefficients = polynomial.coefficients / np.prod(scale**polynomial.exponents, axis=1)
            polynomial = Polynomial(polynomial.exponents, coefficients / coefficients[0])
            if polynomial.degree == 2:
                quadratic.append(_constraint(polynomial))
            else:
                higher.append(polynomial)
    if residual > HELD_OUT:
        raise ModelError(
            f"{system.name}: a relation fits the states on which it was found, but fails on "
            f"others (relative residual {residual:.1g}): the states are badly scaled; set "
            f"flux_range and position_range to the operating range of the machine"
        )
    invisible = invisible_offsets(quadratic) if quadratic else np.eye(2 * n)
    return Discovery(
        system.name,
        tuple(quadratic),
        affine,
        tuple(higher),
        approximate,
        _doubt(system, approximate, relative) if approximate else "",
        margin,
        smallest,
        residual,
        invisible,
    )


@dataclass(frozen=True, eq=False)
class FeatureDiscovery:
    """Relations between features of flux and current that hold at any position.

    Attributes
    ----------
    relations : tuple of Polynomial
        Relations in the features' names; no relation follows from a relation of lower degree.
    margin : float
        Factor by which the singular values fall at the edge of the null space of the highest
        degree. Below 1e10, no relation is reported.
    smallest : float
        Smallest singular value over the largest.
    """

    relations: tuple[Polynomial, ...]
    margin: float
    smallest: float


def discover_in_features(
    system: ElectromechanicalSystem,
    features: Mapping[str, Callable[[Array, Array], Array]],
    degree: int = 2,
    seed: int = 0,
) -> FeatureDiscovery:
    """Find polynomial relations between functions of flux and current.

    Saturation hides relations, which a change of variables can uncover: with
    ``z_k = -ln(1 - λ_k/ψ_s)``, the saturated switched reluctance machine obeys the relation of the
    unsaturated machine (docs/constraints.md).

    Parameters
    ----------
    system : ElectromechanicalSystem
    features : mapping of str to callable
        Name → NumPy function ``f(flux (states, n), current (states, n))`` → (states,). Only these
        variables are used; add λ and i as features if they are needed.
    degree : {1, 2, 3, 4}
        Highest degree in the features.
    seed : int
        Seed of the random states.

    Raises
    ------
    ModelError
        If the degree is invalid, or a feature is not finite or has the wrong shape.

    Examples
    --------
    >>> from fluxobs.research.energies.library import affine_pair
    >>> ratios = {"a": lambda f, i: f[:, 0] / i[:, 0], "b": lambda f, i: f[:, 1] / i[:, 1]}
    >>> print(discover_in_features(affine_pair(), ratios, degree=1).relations[0])
    +1 a +1 b -0.02 = 0
    """
    if degree not in (1, 2, 3, 4):
        raise ModelError(f"degree must be 1, 2, 3 or 4, got {degree}")
    names = tuple(features)
    if not names:
        raise ModelError("features must contain at least one feature")
    count = 40 * len(list(combinations_with_replacement(range(len(names) + 1), degree)))
    flux, current, _ = _sample(system, count, seed)
    columns = []
    for name, feature in features.items():
        with np.errstate(all="ignore"):
            values = np.asarray(feature(flux, current), float)
        if values.shape != (count,):
            raise ModelError(f"feature {name} must return ({count},), got shape {values.shape}")
        if not np.isfinite(values).all():
            at = int(np.argmin(np.isfinite(values)))
            raise ModelError(
                f"feature {name} is not finite at flux {flux[at].round(6).tolist()}, current "
                f"{current[at].round(6).tolist()}; see flux_range and position_range"
            )
        columns.append(values)
    x = np.array(columns).T
    scale = _rms(x)
    by_degree: list[tuple[NDArray[np.int_], Array]] = []
    relations = []
    for d in range(1, degree + 1):
        exponents = _exponents(len(names), range(len(names)), d, len(names))
        space = _null_space(_monomials(x / scale, exponents))
        null = _without_products(space.vectors, exponents, by_degree, d)
        if null.shape[1]:
            null = _reduced(null, np.zeros(len(exponents), dtype=bool))
            by_degree.append((exponents, null))
            relations += [_polynomial(vector, exponents, scale, names) for vector in null.T]
    return FeatureDiscovery(tuple(relations), space.margin, float(space.relative[-1]))


def _polynomial(
    vector: Array, exponents: NDArray[np.int_], scale: Array, names: tuple[str, ...] = ()
) -> Polynomial:
    """Return a scaled null vector's relation without rounding errors; coefficient 1 is one."""
    used = np.abs(vector) > ROUNDING * np.abs(vector).max()
    coefficients = vector[used] / np.prod(scale ** exponents[used], axis=1)
    return Polynomial(exponents[used], coefficients / coefficients[0], names)


def _sample(system: ElectromechanicalSystem, count: int, seed: int) -> tuple[Array, Array, Array]:
    flux, position = system.random_states(np.random.default_rng(seed), count)
    current = np.asarray(jax.jit(jax.vmap(system.current))(flux, position))
    finite = np.isfinite(current).all(axis=1)
    if not finite.all():
        at = int(np.argmin(finite))
        raise ModelError(
            f"{system.name}: the current is not finite at flux {np.asarray(flux[at]).tolist()}, "
            f"position {np.asarray(position[at]).tolist()}; see flux_range and position_range"
        )
    return np.asarray(flux), current, np.asarray(position)


def _exponents(
    variables: int, free: Sequence[int], degree: int, fluxes: int | None = None
) -> NDArray[np.int_]:
    """Return the monomials up to a degree in the free variables.

    The monomials are sorted by degree in flux, then by degree. The first `fluxes` variables are
    fluxes; by default, half of the variables.
    """
    rows = []
    for d in range(degree + 1):
        for factors in combinations_with_replacement(free, d):
            row = np.zeros(variables, dtype=int)
            for factor in factors:
                row[factor] += 1
            rows.append(row)
    n = variables // 2 if fluxes is None else fluxes
    rows.sort(key=lambda row: (-row[:n].sum(), -row.sum(), tuple(-row)))
    return np.array(rows)


def _affine_exponents(variables: int) -> NDArray[np.int_]:
    return np.vstack([np.eye(variables, dtype=int), np.zeros((1, variables), dtype=int)])


def _monomials(x: Array, exponents: NDArray[np.int_]) -> Array:
    product = np.ones((len(x), len(exponents)))
    for j in range(x.shape[1]):
        product *= x[:, [j]] ** exponents[:, j]
    return product


def _no_flux(exponents: NDArray[np.int_]) -> NDArray[np.bool_]:
    return np.asarray(exponents[:, : exponents.shape[1] // 2].sum(axis=1) == 0)


def _rms(columns: Array) -> Array:
    """Return the rms of each column, or one for a column of zeros (current of an open port)."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    return np.where(size > 0, size, 1.0)


class _NullSpace(NamedTuple):
    """Exact and approximate null vectors as columns; singular values over the largest one."""

    vectors: Array
    near: Array
    sizes: Array
    margin: float
    relative: Array


def _null_space(columns: Array) -> _NullSpace:
    norms = _rms(columns)
    _, singular, vt = np.linalg.svd(columns / norms, full_matrices=False)
    relative = singular / singular[0]
    # All values below rounding count as zero.
    falls = relative[:-1] / np.maximum(relative[1:], np.finfo(float).eps)
    at = int(np.argmax(falls))
    exact = falls[at] >= GAP and relative[at + 1] <= FLOOR
    low = np.flatnonzero(relative < NEAR)
    low = low[low <= at] if exact else low
    vectors = (vt / norms).T
    return _NullSpace(
        vectors[:, at + 1 :] if exact else vectors[:, :0],
        vectors[:, low],
        relative[low],
        float(falls[at]),
        relative,
    )


def _approximate(
    space: _NullSpace, exponents: NDArray[np.int_], scale: Array
) -> tuple[Approximate, ...]:
    return tuple(
        Approximate(_polynomial(vector, exponents, scale), float(size))
        for vector, size in zip(space.near.T, space.sizes, strict=True)
    )


def _halved(system: ElectromechanicalSystem, name: str) -> ElectromechanicalSystem:
    """Return the system with its range of positions or fluxes halved around the middle."""
    low, high = np.asarray(getattr(system, name))
    bounds = np.array([3 * low + high, low + 3 * high]) / 4
    halved: ElectromechanicalSystem = eqx.tree_at(
        lambda tree: getattr(tree, name), system, jnp.asarray(bounds)
    )
    return halved


def _doubt(
    system: ElectromechanicalSystem,
    approximate: tuple[Approximate, ...],
    relative: Callable[[ElectromechanicalSystem], Array],
) -> str:
    """Say what would decide whether approximate relations hold: another range or another parameter.

    `relative` returns the singular values of a system's monomials, divided by the largest.
    """
    values = relative(system)
    at = int(np.argmin(np.abs(values - approximate[0].size)))
    change = {
        name: relative(_halved(system, name))[at] / values[at]
        for name in ("position_range", "flux_range")
    }
    if change["flux_range"] > 1 / RANGE_DECIDES:
        remedy = "the position has no effect on most of the sampled fluxes: narrow flux_range"
    elif change["position_range"] < RANGE_DECIDES:
        remedy = "the range of the sampled positions is too narrow: widen position_range"
    else:
        remedy = (
            "a parameter is close to a value at which a relation appears or vanishes: change this "
            "parameter"
        )
    sizes = ", ".join(f"{candidate.size:.1e}" for candidate in approximate)
    number = "a relation" if len(approximate) == 1 else f"{len(approximate)} relations"
    return (
        f"{system.name}: {number} of size {sizes} (0 is exact) may hold only approximately; "
        f"{remedy}"
    )


def _without_affine(
    x: Array, scale: Array
) -> tuple[list[int], tuple[Polynomial, ...], tuple[Approximate, ...]]:
    """Return (variables not eliminated by affine relations, affine relations, approximate ones)."""
    variables = x.shape[1]
    exponents = _affine_exponents(variables)
    space = _null_space(_monomials(x, exponents))
    null = _reduced(space.vectors, np.zeros(len(exponents), dtype=bool))
    eliminated, relations = [], []
    for vector in null.T:
        eliminated.append(int(np.argmax(np.abs(vector) > ROUNDING * np.abs(vector).max())))
        relations.append(_polynomial(vector, exponents, scale))
    free = [j for j in range(variables) if j not in eliminated]
    return free, tuple(relations), _approximate(space, exponents, scale)


def _reduced(null: Array, last: NDArray[np.bool_]) -> Array:
    """Return the reduced echelon form of the null vectors (columns), with pivots in `last` last."""
    order = np.argsort(last, kind="stable")
    rows = null.T[:, order].copy()
    at = 0
    for column in range(rows.shape[1]):
        if at == len(rows):
            break
        pivot = at + int(np.argmax(np.abs(rows[at:, column])))
        if np.abs(rows[pivot, column]) < ROUNDING * np.abs(rows[at:]).max():
            continue
        rows[[at, pivot]] = rows[[pivot, at]]
        rows[at] /= rows[at, column]
        others = np.arange(len(rows)) != at
        rows[others] -= np.outer(rows[others, column], rows[at])
        at += 1
    reduced = np.empty_like(null)
    reduced[order] = rows[:at].T
    return reduced


def _without_products(
    null: Array,
    exponents: NDArray[np.int_],
    lower_relations: list[tuple[NDArray[np.int_], Array]],
    degree: int,
) -> Array:
    """Return the part of a null space that no product of lower relations spans."""
    if not lower_relations or not null.shape[1]:
        return null
    index = {tuple(row): k for k, row in enumerate(exponents)}
    products = []
    for lower, vectors in lower_relations:
        room = degree - int(lower.sum(axis=1).max())
        factors = [row for row in exponents if row.sum() <= room]
        for vector in vectors.T:
            for factor in factors:
                product = np.zeros(len(exponents))
                for row, value in zip(lower, vector, strict=True):
                    if value != 0:
                        product[index[tuple(row + factor)]] += value
                products.append(product)
    basis, singular, _ = np.linalg.svd(np.array(products).T, full_matrices=False)
    basis = basis[:, singular > ROUNDING * singular[0]]
    q, _ = np.linalg.qr(null)
    beyond, singular, _ = np.linalg.svd(q - basis @ (basis.T @ q), full_matrices=False)
    return np.asarray(beyond[:, singular > 1e-6])


def _constraint(polynomial: Polynomial) -> QuadraticConstraint:
    n = polynomial.exponents.shape[1] // 2
    quadratic = np.zeros((2 * n, 2 * n))
    linear, d = np.zeros(2 * n), 0.0
    for row, value in zip(polynomial.exponents, polynomial.coefficients, strict=True):
        variables = np.repeat(np.arange(2 * n), row)
        if len(variables) == 2:
            quadratic[tuple(variables)] += value
        elif len(variables) == 1:
            linear[variables[0]] = value
        else:
            d = float(value)
    return QuadraticConstraint(
        quadratic[:n, :n], quadratic[:n, n:], quadratic[n:, n:], linear[:n], linear[n:], d
    )
