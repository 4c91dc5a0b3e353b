"""The test after which the parameters are known: set points of speed and current.

**Information.** A stay at a set point tells a matrix of information on everything that the estimate
of a log assumes: P⁻¹ - P₀⁻¹, from the covariance that the estimate has after a record of this stay
alone, and before it. Stays add up, and the parameters' standard deviations follow from the sum.
Each stay is chosen for the largest decrease of the standard deviations beyond their targets, per
second. A set point is visited once: a longer stay repeats the same unmodelled errors.

**Promise.** The chosen points become a course with ramps between them, for which the record of the
nominal machine follows in closed form. The standard deviations that the estimate of this record
states are the promise; stays are added until it holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.arrays import Array
from ..errors import FluxobsError, UsageError
from ..estimation.lag import shifted
from ..identification.identify import mechanics_of
from ..identification.values import UNITS
from ..logs.scales import Scales
from ..machines import InductionMachine, RotatingMachine
from ..presentation import Result, estimate
from ..simulation.closed_form.signals import driven, inverter_loss, vectors
from ..simulation.drive import Rating
from ..smoothing.assumptions import Calibration
from ..smoothing.record import RecordSamples, SmoothingModel, smooth_record
from .setup import Sensors

#: Speeds as shares of the rated speed; lengths of the current vector as shares of the rated
#: current, and its directions.
SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 0.95)
LENGTHS, DIRECTIONS = (0.35, 0.65, 0.95), 12
#: Smallest current along d of a machine without magnets, as a share of the rated current: without
#: it there is no flux, and no position.
LEAST_D = 0.25
#: Shortest stay [s]; ramps from rest to rated speed [s], shortest change between set points [s].
STAY, RAMP, CHANGE = 0.25, 1.0, 0.1
#: Pause at rest in which the shaft is uncoupled, or the load machine switched off [s].
PAUSE = 0.5
#: Largest voltage of a set point as a share of what the link gives.
VOLTAGE = 0.95
#: The first set point, shares of the rated speed and current: without a position on the way, the
#: rest tells nothing.
FIRST_SPEED, FIRST, FIRST_WITHOUT_MAGNETS = 0.4, (0.0, 0.35), (0.5, 0.35)
#: Fewest and most set points, and most rounds in which they become more.
LEAST, MOST, ROUNDS = 1, 40, 12
#: Least rotation in a stay [rad]: over a turn, every error of a phase shows.
LEAST_TURN = 2.4 * np.pi
#: Parts of a sample over which the record is integrated.
PARTS = 8
#: Noise of the controller's current at a set point is that of the sensors; angle of the observer
#: that anchors a stay [rad].
ANCHOR = 0.02
#: Loss of the planned inverter over its prior standard deviation, and its knee over the rated
#: current: what the estimate does not know of a loss grows with the loss.
LOSS, KNEE = 0.6, 0.03
#: A planned standard deviation is this share of its target, as the rest comes from rounding, noise
#: and ramps.
MARGIN = 0.9
#: Usual wishes: shares of a value, and of the rated resistive drop for the inverter's loss.
SHARE, INVERTER_SHARE = 0.05, 0.1
#: Speed ramps that tell the inertia: range as shares of the rated speed, largest torque as a share
#: of the rated one, shortest ramps [s] in the order in which they are tried (short ramps need more
#: torque, which is known better; in too short ones the position is not valid), time of all [s].
LOW, HIGH, TORQUE, SHORTEST, RAMPS = 0.35, 0.95, 0.8, (0.03, 0.06, 0.12, 0.25), 2.0
#: Least share of valid rows of the ramps.
VALID = 0.95
#: A ramp: share of its duration, of the change of the speed, of the current.
TRAPEZOID = ((0.1, 0.05 / 0.9, 1.0), (0.9, 0.85 / 0.9, 1.0), (1.0, 1.0, 0.0), (1.25, 1.0, 0.0))


@dataclass(frozen=True)
class Knot:
    """A corner of the course; between corners, everything is linear in time.

    Attributes
    ----------
    t : float
        [s].
    speed : float
        Mechanical [rad/s].
    i_d, i_q : float
        Current in rotor coordinates [A].
    free : bool
        The shaft is free after the corner: speed follows the speed controller, i_q is expected.
    """

    t: float
    speed: float
    i_d: float
    i_q: float
    free: bool = False


@dataclass(frozen=True, eq=False)
class Sequence:
    """A test.

    Attributes
    ----------
    knots : tuple of Knot
    points : int
        Set points.
    ramps_from : float
        Time from which on the shaft is free [s]; the duration if it never is.
    stds : dict
        Promised standard deviations [unit of the parameter].
    values : dict
        Nominal values.
    """

    knots: tuple[Knot, ...]
    points: int
    ramps_from: float
    stds: dict[str, float]
    values: dict[str, float]

    @property
    def duration(self) -> float:
        """[s]."""
        return self.knots[-1].t


@dataclass(frozen=True)
class _Point:
    speed: float  # electrical [rad/s]
    current: complex  # [A]

    @property
    def stay(self) -> float:
        """Time at the set point [s]."""
        return max(STAY, LEAST_TURN / self.speed)


def known_parameters(machine: RotatingMachine, inertia: float | None) -> dict[str, float]:
    """Return the parameters that a test can tell, with their nominal values."""
    values = {"R_s": machine.R_s}
    values |= dict(zip(machine.inductances, machine.L_dq, strict=True))
    if machine.magnets:
        values["psi_f"] = machine.magnet_flux or 0.0
    values["inverter"] = machine.inverter_voltage or 0.0
    if inertia is not None:
        values["J"] = inertia
    return values


def usual_wants(machine: RotatingMachine) -> dict[str, tuple[float, float]]:
    """Return usual wishes, and what a percentage refers to: name → (std, value)."""
    assert machine.rated_current is not None  # as in rating_of
    drop = machine.R_s * machine.rated_current
    wants = {
        name: (SHARE * value, value)
        for name, value in known_parameters(machine, None).items()
        if name != "inverter"
    }
    return wants | {"inverter": (INVERTER_SHARE * drop, drop)}


class Planner:
    """Plans a test of a drive.

    Parameters
    ----------
    machine : RotatingMachine
        Synchronous, with rated_current.
    rated : Rating
    sensors : Sensors
    wanted : mapping
        Parameter → standard deviation in its unit: R_s [Ω], inductances [H], psi_f [Wb],
        inverter [V], J [kg m²].
    priors : mapping
        As for :func:`fluxobs.estimate`.
    loaded : bool
        A load machine holds the speed; else only currents along d are set points.

    Raises
    ------
    UsageError
        The machine has no such parameter, or no log can tell it that well.
    """

    def __init__(
        self,
        machine: RotatingMachine,
        rated: Rating,
        sensors: Sensors,
        wanted: Mapping[str, float],
        priors: Mapping[str, float],
        loaded: bool = True,
    ) -> None:
        if isinstance(machine, InductionMachine):
            raise UsageError("tests are planned for synchronous machines, not for induction ones")
        assert machine.rated_current is not None  # as in rating_of
        self.machine, self.rated, self.sensors = machine, rated, sensors
        self.wanted, self.priors, self.loaded = dict(wanted), dict(priors), loaded
        self.current = machine.rated_current
        self.values = known_parameters(machine, rated.J)
        self._check_wanted()
        flux = machine.flux_base(self.current)
        assert flux is not None
        scales = Scales(self.current, rated.speed_e * flux, sensors.noise, 0.0, 0.5 * rated.speed_e)
        self.model = SmoothingModel.of(
            *(machine, scales, rated.sample_time, flux, sensors.total_noise),
            *(0.5 * rated.speed_e, self.priors),
        )

    def _check_wanted(self) -> None:
        scale = Calibration.of(self.priors)
        shares = {name: scale.ratio for name in ("R_s", *self.machine.inductances, "J")}
        shares["psi_f"] = scale.voltage
        self.floors = {
            name: shares.get(name, 0.0) * abs(value) for name, value in self.values.items()
        }
        for name, std in self.wanted.items():
            if name not in self.values:
                raise UsageError(
                    f"--want {name}: this machine has {', '.join(self.values)} to be known"
                )
            if not 0 < std < np.inf:
                raise UsageError(f"--want {name}: a standard deviation must be positive")
            if name != "inverter" and std > abs(self.values[name]):
                raise UsageError(
                    f"--want {name}: ± {std:.3g} {UNITS[name]} is more than the value, "
                    f"{self.values[name]:.3g} {UNITS[name]}"
                )
            if not std > self.floors[name]:
                raise UsageError(
                    f"--want {name}: no log tells it better than ± {self.floors[name]:.3g} "
                    f"{UNITS[name]}, since "
                    f"the scales of the sensors are unknown; if they are known better, state it: "
                    f"--prior voltage_scale=0.005 --prior current_scale=0.005"
                )

    def plan(self, progress: Callable[[int, int], Any] | None = None) -> Sequence:
        """Return the shortest sequence that was found.

        Raises
        ------
        FluxobsError
            Even all set points do not tell the parameters that well.
        """
        candidates = self._candidates()
        information = []
        for n, point in enumerate(candidates):
            information.append(self._information(point))
            if progress is not None:
                progress(n + 1, len(candidates))
        factors, least = dict.fromkeys(self.wanted, 1.0), LEAST
        for _ in range(ROUNDS):
            chosen, predicted = self._chosen(candidates, information, factors, least)
            result = self._promised(chosen)
            reached = {name: result.stds[name] for name in self.wanted if name != "J"}
            if all(std <= self.wanted[name] for name, std in reached.items()):
                return self._with_ramps(result)
            if len(chosen) >= min(MOST, len(candidates)):
                break
            least = len(chosen) + 1
            for name, std in reached.items():
                own = std**2 - self.floors[name] ** 2
                if np.isfinite(own):  # else the position is not known on the way
                    factors[name] = max(own, 0.0) ** 0.5 / predicted[name]
        text = ", ".join(f"{name} ± {std:.3g} {UNITS[name]}" for name, std in reached.items())
        raise FluxobsError(
            f"{len(candidates)} set points do not tell the parameters that well; they reach "
            f"{text}. Better sensors, or priors of what is known (--prior) help"
        )

    def _candidates(self) -> list[_Point]:
        limit = VOLTAGE * self.rated.dc_link / 3**0.5
        turns = np.exp(2j * np.pi * np.arange(DIRECTIONS) / DIRECTIONS)
        currents = [0j, *(length * turn for length in LENGTHS for turn in turns)]
        if not self.loaded:
            currents = [current for current in currents if abs(current.imag) < 1e-9]
        if not self.machine.magnets:
            currents = [current for current in currents if current.real > LEAST_D]
        points = []
        for share in SPEEDS:
            speed = share * self.rated.speed_e
            for current in currents:
                i = complex(np.round(self.current * current, 4))
                voltage = self.machine.R_s * i + 1j * speed * complex(self.machine.flux_dq(i))
                if abs(voltage) < limit:
                    points.append(_Point(speed, i))
        return points

    def _record(self, t: Array, speed: Array, current: Any) -> tuple[Array, Array, Array]:
        """Return mean voltage until each row, measured current, and angle of a course."""
        h = self.rated.sample_time
        signals = driven(self.machine, h, speed, current, PARTS, theta0=0.3)
        rng = np.random.default_rng(len(t))
        true = vectors(signals.current)[:-1]
        measured = true + self.sensors.noise * rng.standard_normal(true.shape)
        step = self.sensors.step
        measured = np.round(measured / step) * step if step > 0 else measured
        lost = LOSS * self.model.stds["inverter_hard"]
        u = signals.voltage + inverter_loss(signals.mean_current, lost, KNEE * self.current)
        return vectors(u), np.asarray(measured, float), signals.theta_e[:-1]

    def _information(self, point: _Point) -> Array:
        """Return the information of a stay on the assumptions that are not exact."""
        count = round(point.stay / self.rated.sample_time) * PARTS + 1
        constant = np.ones(count)
        u, i, theta = self._record(
            constant[::PARTS], point.speed * constant, point.current * constant
        )
        samples = RecordSamples(
            shifted(u, -1), i, np.zeros(len(i), np.int64), theta, np.full(len(i), ANCHOR)
        )
        start = self.model.prior()
        record = smooth_record(self.model, samples, start, learning=True)
        if not record.converged:
            return 0 * start.covariance
        gained = np.linalg.inv(record.assumed.covariance) - np.linalg.inv(start.covariance)
        values, axes = np.linalg.eigh((gained + gained.T) / 2)
        return np.asarray((axes * np.maximum(values, 0.0)) @ axes.T)

    def _chosen(
        self,
        candidates: list[_Point],
        information: list[Array],
        factors: dict[str, float],
        least: int,
    ) -> tuple[list[_Point], dict[str, float]]:
        """Return set points, and the standard deviations from the sum of their information.

        `factors` are standard deviations of a whole record over those of the sum: errors that all
        stays share do not average out.
        """
        total: Array = np.asarray(np.linalg.inv(self.model.prior().covariance), float)
        left, chosen = list(range(len(candidates))), list[_Point]()
        best = self._excess(total, factors)
        while left and (best > 0 or len(chosen) < least) and len(chosen) < MOST:
            scores = np.array([self._excess(total + information[k], factors) for k in left])
            stays = np.array([candidates[k].stay + CHANGE for k in left])
            at = int(np.argmin((scores - best) / stays))
            if not scores[at] < best and len(chosen) >= least:
                break
            k = left[at]
            total, best = total + information[k], float(scores[at])
            chosen.append(candidates[k])
            left.remove(k)
        return chosen, self._stds(np.asarray(np.linalg.inv(total), float))

    def _excess(self, information: Array, factors: dict[str, float]) -> float:
        """Return by how much standard deviations exceed their targets, in logarithms."""
        stds = self._stds(np.asarray(np.linalg.inv(information), float))
        excess = 0.0
        for name, wanted in self.wanted.items():
            if name in stds:
                target = MARGIN * (wanted**2 - self.floors[name] ** 2) ** 0.5
                excess += max(0.0, float(np.log(factors[name] * stds[name] / target)))
        return excess

    def _stds(self, covariance: Array) -> dict[str, float]:
        """Return standard deviations of parameters, but for scales, from those of assumptions."""
        at = {name: n for n, name in enumerate(self.model.active)}

        def std(*names: str) -> float:
            rows = [at[name] for name in names if name in at]
            return float(np.sqrt(max(covariance[np.ix_(rows, rows)].sum(), 0.0)))

        stds = {
            "R_s": std("resistance"),
            "inverter": std("inverter_hard", "inverter_soft"),
            "psi_f": std("psi_f"),
        }
        for axis, name, L in zip("dq", self.machine.inductances, self.machine.L_dq, strict=True):
            if f"saturation_{axis}" in at:
                stds[name] = L * self._bent(covariance, at, axis)
            elif f"L_{axis}" in at:
                stds[name] = L * std(f"L_{axis}")
        return stds

    @staticmethod
    def _bent(covariance: Array, at: dict[str, int], axis: str) -> float:
        """Return the standard deviation of an inductance at half the rated current [1]."""
        slope = np.zeros(len(at))
        slope[at[f"L_{axis}"]], slope[at[f"saturation_{axis}"]] = 1.0, -0.5
        return float(np.sqrt(slope @ covariance @ slope))

    def course(self, chosen: list[_Point]) -> list[Knot]:
        """Return the corners of a course through set points, from rest."""
        least = 0.0 if self.machine.magnets else LEAST_D * self.current * 1.5
        n_p = self.machine.n_p
        t, last = 0.05, _Point(0.0, complex(least))
        knots = [Knot(0.0, 0.0, least, 0.0), Knot(t, 0.0, least, 0.0)]
        order = sorted(chosen, key=lambda p: (-p.speed, np.angle(p.current), abs(p.current)))
        for point in [self._first(), *order]:
            t += max(CHANGE, RAMP * abs(point.speed - last.speed) / self.rated.speed_e)
            i = point.current
            knots.append(Knot(t, point.speed / n_p, i.real, i.imag))
            t += point.stay
            knots.append(Knot(t, point.speed / n_p, i.real, i.imag))
            last = point
        t += max(CHANGE, RAMP * last.speed / self.rated.speed_e)
        knots.append(Knot(t, 0.0, least, 0.0))
        # Without a load machine, the drive itself controls the speed.
        return knots if self.loaded else [replace(knot, free=True) for knot in knots]

    def _first(self) -> _Point:
        """Return the set point at which an observer finds the position after the run-up."""
        i_d, i_q = FIRST if self.machine.magnets else FIRST_WITHOUT_MAGNETS
        return _Point(
            FIRST_SPEED * self.rated.speed_e,
            self.current * complex(i_d, i_q if self.loaded else 0.0),
        )

    def run(self, knots: list[Knot]) -> Result:
        """Estimate the record of a course with the nominal machine."""
        h, n_p = self.rated.sample_time, self.machine.n_p
        rows = round(knots[-1].t / h)
        t = np.arange(rows * PARTS + 1) * h / PARTS
        corners = np.array([knot.t for knot in knots])
        speed = n_p * np.interp(t, corners, [knot.speed for knot in knots])
        i_d = np.interp(t, corners, [knot.i_d for knot in knots])
        i_q = np.interp(t, corners, [knot.i_q for knot in knots])
        u, i, _ = self._record(t[::PARTS], speed, i_d + 1j * i_q)
        return estimate((u, i), self.machine, sample_time=h, lag=0, priors=self.priors)

    def _promised(self, chosen: list[_Point]) -> Sequence:
        knots = self.course(chosen)
        result = self.run(knots)
        learnt = result.learnt
        if learnt is None or not result.statistics.valid:
            stds = dict.fromkeys(self.values, np.inf)
        else:
            stds = {
                "R_s": learnt.resistance_std,
                "psi_f": learnt.psi_f_std,
                "inverter": learnt.inverter_std,
            }
            for name, L, share in zip(
                self.machine.inductances, self.machine.L_dq, learnt.inductance_std, strict=True
            ):
                stds.setdefault(name, L * share)
            stds = {name: stds[name] for name in self.values if name in stds}
        return Sequence(tuple(knots), len(chosen) + 1, knots[-1].t, stds, self.values)

    def _with_ramps(self, sequence: Sequence) -> Sequence:
        """Append ramps of the free shaft until the inertia is known, if it is wanted."""
        if "J" not in self.wanted:
            return sequence
        best = np.inf
        for shortest in SHORTEST:
            knots = self._ramps(shortest)
            result = self.run(knots)
            # The position of a drive with tolerances is valid on fewer rows than that of the plan.
            t, edge = result["t"], RAMP * LOW + CHANGE
            if result["valid"][(t > edge) & (t < t[-1] - edge)].mean() < VALID:
                continue
            std = float(mechanics_of(result).stds["J"])
            best = min(best, std)
            if std <= self.wanted["J"]:
                begin = sequence.duration + PAUSE
                later = [replace(knot, t=knot.t + begin) for knot in knots]
                stds = sequence.stds | {"J": std}
                return replace(
                    sequence, knots=(*sequence.knots, *later), ramps_from=begin, stds=stds
                )
        raise FluxobsError(
            f"speed ramps tell J only to ± {best:.3g} kg m²; the standard deviation of the torque "
            f"limits it. The scales of voltage and current are part of it: if they are known, "
            f"state --prior voltage_scale=0.005 --prior current_scale=0.005"
        )

    def _ramps(self, shortest: float) -> list[Knot]:
        """Return ramps up and down, each `shortest` [s] or as long as the torque asks."""
        n_p, rated = self.machine.n_p, self.rated
        i_d = 0.0 if self.machine.magnets else 0.5 * self.current
        low, high = (share * rated.speed_e / n_p for share in (LOW, HIGH))
        duration = max(shortest, rated.J * (high - low) / (TORQUE * rated.torque))
        torque = rated.J * (high - low) / (0.9 * duration)  # of the trapezoid below
        i_q = np.linspace(0.0, 1.5 * self.current, 301)
        flux = self.machine.flux_dq(i_d + 1j * i_q)
        given = 1.5 * n_p * (flux.real * i_q - flux.imag * i_d)
        amount = float(np.interp(torque, given, i_q))
        t = max(CHANGE, RAMP * LOW)
        knots = [Knot(0.0, 0.0, i_d, 0.0, True), Knot(t, low, i_d, 0.0, True)]
        t += CHANGE
        knots.append(Knot(t, low, i_d, 0.0, True))
        for _ in range(int(np.ceil(RAMPS / (2.5 * duration)))):
            for target, sign in ((high, 1.0), (low, -1.0)):
                start = knots[-1].speed
                for share, done, i in TRAPEZOID:
                    speed = start + done * (target - start)
                    knots.append(Knot(t + share * duration, speed, i_d, sign * i * amount, True))
                t += 1.25 * duration
        return [*knots, Knot(t + RAMP * LOW, 0.0, i_d, 0.0, True)]
