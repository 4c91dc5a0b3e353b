"""The adaptive observer's learner, readable: two stages with covariances, one record.

Firmware keeps flux, drift and parameters in one triangle (fluxobs_learning.c). The same estimate
follows from Friedland's separation of a bias (doi:10.1109/TAC.1969.1099223), extended by what
is only considered (Schmidt). With f = (λ, θ), p the parameters, c the curve of the inverter's loss:

    f = f̂ + S (p - p̂) + S_c c + e_f,  cov e_f = P       given the parameters
    p = p̂ + G c + e_p,               cov e_p = Q        given the curve
    c ~ (0, 1)

The fast stage takes every row as if the parameters were known; what it leaves, with its own weight,
is the row of the slow stage. Everything is per-unit: flux bases, memories, standard deviations of
the prior. tests/firmware/test_learning.py compares both, number by number.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fluxobs.machines.model.frames import wrap

Array = NDArray[np.float64]

#: Thresholds of fluxobs_learning.c, where their reasons stand.
BLOCK, BLOCK_MOST, MODEL = np.pi / 4, 0.3, 0.002
INVERTER_UNMODELLED, KNEE_UNMODELLED, DRIFT_MEMORY = 0.05, 0.3, 100.0
ROWS, CLIP, PROVEN, LEVEL_LEAST = 16.0, 25.0, 8.0, 0.02
NEW_POINT, ROUND, DOUBT_LIMIT, HEAT_WALK, SINCE_MATTERS = 0.3, 16, 0.5, 0.1, 0.25
#: Order of the parameters; the curve comes last and is only considered.
PSI, RESISTANCE, INVERTER, OFFSET, INDUCTANCE, CURVE = 0, 1, 2, 4, 6, 10
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Settings:
    """The observer's numbers; their meanings are those of ``fo_adaptive``."""

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


@dataclass(frozen=True)
class Sight:
    """The rotor as the filter sees it."""

    i: Array  # current without offset
    x: Array  # position vector
    d: Array  # its direction
    length: float
    made: tuple[float, float]  # flux of the current along and across it, as assumed
    grown: float  # what the current adds to its length


@dataclass
class Block:
    """Sums over the samples since the last row."""

    theta: float
    time: float = 0.0
    samples: int = 0
    effect: Array = field(default_factory=lambda: np.zeros((CURVE + 1, 2)))
    unmodelled: float = 0.0
    residual: float = 0.0
    slope: Array = field(default_factory=lambda: np.zeros(2))
    slope_time: Array = field(default_factory=lambda: np.zeros(2))
    along: Array = field(default_factory=lambda: np.zeros(CURVE + 1))


class LearningTwin:
    """Filter and parameters, started at a flux and drift with these standard deviations."""

    def __init__(self, settings: Settings, flux: Array, drift: Array, stds: Array, theta: float):
        self.a = settings
        self.f = np.concatenate([flux, drift])
        self.P = np.diag(np.asarray(stds, float) ** 2)
        self.S = np.zeros((4, CURVE + 1))  # of parameters and curve
        self.p = np.zeros(CURVE)  # as published; the estimate with all pulls is in `best`
        self.best = np.zeros(CURVE)
        self.Q = np.eye(CURVE)
        self.G = np.zeros(CURVE)
        self.block = Block(theta)
        self.level = self.contradiction = 1.0
        self.rows = self.known_point = self.since = self.passed = 0.0
        self.across = self.across_at = self.turning = self.unsure = 0.0
        self.point: Array = np.zeros(3)
        self.pulled = self.judged = 0
        self.loss_std = self._loss_std()

    # ---- a sample -------------------------------------------------------------------------

    def sample(
        self, v: Array, effect: Array, current: Array, roughness: float, knee: float
    ) -> tuple[Array, Array]:
        """Take in an interval's volt-seconds, with what is learnt, what one std of each parameter
        adds to them, (11, 2), and the measured current; return flux and parameters."""
        a, b = self.a, self.block
        self.f[:2] += v + a.h * self.f[2:]
        b.effect[RESISTANCE:] += effect[RESISTANCE:]
        b.time += a.h
        share = INVERTER_UNMODELLED + KNEE_UNMODELLED * knee
        b.unmodelled += share * np.hypot(self._loss(), self.loss_std) * a.volt
        at = self._look(current)
        self._add(at)
        turned = abs(float(wrap(np.arctan2(at.x[1], at.x[0]) - b.theta)))
        if turned >= BLOCK or b.time >= BLOCK_MOST:
            self._end(current, roughness, turned)
            self.unsure = self._unsure(effect)
        elif (self.unsure * (b.time - self.across_at)) ** 2 > SINCE_MATTERS * self.across:
            self._judge(at)
        return self.f.copy(), self.p.copy()

    def _loss(self) -> float:
        """The inverter's loss, both parts [V]."""
        both = slice(INVERTER, INVERTER + 2)
        return float(2 * self.a.inverter_mean + self.a.std[both] @ self.p[both])

    def _loss_std(self) -> float:
        """Its standard deviation, with what its curve may differ by [V]."""
        a, both = self.a, slice(INVERTER, INVERTER + 2)
        direction = np.zeros(CURVE + 1)
        direction[both] = a.std[both]
        direction[CURVE] = a.std[CURVE] * self._loss()
        return float(np.sqrt(self._known(direction)))

    def _look(self, current: Array) -> Sight:
        a, value = self.a, self.a.std[:CURVE] * self.p
        i = current - value[OFFSET : OFFSET + 2]
        wrong_d, wrong_q = value[INDUCTANCE : INDUCTANCE + 2]
        L_d, L_q = a.L + a.saliency, a.L
        x = self.f[:2] - L_q * (1 + wrong_q) * i
        length = float(np.hypot(*x))
        d = x / length
        i_d, i_q = float(d @ i), float(J @ d @ i)
        grown = (a.saliency + wrong_d * L_d - wrong_q * L_q) * i_d
        return Sight(i, x, d, length, (L_d * i_d, L_q * i_q), grown)

    def _add(self, at: Sight) -> None:
        """Residual r = |x| - ΔL i_d - ψ and its derivatives, summed."""
        a, b, d = self.a, self.block, at.d
        slope = d - a.saliency / at.length * (at.i - (d @ at.i) * d)
        b.residual += at.length - at.grown - (a.psi + a.std[PSI] * self.p[PSI])
        b.slope += slope
        b.slope_time += slope * b.time
        b.along += b.effect @ slope
        b.along[PSI] -= a.std[PSI]
        b.along[INDUCTANCE] -= a.std[INDUCTANCE] * at.made[0]
        b.along[INDUCTANCE + 1] -= a.std[INDUCTANCE + 1] * at.made[1] * (J @ d @ slope)
        offsets = a.L * slope + a.saliency * d
        b.along[OFFSET : OFFSET + 2] += a.std[OFFSET : OFFSET + 2] * offsets
        b.samples += 1

    # ---- a row ----------------------------------------------------------------------------

    def _end(self, current: Array, roughness: float, turned: float) -> None:
        a, b = self.a, self.block
        share = min(turned / BLOCK, 1.0)
        inverter = b.unmodelled / b.time
        self._carry(b, (a.unmodelled * b.time) ** 2 + b.unmodelled**2)
        self._forget_drift(b.time)
        if share > 1e-6:
            n = b.samples
            at, speed = self._look(current), turned / b.time
            fast = np.concatenate([b.slope, b.slope_time - b.time * b.slope]) / n
            slow = b.along / n - b.effect @ fast[:2]
            value = -b.residual / n
            information = share / (MODEL**2 + a.through_L * roughness / n)
            value, slow, information = self._fast(fast, slow, value, information)
            surprise = self._follow(slow, value, information, share)
            if surprise:
                self._forget_drift(DRIFT_MEMORY)
            rows = self._rows_here(at, speed, share)
            if not surprise and speed > 0:
                shape = inverter / speed
                weight = 1 / ((rows / information + shape**2) * max(self.level, 1.0))
                self._learn(slow, value, weight, b.time)
        at = self._look(current)
        self.judged = (self.judged + 1) % 3
        if self.judged == 2:
            self.loss_std = self._loss_std()
        self.block = Block(float(np.arctan2(at.x[1], at.x[0])))
        self._judge(at)

    def _judge(self, at: Sight) -> None:
        self.across, self.turning = self._across(at, self.block)
        self.across_at = self.block.time

    def _unsure(self, effect: Array) -> float:
        """Voltage by which resistance and inverter may be off, after an interval like this."""
        direction = np.zeros(CURVE + 1)
        direction[RESISTANCE:OFFSET] = np.hypot(*effect[RESISTANCE:OFFSET].T)
        return float(np.sqrt(self._known(direction))) / self.a.h

    def _across(self, at: Sight, b: Block) -> tuple[float, float]:
        """Variance of the position vector across its direction, and what L_q adds to it."""
        a = self.a
        across = J @ at.d
        to_fast = np.concatenate([across, b.time * across])
        to_slow = to_fast @ self.S + b.effect @ across
        to_slow[OFFSET : OFFSET + 2] += a.L * a.std[OFFSET : OFFSET + 2] * across
        level = max(self.level, LEVEL_LEAST)
        known = self._known(to_slow)
        to_slow[INDUCTANCE + 1] -= a.std[INDUCTANCE + 1] * at.made[1]
        return level * float(to_fast @ self.P @ to_fast) + known, self._known(to_slow) - known

    def _carry(self, b: Block, walk: float) -> None:
        """To the end of the block: λ = λ + T θ + effect p, and a random step."""
        A = np.eye(4)
        A[:2, 2:] = b.time * np.eye(2)
        self.P = A @ self.P @ A.T
        self.P[:2, :2] += walk * np.eye(2)
        self.S = A @ self.S
        self.S[:2] += b.effect.T

    def _forget_drift(self, time: float) -> None:
        """The information on the drift, given the parameters, goes to that of its prior."""
        share, prior = time / DRIFT_MEMORY, 1 / self.a.plausible**2
        R = np.linalg.cholesky(np.linalg.inv(self.P)).T  # upper, R'R the information
        d = np.diag(R) ** 2
        U = R / np.diag(R)[:, None]
        d[2:] += share * (prior - d[2:])
        self.P = np.linalg.inv(U.T @ np.diag(d) @ U)

    def _fast(
        self, fast: Array, slow: Array, value: float, information: float
    ) -> tuple[float, Array, float]:
        """The Kalman step of flux and drift; returns what it leaves for the parameters."""
        left = slow + fast @ self.S
        variance = float(fast @ self.P @ fast) + 1 / information
        gain = self.P @ fast / variance
        self.f = self.f + gain * value
        self.P = self.P - np.outer(gain, fast @ self.P)
        self.S = self.S - np.outer(gain, left)
        return value, left, 1 / variance

    def _known(self, slow: Array) -> float:
        """Variance of a row by what is not known of parameters and curve."""
        return float(
            slow[:CURVE] @ self.Q @ slow[:CURVE] + (slow[CURVE] + slow[:CURVE] @ self.G) ** 2
        )

    def _follow(self, slow: Array, value: float, information: float, share: float) -> bool:
        """Power of what is left, and how far it contradicts what is known; is it a surprise?"""
        square, noise, known = value**2, 1 / information, self._known(slow)
        self.rows += share
        gain = share / min(self.rows + 1, ROWS)
        usual = max(self.level, LEVEL_LEAST)
        surprise = self.rows > PROVEN and square > CLIP * (usual * noise + known)
        self.level += gain * (min(information * square, CLIP * self.level) - self.level)
        odd = min(square / (noise + known), CLIP * (1 + self.contradiction))
        self.contradiction += 2 / ROWS * share * (odd - self.contradiction)
        return surprise

    def _rows_here(self, at: Sight, speed: float, share: float) -> float:
        """Rows at the present operating point (i_d, i_q, speed)."""
        now = np.array([at.d @ at.i, (J @ at.d) @ at.i, speed])
        before = abs(self.point[2]) + abs(speed)
        scale = np.array([self.a.over_rated] * 2 + [1 / before if before > 0 else 0.0])
        moved = float(np.sum(((now - self.point) * scale) ** 2))
        self.known_point /= 1 + moved / NEW_POINT**2 * self.known_point
        self.known_point += share
        self.point += (now - self.point) / max(self.known_point, 1.0)
        return max(self.known_point, 1.0)

    # ---- the parameters -----------------------------------------------------------------------

    def _learn(self, slow: Array, value: float, weight: float, time: float) -> None:
        row = slow[:CURVE]
        innovation = value - row @ (self.best - self.p)  # the row is about what is published
        gain = self.Q @ row / (row @ self.Q @ row + 1 / weight)
        self.best = self.best + gain * innovation
        self.G = self.G - gain * (slow[CURVE] + row @ self.G)
        self.Q = self.Q - np.outer(gain, row @ self.Q)
        new = self._not_negative(self.best)
        self.f = self.f + self.S[:, :CURVE] @ (new - self.p)
        self.p = new
        self._forget(time)

    def _not_negative(self, p: Array) -> Array:
        """The likeliest parameters with an inverter that adds no voltage."""
        a = self.a
        w = np.zeros(CURVE)
        w[INVERTER : INVERTER + 2] = a.std[INVERTER : INVERTER + 2]
        volts = 2 * a.inverter_mean + w @ p
        if volts >= 0:
            return p.copy()
        along = self.Q @ w + self.G * (self.G @ w)
        return np.asarray(p - along * volts / (w @ along))

    def _forget(self, time: float) -> None:
        """Information is scaled once a round, and the prior's comes back, a parameter a row."""
        self.since += time * self.a.slow
        self.pulled = (self.pulled + 1) % ROUND
        if self.pulled < CURVE:
            if self.passed > 0:
                n = self.pulled
                gain = self.Q[:, n] / (self.Q[n, n] + 1 / self.passed)
                self.best = self.best - gain * self.best[n]
                self.G = self.G - gain * self.G[n]
                self.Q = self.Q - np.outer(gain, self.Q[n])
        elif self.pulled == ROUND - 1:
            self.passed, self.since = min(self.since, 0.5), 0.0
            self.Q = self.Q / (1 - self.passed)
            self.Q[RESISTANCE, RESISTANCE] += HEAT_WALK**2 * self.passed
