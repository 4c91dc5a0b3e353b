"""Readable reference of the adaptive observer's learner, for one record: two stages, covariances.

Firmware keeps flux, drift and parameters in one information factor (fluxobs_learning.c). The same
estimate follows from Friedland's separation of a bias (doi:10.1109/TAC.1969.1099223). With
f = (λ, θ) and p the parameters:

    f = f̂ + S (p - p̂) + e_f,  cov e_f = P       given the parameters
    p = p̂ + e_p,              cov e_p = Q

The fast stage processes every measurement row as if the parameters were known. The innovation of
the fast stage, with its weight, is the measurement row of the slow stage. Everything is per-unit:
the units are flux bases, memories and prior standard deviations. tests/firmware/test_learning.py
compares the numbers of firmware and reference.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fluxobs.machines.model.frames import wrap

Array = NDArray[np.float64]

#: Thresholds of fluxobs_learning.c; that file gives the reasons.
BLOCK, BLOCK_MOST, MODEL = np.pi / 4, 0.3, 0.002
INVERTER_UNMODELLED, KNEE_UNMODELLED, DRIFT_MEMORY = 0.05, 0.3, 100.0
ROWS, CLIP, PROVEN, LEVEL_LEAST = 16.0, 25.0, 8.0, 0.02
NEW_POINT, ROUND, HEAT_WALK, SIXTH, LEARN_STD = 0.3, 16, 0.1, 0.3, np.pi / 9
SPEED_MIN = 1.0
RIPPLE_MIN, RIPPLE_LEAST, ALTERNATING_MIN, TILT = 0.5, 1e-12, 0.75, np.pi / 600
#: Order of the parameters, and their number.
PSI, RESISTANCE, INVERTER, OFFSET, ASYMMETRY, INDUCTANCE, COUNT = 0, 1, 2, 4, 6, 8, 10
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Settings:
    """Settings of the observer; ``fo_adaptive`` explains each setting."""

    h: float
    L: float
    saliency: float
    psi: float
    std: Array
    inverter_mean: float
    volt: float
    over_rated: float
    through_L: float
    unmodelled: float
    slow: float
    plausible: float
    sample_time: float
    resistance: float
    lag_std: float
    delay_std: float
    current_gain_std: float
    magnet_error: float


@dataclass(frozen=True)
class Linearisation:
    """Linearisation point at the estimated position of the rotor."""

    i: Array  # current without offset
    x: Array  # position vector
    d: Array  # direction of x
    length: float
    current_flux: tuple[float, float]  # assumed flux of the current along and across d
    current_length: float  # contribution of the current to the length


@dataclass(frozen=True)
class Ripple:
    """A sample for the row of the direction."""

    change: float  # of 1 / |x|
    before: float  # its change a sample earlier
    turned: float  # rotation
    across: Array  # unit vector across x
    time: float  # since the start of the block
    loss: Array  # turn by one standard deviation of both parts of the inverter's loss


@dataclass
class Block:
    """Sums over the samples since the last row."""

    turned: float = 0.0
    time: float = 0.0
    samples: int = 0
    effect: Array = field(default_factory=lambda: np.zeros((COUNT, 2)))
    unmodelled: float = 0.0
    residual: float = 0.0
    slope: Array = field(default_factory=lambda: np.zeros(2))
    slope_time: Array = field(default_factory=lambda: np.zeros(2))
    along: Array = field(default_factory=lambda: np.zeros(COUNT))
    ripples: list[Ripple] = field(default_factory=list)


@dataclass(frozen=True)
class Row:
    """A measurement row: regressors of flux and drift, and of the parameters."""

    fast: Array
    slow: Array
    value: float
    information: float
    systematic: float


class LearningTwin:
    """Filter and parameters; `stds` are the initial standard deviations of flux and drift."""

    def __init__(self, settings: Settings, flux: Array, drift: Array, stds: Array, theta: float):
        self.a = settings
        self.f = np.concatenate([flux, drift])
        self.P = np.diag(np.asarray(stds, float) ** 2)
        self.S = np.zeros((4, COUNT))
        self.p = np.zeros(COUNT)  # published values; `best` also includes all prior re-injections
        self.best = np.zeros(COUNT)
        self.Q = np.eye(COUNT)
        self.theta = theta
        self.block = Block()
        self.level = self.contradiction = 1.0
        self.rows = self.point_rows = self.since = self.passed = 0.0
        self.across = self.growth = self.turning = 0.0
        self.point: Array = np.zeros(3)
        self.turn = self.loss_turn = 0
        self.loss_size = self._loss_size()
        self.inverse_length = self.change = 0.0
        self.angles = 0  # angles in a row without a correction

    # ---- a sample -------------------------------------------------------------------------

    def sample(
        self, v: Array, effect: Array, current: Array, roughness: float, knee: float
    ) -> tuple[Array, Array]:
        """Process a sample; return flux and parameters.

        Parameters
        ----------
        v : (2,) ndarray
            Volt-seconds of the interval, corrected with the learnt parameters.
        effect : (10, 2) ndarray
            Change of the volt-seconds by one standard deviation of each parameter.
        current : (2,) ndarray
            Measured current.
        """
        a, b = self.a, self.block
        self.f[:2] += v + a.h * self.f[2:]
        b.effect[RESISTANCE:] += effect[RESISTANCE:]
        b.time += a.h
        share = INVERTER_UNMODELLED + KNEE_UNMODELLED * knee
        b.unmodelled += share * self.loss_size * a.volt
        point = self._linearise(current)
        self._accumulate(point)
        theta = float(np.arctan2(point.x[1], point.x[0]))
        turned = float(wrap(theta - self.theta))
        self._accumulate_ripple(point, turned, effect[INVERTER : INVERTER + 2])
        b.turned += turned
        self.theta = theta
        if abs(b.turned) >= BLOCK or b.time >= BLOCK_MOST:
            self._finish_block(current, roughness)
        return self.f.copy(), self.p.copy()

    def _accumulate_ripple(self, at: Linearisation, turned: float, loss: Array) -> None:
        u = 1 / at.length
        change = u - self.inverse_length
        if self.a.saliency and self.angles > 1:
            across = J @ at.d
            self.block.ripples.append(
                Ripple(change, self.change, turned, across, self.block.time, u * (loss @ across))
            )
        self.angles += 1
        self.inverse_length, self.change = u, change

    def _loss_size(self) -> float:
        """Return the root of the squares of the inverter's loss and its standard deviation [V]."""
        both = slice(INVERTER, INVERTER + 2)
        direction = np.zeros(COUNT)
        direction[both] = self.a.std[both]
        loss = 2 * self.a.inverter_mean + self.a.std[both] @ self.p[both]
        return float(np.sqrt(loss**2 + self._parameter_variance(direction)))

    def _linearise(self, current: Array) -> Linearisation:
        a, value = self.a, self.a.std * self.p
        i = current - value[OFFSET : OFFSET + 2]
        error_d, error_q = value[INDUCTANCE : INDUCTANCE + 2]
        L_d, L_q = a.L + a.saliency, a.L
        x = self.f[:2] - L_q * (1 + error_q) * i
        length = float(np.hypot(*x))
        d = x / length
        i_d, i_q = float(d @ i), float(J @ d @ i)
        current_length = (a.saliency + error_d * L_d - error_q * L_q) * i_d
        return Linearisation(i, x, d, length, (L_d * i_d, L_q * i_q), current_length)

    def _accumulate(self, at: Linearisation) -> None:
        """Add the residual r = |x| - ΔL i_d - ψ and its derivatives to the block."""
        a, b, d = self.a, self.block, at.d
        slope = d - a.saliency / at.length * (at.i - (d @ at.i) * d)
        b.residual += at.length - at.current_length - (a.psi + a.std[PSI] * self.p[PSI])
        b.slope += slope
        b.slope_time += slope * b.time
        b.along += b.effect @ slope
        b.along[PSI] -= a.std[PSI]
        b.along[INDUCTANCE] -= a.std[INDUCTANCE] * at.current_flux[0]
        b.along[INDUCTANCE + 1] -= a.std[INDUCTANCE + 1] * at.current_flux[1] * (J @ d @ slope)
        offsets = a.L * slope + a.saliency * d
        b.along[OFFSET : OFFSET + 2] += a.std[OFFSET : OFFSET + 2] * offsets
        b.samples += 1

    # ---- a measurement row ----------------------------------------------------------------

    def _finish_block(self, current: Array, roughness: float) -> None:
        a, b = self.a, self.block
        truly = abs(b.turned)
        self._propagate(b, (a.unmodelled * b.time) ** 2 + b.unmodelled**2)
        self._forget_drift(b.time)
        if truly > 1e-6 or any(ripple.change for ripple in b.ripples):
            n = b.samples
            at, speed = self._linearise(current), truly / b.time
            direction, gain = self._direction_row(at, b, roughness)
            turned = truly + gain
            share = turned / BLOCK
            curvature = (self.across + self.growth * b.time**2) / at.length
            noise = a.through_L * roughness * max(share, 1.0) / n
            information = share / (MODEL**2 + curvature**2 / 2 + noise)
            armature = float(np.sum(np.square(at.current_flux)))
            oscillating = (SIXTH * a.magnet_error) ** 2 + armature * a.current_gain_std**2
            fast = np.concatenate([b.slope, b.slope_time - b.time * b.slope]) / n
            length = Row(
                fast,
                b.along / n - b.effect @ fast[:2],
                -b.residual / n - curvature / 2,
                information,
                (b.unmodelled / turned) ** 2 + oscillating,
            )
            rows = self._rows_at_point(at, speed, share)
            learns = curvature < LEARN_STD**2 * at.length
            flux, parameters = self.f.copy(), self.p.copy()
            self._update_by_row(length, at, rows, share, speed, learns)
            if direction is not None:
                moved = direction.fast @ (self.f - flux) + direction.slow @ (self.p - parameters)
                direction = replace(direction, value=direction.value - moved)
                self._update_by_row(direction, at, rows, 1.0, speed, learns)
            if learns:
                self._forget(b.time)
        self.angles = 0
        at = self._linearise(current)
        self.loss_turn = (self.loss_turn + 1) % 3
        if self.loss_turn == 2:
            self.loss_size = self._loss_size()
        self._update_variances(at, b)
        self.block = Block()

    def _update_by_row(
        self, row: Row, at: Linearisation, rows: float, share: float, speed: float, learns: bool
    ) -> None:
        value, slow, information = self._update_fast(row.fast, row.slow, row.value, row.information)
        outlier = self._assess(slow, value, information, share)
        if outlier:
            self._forget_drift(DRIFT_MEMORY)
        elif learns:
            a, armature = self.a, float(np.sum(np.square(at.current_flux)))
            omega = speed * a.h / a.sample_time
            late = armature * omega**2 * (a.lag_std**2 + a.delay_std**2)
            variance = rows * (1 / information + late) + row.systematic
            self._learn(slow, value, 1 / (variance * max(self.level, 1.0)))

    def _direction_row(
        self, at: Linearisation, b: Block, roughness: float
    ) -> tuple[Row | None, float]:
        """Return the row 0 = Σ du r, and the share of its error that it removes."""
        a = self.a
        noise = a.through_L * (a.L / (a.L + a.saliency)) ** 2 * roughness
        square = sum(ripple.change**2 for ripple in b.ripples)
        true = square - 2 * len(b.ripples) * noise / at.length**4
        lagged = sum(ripple.change * ripple.before for ripple in b.ripples)
        rippling = square > RIPPLE_LEAST and true > RIPPLE_MIN * square
        if not (rippling and -lagged > ALTERNATING_MIN * square):
            return None, 0.0
        share = true / square
        h = share * sum((r.change**2 * r.across for r in b.ripples), np.zeros(2))
        th = share * sum((r.change**2 * r.time * r.across for r in b.ripples), np.zeros(2))
        slow = b.effect @ (th / b.time - h)
        slow[PSI] = 0.0
        slow[OFFSET : OFFSET + 2] += a.L * a.std[OFFSET : OFFSET + 2] * h
        slow[INDUCTANCE + 1] = -a.std[INDUCTANCE + 1] * at.current_flux[1] * true
        loss = sum((r.change * r.loss for r in b.ripples), np.zeros(2))
        slow[INVERTER : INVERTER + 2] += loss
        fast = np.concatenate([h, th - b.time * h])
        value = -sum(ripple.change * ripple.turned for ripple in b.ripples)
        variance = noise / at.length**2 * 2 * (square - lagged) + (MODEL * at.length * true) ** 2
        known = float(fast @ self.P @ fast) + self._parameter_variance(slow + fast @ self.S)
        apart = loss / a.std[INVERTER : INVERTER + 2] * self.loss_size
        systematic = (TILT * at.length * true) ** 2 + (apart[0] - apart[1]) ** 2
        return Row(fast, slow, value, 1 / variance, systematic), known / (known + variance)

    def _update_variances(self, at: Linearisation, b: Block) -> None:
        """Variance across now, and its growth if the next block is like this one."""
        across = J @ at.d
        half = b.turned / 2 if abs(b.turned) < 1 else 0.0
        tangent = half * (15 - half**2) / (15 - 6 * half**2)  # as in C: to within 1e-3
        next_ = ((1 - tangent**2) * across + 2 * tangent * (J @ across)) / (1 + tangent**2)
        self.across, self.turning = self._across(at, across, 0.0, np.zeros(COUNT))
        then, _ = self._across(at, next_, b.time, b.effect @ across)
        self.growth = max(then - self.across, 0.0) / b.time**2

    def _across(
        self, at: Linearisation, across: Array, time: float, moved: Array
    ) -> tuple[float, float]:
        """Return the variance of the flux across the position vector, and what L_q adds."""
        a = self.a
        to_fast = np.concatenate([across, time * across])
        to_slow = to_fast @ self.S + moved
        to_slow[OFFSET : OFFSET + 2] += a.L * a.std[OFFSET : OFFSET + 2] * across
        level = max(self.level, LEVEL_LEAST)
        without_L_q = self._parameter_variance(to_slow)
        to_slow[INDUCTANCE + 1] -= a.std[INDUCTANCE + 1] * at.current_flux[1]
        filter_variance = level * float(to_fast @ self.P @ to_fast)
        return filter_variance + without_L_q, self._parameter_variance(to_slow) - without_L_q

    def _propagate(self, b: Block, walk: float) -> None:
        """Advance to the end of the block: λ = λ + T θ + effect p, plus process noise."""
        A = np.eye(4)
        A[:2, 2:] = b.time * np.eye(2)
        self.P = A @ self.P @ A.T
        self.P[:2, :2] += walk * np.eye(2)
        self.S = A @ self.S
        self.S[:2] += b.effect.T

    def _forget_drift(self, time: float) -> None:
        """Move the drift's information, given the parameters, towards the prior's information."""
        share, prior = time / DRIFT_MEMORY, 1 / self.a.plausible**2
        R = np.linalg.cholesky(np.linalg.inv(self.P)).T  # upper, R'R the information
        d = np.diag(R) ** 2
        U = R / np.diag(R)[:, None]
        d[2:] += share * (prior - d[2:])
        self.P = np.linalg.inv(U.T @ np.diag(d) @ U)

    def _update_fast(
        self, fast: Array, slow: Array, value: float, information: float
    ) -> tuple[float, Array, float]:
        """Update flux and drift (Kalman); return the measurement row of the parameters."""
        row = slow + fast @ self.S
        variance = float(fast @ self.P @ fast) + 1 / information
        gain = self.P @ fast / variance
        self.f = self.f + gain * value
        self.P = self.P - np.outer(gain, fast @ self.P)
        self.S = self.S - np.outer(gain, row)
        return value, row, 1 / variance

    def _parameter_variance(self, slow: Array) -> float:
        """Return the variance that uncertain parameters contribute to a row."""
        return float(slow @ self.Q @ slow)

    def _assess(self, slow: Array, value: float, information: float, share: float) -> bool:
        """Update the innovations' power and contradiction; return whether the row is an outlier."""
        square, noise = value**2, 1 / information
        variance = self._parameter_variance(slow)
        self.rows += share
        gain = share / min(self.rows + 1, ROWS)
        level = max(self.level, LEVEL_LEAST)
        outlier = self.rows > PROVEN and square > CLIP * (level * noise + variance)
        self.level += gain * (min(information * square, CLIP * self.level) - self.level)
        ratio = min(square / (noise + variance), CLIP * (1 + self.contradiction))
        self.contradiction += 2 / ROWS * share * (ratio - self.contradiction)
        return outlier

    def _rows_at_point(self, at: Linearisation, speed: float, share: float) -> float:
        """Count the rows at the present operating point (i_d, i_q, speed)."""
        now = np.array([at.d @ at.i, (J @ at.d) @ at.i, speed])
        speeds = abs(self.point[2]) + abs(speed) + 2 * SPEED_MIN
        scale = np.array([self.a.over_rated] * 2 + [1 / speeds])
        moved = float(np.sum(((now - self.point) * scale) ** 2))
        self.point_rows /= 1 + moved / NEW_POINT**2 * self.point_rows
        self.point_rows += share
        self.point += (now - self.point) / max(self.point_rows, 1.0)
        return max(self.point_rows, 1.0)

    # ---- the parameters -----------------------------------------------------------------------

    def _learn(self, row: Array, value: float, weight: float) -> None:
        # The row refers to the published parameters.
        innovation = value - row @ (self.best - self.p)
        gain = self.Q @ row / (row @ self.Q @ row + 1 / weight)
        self.best = self.best + gain * innovation
        self.Q = self.Q - np.outer(gain, row @ self.Q)
        new = self._not_negative(self.best, slice(RESISTANCE, RESISTANCE + 1), self.a.resistance)
        new = self._not_negative(new, slice(INVERTER, INVERTER + 2), 2 * self.a.inverter_mean)
        self.f = self.f + self.S @ (new - self.p)
        self.p = new

    def _not_negative(self, p: Array, of: slice, mean: float) -> Array:
        """Return the likeliest parameters for which this value is not negative."""
        w = np.zeros(COUNT)
        w[of] = self.a.std[of]
        value = mean + w @ p
        if value >= 0:
            return p.copy()
        along = self.Q @ w
        return np.asarray(p - along * value / (w @ along))

    def _forget(self, time: float) -> None:
        """Scale the information once per round; re-inject the prior, one parameter per row."""
        self.since += time * self.a.slow
        self.turn = (self.turn + 1) % ROUND
        if self.turn < COUNT:
            if self.passed > 0:
                n = [*range(ASYMMETRY), INDUCTANCE, INDUCTANCE + 1, ASYMMETRY, ASYMMETRY + 1][
                    self.turn
                ]
                gain = self.Q[:, n] / (self.Q[n, n] + 1 / self.passed)
                self.best = self.best - gain * self.best[n]
                self.Q = self.Q - np.outer(gain, self.Q[n])
        elif self.turn == ROUND - 1:
            self.passed, self.since = min(self.since, 0.5), 0.0
            self.Q = self.Q / (1 - self.passed)
            self.Q[RESISTANCE, RESISTANCE] += HEAT_WALK**2 * self.passed
