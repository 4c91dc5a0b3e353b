"""Nonlinear least squares over a whole log: parameters from the machine's relation.

The flux of a segment is λ = λ₀ + ∫ (u - R i - V_d S(i)) dt + θ t. Each segment has its own λ₀ and
drift θ. The flux is linear in λ₀, θ, R and V_d; the relations are in `relations`. The method is
Gauss-Newton with Huber's weights. A QR decomposition eliminates λ₀ and θ of each segment, so the
effort is proportional to the number of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..core.robust import huber_loss, huber_weight
from ..observers.thresholds import CORRELATION_LIMIT
from .relations import SATURATION, Linearisation, ResidualFunction
from .segments import Segment

ITERATIONS, HALVINGS = 60, 12
#: The iteration ends when a step is below this share of the uncertainty.
CONVERGED = 1e-4
#: The iteration also ends when a step lowers the cost by less than this share: the derivatives
#: neglect terms as large as the residual, so further steps do not help.
NO_GAIN = 1e-7
#: If no step lowers the cost, the fit counts as converged if the step is below this share. Reason:
#: the derivatives of a cage neglect that the angle changes i_d.
NEARLY = 0.1
#: Number of rows, about an eighth of a turn, that count as one measurement against a prior. Reason:
#: their errors repeat.
REPEATED = 20.0
#: Nuisance parameters of the inverter: shares of harder knees, which sharpen its sign function, and
#: current offsets [A], which shift it. The fit uses priors for them but does not report them.
UNCERTAIN = ("knee 1", "knee 2", "offset_alpha", "offset_beta")
#: Number of blocks of a log; the blocks' sums of residuals are assumed independent.
BLOCKS = 24


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """Best parameters and their uncertainty.

    Attributes
    ----------
    values : dict
        All parameters, free and held.
    free : tuple of str
    covariance : (free, free) array
        For each parameter, the larger of two estimates (from the coloured residuals, and from the
        scatter over blocks of the log), plus the effect of the held parameters.
    own_covariance : (free, free) array
        Covariance without the effect of the held parameters.
    alike : (free,) array
        How well the other parameters, except UNCERTAIN, can imitate each parameter: ratio of its
        variance to the variance with the other parameters known.
    current : (rows,) complex array
        Current of all segments in rotor coordinates [A].
    residuals : list of (rows,) array
        Residual r of each segment [Wb].
    local : list of ((2,) array, (2,) array)
        λ₀ [Wb] and θ [V] of each segment.
    converged : bool
    """

    values: dict[str, float]
    free: tuple[str, ...]
    covariance: Array
    own_covariance: Array
    alike: Array
    current: NDArray[np.complex128]
    residuals: list[Array]
    local: list[tuple[Array, Array]]
    converged: bool

    @property
    def own(self) -> Array:
        """Standard deviations without the effect of the held parameters, (free,)."""
        return np.asarray(np.sqrt(np.diag(self.own_covariance)))

    def std(self, name: str) -> float:
        """Return the standard deviation of a free parameter."""
        k = self.free.index(name)
        return float(np.sqrt(self.covariance[k, k]))

    def rms(self) -> float:
        """Return the rms residual [Wb]."""
        return float(np.sqrt(np.mean(np.concatenate(self.residuals) ** 2)))


def _dot(a: Array, b: Array) -> Array:
    """Return dot products of rows; einsum is several times faster than a sum over the axis."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


#: Converts (α, β) to α + j β.
ALPHA_BETA = np.array([1, 1j])


def evaluate(
    segment: Segment,
    values: Mapping[str, float],
    start: Array,
    drift: Array,
    free: Sequence[str],
    relation: ResidualFunction,
) -> tuple[Array, Array, Array]:
    """Return the residual (rows,), derivatives by (λ₀, θ), and derivatives by `free`."""
    linearised = _linearise(segment, values, start, drift, relation)
    to_flux = np.stack([linearised.to_flux.real, linearised.to_flux.imag], axis=1)
    to_start = to_flux
    if linearised.to_start is not None:
        to_start = to_flux + np.stack([linearised.to_start.real, linearised.to_start.imag], axis=1)
    local = np.concatenate([to_start, to_flux * segment.t[:, None]], axis=1)
    columns = [
        linearised.by_name[name]
        if name in linearised.by_name
        else _dot(to_flux, _flux_derivative(segment, values, name))
        for name in free
    ]
    return linearised.residual, local, np.reshape(columns, (len(free), len(segment))).T


def _flux_derivative(segment: Segment, values: Mapping[str, float], name: str) -> Array:
    """Return the derivative of the flux by a parameter of the voltage."""
    if name == "R_s":
        return -segment.charge
    if name == "inverter":
        return -_inverter_loss(segment, values)
    change = segment.curve if name == "curve" else _nuisance_changes(segment)[name]
    return np.asarray(-values["inverter"] * change)


def _linearise(
    segment: Segment,
    values: Mapping[str, float],
    start: Array,
    drift: Array,
    relation: ResidualFunction,
) -> Linearisation:
    """Linearise the relation for a segment."""
    flux = start + segment.voltage - values["R_s"] * segment.charge
    if values["inverter"]:
        flux = flux - values["inverter"] * _inverter_loss(segment, values)
    flux = flux + drift * segment.t[:, None]
    return relation(flux @ ALPHA_BETA, segment.current @ ALPHA_BETA, values)


def _nuisance_changes(segment: Segment) -> dict[str, Array]:
    """Return the change of the inverter's loss by each of UNCERTAIN [s]."""
    return dict(zip(UNCERTAIN, (*segment.harder, *segment.offset), strict=True))


def _inverter_loss(segment: Segment, values: Mapping[str, float]) -> Array:
    """Return ∫ of the inverter's loss divided by V_d, with knee and current offsets [s]."""
    loss = segment.inverter
    for name, change in _nuisance_changes(segment).items():
        if values.get(name):
            loss = loss + values[name] * change
    return loss


def _apply_step(values: Mapping[str, float], free: Sequence[str], step: Array) -> dict[str, float]:
    """Return the values after a step; L_s sets both inductances, saturation is not negative."""
    updated = dict(values)
    for name, change in zip(free, step, strict=True):
        updated[name] = values[name] + float(change)
        if name in SATURATION:
            updated[name] = max(updated[name], 0.0)
    if "L_s" in free:
        updated["L_d"] = updated["L_q"] = updated["L_s"]
    return updated


def _are_possible(values: Mapping[str, float]) -> bool:
    """Return whether the values are physically possible."""
    positive = ("R_s", "L_d", "L_q", "R_R", "L_M")
    return all(values[name] > 0 for name in positive if name in values) and values["psi_f"] >= 0


def _cost(residuals: Sequence[Array], scale: float) -> float:
    """Return Huber's loss of all residuals."""
    return float(np.sum(huber_loss(np.concatenate(residuals), scale)))


def _weights(residual: Array, scale: float) -> Array:
    """Return the square roots of Huber's weights."""
    return np.asarray(np.sqrt(huber_weight(residual, scale)))


def fit(
    data: Sequence[Segment],
    start: Mapping[str, float],
    free: Sequence[str],
    local: Sequence[tuple[Array, Array]] | None = None,
    held: Mapping[str, float] | None = None,
    *,
    relation: ResidualFunction,
    prior: Mapping[str, tuple[float, float]] | None = None,
    model_error: float = 0.0,
) -> ParameterFit:
    """Find the best parameters; the initial values must be right within a factor of about two.

    Parameters
    ----------
    data : sequence of Segment
    start : mapping
        R_s, L_d, L_q (and L_s), psi_f, inverter.
    free : sequence of str
        Parameters to fit. Without any, only λ₀ and θ of the segments are fitted.
    local : sequence of ((2,) array, (2,) array), optional
        Initial λ₀ and θ; default: those from the observer.
    held : mapping of str to float, optional
        Standard deviations of parameters. The covariance contains the effect of parameters that are
        not free.
    relation : ResidualFunction
    prior : mapping of str to (float, float), optional
        Prior mean and standard deviation of free parameters.
    model_error : float
        Standard deviation of the relation's error [Wb]. This error is constant within a block of
        the log and affects only the covariance.
    """
    prior_rows = _make_prior_rows(prior or {}, free)
    values, names = dict(start), tuple(free)
    if local is None:
        local = [(segment.start, segment.drift) for segment in data]
    current_local = [(flux.copy(), drift.copy()) for flux, drift in local]

    def residuals_at(
        trial: Mapping[str, float], trial_local: Sequence[tuple[Array, Array]]
    ) -> list[Array]:
        return [
            evaluate(segment, trial, *local, names, relation)[0]
            for segment, local in zip(data, trial_local, strict=True)
        ]

    converged = False
    for _ in range(ITERATIONS):
        evaluations = [
            evaluate(segment, values, *local_values, names, relation)
            for segment, local_values in zip(data, current_local, strict=True)
        ]
        residuals = [residual for residual, _, _ in evaluations]
        scale = 1.4826 * float(np.median(np.abs(np.concatenate(residuals)))) + 1e-15
        triangles: list[Array] = []
        for residual, to_local, to_free in evaluations:
            block = np.concatenate([to_local, to_free, residual[:, None]], axis=1)
            block = block * _weights(residual, scale)[:, None]
            triangles.append(np.asarray(np.linalg.qr(block, mode="r")))
        step = np.zeros(len(names))
        if names:
            rows = np.concatenate([*(R[4:, 4:] for R in triangles), scale * prior_rows(values)])
            size = np.linalg.norm(rows[:, :-1], axis=0) + 1e-300
            step = -np.linalg.lstsq(rows[:, :-1] / size, rows[:, -1], rcond=1e-9)[0] / size
        moves = [
            -np.linalg.lstsq(R[:4, :4], R[:4, -1] + R[:4, 4:-1] @ step, rcond=1e-12)[0]
            for R in triangles
        ]
        cost = _cost(residuals, scale) + np.sum(prior_rows(values)[:, -1] ** 2) / 2
        factor = 1.0
        for _ in range(HALVINGS):
            trial = _apply_step(values, names, factor * step)
            trial_local = [
                (flux + factor * move[:2], drift + factor * move[2:])
                for (flux, drift), move in zip(current_local, moves, strict=True)
            ]
            if _are_possible(trial):
                trial_cost = (
                    _cost(residuals_at(trial, trial_local), scale)
                    + np.sum(prior_rows(trial)[:, -1] ** 2) / 2
                )
                if trial_cost <= cost * (1 + 1e-12):
                    break
            factor /= 2
        else:
            converged = _residual_change(triangles, moves, step) < NEARLY * scale
            break
        values, current_local = trial, trial_local
        gain_is_small = cost - trial_cost < NO_GAIN * cost
        if gain_is_small or _residual_change(triangles, moves, step) < CONVERGED * scale:
            converged = True
            break
    current = [
        _linearise(segment, values, *local_values, relation).current
        for segment, local_values in zip(data, current_local, strict=True)
    ]
    covariance, own, alike, residuals = _uncertainty(
        data,
        values,
        current_local,
        names,
        held or {},
        relation,
        prior_rows(values)[:, :-1],
        model_error,
    )
    return ParameterFit(
        values,
        names,
        covariance,
        own,
        alike,
        np.concatenate(current),
        residuals,
        current_local,
        converged,
    )


def _make_prior_rows(
    prior: Mapping[str, tuple[float, float]], free: Sequence[str]
) -> Callable[[Mapping[str, float]], Array]:
    """Return a function that maps values to the prior's rows (derivatives, residual).

    The rows are divided by the standard deviation and multiplied by √REPEATED, since REPEATED rows
    of a log count as one independent measurement.
    """
    names = [name for name in free if name in prior]
    columns = [tuple(free).index(name) for name in names]

    def rows(values: Mapping[str, float]) -> Array:
        matrix = np.zeros((len(names), len(free) + 1))
        for row, (name, column) in enumerate(zip(names, columns, strict=True)):
            mean, std = prior[name]
            matrix[row, column] = np.sqrt(REPEATED) / std
            matrix[row, -1] = np.sqrt(REPEATED) * (values[name] - mean) / std
        return matrix

    return rows


def _imitability(H: Array, among: Sequence[bool]) -> Array:
    """Return how well the other parameters in `among` can imitate each parameter."""
    indices = np.flatnonzero(among)
    size = np.sqrt(np.diag(H))[indices] + 1e-300
    factors = np.ones(len(H))
    factors[indices] = np.diag(
        np.linalg.pinv(H[np.ix_(indices, indices)] / np.outer(size, size), rcond=1e-12)
    )
    return factors


def _residual_change(triangles: Sequence[Array], moves: Sequence[Any], step: Array) -> float:
    """Return the rms change of the residual by a step, over the rows of the triangles [Wb]."""
    changes = [
        R[:, :-1] @ np.concatenate([move, step]) for R, move in zip(triangles, moves, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(changes) ** 2)))


def _uncertainty(
    data: Sequence[Segment],
    values: Mapping[str, float],
    local: Sequence[tuple[Array, Array]],
    names: Sequence[str],
    held: Mapping[str, float],
    relation: ResidualFunction,
    prior_derivatives: Array,
    model_error: float,
) -> tuple[Array, Array, Array, list[Array]]:
    """Return two covariances of the free parameters, their `alike` factors, and the residuals.

    Only the first covariance includes the effect of the held parameters.
    """
    considered = [name for name in held if name not in names]
    parameters = [*names, *considered]
    evaluations = [
        evaluate(segment, values, *local_values, parameters, relation)
        for segment, local_values in zip(data, local, strict=True)
    ]
    residuals = [residual for residual, _, _ in evaluations]
    scale = 1.4826 * float(np.median(np.abs(np.concatenate(residuals)))) + 1e-15
    count_free = len(names)
    H, coupling = np.zeros((count_free, count_free)), np.zeros((count_free, len(considered)))
    sums, shifts, power, lagged, degrees_of_freedom = [], [], 0.0, 0.0, 0.0
    block_rows = max(1, sum(map(len, data)) // BLOCKS)
    for residual, to_local, to_free in evaluations:
        weight = _weights(residual, scale)[:, None]
        local_derivatives, derivatives, r = (
            weight * to_local,
            weight * to_free,
            weight[:, 0] * residual,
        )
        reduced = (
            derivatives
            - local_derivatives @ np.linalg.lstsq(local_derivatives, derivatives, rcond=1e-12)[0]
        )
        reduced, reduced_held = reduced[:, :count_free], reduced[:, count_free:]
        H += reduced.T @ reduced
        coupling += reduced.T @ reduced_held
        gradient = reduced * r[:, None]
        power, lagged = power + float(r @ r), lagged + float(r[1:] @ r[:-1])
        degrees_of_freedom += float(np.sum(weight**2)) - 4
        count = max(1, round(len(r) / block_rows))
        sums += [block.sum(axis=0) for block in np.array_split(gradient, count)]
        shifts += [block.sum(axis=0) for block in np.array_split(reduced * weight, count)]
    g = np.stack(sums)
    H += scale**2 * prior_derivatives.T @ prior_derivatives
    size = np.sqrt(np.diag(H)) + 1e-300
    inverse = np.linalg.pinv(H / np.outer(size, size), rcond=1e-12) / np.outer(size, size)
    scatter = g.T @ g * len(g) / max(1, len(g) - len(names))
    sandwich = inverse @ scatter @ inverse
    r1 = min(max(lagged / (power + 1e-300), 0.0), CORRELATION_LIMIT)
    coloured = inverse * power / max(degrees_of_freedom, 1.0) * (1 + r1) / (1 - r1)
    inflation = np.sqrt(np.maximum(1.0, np.diag(sandwich) / (np.diag(coloured) + 1e-300)))
    held_effect = inverse @ coupling * np.array([held[name] for name in considered])
    shift = model_error * inverse @ np.stack(shifts).T
    own = coloured * np.outer(inflation, inflation) + shift @ shift.T
    imitability = _imitability(H, [name not in UNCERTAIN for name in names])
    return own + held_effect @ held_effect.T, own, imitability, residuals
