"""Block (six-step) commutation: two phases conduct, the third floats.

A phase that is switched off carries its current through a diode to a rail until the current is
zero; then it floats, and its terminal has the voltage that keeps its current at zero. Speed and
current are prescribed, so that the log tells how the observer works, not how the speed controller
does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from ...errors import ModelError
from ...logs.record import Record
from ...machines import RotatingMachine
from .motor import Motor
from .profile import Profile
from .sensors import Sensors
from .simulate import count_rows
from .vectors import from_phases, pair, phases, turn, wrap

#: Harmonics of the magnet flux of a trapezoidal EMF that is flat for 120°: the n-th harmonic of the
#: EMF is 2 sin(n π/6) / n² of the fundamental, that of the flux another n-th of it.
TRAPEZOIDAL = {"fifth": 1 / 125, "seventh": -1 / 343}
#: Integration steps per sample.
STEPS = 16
#: What a log contains for the voltage of the floating phase.
FLOATING = ("measured", "zero", "mean")

#: In the k-th sixth of a turn, current flows into the first phase and out of the second.
CONDUCTING = jnp.array([(2, 1), (0, 1), (0, 2), (1, 2), (1, 0), (2, 0)])


class _State(NamedTuple):
    flux: Array
    theta: Array
    integral: Array


@dataclass(frozen=True, eq=False)
class BlockRun:
    """A simulated block-commutated drive.

    Attributes
    ----------
    sample_time : float
        [s].
    theta_e : (rows,) ndarray
        [rad].
    current : (rows, 3) ndarray
        Measured phase currents [A].
    voltage : (rows, 3) ndarray
        Mean terminal voltages over the interval that follows, against the negative rail [V].
    floating : (rows,) ndarray of int
        The phase that is switched off in this interval: 0, 1 or 2.
    """

    sample_time: float
    theta_e: NDArray[np.float64]
    current: NDArray[np.float64]
    voltage: NDArray[np.float64]
    floating: NDArray[np.int64]

    def record(self, floating: str = "zero") -> Record:
        """Return the record of a log.

        Parameters
        ----------
        floating : {"zero", "mean", "measured"}
            Voltage of the floating phase in the log: 0, the mean of the other two, or the measured
            terminal voltage.
        """
        if floating not in FLOATING:
            raise ModelError(f"floating must be one of {', '.join(FLOATING)}, got {floating!r}")
        voltage, rows = self.voltage.copy(), np.arange(len(self.voltage))
        if floating == "zero":
            voltage[rows, self.floating] = 0.0
        elif floating == "mean":
            others = voltage.sum(axis=1) - voltage[rows, self.floating]
            voltage[rows, self.floating] = others / 2
        u, i = (np.asarray(pair(from_phases(jnp.asarray(x)))) for x in (voltage, self.current))
        return Record(self.sample_time, u, i, lag=0.0, theta_e=self.theta_e)


def simulate_block(
    machine: RotatingMachine,
    sample_time: float,
    duration: float,
    speed: Any,
    current: Any,
    dc_link: Any,
    advance: float = 0.0,
    theta_e: float = 0.0,
    noise: float = 0.0,
    trapezoidal: bool = False,
    seed: int = 0,
) -> BlockRun:
    """Simulate a drive with block commutation.

    Parameters
    ----------
    machine : RotatingMachine
        Machine with magnets and one inductance.
    sample_time, duration : float
        [s].
    speed : Profile or number
        Electrical speed [rad/s].
    current : Profile or number
        Current of the two conducting phases [A]; negative: braking.
    dc_link : Profile or number
        [V].
    advance : float
        Angle by which the commutation is early [rad].
    theta_e : float
        Initial angle of the rotor [rad].
    noise : float
        Standard deviation of the measured current in αβ [A].
    trapezoidal : bool
        Trapezoidal instead of sinusoidal EMF; see :data:`TRAPEZOIDAL`.
    seed : int
        Seed of the noise.
    """
    L_d, L_q = machine.L_dq
    if L_d != L_q or not machine.magnet_flux:
        raise ModelError(
            f"block commutation is simulated for machines with magnets and one inductance, "
            f"not for {machine.kind}"
        )
    harmonics = TRAPEZOIDAL if trapezoidal else {}
    motor = Motor(machine.R_s, L_d, L_q, machine.magnet_flux, machine.n_p, **harmonics)
    rows = count_rows(sample_time, duration)
    t = jnp.arange(rows) * sample_time
    inputs = tuple(Profile.of(x).at(t) for x in (speed, current, dc_link))
    drawn = jnp.asarray(np.random.default_rng(seed).standard_normal((rows, 3)))
    start = _State(
        motor.flux(jnp.zeros((), complex), turn(jnp.asarray(theta_e))),
        jnp.asarray(theta_e),
        jnp.zeros(()),
    )
    _, out = _scan(motor, Sensors(noise=noise), start, (*inputs, drawn), sample_time, advance)
    angle, measured, voltage, off = (np.asarray(x) for x in out)
    return BlockRun(sample_time, angle, measured, voltage, off.astype(np.int64))


@jax.jit
def _scan(
    motor: Motor, sensors: Sensors, start: _State, rows: Any, h: Array, advance: Array
) -> tuple[_State, Any]:
    def body(state: _State, row: Any) -> tuple[_State, Any]:
        return _sample(motor, sensors, state, row, h, advance)

    return jax.lax.scan(body, start, rows)


def _sample(
    motor: Motor, sensors: Sensors, state: _State, row: Any, h: Array, advance: Array
) -> tuple[_State, Any]:
    speed, reference, dc_link, noise = row
    current = motor.current(state.flux, turn(state.theta))
    # The currents of a positive reference are a quarter turn ahead of the magnets, ± a twelfth.
    ahead = state.theta + advance + jnp.where(speed < 0, jnp.pi, 0.0) + jnp.pi / 2
    forward = reference * jnp.where(speed < 0, -1.0, 1.0) >= 0
    sector = jnp.floor((ahead + jnp.where(forward, 0, jnp.pi)) / (jnp.pi / 3) + 2.0).astype(int) % 6
    high, low = CONDUCTING[sector]
    off = 3 - high - low
    flows = phases(current)
    bandwidth = 0.1 / h
    error = jnp.abs(reference) - (flows[high] - flows[low]) / 2
    emf = phases(1j * speed * (state.flux - motor.L_d * current))
    wanted = 2 * bandwidth * motor.L_d * error + state.integral + emf[high] - emf[low]
    duty = jnp.clip(wanted / dc_link, -1.0, 1.0)
    integral = state.integral + 2 * bandwidth * motor.R_s * error * h
    # One leg is at the negative rail, the other switches.
    driven = jnp.zeros(3)
    driven = driven.at[high].set(jnp.maximum(duty, 0.0) * dc_link)
    driven = driven.at[low].set(jnp.maximum(-duty, 0.0) * dc_link)
    axis = turn(2 * jnp.pi / 3 * off)
    small = h / STEPS

    def step(_: Any, carried: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        flux, theta, total = carried
        before = motor.current(flux, turn(theta))
        i_off = phases(before)[off]
        rail = jnp.where(i_off > 0, 0.0, dc_link)
        legs = from_phases(driven.at[off].set(rail))
        theta = theta + small * speed
        rotor = turn(theta)
        after = flux + small * (legs - motor.R_s * before)
        i_after = phases(motor.current(after, rotor))[off]
        # A diode carries no current backwards: then the phase floats.
        floats = i_off * i_after <= 0
        after = jnp.where(floats, after - motor.L_d * i_after * axis, after)
        mean = (before + motor.current(after, rotor)) / 2
        return after, theta, total + (after - flux + small * motor.R_s * mean)

    flux, theta, total = jax.lax.fori_loop(
        0, STEPS, step, (state.flux, state.theta, jnp.zeros_like(state.flux))
    )
    vector = total / h
    # Terminal voltages against the negative rail: that of the low leg is known.
    by_phase = phases(vector)
    terminals = by_phase - by_phase[low] + driven[low]
    zero = jnp.zeros(())
    offset = sensors.offset.at(zero)
    measured = sensors.measure(
        current, zero, jax.lax.complex(*offset), jax.lax.complex(noise[0], noise[1]), noise[2]
    )
    out = (
        wrap(state.theta),
        phases(measured),
        terminals,
        off,
    )
    return _State(flux, theta, integral), out
