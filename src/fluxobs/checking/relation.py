"""How well a machine's relation holds in stretches of a log: a fit with priors.

The flux of a stretch is λ = λ₀ + ∫ (u - R i - V_d S) dt + θ t, with its own λ₀ and θ, and the
relation leaves the residual r = |x| - ψ - (L_d - L_q) i_d, x = λ - L_q i (docs/theory.md, section
13). Noise of the current makes r² larger by (L σ)², which would pull L down; so in place of r²
stands the product of the residuals of two neighbouring rows, whose noises are independent.

Unknown are also ln R, ln L, ln ψ and V_d, about the machine file's. The cost, misfit plus distance
from the prior, is minus twice the logarithm of the posterior: costs of different explanations can
be compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..machines import RotatingMachine
from ..machines.model.held import mean_current
from ..machines.model.inverter import inverter_direction
from .segments import Complex, Stretches

#: Order of the parameters.
R, L, PSI, INVERTER = range(4)
#: Pairs of neighbouring rows of a stretch that enter the fit.
PAIRS = 100
#: The relation of a real machine holds to this share of the flux.
MODEL = 0.005
#: So many rows of a stretch are independent: what a model leaves out repeats in every turn.
INDEPENDENT = 4.0
#: Residuals beyond this many standard deviations count linearly (Huber's constant).
HUBER = 1.345
#: The drift's standard deviation, as a share of the voltage.
DRIFT = 0.03
ITERATIONS, HALVINGS = 25, 5
#: An iteration that lowers the cost by less ends the fit.
CONVERGED = 1e-3
#: Rounds in which the angle is refined at which a flux map is asked.
ROUNDS = 3
#: A position vector that turns by less than this tells nothing [rad].
TURNED = np.pi / 2


@dataclass(frozen=True, eq=False)
class Prior:
    """Normal prior of ln R, ln L, ln ψ over the machine file's, and of V_d over the voltage."""

    mean: Array
    precision: Array


@dataclass(frozen=True, eq=False)
class SegmentRows:
    """Rows of stretches, integrated; (stretches, 2 PAIRS) complex arrays, starting at zero."""

    t: Array
    current: Complex
    voltage: Complex
    charge: Complex
    inverter: Complex
    size: float  # of the voltage [V]


@dataclass(frozen=True, eq=False)
class RelationFit:
    """What fits best.

    Attributes
    ----------
    misfit, distance : float
        Of the relation, and from the prior; squares, in standard deviations.
    share : float
        Rms residual over the flux.
    values : (4,) array
        ln R, ln L, ln ψ over the machine file's; V_d over the voltage.
    std : (4,) array
    position : (stretches, 2 PAIRS) array
        Position vector x [Wb].
    """

    misfit: float
    distance: float
    share: float
    values: Array
    std: Array
    position: Complex


def positions(count: int) -> NDArray[np.intp]:
    """Rows of a stretch of `count` that enter the fit: pairs of neighbours."""
    first = np.linspace(0, count - 2, min(PAIRS, count // 2)).astype(int)
    return np.stack([first, first + 1], axis=1).ravel()


def _swapped(values: Array) -> Array:
    """The values of the other row of each pair."""
    return values.reshape(len(values), -1, 2)[..., ::-1].reshape(values.shape)


def rows(data: Stretches, voltage: Complex, current: Complex, smoothing: float) -> SegmentRows:
    """Integrate stretches; `smoothing` is that of the inverter's sign [A]."""
    h, count = data.sample_time, current.shape[1]
    mean: Complex = mean_current(current)
    flat = mean.ravel()
    sign = inverter_direction(np.stack([flat.real, flat.imag], axis=1), smoothing) @ [1, 1j]
    at = positions(count)

    def integral(values: Complex) -> Complex:
        total = h * np.cumsum(values, axis=1)
        return np.asarray((total - total[:, :1])[:, at])

    t = np.broadcast_to(h * at, (len(current), len(at)))
    return SegmentRows(
        np.asarray(t, float),
        current[:, at],
        integral(voltage),
        integral(mean),
        integral(np.asarray(sign.reshape(mean.shape), complex)),
        float(np.abs(voltage).mean()),
    )


def _start(y: Complex, t: Array) -> tuple[Complex, Complex, float]:
    """λ₀ and θ of each stretch, and the misfit, from |λ₀ + θ t + y|² constant: linear in them.

    This is the paper's relation with its products as further unknowns (docs/theory.md, section 3).
    """
    size = np.sqrt(np.mean(np.abs(y - y.mean(axis=1, keepdims=True)) ** 2)) + 1e-300
    end = t[:, -1:] + 1e-300
    z, s = (y - y.mean(axis=1, keepdims=True)) / size, t / end
    one = np.ones_like(s)
    columns = [2 * z.real, 2 * z.imag, 2 * s * z.real, 2 * s * z.imag, one, s, s**2]
    A = np.stack(columns, axis=-1)
    b = -(np.abs(z) ** 2)
    x = np.linalg.pinv(A, rcond=1e-9) @ b[..., None]
    left = (A @ x)[..., 0] - b
    first = size * (x[:, 0, 0] + 1j * x[:, 1, 0]) - y.mean(axis=1)
    slope = size * (x[:, 2, 0] + 1j * x[:, 3, 0]) / end[:, 0]
    radius = np.mean(np.abs(z + (x[:, 0] + 1j * x[:, 1]) + s * (x[:, 2] + 1j * x[:, 3])) ** 2)
    return first[:, None], slope[:, None], float(np.mean(left**2) / radius**2)


@dataclass(frozen=True, eq=False)
class _Point:
    """The relation at some parameters, linearised."""

    cost: float
    misfit: float
    share: float
    position: Complex
    columns: Array  # derivatives by λ₀, θ and the parameters, then the neighbour's residual
    drift: NDArray[np.complex128]  # of each stretch, in standard deviations
    off: Array  # of the parameters, from the prior's mean


class _Position(NamedTuple):
    """Position vector [Wb], what currents add to its length, and the derivatives of the length less
    that: by the flux, and by the logarithm of the inductances."""

    x: Complex
    grown: Array
    to_flux: Complex
    by_scale: Array


class RelationResidual:
    """The relation of one machine on one set of rows."""

    def __init__(self, machine: RotatingMachine, data: SegmentRows, noise: float):
        self.data = data
        self.noise = noise
        self.R = machine.R_s
        L_d, self.L_q = machine.L_dq
        self.saliency = L_d - self.L_q
        self.psi = machine.magnet_flux
        self.magnets = machine.magnets
        self.moves = machine.flux_moves
        fit = machine.saturation
        self.table = None if fit is None else fit.table

    def _integral(self, values: Array) -> Complex:
        """∫ (u - R i - V_d S) dt."""
        d, resistance = self.data, self.R * np.exp(values[R])
        return np.asarray(
            d.voltage - resistance * d.charge - values[INVERTER] * d.size * d.inverter
        )

    def _without_start(self, values: Array) -> Complex:
        """∫ (u - R i - V_d S) dt - L_q i."""
        inductance = self.L_q * np.exp(values[L])
        return np.asarray(self._integral(values) - inductance * self.data.current)

    def _position(self, flux: Complex, values: Array, psi: float | Array) -> _Position:
        """Position vector of a flux, and how its length answers."""
        current, scale = self.data.current, np.exp(values[L])
        x = flux - self.L_q * scale * current
        if self.table is None:
            length = np.abs(x) + 1e-300
            direction = x / length
            i_d = (direction.conj() * current).real
            saliency = self.saliency * scale
            to_flux = direction - saliency * (current - i_d * direction) / length
            by_scale = -self.L_q * scale * (to_flux.conj() * current).real - saliency * i_d
            return _Position(x, saliency * i_d, to_flux, by_scale)
        for _ in range(ROUNDS):  # the angle at which the map is asked
            direction = x / (np.abs(x) + 1e-300)
            i = current * direction.conj()
            at = self.table.at(i)
            through = at.flux - self.table.psi_f
            a = at.auxiliary(i) - self.table.psi_f
            x = flux - direction * (through - a.real) * scale
        grown = a.real * scale if self.magnets else np.abs(a.real) * scale
        active = psi + a.real * scale
        lean = a.imag * scale / np.where(np.abs(active) > 1e-9, active, np.inf)
        to_flux = direction * (1 + 1j * lean)
        by_scale = -(to_flux.conj() * direction * through).real * scale
        return _Position(x, grown, to_flux, by_scale)

    def misfit(self, values: Array) -> float:
        """How far the position vector of these parameters is from a circle, squared."""
        return _start(self._without_start(values), self.data.t)[2]

    def fit(self, prior: Prior, values: Array) -> RelationFit:
        """Fit from these values on."""
        d = self.data
        values = np.array(values, float)
        first, slope, _ = _start(self._without_start(values), d.t)
        length = np.abs(self._without_start(values) + first + slope * d.t)
        if self.magnets and self.psi is not None:
            base: float | Array = self.psi
            values[PSI] = np.log(float(np.median(length)) / base + 1e-300)
            if self.moves:  # each stretch has its own flux
                base = base * np.median(length, axis=1, keepdims=True) / np.median(length)
        else:
            base = float(np.sqrt(np.mean(length**2)))
        best = self._evaluate(values, first, slope, base, prior)
        for _ in range(ITERATIONS):
            step, moves = self._step(best, prior)
            factor = 1.0
            for _ in range(HALVINGS):
                new = values + factor * np.clip(step, -2, 2)
                new[INVERTER] = max(new[INVERTER], 0.0)
                at = first + factor * moves[0], slope + factor * moves[1]
                found = self._evaluate(new, *at, base, prior)
                if found.cost <= best.cost:
                    break
                factor /= 4
            else:
                break
            gained = best.cost - found.cost
            values, (first, slope), best = new, at, found
            if gained < CONVERGED:
                break
        with np.errstate(invalid="ignore", divide="ignore"):
            turned = np.ptp(np.unwrap(np.angle(best.position), axis=1), axis=1)
        share = best.share if np.median(turned) > TURNED else np.inf
        misfit = best.misfit if np.isfinite(share) else np.inf
        covariance = np.linalg.pinv(self._information(best)[0] + prior.precision)
        std = np.sqrt(np.diag(covariance))
        return RelationFit(misfit, best.cost - best.misfit, share, values, std, best.position)

    def _evaluate(
        self, values: Array, first: Complex, slope: Complex, base: float | Array, prior: Prior
    ) -> _Point:
        d = self.data
        psi = base * np.exp(values[PSI]) if self.magnets else 0.0
        found = self._position(self._integral(values) + first + slope * d.t, values, psi)
        x, to_flux = found.x, found.to_flux
        length = np.abs(x) + 1e-300
        size = float(np.sqrt(np.mean(length**2)))
        residual = length - psi - found.grown
        inductance = self.L_q * np.exp(values[L])
        std = np.hypot(MODEL * size, inductance * self.noise)
        neighbour = _swapped(residual)
        scaled = np.abs(residual + neighbour) / (2 * std)
        huber = np.minimum(1.0, HUBER / (scaled + 1e-300))
        worth = INDEPENDENT / scaled.shape[1]
        square = residual * neighbour / std**2
        loss = np.where(huber < 1, HUBER * scaled * 2 - HUBER**2, square)
        off = values - prior.mean
        drift = slope[:, 0] / (DRIFT * d.size)
        misfit = worth * float(loss.sum())
        cost = misfit + float(off @ prior.precision @ off + (np.abs(drift) ** 2).sum())
        along = [
            -self.R * np.exp(values[R]) * (to_flux.conj() * d.charge).real,
            found.by_scale,
            -psi * np.ones_like(length),
            -d.size * (to_flux.conj() * d.inverter).real,
        ]
        columns = np.stack(
            [to_flux.real, to_flux.imag, d.t * to_flux.real, d.t * to_flux.imag, *along, neighbour],
            axis=-1,
        )
        columns *= (np.sqrt(worth * huber) / std)[..., None]
        share = float(np.sqrt(np.mean(np.minimum(np.abs(residual), size) ** 2)) / size)
        return _Point(cost, misfit, share, x, columns, drift, off)

    def _information(self, found: _Point) -> tuple[Array, Array, Array, Array, Array]:
        """Information on the parameters with λ₀ and θ of each stretch eliminated, and its parts."""
        A = found.columns
        H = np.einsum("pmi,pmj->pij", A, A)
        tight = 1 / (DRIFT * self.data.size)
        for k, part in ((2, found.drift.real), (3, found.drift.imag)):
            H[:, k, k] += tight**2
            H[:, k, 8] += tight * part
        inner = H[:, :4, :4]
        scale = np.sqrt(np.einsum("pii->pi", inner)) + 1e-300
        inner = inner / (scale[:, :, None] * scale[:, None, :]) + 1e-12 * np.eye(4)
        outer = H[:, :4, 4:] / scale[:, :, None]
        solved = np.linalg.solve(inner, outer)
        reduced = (H[:, 4:, 4:] - np.einsum("pki,pkj->pij", outer, solved)).sum(axis=0)
        return reduced[:4, :4], reduced[:4, 4], solved[:, :, :4], solved[:, :, 4], scale

    def _step(self, found: _Point, prior: Prior) -> tuple[Array, tuple[Complex, Complex]]:
        H, g, solved, right, scale = self._information(found)
        step = -np.linalg.solve(H + prior.precision, g + prior.precision @ found.off)
        moves = -(right + solved @ step) / scale
        return np.asarray(step, float), (
            (moves[:, :1] + 1j * moves[:, 1:2]),
            (moves[:, 2:3] + 1j * moves[:, 3:4]),
        )
