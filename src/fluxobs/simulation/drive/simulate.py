"""Simulate a whole drive sample by sample, with one scan per record; vmap makes batches."""

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

#: Trip current divided by the current limit.
TRIP = 3.0
#: Speed error over the largest reference above which a speed does not follow its reference.
UNFOLLOWED = 0.1
#: Integration steps per sample above which a drive is too stiff for its sample time.
MOST_STEPS = 100


class Drive(eqx.Module):
    """All components between the speed reference and the shaft.

    Parameters
    ----------
    plant, inverter, sensors, control
    observer : LoopObserver, optional
        With `sensorless`, the observer is in the loop; otherwise it only runs alongside. It can be
        any module with `sample_time`, `init` and `step` whose readings have the fields that
        :class:`Sensorless` and control use.
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
        Commanded voltage minus true voltage [V].
    theta_e, start_speed : float
        Initial angle [rad] and speed [rad/s mechanical] of the rotor.
    heat : Profile or number
        Stator resistance divided by its initial value, which rises as the winding warms.
    """

    speed: Profile
    load: Profile
    dc_link: Profile
    voltage_offset: Profile
    theta_e: Array
    start_speed: Array
    heat: Profile

    def __init__(
        self,
        speed: Any,
        dc_link: Any,
        load: Any = 0.0,
        voltage_offset: Any = (0.0, 0.0),
        theta_e: Any = 0.0,
        start_speed: Any = 0.0,
        heat: Any = 1.0,
    ) -> None:
        self.speed, self.load = Profile.of(speed), Profile.of(load)
        self.dc_link, self.voltage_offset = Profile.of(dc_link), Profile.of(voltage_offset)
        self.theta_e = real("theta_e", theta_e)
        self.start_speed = real("start_speed", start_speed)
        self.heat = Profile.of(heat)


class Trace(NamedTuple):
    """Rows of a run; vectors are complex numbers in αβ.

    Values are valid at the sampling instant; a row's voltages act until the next row.
    """

    current: Array
    measured_current: Array
    voltage: Array  # Commanded voltage.
    true_voltage: Array  # Mean over the interval.
    flux: Array
    theta_e: Array
    speed: Array  # Mechanical speed [rad/s].
    torque: Array
    current_reference: Array  # In rotor coordinates.
    mode: Array
    voltage_limited: Array
    current_limited: Array
    tripped: Array
    reference: Array  # Speed reference [rad/s].
    reading: Reading | None


@dataclass(frozen=True)
class Event:
    """An event that the user must know, with its first time and its share of the rows."""

    what: str
    at: float
    share: float | None = None

    def __str__(self) -> str:
        if self.share is None:
            return f"{self.what} at t = {self.at:.4g} s"
        return f"{self.what} from t = {self.at:.4g} s ({self.share:.2g} of the rows)"


@dataclass(frozen=True, eq=False)
class Run:
    """A simulated record with the NumPy arrays of :class:`Trace`.

    Attributes
    ----------
    events : tuple of Event
        Limits reached, trips, hand-overs, lost positions, a reference not followed at the end. A
        trip sets the voltage to zero, which shorts the terminals.
    """

    sample_time: float
    t: NDArray[np.float64]
    trace: Trace
    events: tuple[Event, ...]

    def record(self) -> Record:
        """Return the record that a log would contain; row k's voltage acts from row k to k + 1."""
        trace = self.trace
        return Record(
            self.sample_time,
            np.asarray(pair(trace.voltage)),
            np.asarray(pair(trace.measured_current)),
            lag=0.0,
            theta_e=np.asarray(trace.theta_e),
        )


class _Loop(NamedTuple):
    """State carried from sample to sample."""

    plant: PlantState
    control: ControlState
    acted: Array  # Commanded voltage of the last interval.
    lost: Array  # Commanded less true voltage of the last interval.
    pending: Array  # Commanded voltage computed last.
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
    heat: Array


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
        Apply a voltage one sample after the currents from which it was computed, like a processor.

    Raises
    ------
    ModelError
        If the current loop is unstable, the load exceeds the torque at the current limit, or a
        state is not finite.
    """
    check(drive, course)
    rows = count_rows(float(drive.sample_time), duration)
    noise = _draw_noise([seed], rows)[0]
    trace = _simulate(drive, course, noise, substeps(drive, course), delay)
    return _create_run(trace, float(drive.sample_time))


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
        One drive, course and seed per lane (simulation). All drives need the same components (with
        or without observer, elastic or rigid), the same number of switching intervals, and the same
        sample time.
    keep : callable
        Function that returns the values to keep from a row of the trace. All values of 256 seconds
        at 8 kHz need half a gigabyte, so keep only the values you evaluate, and `row.tripped` to
        detect trips. Use one function object for all calls to avoid a new compilation.
    threads : int, optional
        Number of threads; the default is one per processor.

    Returns
    -------
    Output of `keep` as NumPy arrays with the leading axes (lanes, rows).

    Raises
    ------
    ModelError
        As for :func:`simulate`. The message names the lane.
    """
    if not len(drives) == len(courses) == len(seeds) or not drives:
        raise ModelError(
            f"a batch needs as many drives as courses and seeds, at least one; got {len(drives)} "
            f"drives, {len(courses)} courses and {len(seeds)} seeds"
        )
    rows = count_rows(float(drives[0].sample_time), duration)
    sample_times = {float(drive.sample_time) for drive in drives}
    if len(sample_times) != 1:
        raise ModelError(f"a batch needs one sample time, got {sorted(sample_times)} s")
    pairs = {(id(d), id(c)): (d, c) for d, c in zip(drives, courses, strict=True)}
    for drive, course in pairs.values():
        check(drive, course)
    steps = max(substeps(drive, course) for drive, course in pairs.values())
    lanes = list(zip(drives, courses, strict=True))
    _check_alike(lanes)
    knots = _longest_profile(lanes)
    workers = min(threads or len(os.sched_getaffinity(0)), len(lanes))
    edges = np.linspace(0, len(lanes), workers + 1).astype(int)

    def simulate_chunk(k: int) -> Any:
        chunk = slice(edges[k], edges[k + 1])
        noise = _draw_noise(list(seeds)[chunk], rows)
        return simulate_lanes(lanes[chunk], noise, steps, keep, knots, delay)

    with ThreadPoolExecutor(workers) as pool:
        chunks = list(pool.map(simulate_chunk, range(workers)))
    finite = np.concatenate([chunk_finite for chunk_finite, _ in chunks])
    if not finite.all():
        raise ModelError(
            f"the state of lane {int(np.argmin(finite))} is not finite at the end; simulate this "
            f"lane alone to see the time"
        )
    return jax.tree.map(lambda *arrays: np.concatenate(arrays), *(kept for _, kept in chunks))


def simulate_lanes(
    lanes: Sequence[tuple[Drive, Course]],
    noise: NDArray[np.float64],
    steps: int,
    keep: Callable[[Trace], Any],
    knots: int,
    delay: bool = True,
) -> tuple[NDArray[np.bool_], Any]:
    """Simulate many checked drives in one call, in this thread.

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
        Smallest number of knots to which profiles are padded.

    Returns
    -------
    finite : (lanes,) ndarray of bool
        Whether the lane's last state is finite.
    kept
        Output of `keep` as NumPy arrays (lanes, rows).
    """
    batch = stack(lanes, knots)
    finite, kept = _simulate_many(batch, noise, steps, delay, keep)
    return np.asarray(finite), jax.tree.map(np.asarray, kept)


def _longest_profile(lanes: Sequence[tuple[Drive, Course]]) -> int:
    """Return the number of knots of the longest profile."""
    profiles = (
        (d.sensors.offset, c.speed, c.load, c.dc_link, c.voltage_offset, c.heat) for d, c in lanes
    )
    return max(len(profile.times) for of_lane in profiles for profile in of_lane)


def stack(items: Sequence[Any], knots: int = 0) -> Any:
    """Stack pytrees of one structure along a new leading axis.

    Profiles are padded to one length, which is at least `knots`.
    """
    longest: dict[Any, int] = {}
    items = list(items)
    flat = [jax.tree.leaves(item, is_leaf=_is_profile) for item in items]
    _check_alike(items)
    for leaves in flat:
        for k, leaf in enumerate(leaves):
            if _is_profile(leaf):
                longest[k] = max(longest.get(k, knots), len(leaf.times))
    structure = jax.tree.structure(items[0], is_leaf=_is_profile)
    padded = [
        jax.tree.unflatten(
            structure,
            [
                _padded(leaf, longest[k]) if _is_profile(leaf) else leaf
                for k, leaf in enumerate(leaves)
            ],
        )
        for leaves in flat
    ]
    # Stack with NumPy: hundreds of small JAX arrays would need more time than the simulation.
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *padded)


def _is_profile(node: Any) -> bool:
    return isinstance(node, Profile)


def _check_alike(items: Sequence[Any]) -> None:
    """Raise ModelError unless all pytrees have one structure."""
    if len({jax.tree.structure(item, is_leaf=_is_profile) for item in items}) != 1:
        raise ModelError(
            "a batch needs drives with the same components: observer, sensorless, elastic coupling"
        )


def _padded(profile: Profile, length: int) -> Profile:
    """Repeat the last knot until the profile has `length` knots."""
    missing = length - len(profile.times)
    if missing == 0:
        return profile
    times, values = np.asarray(profile.times), np.asarray(profile.values)
    return Profile(
        np.concatenate([times, np.repeat(times[-1:], missing)]),
        np.concatenate([values, np.repeat(values[-1:], missing, axis=0)]),
    )


def check(drive: Drive, course: Course) -> None:
    """Raise ModelError for a drive or course that cannot work."""
    for name, kind in (
        ("plant", Plant),
        ("inverter", Inverter),
        ("sensors", Sensors),
        ("control", Control),
        ("observer", eqx.Module | None),
        ("sensorless", Sensorless | None),
    ):
        component = getattr(drive, name, None)
        if not isinstance(component, kind):
            advice = "; create it with LoopObserver.of(…)" if name == "observer" else ""
            raise ModelError(f"drive.{name} is a {type(component).__name__}{advice}")
    for name, dimensions in (("speed", 1), ("load", 1), ("dc_link", 1), ("voltage_offset", 2)):
        if getattr(course, name).values.ndim != dimensions:
            value = "number" if dimensions == 1 else "pair (α, β)"
            raise ModelError(f"course.{name} must be a {value} or a Profile(times, {value}s)")
    if drive.sensorless is not None and drive.observer is None:
        raise ModelError("drive.sensorless needs a drive.observer")
    if drive.observer is not None and not np.isclose(
        float(drive.observer.sample_time), float(drive.sample_time), rtol=1e-6
    ):
        raise ModelError(
            f"the observer's sample time is {float(drive.observer.sample_time):g} s, but the "
            f"drive's sample time is {float(drive.sample_time):g} s"
        )
    drive.control.check()
    torque, load = float(drive.control.most_torque()), float(np.abs(course.load.values).max())
    if load > torque:
        raise ModelError(
            f"a load of {load:.4g} N m cannot be held: at the current limit, "
            f"{float(drive.control.current_limit):.4g} A, the torque is {torque:.4g} N m; reduce "
            f"the load or increase current_limit"
        )
    if not (np.asarray(course.dc_link.values) > 0).all():
        raise ModelError(f"dc_link must be positive, got {float(course.dc_link.values.min())} V")


def substeps(drive: Drive, course: Course) -> int:
    """Return Runge-Kutta steps per sample; a step is at most 0.1 of the shortest time constant."""
    h, motor, m = float(drive.sample_time), drive.plant.motor, drive.plant.mechanics
    speeds = np.append(np.abs(course.speed.values), np.abs(course.start_speed))
    fastest = float(speeds.max()) * 1.2 * float(motor.n_p)
    rates = [*motor.rates(), fastest]
    rates += [(float(m.viscous) + float(m.coulomb / m.smoothing)) / float(m.J)]
    if m.elastic:
        reduced = 1 / (1 / float(m.J) + 1 / float(m.J_load))
        rates += [np.sqrt(float(m.stiffness) / reduced), float(m.damping) / reduced]
    steps = int(np.ceil(h * max(rates) / 0.1))
    if steps > MOST_STEPS:
        names = ["R_s/L", "speed", "friction/J", "stiffness", "damping"]
        raise ModelError(
            f"{names[int(np.argmax(rates))]} is {max(rates):.3g} 1/s and needs {steps} steps per "
            f"sample of {h:g} s; leave {names[int(np.argmax(rates))]} out or reduce the sample time"
        )
    return max(steps, 1)


def count_rows(sample_time: float, duration: float) -> int:
    """Return the number of samples in `duration` [s]; raise ModelError if it is below two."""
    if not (isinstance(duration, int | float) and np.isfinite(duration)):
        raise ModelError(f"duration must be a number of seconds, got {duration!r}")
    rows = round(duration / sample_time)
    if rows < 2:
        raise ModelError(f"duration = {duration:g} s is less than two samples of {sample_time:g} s")
    return rows


def _draw_noise(seeds: Sequence[int], rows: int) -> NDArray[np.float64]:
    """Draw standard normal samples (lanes, rows, 3)."""
    return np.stack([np.random.default_rng(seed).standard_normal((rows, 3)) for seed in seeds])


@eqx.filter_jit
def _simulate(drive: Drive, course: Course, noise: Any, steps: int, delay: bool) -> Trace:
    return _run(drive, course, noise, steps, delay, lambda row: row)[1]  # type: ignore[no-any-return]


@eqx.filter_jit
def _simulate_many(
    batch: Any, noise: Any, steps: int, delay: bool, keep: Callable[[Trace], Any]
) -> tuple[Array, Any]:
    return jax.vmap(lambda lane, n: _run(lane[0], lane[1], n, steps, delay, keep))(batch, noise)


def _run(
    drive: Drive,
    course: Course,
    noise: Array,
    steps: int,
    delay: bool,
    keep: Callable[[Trace], Any],
) -> tuple[Array, Any]:
    """Return (whether the final state is finite, output of `keep`); this function is compiled."""
    t = jnp.arange(noise.shape[0]) * drive.sample_time
    rows = _Row(
        course.speed.at(t),
        course.load.at(t),
        course.dc_link.at(t),
        vector(course.voltage_offset.at(t)),
        vector(drive.sensors.offset.at(t)),
        vector(noise[:, :2]),
        noise[:, 2],
        course.heat.at(t),
    )
    zero = jnp.zeros(())
    start = _Loop(
        drive.plant.standstill(course.theta_e, course.start_speed),
        drive.control.init(),
        jax.lax.complex(zero, zero),
        jax.lax.complex(zero, zero),
        jax.lax.complex(zero, zero),
        None if drive.observer is None else drive.observer.init(),
        None if drive.sensorless is None else drive.sensorless.init(),
        jnp.zeros((), bool),
    )

    def body(loop: _Loop, row: _Row) -> tuple[_Loop, Any]:
        loop, trace = _sample(drive, steps, delay, loop, row)
        return loop, keep(trace)

    end, kept = jax.lax.scan(body, start, rows)
    finite = [jnp.isfinite(x) for x in end.plant] + [jnp.isfinite(end.pending)]
    return jnp.stack(finite).all(), kept


def _sample(drive: Drive, steps: int, delay: bool, loop: _Loop, row: _Row) -> tuple[_Loop, Trace]:
    """Measure, observe and control; then advance the plant by one sample time."""
    drive = eqx.tree_at(lambda d: d.plant.motor.R_s, drive, row.heat * drive.plant.motor.R_s)
    plant, control, h = drive.plant, drive.control, drive.sample_time
    motor, state = plant.motor, loop.plant
    winding_current = plant.current(state)
    current = winding_current + plant.iron_current(state)
    # A sensor that samples after the row already follows the next voltage.
    is_later = drive.sensors.later(row.late) > 0
    at_sampling = jnp.where(is_later, loop.pending, loop.acted) if delay else loop.acted
    rate = plant.rate(state, at_sampling - loop.lost, row.load)
    _, slope = jax.jvp(plant.terminal_current, (state,), (rate,))
    measured = drive.sensors.measure(current, slope, row.current_offset, row.noise, row.late)
    dc_link = row.dc_link * drive.sensors.dc_link_gain

    observer, reading = loop.observer, None
    if drive.observer is not None and observer is not None:
        observer, reading = drive.observer.step(observer, pair(loop.acted), pair(measured))

    reference = row.reference
    sensorless, control_state = loop.sensorless, loop.control
    if drive.sensorless is None or sensorless is None or reading is None:
        direction = jnp.where(length(state.rotor) > 0, unit(state.rotor), 1.0)
        rotor_flux = motor.rotor_flux(state.rotor)
        slip = motor.slip((current * jnp.conj(direction)).imag, rotor_flux)
        speed_e = motor.n_p * state.speed + slip
        mode = jnp.asarray(RUNNING)
        control_state, torque, current_limited = control.speed_step(
            control_state, reference, state.speed
        )
        current_reference = control.current_for(
            torque, control_state.weakening, rotor_flux, speed_e, dc_link
        )
    else:
        sensorless, direction, speed_e, changed = drive.sensorless.step(
            sensorless, reading, motor.n_p * reference, measured, h
        )
        mode = sensorless.mode
        # If the frame jumps, transform voltage and current to the new frame.
        current_dq = measured * jnp.conj(direction)
        torque_now = motor.torque_dq(current_dq.real, current_dq.imag)
        running = mode == RUNNING
        voltage = loop.pending * jnp.conj(direction)
        carried = control.continued(control_state, voltage, current_dq, speed_e, running)
        control_state = control_state._replace(
            voltage=jnp.where(changed, carried.voltage, control_state.voltage),
            torque=jnp.where(running & ~changed, control_state.torque, torque_now),
        )
        slip = control.motor.slip(current_dq.imag, reading.psi_f)
        speed = (speed_e - slip) / motor.n_p
        stepped, torque, current_limited = control.speed_step(control_state, reference, speed)
        control_state = control_state._replace(
            torque=jnp.where(running, stepped.torque, control_state.torque)
        )
        current_limited = current_limited & running
        demand = jnp.where(
            running,
            control.current_for(torque, control_state.weakening, reading.psi_f, speed_e, dc_link),
            jax.lax.complex(drive.sensorless.current, jnp.zeros(())),
        )
        transient = jnp.where(changed, current_dq - demand, sensorless.transient)
        sensorless = sensorless._replace(transient=transient)
        current_reference = limit(demand + transient, control.current_limit)
    control_state, voltage_dq, voltage_limited = control.current_step(
        control_state,
        current_reference,
        measured * jnp.conj(direction),
        speed_e,
        dc_link,
        mode == RUNNING,
    )
    # The middle of the voltage's interval is 0.5 samples later, or 1.5 samples with a delay.
    ahead = (1.5 if delay else 0.5) * h * speed_e
    command = voltage_dq * direction * turn(ahead)
    tripped = loop.tripped | ~(length(current) < TRIP * control.current_limit)
    command = jnp.where(tripped, 0.0, command)

    applied = loop.pending if delay else command
    after, mean = _advance_plant(
        drive, state, applied - row.voltage_offset, current, row, steps, dc_link
    )
    trace = Trace(
        current,
        measured,
        applied,
        mean,
        state.flux,
        jnp.arctan2(state.rotor.imag, state.rotor.real),
        state.speed,
        motor.torque(state.flux, winding_current),
        current_reference,
        mode,
        voltage_limited,
        current_limited,
        tripped,
        reference,
        reading,
    )
    return (
        _Loop(
            *(after, control_state, applied, applied - mean, command),
            *(observer, sensorless, tripped),
        ),
        trace,
    )


def _advance_plant(
    drive: Drive,
    state: PlantState,
    voltage: Array,
    current: Array,
    row: _Row,
    steps: int,
    dc_link: Array,
) -> tuple[PlantState, Array]:
    """Return (plant state one sample later, mean true voltage)."""
    inverter, plant, h = drive.inverter, drive.plant, drive.sample_time
    # Duty cycles come from the measured DC link, the voltage from the true DC link.
    duties = inverter.duties(voltage, dc_link)
    if inverter.switching == 0:
        # A leg switches twice per period, around its middle; the current there determines the loss.
        at, by_alpha, by_beta = _current_slopes(
            plant, state, inverter.ideal(duties, row.dc_link), row.load
        )
        middle = inverter.middle_current(
            current, current + h / 2 * at, h / 2 * by_alpha, h / 2 * by_beta, row.dc_link, h
        )
        mean = inverter.averaged(duties, row.dc_link, middle, h)
        return plant.advance(state, mean, row.load, h, steps), mean
    intervals = inverter.switching
    steps_each = max(1, -(-steps // intervals))

    def advance(
        carried: tuple[PlantState, Array], k: Array
    ) -> tuple[tuple[PlantState, Array], None]:
        now, mean = carried
        u = inverter.switched(duties, row.dc_link, plant.terminal_current(now), h, k)
        after = plant.advance(now, u, row.load, h / intervals, steps_each)
        return (after, mean + u / intervals), None

    start = (state, jnp.zeros_like(voltage))
    (after, mean), _ = jax.lax.scan(advance, start, jnp.arange(intervals))
    return after, mean


def _current_slopes(
    plant: Plant, state: PlantState, voltage: Array, load: Array
) -> tuple[Array, Array, Array]:
    """Return the derivative of the terminal current by time at a voltage [A/s], and how much one
    more volt along α or β adds to it."""

    def slope(u: Array) -> Array:
        _, rate = jax.jvp(plant.terminal_current, (state,), (plant.rate(state, u, load),))
        return jnp.asarray(rate)

    at, add = jax.linearize(slope, voltage)
    return at, add(jnp.ones_like(voltage)), add(1j * jnp.ones_like(voltage))


def _create_run(trace: Trace, h: float) -> Run:
    """Check a trace and list its events."""
    trace = jax.tree.map(np.asarray, trace)
    t = np.asarray(np.arange(len(trace.theta_e)) * h, np.float64)
    finite = np.isfinite(trace.current) & np.isfinite(trace.speed) & np.isfinite(trace.voltage)
    if not finite.all():
        last = max(int(np.argmin(finite)) - 1, 0)
        raise ModelError(
            f"the state is not finite after t = {t[last]:.6g} s, at "
            f"{trace.speed[last]:.4g} rad/s; check that the gains are stable and that the time "
            f"constants are not far below the sample time"
        )
    events = []
    for what, mask in (
        ("voltage limit met", trace.voltage_limited),
        ("current limit met", trace.current_limited),
        ("overcurrent trip", trace.tripped),
    ):
        if mask.any():
            events.append(Event(what, float(t[np.argmax(mask)]), float(mask.mean())))
    change = np.diff(trace.mode)
    for what, jumps in (("observer in the loop", change > 0), ("position lost", change < 0)):
        events += [Event(what, float(t[k + 1])) for k in np.flatnonzero(jumps)]
    events += _find_failures(t, trace)
    return Run(h, t, trace, tuple(sorted(events, key=lambda event: event.at)))


def _find_failures(t: NDArray[np.float64], trace: Trace) -> list[Event]:
    """Return events if the observer is never in the loop or the final speed is wrong."""
    events = []
    if not (trace.mode == RUNNING).any():
        events.append(Event("observer never in the loop", float(t[0]), 1.0))
    largest = np.abs(trace.reference).max()
    followed = ~(np.abs(trace.speed - trace.reference) > UNFOLLOWED * largest)
    start = np.flatnonzero(followed)[-1] + 1 if followed.any() else 0
    if largest > 0 and len(t) - start > len(t) // 20:
        events.append(
            Event("speed reference not followed", float(t[start]), (len(t) - start) / len(t))
        )
    return events
