"""The plant: a magnet or reluctance machine, or both, in stator coordinates, with mechanics.

``λ̇ = u - R i``, ``i = e(θ)((λ_d - ψ)/L_d + j λ_q/L_q)``, torque ``1.5 n_p Im(λ* i)``; constant
inductances. Integrating the flux and the rotor direction needs no sine, and the voltage, which the
inverter holds in stator coordinates, needs no rotation.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...machines import RotatingMachine, rotating
from ..precision import not_negative, positive, real
from .vectors import length, turn

Array = jax.Array

#: Largest number of integration steps per sample to unroll; more run in a loop.
UNROLLED = 4


class Motor(eqx.Module):
    """Electrical parameters: R_s [Ω], L_d, L_q [H], psi_f [Wb], n_p."""

    R_s: Array
    L_d: Array
    L_q: Array
    psi_f: Array
    n_p: Array

    def __init__(self, R_s: Any, L_d: Any, L_q: Any, psi_f: Any, n_p: Any) -> None:
        self.R_s, self.L_d = positive("R_s", R_s), positive("L_d", L_d)
        self.L_q, self.psi_f = positive("L_q", L_q), not_negative("psi_f", psi_f)
        if isinstance(n_p, int | float) and (n_p < 1 or n_p != int(n_p)):
            raise ModelError(f"n_p must be a whole number of pole pairs, got {n_p}")
        self.n_p = real("n_p", n_p, ())

    @classmethod
    def of(cls, machine: RotatingMachine) -> Motor:
        """Motor of a machine; a magnet machine needs its psi_f."""
        machine = rotating(machine, "the simulation of drives")
        if machine.magnet_flux is None:
            raise ModelError(f"psi_f is missing in the {machine.kind}: simulation needs it")
        return cls(machine.R_s, *machine.L_dq, machine.magnet_flux, machine.n_p)

    def flux(self, current: Array, direction: Array) -> Array:
        """Flux linkage at a current; `direction` is exp(jθ_e)."""
        return direction * self.flux_dq(current * jnp.conj(direction))

    def flux_dq(self, current: Array) -> Array:
        """Flux linkage in rotor coordinates."""
        return jax.lax.complex(self.L_d * current.real + self.psi_f, self.L_q * current.imag)

    def current(self, flux: Array, direction: Array) -> Array:
        """Current at a flux linkage."""
        x = flux * jnp.conj(direction)
        return direction * jax.lax.complex((x.real - self.psi_f) / self.L_d, x.imag / self.L_q)

    def torque(self, flux: Array, current: Array) -> Array:
        """Torque [N m]."""
        return 1.5 * self.n_p * (jnp.conj(flux) * current).imag

    def torque_dq(self, i_d: Array, i_q: Array) -> Array:
        """Torque from currents in rotor coordinates [N m]."""
        return 1.5 * self.n_p * (self.psi_f + (self.L_d - self.L_q) * i_d) * i_q

    def field_energy(self, current: Array, direction: Array) -> Array:
        """Magnetic energy stored by the currents [J]."""
        i = current * jnp.conj(direction)
        return 0.75 * (self.L_d * i.real**2 + self.L_q * i.imag**2)


class Mechanics(eqx.Module):
    """Rotor, load machine, and the coupling between them.

    Parameters
    ----------
    J : float
        Inertia of the rotor, including the load if `stiffness` is None [kg m²], > 0.
    viscous : float
        Viscous friction [N m s].
    coulomb : float
        Dry friction [N m], smoothed around standstill over `smoothing` [rad/s].
    fan : float
        Load torque over the square of the speed [N m s²].
    J_load, stiffness, damping : float, optional
        Second inertia behind an elastic coupling [kg m², N m, N m s]; the load acts on it.
    """

    J: Array
    viscous: Array
    coulomb: Array
    fan: Array
    smoothing: Array
    J_load: Array
    stiffness: Array
    damping: Array
    elastic: bool = eqx.field(static=True)

    def __init__(
        self,
        J: Any,
        viscous: Any = 0.0,
        coulomb: Any = 0.0,
        fan: Any = 0.0,
        smoothing: Any = 1.0,
        J_load: Any = None,
        stiffness: Any = None,
        damping: Any = 0.0,
    ) -> None:
        self.J, self.viscous = positive("J", J), not_negative("viscous", viscous)
        self.coulomb, self.fan = not_negative("coulomb", coulomb), not_negative("fan", fan)
        self.smoothing = positive("smoothing", smoothing)
        if (J_load is None) != (stiffness is None):
            raise ModelError("an elastic coupling needs both J_load and stiffness")
        self.elastic = stiffness is not None
        self.J_load = positive("J_load", 1.0 if J_load is None else J_load)
        self.stiffness = positive("stiffness", 1.0 if stiffness is None else stiffness)
        self.damping = not_negative("damping", damping)

    def resisting(self, speed: Array) -> Array:
        """Torque of friction and fan at a speed [N m]."""
        dry = self.coulomb * jnp.tanh(speed / self.smoothing)
        return self.viscous * speed + dry + self.fan * speed * jnp.abs(speed)


class PlantState(NamedTuple):
    """Flux linkage [Wb], rotor direction exp(jθ_e), mechanical speed [rad/s]; with an elastic
    coupling also the load speed [rad/s] and the twist [rad]."""

    flux: Array
    direction: Array
    speed: Array
    load_speed: Array
    twist: Array


class Plant(eqx.Module):
    """Motor and mechanics as one differential equation."""

    motor: Motor
    mechanics: Mechanics

    def standstill(self, theta_e: Any = 0.0, speed: Any = 0.0) -> PlantState:
        """State without current at an angle [rad] and a speed [rad/s]."""
        direction = turn(real("theta_e", theta_e))
        speed = real("speed", speed)
        return PlantState(self.motor.psi_f * direction, direction, speed, speed, jnp.zeros(()))

    def current(self, state: PlantState) -> Array:
        return self.motor.current(state.flux, state.direction)

    def rate(self, state: PlantState, voltage: Array, load: Array) -> PlantState:
        """Time derivative under a voltage [V] and a load torque [N m]."""
        motor, m = self.motor, self.mechanics
        i = self.current(state)
        torque = motor.torque(state.flux, i)
        turning = jax.lax.complex(jnp.zeros(()), motor.n_p * state.speed)
        if m.elastic:
            shaft = m.stiffness * state.twist + m.damping * (state.speed - state.load_speed)
            accelerating = (torque - shaft) / m.J
            load_rate = (shaft - load - m.resisting(state.load_speed)) / m.J_load
            twisting = state.speed - state.load_speed
        else:
            accelerating = (torque - load - m.resisting(state.speed)) / m.J
            load_rate, twisting = accelerating, jnp.zeros(())
        return PlantState(
            voltage - motor.R_s * i,
            turning * state.direction,
            accelerating,
            load_rate,
            twisting,
        )

    def advance(
        self, state: PlantState, voltage: Array, load: Array, duration: Array, steps: int
    ) -> PlantState:
        """Integrates by fourth-order Runge-Kutta in equal steps, with voltage and load held."""
        h = duration / steps

        def step(_: Any, state: PlantState) -> PlantState:
            k1 = self.rate(state, voltage, load)
            k2 = self.rate(_along(state, k1, h / 2), voltage, load)
            k3 = self.rate(_along(state, k2, h / 2), voltage, load)
            k4 = self.rate(_along(state, k3, h), voltage, load)
            rates = zip(k1, k2, k3, k4, strict=True)
            mean = PlantState(*((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in rates))
            return _along(state, mean, h)

        # A loop costs run time; many unrolled steps cost minutes of compilation.
        if steps <= UNROLLED:
            for k in range(steps):
                state = step(k, state)
        else:
            state = jax.lax.fori_loop(0, steps, step, state)
        return state._replace(direction=state.direction / length(state.direction))


def _along(state: PlantState, rate: PlantState, h: Array) -> PlantState:
    return PlantState(*(x + h * r for x, r in zip(state, rate, strict=True)))
