"""Nonlinear least squares over a whole log: parameters from the machine's relation.

The flux of a piece is λ = λ₀ + ∫ (u - R i - V_d S(i)) dt + θ t with its own λ₀ and drift θ. It is
linear in all of these. The relation of a machine with a magnet or saliency leaves the residual

    r = |x| - ψ - (L_d - L_q) (x·i) / |x|,        x = λ - L_q i

(docs/theory.md, section 13). The method is Gauss-Newton with Huber's weights. Each piece eliminates
its λ₀ and θ by its own QR decomposition, so the work grows only with the number of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checking.segments import LAGS
from ..core.arrays import Array
from ..observers.immersed import CORRELATION_LIMIT
from .relations import SATURATION, Linearisation, ResidualFunction, linear
from .segments import Piece

#: Huber's constant: 95 % of the efficiency of least squares under normal noise.
HUBER = 1.345
ITERATIONS, HALVINGS = 60, 12
#: Steps below this share of the uncertainty end the iteration.
CONVERGED = 1e-4
#: So does a gain below this share of the cost: derivatives leave out what is of the size of the
#: residual, and get no nearer.
NO_GAIN = 1e-7
#: And where no step helps, so near to the last one: a cage's derivatives leave out that the angle
#: moves i_d.
NEARLY = 0.1
#: Rows of a log that repeat one another's errors, against a prior: about an eighth of a turn.
REPEATED = 20.0
#: A lag is this close to a whole one where its derivative is taken from both sides [samples].
NEAR_WHOLE = 0.05
#: What goes with an inverter's voltage: how hard its sign is (shares of harder knees), and the
#: currents' offsets [A], which shift it. They are fitted, with a prior, but are no result.
UNCERTAIN = ("knee 1", "knee 2", "offset_alpha", "offset_beta")
#: Number of stretches of a log whose sums of residuals are taken as independent.
BLOCKS = 24


@dataclass(frozen=True, eq=False)
class ParameterFit:
    """Parameters that fit best, and how sure they are.

    Attributes
    ----------
    values : dict
        All parameters, free and held.
    free : tuple of str
    covariance : (free, free) array
        For each parameter the larger of two estimates: from the coloured residuals, and from the
        scatter over stretches of the log. Then what the held parameters may turn it by.
    own_covariance : (free, free) array
        Without that.
    alike : (free,) array
        How far the others, but for UNCERTAIN, can imitate each parameter: the factor by which its
        variance exceeds that with the others known.
    current : (rows,) complex array
        Current in rotor coordinates, all pieces [A].
    residuals : list of (rows,) array
        r of each piece [Wb].
    local : list of ((2,) array, (2,) array)
        λ₀ [Wb] and θ [V] of each piece.
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
        """Standard deviations without what the held parameters may do, (free,)."""
        return np.asarray(np.sqrt(np.diag(self.own_covariance)))

    def std(self, name: str) -> float:
        k = self.free.index(name)
        return float(np.sqrt(self.covariance[k, k]))

    def rms(self) -> float:
        """Rms residual [Wb]."""
        return float(np.sqrt(np.mean(np.concatenate(self.residuals) ** 2)))


def _dot(a: Array, b: Array) -> Array:
    """Dot products row by row; several times as fast as a sum over an axis of two."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


#: α + j β of a vector.
ALPHA_BETA = np.array([1, 1j])


def evaluate(
    piece: Piece,
    values: Mapping[str, float],
    start: Array,
    drift: Array,
    free: Sequence[str],
    relation: ResidualFunction = linear,
) -> tuple[Array, Array, Array]:
    """Residual (rows,), its derivatives by (λ₀, θ), (rows, 4), and by the free parameters."""
    said, slope = _said(piece, values, start, drift, relation)
    to_flux = np.stack([said.to_flux.real, said.to_flux.imag], axis=1)
    to_start = to_flux
    if said.to_start is not None:
        to_start = to_flux + np.stack([said.to_start.real, said.to_start.imag], axis=1)
    local = np.concatenate([to_start, to_flux * piece.t[:, None]], axis=1)
    columns = [
        said.by_name[name]
        if name in said.by_name
        else _dot(to_flux, slope if name == "lag" else _moved(piece, values, name))
        for name in free
    ]
    return said.residual, local, np.reshape(columns, (len(free), len(piece))).T


def _moved(piece: Piece, values: Mapping[str, float], name: str) -> Array:
    """Derivative of the flux by a parameter of the voltage."""
    if name == "R_s":
        return -piece.charge
    if name == "inverter":
        return -_lost(piece, values)
    change = piece.curve if name == "curve" else _uncertain(piece)[name]
    return np.asarray(-values["inverter"] * change)


def _said(
    piece: Piece,
    values: Mapping[str, float],
    start: Array,
    drift: Array,
    relation: ResidualFunction,
) -> tuple[Linearisation, Array]:
    """What the relation says of a piece, and the derivative of its flux by the lag."""
    i, lag = piece.current, values["lag"]
    if len(piece.voltage) == 1:
        u, slope = piece.voltage[0], np.zeros_like(i)
    else:
        u, slope = _lagging(piece.voltage, lag - LAGS[0])
    flux = start + u - values["R_s"] * piece.charge
    if values["inverter"]:
        flux = flux - values["inverter"] * _lost(piece, values)
    flux = flux + drift * piece.t[:, None]
    return relation(flux @ ALPHA_BETA, i @ ALPHA_BETA, values), slope


def _lagging(voltage: Array, lag: float) -> tuple[Array, Array]:
    """∫ u dt at a lag, counted from the first one, and its derivative by the lag.

    The integral is linear between whole lags. At one of them the derivative jumps: a vector that
    turns is a chord on either side. Close to it, what lies on either side is mixed.
    """
    last = len(voltage) - 1
    low = int(np.clip(np.floor(lag), 0, last - 1))
    slope = voltage[low + 1] - voltage[low]
    u = voltage[low] + (lag - low) * slope
    at = int(np.clip(round(lag), 1, last - 1))
    if abs(lag - at) < NEAR_WHOLE:
        share = (1 + (lag - at) / NEAR_WHOLE) / 2
        slope = share * (voltage[at + 1] - voltage[at]) + (1 - share) * (
            voltage[at] - voltage[at - 1]
        )
    return u, slope


def _uncertain(piece: Piece) -> dict[str, Array]:
    """What each of UNCERTAIN changes of what the inverter loses [s]."""
    return dict(zip(UNCERTAIN, (*piece.harder, *piece.offset), strict=True))


def _lost(piece: Piece, values: Mapping[str, float]) -> Array:
    """∫ of what the inverter loses, over V_d, with its knee and the currents' offsets [s]."""
    found = piece.inverter
    for name, change in _uncertain(piece).items():
        if values.get(name):
            found = found + values[name] * change
    return found


def _with(values: Mapping[str, float], free: Sequence[str], step: Array) -> dict[str, float]:
    """Values after a step; L_s stands for both inductances, and saturation is not negative."""
    new = dict(values)
    for name, change in zip(free, step, strict=True):
        new[name] = values[name] + float(change)
        if name in SATURATION:
            new[name] = max(new[name], 0.0)
    if "L_s" in free:
        new["L_d"] = new["L_q"] = new["L_s"]
    return new


def _possible(values: Mapping[str, float]) -> bool:
    positive = ("R_s", "L_d", "L_q", "R_R", "L_M")
    return (
        all(values[name] > 0 for name in positive if name in values)
        and values["psi_f"] >= 0
        and LAGS[0] <= values["lag"] <= LAGS[-1]
    )


def _cost(residuals: Sequence[Array], scale: float) -> float:
    r = np.abs(np.concatenate(residuals)) / scale
    return float(np.sum(np.where(r < HUBER, r**2 / 2, HUBER * r - HUBER**2 / 2)))


def _weights(residual: Array, scale: float) -> Array:
    """Square roots of Huber's weights."""
    r = np.abs(residual) / scale
    return np.asarray(np.sqrt(np.where(r < HUBER, 1.0, HUBER / np.maximum(r, HUBER))))


def fit(
    data: Sequence[Piece],
    start: Mapping[str, float],
    free: Sequence[str],
    local: Sequence[tuple[Array, Array]] | None = None,
    held: Mapping[str, float] | None = None,
    relation: ResidualFunction = linear,
    prior: Mapping[str, tuple[float, float]] | None = None,
    model_error: float = 0.0,
) -> ParameterFit:
    """Find the best parameters, from a start that is right within a factor of two or so.

    Parameters
    ----------
    data : sequence of Piece
    start : mapping
        R_s, L_d, L_q (and L_s), psi_f, inverter, lag.
    free : sequence of str
        The ones to fit; if empty, only λ₀ and θ of the pieces are fitted.
    local : sequence of ((2,) array, (2,) array), optional
        Where λ₀ and θ start; default: the observer's.
    held : mapping of str to float, optional
        Standard deviations of parameters; of those that are not free, what they may turn the others
        by is in the covariance.
    relation : ResidualFunction
        Default: constant inductances.
    prior : mapping of str to (float, float), optional
        Mean and standard deviation of free parameters before the log.
    model_error : float
        Standard deviation of an error of the relation that is constant over a stretch of the log
        [Wb]; it is in the covariance only.
    """
    believed = _believed(prior or {}, free)
    values, names = dict(start), tuple(free)
    at = local if local is not None else [(piece.start, piece.drift) for piece in data]
    here = [(start.copy(), drift.copy()) for start, drift in at]

    def run(at: Mapping[str, float], where: Sequence[tuple[Array, Array]]) -> list[Array]:
        return [evaluate(p, at, *w, names, relation)[0] for p, w in zip(data, where, strict=True)]

    converged = False
    for _ in range(ITERATIONS):
        parts = [evaluate(p, values, *w, names, relation) for p, w in zip(data, here, strict=True)]
        residuals = [part[0] for part in parts]
        scale = 1.4826 * float(np.median(np.abs(np.concatenate(residuals)))) + 1e-15
        triangles: list[Array] = []
        for residual, to_local, to_free in parts:
            block = np.concatenate([to_local, to_free, residual[:, None]], axis=1)
            block = block * _weights(residual, scale)[:, None]
            triangles.append(np.asarray(np.linalg.qr(block, mode="r")))
        step = np.zeros(len(names))
        if names:
            rows = np.concatenate([*(R[4:, 4:] for R in triangles), scale * believed(values)])
            size = np.linalg.norm(rows[:, :-1], axis=0) + 1e-300
            step = -np.linalg.lstsq(rows[:, :-1] / size, rows[:, -1], rcond=1e-9)[0] / size
        moves = [
            -np.linalg.lstsq(R[:4, :4], R[:4, -1] + R[:4, 4:-1] @ step, rcond=1e-12)[0]
            for R in triangles
        ]
        before = _cost(residuals, scale) + np.sum(believed(values)[:, -1] ** 2) / 2
        factor = 1.0
        for _ in range(HALVINGS):
            new = _with(values, names, factor * step)
            where = [
                (s + factor * m[:2], d + factor * m[2:])
                for (s, d), m in zip(here, moves, strict=True)
            ]
            if _possible(new):
                after = _cost(run(new, where), scale) + np.sum(believed(new)[:, -1] ** 2) / 2
                if after <= before * (1 + 1e-12):
                    break
            factor /= 2
        else:
            converged = _change(triangles, moves, step) < NEARLY * scale
            break
        values, here = new, where
        settled = before - after < NO_GAIN * before
        if settled or _change(triangles, moves, step) < CONVERGED * scale:
            converged = True
            break
    current = [_said(p, values, *w, relation)[0].current for p, w in zip(data, here, strict=True)]
    covariance, own, alike, residuals = _uncertainty(
        data, values, here, names, held or {}, relation, believed(values)[:, :-1], model_error
    )
    return ParameterFit(
        values, names, covariance, own, alike, np.concatenate(current), residuals, here, converged
    )


def _believed(
    prior: Mapping[str, tuple[float, float]], free: Sequence[str]
) -> Callable[[Mapping[str, float]], Array]:
    """Rows (derivatives, residual) of the prior at given values, in standard deviations. A row of a
    log is no independent measurement; REPEATED of them count as one against the prior."""
    names = [name for name in free if name in prior]
    places = [tuple(free).index(name) for name in names]

    def rows(values: Mapping[str, float]) -> Array:
        out = np.zeros((len(names), len(free) + 1))
        for k, (name, place) in enumerate(zip(names, places, strict=True)):
            mean, std = prior[name]
            out[k, place] = np.sqrt(REPEATED) / std
            out[k, -1] = np.sqrt(REPEATED) * (values[name] - mean) / std
        return out

    return rows


def _alike(H: Array, among: Sequence[bool]) -> Array:
    """How far those of the parameters that are results can imitate each other."""
    some = np.flatnonzero(among)
    size = np.sqrt(np.diag(H))[some] + 1e-300
    out = np.ones(len(H))
    out[some] = np.diag(np.linalg.pinv(H[np.ix_(some, some)] / np.outer(size, size), rcond=1e-12))
    return out


def _change(triangles: Sequence[Array], moves: Sequence[Any], step: Array) -> float:
    """Change of the residual by a step, rms over the rows of the triangles [Wb]."""
    changes = [
        R[:, :-1] @ np.concatenate([move, step]) for R, move in zip(triangles, moves, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(changes) ** 2)))


def _uncertainty(
    data: Sequence[Piece],
    values: Mapping[str, float],
    local: Sequence[tuple[Array, Array]],
    names: Sequence[str],
    held: Mapping[str, float],
    relation: ResidualFunction,
    believed: Array,
    model_error: float,
) -> tuple[Array, Array, Array, list[Array]]:
    """Covariance of the free parameters, that without the held ones, how alike they are, and the
    residuals."""
    considered = [name for name in held if name not in names]
    both = [*names, *considered]
    parts = [evaluate(p, values, *w, both, relation) for p, w in zip(data, local, strict=True)]
    residuals = [part[0] for part in parts]
    scale = 1.4826 * float(np.median(np.abs(np.concatenate(residuals)))) + 1e-15
    free = len(names)
    H, across = np.zeros((free, free)), np.zeros((free, len(considered)))
    sums, shifts, power, lagged, rows = [], [], 0.0, 0.0, 0.0
    stretch = max(1, sum(map(len, data)) // BLOCKS)
    for residual, to_local, to_free in parts:
        weight = _weights(residual, scale)[:, None]
        inner, outer, r = weight * to_local, weight * to_free, weight[:, 0] * residual
        left = outer - inner @ np.linalg.lstsq(inner, outer, rcond=1e-12)[0]
        left, rest = left[:, :free], left[:, free:]
        H += left.T @ left
        across += left.T @ rest
        gradient = left * r[:, None]
        power, lagged = power + float(r @ r), lagged + float(r[1:] @ r[:-1])
        rows += float(np.sum(weight**2)) - 4
        count = max(1, round(len(r) / stretch))
        sums += [part.sum(axis=0) for part in np.array_split(gradient, count)]
        shifts += [part.sum(axis=0) for part in np.array_split(left * weight, count)]
    g = np.stack(sums)
    H += scale**2 * believed.T @ believed
    size = np.sqrt(np.diag(H)) + 1e-300
    inverse = np.linalg.pinv(H / np.outer(size, size), rcond=1e-12) / np.outer(size, size)
    spread = g.T @ g * len(g) / max(1, len(g) - len(names))
    sandwich = inverse @ spread @ inverse
    r1 = min(max(lagged / (power + 1e-300), 0.0), CORRELATION_LIMIT)
    coloured = inverse * power / max(rows, 1.0) * (1 + r1) / (1 - r1)
    larger = np.sqrt(np.maximum(1.0, np.diag(sandwich) / (np.diag(coloured) + 1e-300)))
    turned = inverse @ across * np.array([held[name] for name in considered])
    shift = model_error * inverse @ np.stack(shifts).T
    own = coloured * np.outer(larger, larger) + shift @ shift.T
    alike = _alike(H, [name not in UNCERTAIN for name in names])
    return own + turned @ turned.T, own, alike, residuals
