"""Inertia, friction and load of a drive from its torque and position.

The equation of motion is J dω/dt = T - B ω - T_c sign(ω) - T_L.

**Inertia.** Within a segment of a tenth of a second, the load is a straight line in time. The angle
is then (1/J) ∫∫T dt² and a cubic. Without their cubic parts, the angle y and the integral x of a
segment are proportional, y = x/J: x contains what changes the torque, such as the ends of ramps and
the time after a step of the load. The noise of the torque is small in x. A segment with a step of
the load inside does not fit; the cost of its residual is bounded.

**Friction.** The quadratic part of a segment gives the torque that does not accelerate, B ω + T_c
sign(ω) + T_L. The load T_L is a random walk from segment to segment with steps of a Student
distribution, since loads are constant most of the time and step now and then. The variances of
steps and noise maximise the likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize

from ..core.arrays import Array
from ..errors import FluxobsError

#: Names of the parameters, with their units.
UNITS = {"J": "kg m²", "viscous": "N m s/rad", "coulomb": "N m"}
#: Duration of a segment [s], points of a segment, and segments that begin within its duration.
SEGMENT, POINTS, OVERLAP = 0.1, 33, 4
#: A segment whose squared residual is this multiple of the median has a quarter of the weight.
OUTLIER = 4.0
#: The squared change of the torque in a segment that tells J, relative to its noise.
TELLING = 25.0
#: Range and number of the inertias from which the search starts: a step is 1 %.
RANGE, GRID = 30.0, 700
#: Gaps of at most this many rows are interpolated.
BRIDGED = 5
#: Fewest segments that do not overlap.
LEAST_SEGMENTS = 5
#: Segments of these durations give the same inertia in a rigid drive, relative to SEGMENT.
SHORTER, LONGER = 0.5, 2.0
#: Degrees of freedom of the load's steps, and the rounds in which weights converge.
FREEDOM, ROUNDS = 2.0, 24
#: Alternations between the variances and the weights of the steps.
MAXIMISATIONS = 3
#: A change of the load whose weight is below this is a step.
STEPPED = 0.2
#: Parts of a log that are left out in turn.
PARTS = 8
#: Below this share of the largest speed the direction of rotation is unsure.
SLOW = 0.005
#: A difference of short and long segments beyond this is no chance [standard deviations].
NOT_RIGID = 3.0
#: Torques above this share of the largest tell the standard deviation of the torque's scale.
LOADED = 0.5
#: A parameter is identified if its standard deviation is below this share of its value; friction
#: also if it takes up less than this share of the largest torque.
IDENTIFIED, NEGLIGIBLE = 0.15, 0.002


class Segments(NamedTuple):
    """Segments of a log, each at a few points.

    Attributes
    ----------
    t : (segments,) ndarray
        Middle of each segment [s].
    theta : (segments, POINTS) ndarray
        Mechanical angle [rad].
    torque : (2, segments, POINTS) ndarray
        Torque of the even and of the odd rows [N m], integrated twice.
    speed, sign : (segments, POINTS) ndarray
        Speed [rad/s] and its sign, integrated twice.
    duration : float
        [s].
    """

    t: Array
    theta: Array
    torque: Array
    speed: Array
    sign: Array
    duration: float


@dataclass(frozen=True, eq=False)
class Mechanics:
    """Mechanical parameters and load of a drive.

    Attributes
    ----------
    values, stds : dict
        Of J [kg m²], viscous [N m s/rad], coulomb [N m].
    torque : float
        Largest torque [N m].
    speed : float
        Largest speed [rad/s].
    t, load, load_std : (segments,) ndarray
        Time [s], and the torque of the load, which opposes positive speeds [N m].
    elastic : float
        Difference of the inertias with long and with short segments [standard deviations]: a
        rigid drive has less than 3.
    """

    values: dict[str, float]
    stds: dict[str, float]
    torque: float
    speed: float
    t: Array
    load: Array
    load_std: Array
    elastic: float

    def identifies(self, name: str) -> bool:
        """Whether the log identifies a parameter."""
        std = self.stds[name]
        if std < IDENTIFIED * abs(self.values[name]):
            return True
        largest = {"J": 0.0, "viscous": self.torque / self.speed, "coulomb": self.torque}[name]
        return std < NEGLIGIBLE * largest


def cut(
    t: Array,
    theta: Array,
    torque: Array,
    valid: NDArray[np.bool_],
    duration: float,
    overlap: int,
) -> Segments:
    """Cut segments in which every row is valid.

    Raises
    ------
    FluxobsError
        There are too few.
    """
    h = float(np.median(np.diff(t)))
    between = max(1, round(duration / h / (POINTS - 1)))  # rows from a point to the next
    rows = between * (POINTS - 1)
    starts = np.arange(0, len(t) - rows, max(1, rows // overlap))
    lost = np.concatenate([[0], np.cumsum(~valid)])
    starts = starts[lost[starts + rows + 1] == lost[starts]]
    if len(starts) < LEAST_SEGMENTS * overlap:
        raise FluxobsError(
            f"the position is valid over only {len(starts) // overlap} segments of {rows * h:.3g} "
            f"s: the mechanics need {LEAST_SEGMENTS}"
        )
    known = np.where(valid, torque, 0.0)
    rows_of_torque = np.arange(len(t))
    halves = []
    for first in (0, 1):
        half = np.interp(rows_of_torque, rows_of_torque[first::2], known[first::2])
        for _ in range(2):
            half = h * np.concatenate([[0.0], np.cumsum((half[1:] + half[:-1]) / 2)])
        halves.append(half)
    at = starts[:, None] + between * np.arange(POINTS)
    angles = theta[at] - theta[starts][:, None]
    apart = between * h
    speeds = np.gradient(angles, apart, axis=1)
    signs = np.tanh(speeds / (SLOW * float(np.abs(speeds).max()) + 1e-300))
    return Segments(
        t[starts + rows // 2],
        angles,
        np.stack([half[at] - half[starts][:, None] for half in halves]),
        integral(angles, apart),
        integral(integral(signs, apart), apart),
        rows * h,
    )


def integral(values: Array, step: float) -> Array:
    """Return the integral from the first point of each segment."""
    trapezes = step * (values[:, 1:] + values[:, :-1]) / 2
    return np.concatenate([np.zeros((len(values), 1)), np.cumsum(trapezes, axis=1)], axis=1)


def bridged(
    valid: NDArray[np.bool_], theta: Array, torque: Array
) -> tuple[NDArray[np.bool_], Array, Array]:
    """Interpolate angle and torque over gaps of at most BRIDGED rows, where samples were lost."""
    rows = np.arange(len(valid))
    known = np.flatnonzero(valid)
    if not len(known):
        return valid, theta, torque
    last = np.maximum.accumulate(np.where(valid, rows, -len(rows)))
    following = np.minimum.accumulate(np.where(valid, rows, 3 * len(rows))[::-1])[::-1]
    filled = valid | (following - last <= BRIDGED + 1)
    theta = np.where(valid, theta, np.interp(rows, known, theta[known]))
    torque = np.where(valid, torque, np.interp(rows, known, torque[known]))
    return np.asarray(filled), np.asarray(theta), np.asarray(torque)


def student(squares: Array, scale: float) -> Array:
    """Return the weights of residuals with these squares."""
    return np.asarray((FREEDOM + 1) / (FREEDOM + squares / scale))


def inertia(segments: Segments, overlap: int) -> tuple[float, float]:
    """Return J and its standard deviation [kg m²].

    The noise of the torque would make 1/J too small: x² contains its square. The product of x from
    even and from odd rows does not, since their noise is independent.

    Raises
    ------
    FluxobsError
        The torque does not accelerate the drive.
    """
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, POINTS), 4))

    def without_cubic(values: Array) -> Array:
        return np.asarray(values - (values @ basis) @ basis.T)

    y, even, odd = (without_cubic(v) for v in (segments.theta, *segments.torque))
    x = (even + odd) / 2
    product, square = (x * y).sum(axis=1), (even * odd).sum(axis=1)
    # A segment without changes of the torque tells nothing, and there may be many of them.
    tells = square > TELLING * float(np.median(((even - odd) ** 2).sum(axis=1))) / 4
    if tells.sum() < LEAST_SEGMENTS:
        raise FluxobsError("the torque hardly changes: J cannot be identified")
    x, y, product, square = x[tells], y[tells], product[tells], square[tells]
    power, own = (x * x).sum(axis=1) + 1e-300, (y * y).sum(axis=1)
    # Noise of the angle: what each segment leaves with its own inertia.
    noise = float(np.median(np.maximum(own - product**2 / power, 0.0))) + 1e-300
    limit = OUTLIER * noise

    def squares(inverse: float | Array) -> Array:
        return np.asarray(np.maximum(own - 2 * inverse * product + inverse**2 * square, 0.0))

    # Segments with a step of the load have the largest residuals and the largest torques: the cost
    # of a residual is bounded, and has many minima.
    alike = product**2 / (power * own + 1e-300)
    start = float(np.sqrt(own @ alike / (power @ alike)))
    grid = start * np.geomspace(1 / RANGE, RANGE, GRID)
    costs = [float((squares(tried) / (squares(tried) + limit)).sum()) for tried in grid.tolist()]
    inverse = float(grid[int(np.argmin(costs))])
    for _ in range(ROUNDS):
        weights = 1 / (1 + squares(inverse) / limit) ** 2
        inverse = float(weights @ product) / float(weights @ square)
    if not (inverse > 0 and weights @ square > 0):
        raise FluxobsError("the torque does not accelerate the drive: J cannot be identified")
    # The residuals of a segment are correlated, those of different segments are not; segments that
    # overlap count once.
    scores = weights * (product - inverse * square)
    std = np.sqrt(overlap * float((scores**2).sum())) / float(weights @ square)
    return 1 / inverse, float(std) / inverse**2


class Solution(NamedTuple):
    """Load of the segments, and B, T_c and the correction of J with their covariance.

    `factor` is that of the information of the loads, `through` their derivative by the parameters.
    """

    load: Array
    parameters: Array
    covariance: Array
    factor: Array
    through: Array

    @property
    def load_std(self) -> Array:
        """Standard deviation of the load [N m]."""
        diagonal, below = self.factor
        # The diagonal of the inverse of a tridiagonal matrix, from the last row to the first.
        own = 1 / diagonal**2
        for n in range(len(own) - 2, -1, -1):
            own[n] += (below[n] / diagonal[n]) ** 2 * own[n + 1]
        by_parameters = np.einsum("ki,ij,kj->k", self.through, self.covariance, self.through)
        return np.asarray(np.sqrt(own + by_parameters))


class Friction:
    """The torque that does not accelerate, as friction and a load that steps now and then.

    Parameters
    ----------
    segments : Segments
        They do not overlap.
    J, J_std : float
        Inertia and its standard deviation [kg m²].
    load_std : float
        Prior standard deviation of the load [N m]; 0 if the shaft is free.
    """

    def __init__(
        self, segments: Segments, J: float, J_std: float, load_std: float = np.inf
    ) -> None:
        points = np.vander(np.linspace(-1, 1, POINTS), 4, increasing=True)
        second = 2 * np.linalg.pinv(points)[2] / (segments.duration / 2) ** 2
        self.second = second
        acceleration = segments.theta @ second
        self.torque = segments.torque.mean(axis=0) @ second - J * acceleration
        self.size = float(np.abs(self.torque).max()) + 1e-300
        self.speed, sign = segments.speed @ second, segments.sign @ second
        self.regressors = np.stack([self.speed, sign, acceleration], axis=1)
        # Friction is far below this: the prior only keeps the matrix regular.
        broad = 10 * self.size / np.array([np.abs(self.speed).max() + 1e-300, 1.0])
        # No load at all would make the matrix singular.
        self.load_std = min(max(load_std, 1e-6 * self.size), 10 * self.size)
        self.prior = 1 / np.array([*broad, J_std]) ** 2

    def solve(
        self, logs: Array, weights: Array, used: Array | float = 1.0, torque: Array | None = None
    ) -> tuple[Array, Array, Array, Array, float]:
        """Solve for the logarithms of the variances of noise and steps, and the steps' weights.

        Returns the factor of the load's information, the loads for known parameters with their
        derivatives, the parameters' covariance, and minus twice the log-likelihood. `used` is 0 for
        segments that are left out.
        """
        torque = self.torque if torque is None else torque
        noise, step = self.size**2 * np.exp(logs)
        band = np.zeros((2, len(self.torque)))
        band[0] = used / noise
        band[0, :-1] += weights / step
        band[0, 1:] += weights / step
        band[1, :-1] = -weights / step
        band[0] += 1 / self.load_std**2
        factor = cholesky_banded(band, lower=True)
        kept = (self.regressors.T * used).T / noise
        through = cho_solve_banded((factor, True), kept)
        alone = cho_solve_banded((factor, True), used * torque / noise)
        schur = kept.T @ (self.regressors - through) + np.diag(self.prior)
        right = kept.T @ (torque - alone)
        covariance = np.linalg.inv(schur)
        cost = (
            float(torque @ (torque - alone)) / noise
            - float(right @ covariance @ right)
            + len(self.torque) * np.log(noise)
            + float(np.log(step / weights).sum())
            + 2 * float(np.log(factor[0]).sum())
            + float(np.linalg.slogdet(schur)[1])
        )
        return factor, alone, through, covariance, float(cost)

    def solution(self) -> tuple[Solution, Array]:
        """Maximise the likelihood; return also the covariance of the parameters with the spread."""
        logs, weights = np.log([1e-4, 1e-4]), np.ones(len(self.torque) - 1)
        for _ in range(MAXIMISATIONS):
            logs = minimize(
                lambda tried, fixed: self.solve(tried, fixed)[-1],
                logs,
                (weights,),
                method="Nelder-Mead",
                bounds=[(-25.0, 2.0)] * 2,
                options={"xatol": 0.02, "fatol": 0.02},
            ).x
            for _ in range(ROUNDS):
                steps = np.diff(self._state(logs, weights).load) ** 2
                weights = student(steps, self.size**2 * float(np.exp(logs[1])))
        self.chosen = logs, weights
        solution = self._state(logs, weights)
        if len(weights) == 0 or weights.min() > STEPPED:
            return solution, solution.covariance
        return solution, solution.covariance + self._spread(logs, weights)

    def moved_by(self, segments: Segments) -> Array:
        """Return how the torque of the segments moves the parameters, if it is an error."""
        error = segments.torque.mean(axis=0) @ self.second  # the parameters are linear in it
        return self._state(*self.chosen, torque=error).parameters

    def _spread(self, logs: Array, weights: Array) -> Array:
        """Return the jackknife covariance of the parameters.

        Where the load steps, a step at the same time as a change of speed may pass for friction.
        Without the segments around it, and without the load that connects both sides, friction is
        another.
        """
        n, found = len(self.torque), []
        parts = min(PARTS, n)
        for part in np.array_split(np.arange(n), parts):
            used, walk = np.ones(n), weights.copy()
            used[part] = 0.0
            walk[max(part[0] - 1, 0) : part[-1] + 1] = 1e-12
            found.append(self._state(logs, walk, used).parameters)
        deviations = np.array(found) - np.mean(found, axis=0)
        return np.asarray((parts - 1) / parts * deviations.T @ deviations)

    def _state(
        self,
        logs: Array,
        weights: Array,
        used: Array | float = 1.0,
        torque: Array | None = None,
    ) -> Solution:
        torque = self.torque if torque is None else torque
        factor, alone, through, covariance, _ = self.solve(logs, weights, used, torque)
        noise = self.size**2 * float(np.exp(logs[0]))
        parameters = covariance @ ((self.regressors.T * used) @ (torque - alone) / noise)
        return Solution(alone - through @ parameters, parameters, covariance, factor, through)


def identify_mechanics(
    t: Array,
    theta: Array,
    torque: Array,
    torque_std: Array,
    valid: NDArray[np.bool_],
    load_std: float = np.inf,
) -> Mechanics:
    """Identify inertia, friction and load.

    Parameters
    ----------
    t, theta, torque, torque_std : (rows,) ndarray
        Time [s], mechanical angle, continuous where it is valid [rad], torque and its standard
        deviation [N m].
    valid : (rows,) ndarray of bool
    load_std : float
        Prior standard deviation of the load [N m]; 0 if the shaft is free.

    Raises
    ------
    FluxobsError
        Too few rows are valid, or the torque does not accelerate the drive.
    """
    valid, theta, torque = bridged(valid, theta, torque)
    signals = t, theta, torque, valid
    J, J_std = inertia(cut(*signals, SEGMENT, OVERLAP), OVERLAP)
    others = []
    for duration in (SHORTER * SEGMENT, LONGER * SEGMENT):
        try:
            others.append(inertia(cut(*signals, duration, OVERLAP), OVERLAP))
        except FluxobsError:  # the log has no such segments
            others.append((J, J_std))
    (short, short_std), (long, long_std) = others
    elastic = (long - short) / float(np.hypot(short_std, long_std))
    if abs(elastic) > 1:  # the segments disagree by more than their noise
        J_std = float(np.hypot(J_std, (long - short) / 2))
    segments = cut(*signals, SEGMENT, 1)
    friction = Friction(segments, J, J_std, load_std)
    solution, covariance = friction.solution()
    viscous, coulomb, correction = solution.parameters.tolist()
    # An error of the torque that opposes the motion passes for friction: one as large as its
    # standard deviation at each row, and one that grows with the speed, such as iron loss.
    speed = np.where(valid, np.gradient(theta, t), 0.0)
    fast = np.abs(speed) > np.abs(speed).max() / 2
    grown = float(np.nanmedian(torque_std[fast])) * speed / np.abs(speed).max()
    by_drag = np.zeros(3)
    for drag in (np.nan_to_num(torque_std * np.sign(speed)), grown):
        change = friction.moved_by(cut(t, theta, drag, valid, SEGMENT, 1))
        by_drag = np.maximum(by_drag, np.abs(change))
    values = {"J": J + correction, "viscous": viscous, "coulomb": coulomb}
    stds = np.sqrt(np.diag(covariance) + by_drag**2)[[2, 0, 1]]
    # A common scale of the torque scales every parameter.
    sure = valid & np.isfinite(torque_std)
    size = np.abs(torque[sure])
    loaded = size > LOADED * size.max()
    scale = float(np.median(torque_std[sure][loaded] / size[loaded]))
    return Mechanics(
        values,
        {
            name: float(np.hypot(std, scale * values[name]))
            for name, std in zip(UNITS, stds.tolist(), strict=True)
        },
        float(size.max()),
        float(np.abs(friction.speed).max()),
        segments.t,
        solution.load,
        np.hypot(solution.load_std, scale * solution.load),
        elastic,
    )
