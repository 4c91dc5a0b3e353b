"""Base of the baseline observers: interface, machine model, phase-locked loop, runner."""

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
    """Estimate of one sample, with the names of :class:`fluxobs.Estimate`.

    Position [rad], speed [rad/s], flux linkage [Wb], and position of the phase-locked loop [rad].
    Observers compute the flux as a complex number; `step` returns it as (2,). The observers do not
    detect the loss of the position: `valid` is always true.
    """

    theta_e: Array
    speed_e: Array
    flux: Array
    theta_e_tracked: Array
    valid: Any = True


class BaselineState(NamedTuple):
    """Last current, whether a last current exists, and the state of the specific observer."""

    current: Array
    started: Array
    inner: Any


class Baseline(eqx.Module):
    """One published observer.

    Subclasses implement `start` and `advance`. The voltage is the mean over the interval that ends
    at the sample, so its integral is exact. The resistive drop uses the mean of the two currents.
    Both integrals are more accurate than the usual forward Euler.

    Parameters
    ----------
    motor : Motor
        Machine parameters that the observer assumes.
    sample_time : float
        Sample time [s].
    """

    motor: Motor
    sample_time: Array

    def start(self) -> Any:
        """Return the initial state: rotor at θ_e = 0, at standstill."""
        raise NotImplementedError

    def advance(
        self, state: Any, voltage: Array, volt_seconds: Array, current: Array, previous: Array
    ) -> tuple[Any, Guess]:
        """Process one sample; the vectors are complex.

        `volt_seconds` is ∫(u - R i) dt over the interval, `previous` is the last current.
        """
        raise NotImplementedError

    def init(self) -> BaselineState:
        zero = jnp.zeros(())
        return BaselineState(jax.lax.complex(zero, zero), jnp.zeros((), bool), self.start())

    def step(
        self, state: BaselineState, voltage: Array, current: Array
    ) -> tuple[BaselineState, Guess]:
        """Process one sample; shape (2,) each.

        `voltage` [V] is the mean over the interval that ends now, `current` [A] is measured now.
        """
        u, i = vector(voltage), vector(current)
        previous = jnp.where(state.started, state.current, i)
        u = jnp.where(state.started, u, self.motor.R_s * i)
        volt_seconds = self.sample_time * (u - self.motor.R_s * (i + previous) / 2)
        inner, guess = self.advance(state.inner, u, volt_seconds, i, previous)
        guess = guess._replace(flux=pair(guess.flux), valid=jnp.ones((), bool))
        return BaselineState(i, jnp.ones((), bool), inner), guess

    def run(self, voltage: Any, current: Any) -> Guess:
        """Run a record, shape (rows, 2); voltages are means over intervals that end at the rows."""
        return run(self, jnp.asarray(voltage, float), jnp.asarray(current, float))

    # ---- machine model -------------------------------------------------------------------

    def active(self, flux: Array, current: Array) -> Array:
        """Return the active flux ``x = λ - L_q i``, along the rotor's d axis."""
        return flux - self.motor.L_q * current

    def length(self, current: Array, direction: Array) -> Array:
        """Return the length of the active flux, ``ψ + (L_d - L_q) i_d``, at least 0.1 % of `size`.

        `direction` is the direction of the d axis.
        """
        i_d = (current * jnp.conj(direction)).real
        length = self.motor.psi_f + (self.motor.L_d - self.motor.L_q) * i_d
        return jnp.maximum(length, 1e-3 * self.size())

    def size(self) -> Array:
        """Return the typical flux of the machine [Wb]; without magnets, the flux of 1 A in d."""
        return self.motor.psi_f + jnp.where(self.motor.psi_f > 0, 0.0, self.motor.L_d)


class PllState(NamedTuple):
    theta: Array
    speed: Array


def pll_gains(bandwidth: Array, h: Array) -> tuple[Array, Array]:
    """Return the gains from angle error to angle and speed, for a double pole at `bandwidth`."""
    pole = jnp.exp(-bandwidth * h)
    return 1 - pole**2, (1 - pole) ** 2 / h


def pll(state: PllState, theta: Array, bandwidth: Array, h: Array) -> PllState:
    """Advance a phase-locked loop on an angle, with a double pole at `bandwidth`.

    L. Harnefors, H.-P. Nee, "A general algorithm for speed and position estimation of AC motors",
    IEEE Trans. Industrial Electronics 47 (2000), doi:10.1109/41.824128.
    """
    gain_theta, gain_speed = pll_gains(bandwidth, h)
    predicted = state.theta + h * state.speed
    error = wrap(theta - predicted)
    return PllState(wrap(predicted + gain_theta * error), state.speed + gain_speed * error)


def pll_start() -> PllState:
    return PllState(jnp.zeros(()), jnp.zeros(()))


def angle(z: Array) -> Array:
    return jnp.arctan2(z.imag, z.real)


def leaf(value: Any) -> Array:
    """Return a gain as an array leaf of the pytree."""
    return real("gain", value)


@eqx.filter_jit
def run(observer: Any, voltage: Array, current: Array) -> Guess:
    """Run any observer that steps in JAX on a record; see :meth:`Baseline.run`."""

    def body(state: Any, row: tuple[Array, Array]) -> tuple[Any, Guess]:
        next_state, guess = observer.step(state, *row)
        return next_state, guess

    guesses: Guess = jax.lax.scan(body, observer.init(), (voltage, current))[1]
    return guesses
