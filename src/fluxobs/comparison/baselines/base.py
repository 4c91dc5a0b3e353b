"""Common parts of the baseline observers: protocol, machine model, phase-locked loop, runner."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ...simulation.drive.motor import Motor
from ...simulation.drive.vectors import pair, vector, wrap
from ...simulation.precision import real


class Guess(NamedTuple):
    """Estimate of one sample, named as in :class:`fluxobs.Estimate`: position [rad], speed [rad/s],
    flux linkage [Wb], and the position of the phase-locked loop [rad].

    Subclasses give the flux as a complex number; `step` returns it as (2,). These observers do not
    detect when they are lost: `valid` is always true.
    """

    theta_e: Array
    speed_e: Array
    flux: Array
    theta_e_tracked: Array
    valid: Any = True


class BaselineState(NamedTuple):
    """Last current, whether there has been one, and the observer's own state."""

    current: Array
    started: Array
    own: Any


class Baseline(eqx.Module):
    """One published observer.

    Subclasses implement `start` and `advance`. Voltage integrals are exact: the voltage is the mean
    over the interval that ends now. The resistive drop uses the mean of the two currents. Both are
    better than the usual forward Euler.

    Parameters
    ----------
    motor : Motor
        Machine parameters as the observer believes them.
    sample_time : float
        Sample time [s].
    """

    motor: Motor
    sample_time: Array

    def start(self) -> Any:
        """Initial own state: rotor at θ_e = 0, at rest."""
        raise NotImplementedError

    def advance(
        self, own: Any, voltage: Array, volt_seconds: Array, current: Array, before: Array
    ) -> tuple[Any, Guess]:
        """One sample, complex vectors: `volt_seconds` ∫(u - R i) dt, `before` the last current."""
        raise NotImplementedError

    def init(self) -> BaselineState:
        zero = jnp.zeros(())
        return BaselineState(jax.lax.complex(zero, zero), jnp.zeros((), bool), self.start())

    def step(
        self, state: BaselineState, voltage: Array, current: Array
    ) -> tuple[BaselineState, Guess]:
        """One sample: mean voltage over the interval ending now [V], current now [A], (2,) each."""
        u, i = vector(voltage), vector(current)
        before = jnp.where(state.started, state.current, i)
        u = jnp.where(state.started, u, self.motor.R_s * i)
        volt_seconds = self.sample_time * (u - self.motor.R_s * (i + before) / 2)
        own, guess = self.advance(state.own, u, volt_seconds, i, before)
        guess = guess._replace(flux=pair(guess.flux), valid=jnp.ones((), bool))
        return BaselineState(i, jnp.ones((), bool), own), guess

    def run(self, voltage: Any, current: Any) -> Guess:
        """Runs a record, (rows, 2) each; voltages are means over the interval ending at a row."""
        return run(self, jnp.asarray(voltage, float), jnp.asarray(current, float))

    # ---- shared by several ---------------------------------------------------------------

    def active(self, flux: Array, current: Array) -> Array:
        """Active flux ``x = λ - L_q i``, along the rotor's d axis."""
        return flux - self.motor.L_q * current

    def length(self, current: Array, direction: Array) -> Array:
        """Its length ``ψ + (L_d - L_q) i_d``, d along `direction`; kept above 0.1 % of `size`."""
        i_d = (current * jnp.conj(direction)).real
        length = self.motor.psi_f + (self.motor.L_d - self.motor.L_q) * i_d
        return jnp.maximum(length, 1e-3 * self.size())

    def size(self) -> Array:
        """Typical flux of the machine, also without magnets [Wb]."""
        return self.motor.psi_f + jnp.where(self.motor.psi_f > 0, 0.0, self.motor.L_d)


class PllState(NamedTuple):
    theta: Array
    speed: Array


def pll_gains(bandwidth: Array, h: Array) -> tuple[Array, Array]:
    """Gains from angle error to angle and speed, for a double pole at `bandwidth`."""
    pole = jnp.exp(-bandwidth * h)
    return 1 - pole**2, (1 - pole) ** 2 / h


def pll(state: PllState, theta: Array, bandwidth: Array, h: Array) -> PllState:
    """Phase-locked loop on an angle, with a double pole at `bandwidth`.

    L. Harnefors, H.-P. Nee, "A general algorithm for speed and position estimation of AC motors",
    IEEE Trans. Industrial Electronics 47 (2000), doi:10.1109/41.824128.
    """
    gain_theta, gain_speed = pll_gains(bandwidth, h)
    ahead = state.theta + h * state.speed
    error = wrap(theta - ahead)
    return PllState(wrap(ahead + gain_theta * error), state.speed + gain_speed * error)


def pll_start() -> PllState:
    return PllState(jnp.zeros(()), jnp.zeros(()))


def angle(z: Array) -> Array:
    return jnp.arctan2(z.imag, z.real)


def leaf(value: Any) -> Array:
    """A gain as an array leaf of the pytree."""
    return real("gain", value)


@eqx.filter_jit
def run(observer: Any, voltage: Array, current: Array) -> Guess:
    """Runs a record through any observer that steps in JAX; see :meth:`Baseline.run`."""

    def body(state: Any, row: tuple[Array, Array]) -> tuple[Any, Guess]:
        after, guess = observer.step(state, *row)
        return after, guess

    found: Guess = jax.lax.scan(body, observer.init(), (voltage, current))[1]
    return found
