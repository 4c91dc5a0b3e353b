"""Simulates a whole drive sample by sample: one scan per record, batches by vmap."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from ...errors import ModelError
from ...logs.record import Record
from ..precision import real
from .control import Control, ControlState
from .inverter import Inverter
from .loop_observer import Reading
from .motor import Plant, PlantState
from .profile import Profile
from .sensorless import RUNNING, Sensorless, SensorlessState
from .sensors import Sensors
from .vectors import length, limit, pair, turn, unit, vector

#: Trip current over the current limit.
TRIP = 3.0
#: A speed does not follow if its error exceeds this share of the largest reference.
UNFOLLOWED = 0.1
#: Integration steps per sample above which a drive is too stiff for its sample time.
MOST_STEPS = 100


class Drive(eqx.Module):
    """Everything between the speed reference and the shaft.

    Parameters
    ----------
    plant, inverter, sensors, control
    observer : LoopObserver, optional
        Runs alongside; in the loop only with `sensorless`. Or any other module with `sample_time`,
        `init` and `step` whose readings have what :class:`Sensorless` and the control use.
    sensorless : Sensorless, optional
        If None, the controller uses an encoder.
    """

    plant: Plant
    inverter: Inverter
    sensors: Sensors
    control: Control
    observer: Any = None
    sensorless: Sensorless | None = None

    @property
    def sample_time(self) -> Array:
        return self.control.sample_time


class Course(eqx.Module):
    """Inputs of a drive over time.

    Parameters
    ----------
    speed : Profile or number
        Mechanical speed reference [rad/s].
    load : Profile or number
        Load torque on the shaft [N m].
    dc_link : Profile or number
        DC-link voltage [V].
    voltage_offset : Profile or (2,)
        Commanded minus true [V].
    theta_e, start_speed : float
        Initial angle [rad] and speed [rad/s mechanical] of the rotor.
    """

    speed: Profile
    load: Profile
    dc_link: Profile
    voltage_offset: Profile
    theta_e: Array
    start_speed: Array

    def __init__(
        self,
        speed: Any,
        dc_link: Any,
        load: Any = 0.0,
        voltage_offset: Any = (0.0, 0.0),
        theta_e: Any = 0.0,
        start_speed: Any = 0.0,
    ) -> None:
        self.speed, self.load = Profile.of(speed), Profile.of(load)
        self.dc_link, self.voltage_offset = Profile.of(dc_link), Profile.of(voltage_offset)
        self.theta_e = real("theta_e", theta_e)
        self.start_speed = real("start_speed", start_speed)


class Trace(NamedTuple):
    """Rows of a run; vectors are complex, in αβ. All values hold at the sampling instant, except
    voltages, which act from the row to the next."""

    current: Array
    measured_current: Array
    voltage: Array  # commanded
    true_voltage: Array  # mean
    flux: Array
    theta_e: Array
    speed: Array  # mechanical [rad/s]
    torque: Array
    current_reference: Array  # rotor coordinates
    mode: Array
    voltage_limited: Array
    current_limited: Array
    tripped: Array
    reference: Array  # speed [rad/s]
    reading: Reading | None


@dataclass(frozen=True)
class Event:
    """Something the user must know: its first time, and the share of rows it holds on."""

    what: str
    at: float
    share: float | None = None

    def __str__(self) -> str:
        if self.share is None:
            return f"{self.what} at t = {self.at:.4g} s"
        return f"{self.what} from t = {self.at:.4g} s ({self.share:.2g} of the rows)"


@dataclass(frozen=True, eq=False)
class Run:
    """A simulated record; arrays as in :class:`Trace`, NumPy.

    Attributes
    ----------
    events : tuple of Event
        Limits met, trips, hand-overs, losses of the position, a reference not followed at the end.
        A trip sets the voltage to zero: a short at the terminals.
    """

    sample_time: float
    t: NDArray[np.float64]
    trace: Trace
    events: tuple[Event, ...]

    def record(self) -> Record:
        """The record that a log of this drive would hold; row k's voltage acts from k to k + 1."""
        trace = self.trace
        return Record(
            self.sample_time,
            np.asarray(pair(trace.voltage)),
            np.asarray(pair(trace.measured_current)),
            theta_e=np.asarray(trace.theta_e),
        )


class _Loop(NamedTuple):
    """State carried from sample to sample."""

    plant: PlantState
    control: ControlState
    acted: Array  # commanded voltage that acted until now
    pending: Array  # the one computed last
    observer: Any
    sensorless: SensorlessState | None
    tripped: Array


class _Row(NamedTuple):
    """External inputs at a sample."""

    reference: Array
    load: Array
    dc_link: Array
    voltage_offset: Array
    current_offset: Array
    noise: Array
    late: Array


def simulate(
    drive: Drive, course: Course, duration: float, seed: int = 0, delay: bool = True
) -> Run:
    """Simulate a drive on a course.

    Parameters
    ----------
    drive, course
    duration : float
        Simulated time [s].
    seed : int
        Seed of sensor noise and jitter.
    delay : bool
        Lets a voltage act one sample after the currents it was computed from, as on a processor.

    Raises
    ------
    ModelError
        The current loop is unstable, the load exceeds the torque at the current limit, or a state
        is not finite; the message says what and when.
    """
    check(drive, course)
    rows = _rows(drive, duration)
    noise = _noise([seed], rows)[0]
    trace = _simulate(drive, course, noise, substeps(drive, course), delay)
    return _finish(trace, float(drive.sample_time))


def simulate_batch(
    drives: Sequence[Drive],
    courses: Sequence[Course],
    duration: float,
    seeds: Sequence[int],
    keep: Callable[[Trace], Any],
    delay: bool = True,
    threads: int | None = None,
) -> Any:
    """Simulate many drives at once.

    Parameters
    ----------
    drives, courses, seeds
        One of each per lane. All drives need the same parts (with or without observer, elastic or
        rigid), the same number of switching parts, and the same sample time.
    keep : callable
        Maps a row of the trace to what to return of it. A record of everything takes half a
        gigabyte for 256 seconds at 8 kHz: keep what you score, and `row.tripped` to see trips.
        Passing the same function object again avoids a new compilation.
    threads : int, optional
        Default one per processor.

    Returns
    -------
    Output of `keep`, as NumPy arrays with leading shape (lanes, rows).

    Raises
    ------
    ModelError
        As for :func:`simulate`; the message names the lane.
    """
    if not len(drives) == len(courses) == len(seeds) or not drives:
        raise ModelError("a batch needs as many drives as courses and seeds, at least one")
    rows = _rows(drives[0], duration)
    times = {float(drive.sample_time) for drive in drives}
    if len(times) != 1:
        raise ModelError(f"a batch needs one sample time, got {sorted(times)} s")
    pairs = {(id(d), id(c)): (d, c) for d, c in zip(drives, courses, strict=True)}
    for drive, course in pairs.values():
        check(drive, course)
    steps = max(substeps(drive, course) for drive, course in pairs.values())
    both = list(zip(drives, courses, strict=True))
    _check_alike(both)
    lanes, knots = len(drives), _knots(both)
    wanted = min(threads or len(os.sched_getaffinity(0)), lanes)
    edges = np.linspace(0, lanes, wanted + 1).astype(int)

    def part(k: int) -> Any:
        cut = slice(edges[k], edges[k + 1])
        noise = _noise(list(seeds)[cut], rows)
        return simulate_lanes(both[cut], noise, steps, keep, knots, delay)

    with ThreadPoolExecutor(wanted) as pool:
        parts = list(pool.map(part, range(wanted)))
    finite = np.concatenate([part[0] for part in parts])
    if not finite.all():
        raise ModelError(
            f"the simulation of lane {int(np.argmin(finite))} ends without a number; simulate it "
            f"alone to see when"
        )
    return jax.tree.map(lambda *xs: np.concatenate(xs), *(part[1] for part in parts))


def simulate_lanes(
    lanes: Sequence[tuple[Drive, Course]],
    noise: NDArray[np.float64],
    steps: int,
    keep: Callable[[Trace], Any],
    knots: int,
    delay: bool = True,
) -> tuple[NDArray[np.bool_], Any]:
    """Simulate checked drives at once, in this thread, with what a batch would choose given.

    Parameters
    ----------
    lanes : sequence of (Drive, Course)
    noise : (lanes, rows, 3) ndarray
        Standard normal numbers.
    steps : int
        Integration steps per sample, at least :func:`substeps` of every lane.
    keep : callable
        See :func:`simulate_batch`.
    knots : int
        Profiles are padded to this length.

    Returns
    -------
    finite : (lanes,) ndarray of bool
        Whether the lane's last state is one.
    kept
        Output of `keep`, NumPy arrays (lanes, rows).
    """
    batch = stack(lanes, knots)
    finite, kept = _simulate_many(batch, noise, steps, delay, keep)
    return np.asarray(finite), jax.tree.map(np.asarray, kept)


def _knots(lanes: Sequence[tuple[Drive, Course]]) -> int:
    """Length of the longest profile of some drives."""
    profiles = ((d.sensors.offset, c.speed, c.load, c.dc_link, c.voltage_offset) for d, c in lanes)
    return max(len(one.times) for some in profiles for one in some)


def stack(items: Sequence[Any], knots: int = 0) -> Any:
    """Stacks pytrees of one structure along a new leading axis; pads profiles to one
    length, at least to `knots`."""
    longest: dict[Any, int] = {}
    items = list(items)
    flat = [jax.tree.leaves(item, is_leaf=_is_profile) for item in items]
    _check_alike(items)
    for leaves in flat:
        for k, leaf in enumerate(leaves):
            if _is_profile(leaf):
                longest[k] = max(longest.get(k, knots), len(leaf.times))
    shapes = jax.tree.structure(items[0], is_leaf=_is_profile)
    padded = [
        jax.tree.unflatten(
            shapes,
            [
                _padded(leaf, longest[k]) if _is_profile(leaf) else leaf
                for k, leaf in enumerate(leaves)
            ],
        )
        for leaves in flat
    ]
    # Stack with NumPy: hundreds of small JAX arrays would take longer than the simulation.
    return jax.tree.map(lambda *parts: np.stack([np.asarray(part) for part in parts]), *padded)


def _is_profile(node: Any) -> bool:
    return isinstance(node, Profile)


def _check_alike(items: Sequence[Any]) -> None:
    """Raise ModelError unless all pytrees have one structure."""
    if len({jax.tree.structure(item, is_leaf=_is_profile) for item in items}) != 1:
        raise ModelError(
            "a batch needs drives with the same parts: observer, sensorless, elastic coupling, …"
        )


def _padded(profile: Profile, length: int) -> Profile:
    """Repeats the last knot until the profile has `length` knots."""
    more = length - len(profile.times)
    if more == 0:
        return profile
    times, values = np.asarray(profile.times), np.asarray(profile.values)
    return Profile(
        np.concatenate([times, np.repeat(times[-1:], more)]),
        np.concatenate([values, np.repeat(values[-1:], more, axis=0)]),
    )


def check(drive: Drive, course: Course) -> None:
    """Raises ModelError for a drive or course that cannot work."""
    for name, kind in (
        ("plant", Plant),
        ("inverter", Inverter),
        ("sensors", Sensors),
        ("control", Control),
        ("observer", eqx.Module | None),
        ("sensorless", Sensorless | None),
    ):
        part = getattr(drive, name, None)
        if not isinstance(part, kind):
            advice = "; make it with LoopObserver.of(…)" if name == "observer" else ""
            raise ModelError(f"drive.{name} is a {type(part).__name__}{advice}")
    for name, dimensions in (("speed", 1), ("load", 1), ("dc_link", 1), ("voltage_offset", 2)):
        if getattr(course, name).values.ndim != dimensions:
            what = "a number or numbers" if dimensions == 1 else "a pair (α, β) or pairs"
            raise ModelError(f"course.{name} must be {what} in time: Profile(times, values)")
    if drive.sensorless is not None and drive.observer is None:
        raise ModelError("drive.sensorless needs a drive.observer")
    if drive.observer is not None and not np.isclose(
        float(drive.observer.sample_time), float(drive.sample_time), rtol=1e-6
    ):
        raise ModelError(
            f"the observer's sample time, {float(drive.observer.sample_time):g} s, is not the "
            f"drive's, {float(drive.sample_time):g} s"
        )
    drive.control.check()
    most, heaviest = float(drive.control.most_torque()), float(np.abs(course.load.values).max())
    if heaviest > most:
        raise ModelError(
            f"a load of {heaviest:.4g} N m cannot be held: at the current limit, "
            f"{float(drive.control.current_limit):.4g} A, the torque is {most:.4g} N m. Lower the "
            f"load, or raise current_limit"
        )
    if not (np.asarray(course.dc_link.values) > 0).all():
        raise ModelError(f"dc_link must be positive, got {float(course.dc_link.values.min())} V")


def substeps(drive: Drive, course: Course) -> int:
    """Runge-Kutta steps per sample, each at most a tenth of the shortest time constant."""
    h, motor, m = float(drive.sample_time), drive.plant.motor, drive.plant.mechanics
    speeds = np.append(np.abs(course.speed.values), np.abs(course.start_speed))
    fastest = float(speeds.max()) * 1.2 * float(motor.n_p)
    rates = [*motor.rates(), fastest]
    rates += [(float(m.viscous) + float(m.coulomb / m.smoothing)) / float(m.J)]
    if m.elastic:
        least = 1 / (1 / float(m.J) + 1 / float(m.J_load))
        rates += [np.sqrt(float(m.stiffness) / least), float(m.damping) / least]
    steps = int(np.ceil(h * max(rates) / 0.1))
    if steps > MOST_STEPS:
        names = ["R_s/L", "speed", "friction/J", "stiffness", "damping"]
        raise ModelError(
            f"{names[int(np.argmax(rates))]} is {max(rates):.3g} 1/s: {steps} steps a sample of "
            f"{h:g} s. Leave that part out, or take shorter samples"
        )
    return max(steps, 1)


def _rows(drive: Drive, duration: float) -> int:
    if not (isinstance(duration, int | float) and np.isfinite(duration)):
        raise ModelError(f"duration must be a number of seconds, got {duration!r}")
    rows = round(duration / float(drive.sample_time))
    if rows < 2:
        raise ModelError(
            f"duration = {duration:g} s is less than two samples of {float(drive.sample_time):g} s"
        )
    return rows


def _noise(seeds: Sequence[int], rows: int) -> NDArray[np.float64]:
    """Standard normal samples, (lanes, rows, 3)."""
    return np.stack([np.random.default_rng(seed).standard_normal((rows, 3)) for seed in seeds])


@eqx.filter_jit
def _simulate(drive: Drive, course: Course, noise: Any, steps: int, delay: bool) -> Trace:
    return _run(drive, course, noise, steps, delay, lambda row: row)[1]  # type: ignore[no-any-return]


@eqx.filter_jit
def _simulate_many(
    batch: Any, noise: Any, steps: int, delay: bool, keep: Callable[[Trace], Any]
) -> tuple[Array, Any]:
    return jax.vmap(lambda both, n: _run(both[0], both[1], n, steps, delay, keep))(batch, noise)


def _run(
    drive: Drive,
    course: Course,
    noise: Array,
    steps: int,
    delay: bool,
    keep: Callable[[Trace], Any],
) -> tuple[Array, Any]:
    """Whether the final state is finite, and what `keep` returns of the rows; to be compiled."""
    t = jnp.arange(noise.shape[0]) * drive.sample_time
    rows = _Row(
        course.speed.at(t),
        course.load.at(t),
        course.dc_link.at(t),
        vector(course.voltage_offset.at(t)),
        vector(drive.sensors.offset.at(t)),
        vector(noise[:, :2]),
        noise[:, 2],
    )
    zero = jnp.zeros(())
    start = _Loop(
        drive.plant.standstill(course.theta_e, course.start_speed),
        drive.control.init(),
        jax.lax.complex(zero, zero),
        jax.lax.complex(zero, zero),
        None if drive.observer is None else drive.observer.init(),
        None if drive.sensorless is None else drive.sensorless.init(),
        jnp.zeros((), bool),
    )

    def body(loop: _Loop, row: _Row) -> tuple[_Loop, Any]:
        loop, out = _sample(drive, steps, delay, loop, row)
        return loop, keep(out)

    end, kept = jax.lax.scan(body, start, rows)
    numbers = [jnp.isfinite(x) for x in end.plant] + [jnp.isfinite(end.pending)]
    return jnp.stack(numbers).all(), kept


def _sample(drive: Drive, steps: int, delay: bool, loop: _Loop, row: _Row) -> tuple[_Loop, Trace]:
    """Measures, observes, controls; then advances the plant by one sample time."""
    plant, control, h = drive.plant, drive.control, drive.sample_time
    motor, state = plant.motor, loop.plant
    current = plant.current(state)
    rate = plant.rate(state, loop.acted, row.load)
    _, slope = jax.jvp(plant.current, (state,), (rate,))
    measured = drive.sensors.measure(current, slope, row.current_offset, row.noise, row.late)
    dc_link = row.dc_link * drive.sensors.dc_link_gain

    observer, reading = loop.observer, None
    if drive.observer is not None and observer is not None:
        observer, reading = drive.observer.step(observer, pair(loop.acted), pair(measured))

    reference = row.reference
    sensorless, kept = loop.sensorless, loop.control
    if drive.sensorless is None or sensorless is None or reading is None:
        direction = jnp.where(length(state.rotor) > 0, unit(state.rotor), 1.0)
        rotor_flux = motor.rotor_flux(state.rotor)
        slip = motor.slip((current * jnp.conj(direction)).imag, rotor_flux)
        speed_e = motor.n_p * state.speed + slip
        mode = jnp.asarray(RUNNING)
        kept, torque, cut = control.speed_step(kept, reference, state.speed)
        wanted = control.current_for(torque, kept.weakening, rotor_flux, speed_e, dc_link)
    else:
        sensorless, direction, speed_e, changed = drive.sensorless.step(
            sensorless, reading, motor.n_p * reference, measured, h
        )
        mode = sensorless.mode
        # At a jump of the frame, carry voltage and current over to the new frame.
        seen = measured * jnp.conj(direction)
        torque_now = motor.torque_dq(seen.real, seen.imag)
        running = mode == RUNNING
        last = loop.pending * jnp.conj(direction)
        entered = control.continued(kept, last, seen, speed_e, running)
        kept = kept._replace(
            voltage=jnp.where(changed, entered.voltage, kept.voltage),
            torque=jnp.where(running & ~changed, kept.torque, torque_now),
        )
        slip = control.motor.slip(seen.imag, reading.psi_f)
        speed = (speed_e - slip) / motor.n_p
        stepped, torque, cut = control.speed_step(kept, reference, speed)
        kept = kept._replace(torque=jnp.where(running, stepped.torque, kept.torque))
        cut = cut & running
        demand = jnp.where(
            running,
            control.current_for(torque, kept.weakening, reading.psi_f, speed_e, dc_link),
            jax.lax.complex(drive.sensorless.current, jnp.zeros(())),
        )
        left = jnp.where(changed, seen - demand, sensorless.left)
        sensorless = sensorless._replace(left=left)
        wanted = limit(demand + left, control.current_limit)
    kept, voltage_dq, limited = control.current_step(
        kept, wanted, measured * jnp.conj(direction), speed_e, dc_link, mode == RUNNING
    )
    # The voltage acts on average half a sample later, with a delay one and a half.
    ahead = (1.5 if delay else 0.5) * h * speed_e
    command = voltage_dq * direction * turn(ahead)
    tripped = loop.tripped | ~(length(current) < TRIP * control.current_limit)
    command = jnp.where(tripped, 0.0, command)

    acting = loop.pending if delay else command
    after, mean = _pass(drive, state, acting - row.voltage_offset, current, row, steps, dc_link)
    rows = Trace(
        current,
        measured,
        acting,
        mean,
        state.flux,
        jnp.arctan2(state.rotor.imag, state.rotor.real),
        state.speed,
        motor.torque(state.flux, current),
        wanted,
        mode,
        limited,
        cut,
        tripped,
        reference,
        reading,
    )
    return _Loop(after, kept, acting, command, observer, sensorless, tripped), rows


def _pass(
    drive: Drive,
    state: PlantState,
    voltage: Array,
    current: Array,
    row: _Row,
    steps: int,
    dc_link: Array,
) -> tuple[PlantState, Array]:
    """Plant state after one sample time under a commanded voltage, and the mean true voltage."""
    inverter, plant, h = drive.inverter, drive.plant, drive.sample_time
    # Duty cycles come from the measured DC link, the voltage from the true one.
    duties = inverter.duties(voltage, dc_link)
    if inverter.switching == 0:
        # A leg switches twice per period, around its middle: the current there sets the error.
        at_start = inverter.averaged(duties, row.dc_link, current, h)
        _, slope = jax.jvp(plant.current, (state,), (plant.rate(state, at_start, row.load),))
        mean = inverter.averaged(duties, row.dc_link, current + h / 2 * slope, h)
        return plant.advance(state, mean, row.load, h, steps), mean
    parts = inverter.switching

    def part(carried: tuple[PlantState, Array], k: Array) -> tuple[tuple[PlantState, Array], None]:
        now, total = carried
        u = inverter.switched(duties, row.dc_link, plant.current(now), h, k)
        each = max(1, -(-steps // parts))
        return (plant.advance(now, u, row.load, h / parts, each), total + u / parts), None

    start = (state, jnp.zeros_like(voltage))
    (after, mean), _ = jax.lax.scan(part, start, jnp.arange(parts))
    return after, mean


def _finish(trace: Trace, h: float) -> Run:
    """Checks a trace and lists its events."""
    trace = jax.tree.map(np.asarray, trace)
    t = np.asarray(np.arange(len(trace.theta_e)) * h, np.float64)
    finite = np.isfinite(trace.current) & np.isfinite(trace.speed) & np.isfinite(trace.voltage)
    if not finite.all():
        at = max(int(np.argmin(finite)) - 1, 0)
        raise ModelError(
            f"the simulation has no number after t = {t[at]:.6g} s, at "
            f"{trace.speed[at]:.4g} rad/s: are the gains stable, and the time constants "
            f"not far below the sample time?"
        )
    events = []
    for what, where in (
        ("voltage limit met", trace.voltage_limited),
        ("current limit met", trace.current_limited),
        ("overcurrent trip", trace.tripped),
    ):
        if where.any():
            events.append(Event(what, float(t[np.argmax(where)]), float(where.mean())))
    change = np.diff(trace.mode)
    for what, rows in (("observer in the loop", change > 0), ("position lost", change < 0)):
        events += [Event(what, float(t[k + 1])) for k in np.flatnonzero(rows)]
    events += _unfollowed(t, trace)
    return Run(h, t, trace, tuple(sorted(events, key=lambda event: event.at)))


def _unfollowed(t: NDArray[np.float64], trace: Trace) -> list[Event]:
    """Events for a position never known, and for a final speed far from its reference."""
    events = []
    if not (trace.mode == RUNNING).any():
        events.append(Event("observer never in the loop", float(t[0]), 1.0))
    largest = np.abs(trace.reference).max()
    off = np.abs(trace.speed - trace.reference) > UNFOLLOWED * largest
    last = np.flatnonzero(~off)[-1] + 1 if (~off).any() else 0
    if largest > 0 and len(t) - last > len(t) // 20:
        events.append(
            Event("speed reference not followed", float(t[last]), (len(t) - last) / len(t))
        )
    return events
