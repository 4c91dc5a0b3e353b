"""Fit of a machine's relation, with priors, to segments of a log.

The flux of a segment is λ = λ₀ + ∫ (u - R i - V_d S) dt + θ t; each segment has its own λ₀ and θ.
The residual is r = |x| - ψ - (L_d - L_q) i_d, where x = λ - L_q i (docs/theory.md, section 13).
Noise of the current increases r² by (L σ)² and would bias L downwards. The cost therefore replaces
r² by the product of the residuals of two neighbouring rows, whose noises are independent. In a log
with injection the two rows are a period of the injected signal apart: the residual of a wrong lag
alternates with it.

ln R, ln L, ln ψ and V_d are unknown as well, with a prior around the machine file's values. The
cost is the misfit plus the distance from the prior. This sum is -2 ln of the posterior, so the
costs of different explanations can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..core.robust import HUBER, huber_weight
from ..machines import RotatingMachine
from ..machines.model.held import mean_current
from ..machines.model.inverter import inverter_direction
from ..machines.model.relation import linearise
from .segments import Complex, Segments

#: Order of the parameters.
R, L, PSI, INVERTER = range(4)
#: Number of pairs of neighbouring rows that the fit uses in each segment.
PAIRS = 100
#: Model error: the residual of a real machine as a share of the flux.
MODEL = 0.005
#: Number of independent rows in a segment; it is small because model errors repeat in every turn.
INDEPENDENT = 4.0
#: Prior standard deviation of the drift, as a share of the voltage.
DRIFT = 0.03
ITERATIONS, HALVINGS = 25, 5
#: The fit ends when an iteration lowers the cost by less than this, and a cost above one by less
#: than this share of the cost: a cost of thousands never becomes the lowest.
CONVERGED = 1e-3
#: Number of iterations for the rotor angle at which a flux map is evaluated.
ROUNDS = 3
#: If the position vector turns by less in most segments, the position counts as unknown [rad]. Up
#: to this share of the segments may be at standstill.
TURNED, STANDING = np.pi / 2, 0.7


@dataclass(frozen=True, eq=False)
class Prior:
    """Normal prior of the parameters.

    These are ln R, ln L, ln ψ relative to the machine file, and V_d divided by the voltage.
    """

    mean: Array
    precision: Array


@dataclass(frozen=True, eq=False)
class SegmentRows:
    """Integrals from the start of each segment to its paired rows: shape (segments, 2 PAIRS)."""

    t: Array
    current: Complex
    voltage: Complex
    charge: Complex
    inverter: Complex
    size: float  # mean magnitude of the voltage [V]


@dataclass(frozen=True, eq=False)
class RelationFit:
    """Best fit of the relation.

    Attributes
    ----------
    misfit, distance : float
        Sum of squared residuals and squared distance from the prior, in standard deviations.
    share : float
        Rms residual as a share of the flux.
    values : (4,) array
        ln R, ln L, ln ψ relative to the machine file, and V_d divided by the voltage.
    std : (4,) array
    position : (segments, 2 PAIRS) array
        Position vector x [Wb].
    """

    misfit: float
    distance: float
    share: float
    values: Array
    std: Array
    position: Complex


def paired_rows(count: int, apart: int) -> NDArray[np.intp]:
    """Return the rows that the fit uses in a segment of `count` rows: pairs `apart` rows apart."""
    even = np.linspace(0, count - 1 - apart, min(PAIRS, count // 2)).astype(int)
    return np.stack([even, even + apart], axis=1).ravel()


def _swap_pairs(values: Array) -> Array:
    """Return the values with the two rows of each pair exchanged."""
    return values.reshape(len(values), -1, 2)[..., ::-1].reshape(values.shape)


def integrate_segments(
    data: Segments, voltage: Complex, current: Complex, smoothing: float
) -> SegmentRows:
    """Integrate segments; the current `smoothing` [A] smooths the sign of the inverter voltage."""
    h, count = data.sample_time, current.shape[1]
    mean: Complex = mean_current(current)
    flat = mean.ravel()
    sign = inverter_direction(np.stack([flat.real, flat.imag], axis=1), smoothing) @ [1, 1j]
    rows = paired_rows(count, data.apart)

    def integral(values: Complex) -> Complex:
        total = h * np.cumsum(values, axis=1)
        return np.asarray((total - total[:, :1])[:, rows])

    t = np.broadcast_to(h * rows, (len(current), len(rows)))
    return SegmentRows(
        np.asarray(t, float),
        current[:, rows],
        integral(voltage),
        integral(mean),
        integral(np.asarray(sign.reshape(mean.shape), complex)),
        float(np.abs(voltage).mean()),
    )


def _initial_flux(y: Complex, t: Array) -> tuple[Complex, Complex, float]:
    """Return (λ₀, θ, misfit): each segment's |λ₀ + θ t + y|² is as constant as possible.

    This relation of the paper is linear if the products of λ₀ and θ are further unknowns
    (docs/theory.md, section 3).
    """
    size = np.sqrt(np.mean(np.abs(y - y.mean(axis=1, keepdims=True)) ** 2)) + 1e-300
    duration = t[:, -1:] + 1e-300
    z, s = (y - y.mean(axis=1, keepdims=True)) / size, t / duration
    ones = np.ones_like(s)
    columns = [2 * z.real, 2 * z.imag, 2 * s * z.real, 2 * s * z.imag, ones, s, s**2]
    A = np.stack(columns, axis=-1)
    b = -(np.abs(z) ** 2)
    x = np.linalg.pinv(A, rcond=1e-9) @ b[..., None]
    residual = (A @ x)[..., 0] - b
    offset = size * (x[:, 0, 0] + 1j * x[:, 1, 0]) - y.mean(axis=1)
    slope = size * (x[:, 2, 0] + 1j * x[:, 3, 0]) / duration[:, 0]
    radius = np.mean(np.abs(z + (x[:, 0] + 1j * x[:, 1]) + s * (x[:, 2] + 1j * x[:, 3])) ** 2)
    return offset[:, None], slope[:, None], float(np.mean(residual**2) / radius**2)


class _Position(NamedTuple):
    """Position vector x [Wb], the part of |x| that the current causes, and derivatives.

    `to_flux` and `by_scale` are the derivatives of |x| minus `from_current` by the flux and by ln
    of the inductances.
    """

    x: Complex
    from_current: Array
    to_flux: Complex
    by_scale: Array


@dataclass(frozen=True, eq=False)
class _Linearisation:
    """The relation at given parameters, with all that its derivatives need."""

    cost: float
    misfit: float
    share: float
    values: Array
    position: _Position
    psi: Array  # magnet flux [Wb], zero without magnets; shape of the rows or of a segment
    neighbour: Array  # residual of the other row of the pair
    weight: Array  # square root of the weight of a row, in its standard deviation
    drift: NDArray[np.complex128]  # Drift of each segment in standard deviations.
    deviation: Array  # Parameters minus the prior's mean.


class RelationResidual:
    """The relation of one machine, evaluated on one set of integrated segments."""

    def __init__(self, machine: RotatingMachine, data: SegmentRows, noise: float):
        self.data = data
        self.noise = noise
        self.R = machine.R_s
        self.L_d, self.L_q = machine.L_dq
        self.psi = machine.magnet_flux
        self.magnets = machine.magnets
        self.flux_moves = machine.flux_moves
        fit = machine.saturation
        self.table = None if fit is None else fit.table

    def _integral(self, values: Array) -> Complex:
        """Return ∫ (u - R i - V_d S) dt."""
        data, resistance = self.data, self.R * np.exp(values[R])
        return np.asarray(
            data.voltage - resistance * data.charge - values[INVERTER] * data.size * data.inverter
        )

    def _open_loop_position(self, values: Array) -> Complex:
        """Return ∫ (u - R i - V_d S) dt - L_q i."""
        inductance = self.L_q * np.exp(values[L])
        return np.asarray(self._integral(values) - inductance * self.data.current)

    def _position(self, flux: Complex, values: Array, psi: float | Array) -> _Position:
        """Return the position vector for a flux, with the derivatives of the vector's length."""
        current, scale = self.data.current, np.exp(values[L])
        L_d, L_q = self.L_d * scale, self.L_q * scale
        if self.table is None:
            linear = linearise(flux, current, L_d, L_q)
            by_scale = L_d * linear.by_L_d + L_q * linear.by_L_q
            return _Position(linear.x, linear.from_current, linear.by_flux, by_scale)
        x = flux - L_q * current
        for _ in range(ROUNDS):  # refine the angle at which the map is evaluated
            direction = x / (np.abs(x) + 1e-300)
            i = current * direction.conj()
            point = self.table.at(i)
            through = point.flux - self.table.psi_f
            auxiliary = point.auxiliary(i) - self.table.psi_f
            x = flux - direction * (through - auxiliary.real) * scale
        from_current = auxiliary.real * scale if self.magnets else np.abs(auxiliary.real) * scale
        active = psi + auxiliary.real * scale
        tilt = auxiliary.imag * scale / np.where(np.abs(active) > 1e-9, active, np.inf)
        to_flux = direction * (1 + 1j * tilt)
        by_scale = -(to_flux.conj() * direction * through).real * scale
        return _Position(x, from_current, to_flux, by_scale)

    def misfit(self, values: Array) -> float:
        """Return the mean squared deviation of the position vector from a circle, normalised."""
        return _initial_flux(self._open_loop_position(values), self.data.t)[2]

    def fit(self, prior: Prior, values: Array) -> RelationFit:
        """Fit the parameters, starting at `values`."""
        data = self.data
        values = np.array(values, float)
        offset, slope, _ = _initial_flux(self._open_loop_position(values), data.t)
        length = np.abs(self._open_loop_position(values) + offset + slope * data.t)
        if self.magnets and self.psi is not None:
            base_flux: float | Array = self.psi
            values[PSI] = np.log(float(np.median(length)) / base_flux + 1e-300)
            if self.flux_moves:  # each segment has its own flux
                base_flux = base_flux * np.median(length, axis=1, keepdims=True) / np.median(length)
        else:
            base_flux = float(np.sqrt(np.mean(length**2)))
        best = self._linearise(values, offset, slope, base_flux, prior)
        for _ in range(ITERATIONS):
            step, moves = self._step(best, prior)
            factor = 1.0
            for _ in range(HALVINGS):
                trial_values = values + factor * np.clip(step, -2, 2)
                trial_values[INVERTER] = max(trial_values[INVERTER], 0.0)
                trial_flux = offset + factor * moves[0], slope + factor * moves[1]
                trial = self._linearise(trial_values, *trial_flux, base_flux, prior)
                if trial.cost <= best.cost:
                    break
                factor /= 4
            else:
                break
            gain = best.cost - trial.cost
            values, (offset, slope), best = trial_values, trial_flux, trial
            if gain < CONVERGED * max(1.0, best.cost):
                break
        with np.errstate(invalid="ignore", divide="ignore"):
            turned = np.ptp(np.unwrap(np.angle(best.position.x), axis=1), axis=1)
        share = best.share if np.mean(turned > TURNED) > 1 - STANDING else np.inf
        misfit = best.misfit if np.isfinite(share) else np.inf
        covariance = np.linalg.pinv(self._information(best)[0] + prior.precision)
        std = np.sqrt(np.diag(covariance))
        return RelationFit(misfit, best.cost - best.misfit, share, values, std, best.position.x)

    def _linearise(
        self, values: Array, offset: Complex, slope: Complex, base_flux: float | Array, prior: Prior
    ) -> _Linearisation:
        data = self.data
        psi = base_flux * np.exp(values[PSI]) if self.magnets else 0.0
        position = self._position(self._integral(values) + offset + slope * data.t, values, psi)
        length = np.abs(position.x) + 1e-300
        size = float(np.sqrt(np.mean(length**2)))
        residual = length - psi - position.from_current
        inductance = self.L_q * np.exp(values[L])
        std = np.hypot(MODEL * size, inductance * self.noise)
        neighbour = _swap_pairs(residual)
        scaled = np.abs(residual + neighbour) / (2 * std)
        huber = huber_weight(scaled, 1.0)
        row_weight = INDEPENDENT / scaled.shape[1]
        square = residual * neighbour / std**2
        loss = np.where(huber < 1, HUBER * scaled * 2 - HUBER**2, square)
        deviation = values - prior.mean
        drift = slope[:, 0] / (DRIFT * data.size)
        misfit = row_weight * float(loss.sum())
        cost = misfit + float(deviation @ prior.precision @ deviation + (np.abs(drift) ** 2).sum())
        share = float(np.sqrt(np.mean(np.minimum(np.abs(residual), size) ** 2)) / size)
        weight = np.sqrt(row_weight * huber) / std
        return _Linearisation(
            cost,
            misfit,
            share,
            values,
            position,
            psi * np.ones_like(length),
            neighbour,
            weight,
            drift,
            deviation,
        )

    def _columns(self, point: _Linearisation) -> Array:
        """Return the derivatives by λ₀, θ and the parameters, then the neighbour's residual."""
        data, to_flux = self.data, point.position.to_flux
        columns = [
            to_flux.real,
            to_flux.imag,
            data.t * to_flux.real,
            data.t * to_flux.imag,
            -self.R * np.exp(point.values[R]) * (to_flux.conj() * data.charge).real,
            point.position.by_scale,
            -point.psi,
            -data.size * (to_flux.conj() * data.inverter).real,
            point.neighbour,
        ]
        return np.asarray(np.stack(columns, axis=-1) * point.weight[..., None])

    def _information(self, point: _Linearisation) -> tuple[Array, Array, Array, Array, Array]:
        """Eliminate λ₀ and θ of each segment; return the information on the parameters.

        Also return the right side, and the terms from which the steps of λ₀ and θ follow.
        """
        A = self._columns(point)
        H = A.transpose(0, 2, 1) @ A
        tight = 1 / (DRIFT * self.data.size)
        for k, component in ((2, point.drift.real), (3, point.drift.imag)):
            H[:, k, k] += tight**2
            H[:, k, 8] += tight * component
        local = H[:, :4, :4]
        scale = np.sqrt(np.einsum("pii->pi", local)) + 1e-300
        local = local / (scale[:, :, None] * scale[:, None, :]) + 1e-12 * np.eye(4)
        coupling = H[:, :4, 4:] / scale[:, :, None]
        solved = np.linalg.solve(local, coupling)
        reduced = (H[:, 4:, 4:] - coupling.transpose(0, 2, 1) @ solved).sum(axis=0)
        return reduced[:4, :4], reduced[:4, 4], solved[:, :, :4], solved[:, :, 4], scale

    def _step(self, point: _Linearisation, prior: Prior) -> tuple[Array, tuple[Complex, Complex]]:
        H, g, solved, solved_right, scale = self._information(point)
        step = -np.linalg.solve(H + prior.precision, g + prior.precision @ point.deviation)
        moves = -(solved_right + solved @ step) / scale
        return np.asarray(step, float), (
            (moves[:, :1] + 1j * moves[:, 1:2]),
            (moves[:, 2:3] + 1j * moves[:, 3:4]),
        )
