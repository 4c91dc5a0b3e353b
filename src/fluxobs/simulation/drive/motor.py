"""The plant: a machine (with magnets, saliency, a flux map or a cage) and its mechanics.

In stator coordinates, ``λ̇ = u - R i`` and the torque is ``1.5 n_p Im(λ* i)``. The current is a
function of the flux and the rotor's vector, ``motor.current(flux, rotor)``. The rotor's vector is
the direction exp(jθ_e) or, for a cage, the rotor flux. Integrating flux and rotor's vector needs no
sine. The voltage needs no rotation, because the inverter holds it in stator coordinates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...errors import ModelError
from ...machines import RotatingMachine, rotating
from ...machines.model.flux_map import CageMap, TableMap
from ..precision import not_negative, positive, real
from ..runge_kutta import runge_kutta_step
from .flux_map import Map
from .vectors import length, turn

#: Largest number of integration steps per sample that are unrolled; more steps run in a loop.
UNROLLED = 4
#: Smallest rotor flux in the slip's equation, as a share of the rated rotor flux.
LEAST_FLUX = 0.1
#: Gauss nodes of the energy integral of a flux map.
ENERGY_NODES = 16


class Motor(eqx.Module):
    """A motor with constant inductances and the parameters R_s [Ω], L_d, L_q [H], psi_f [Wb], n_p.

    ``i = e(θ)((λ_d - ψ)/L_d + j λ_q/L_q)``; the rotor's vector is its direction exp(jθ_e). In rotor
    coordinates the magnet flux is ``ψ (1 + k_5 exp(-6jθ_e) + k_7 exp(6jθ_e))``.

    Parameters
    ----------
    fifth, seventh : float
        Harmonics k_5 and k_7 of the magnet flux, as shares of psi_f. The torque neglects their
        change with the angle.
    iron_loss : float
        Conductance of the iron loss [S]: the terminals carry the current jωλ times this value
        besides the current of the windings.
    """

    R_s: Array
    L_d: Array
    L_q: Array
    psi_f: Array
    n_p: Array
    fifth: Array
    seventh: Array
    iron_loss: Array

    def __init__(
        self,
        R_s: Any,
        L_d: Any,
        L_q: Any,
        psi_f: Any,
        n_p: Any,
        fifth: Any = 0.0,
        seventh: Any = 0.0,
        iron_loss: Any = 0.0,
    ) -> None:
        self.R_s, self.L_d = positive("R_s", R_s), positive("L_d", L_d)
        self.L_q, self.psi_f = positive("L_q", L_q), not_negative("psi_f", psi_f)
        if isinstance(n_p, int | float) and (n_p < 1 or n_p != int(n_p)):
            raise ModelError(f"n_p must be a whole number of pole pairs, got {n_p}")
        self.n_p = real("n_p", n_p, ())
        self.fifth, self.seventh = real("fifth", fifth, ()), real("seventh", seventh, ())
        self.iron_loss = not_negative("iron_loss", iron_loss)

    @staticmethod
    def of(machine: RotatingMachine) -> Motor:
        """Create the motor of a machine; a machine with magnets needs psi_f."""
        machine = rotating(machine, "the simulation of drives")
        psi = machine.magnet_flux
        if psi is None:
            name = machine.flux_name
            raise ModelError(f"{name} is missing in the {machine.kind}: simulation needs it")
        flux_map = machine.map_for(1.0, psi)
        if isinstance(flux_map, CageMap):
            return CageMotor(
                machine.R_s, flux_map.R_R, flux_map.L_sigma, flux_map.L_M, psi, machine.n_p
            )
        if isinstance(flux_map, TableMap):
            return MappedMotor(machine.R_s, *machine.L_dq, psi, machine.n_p, flux_map)
        return Motor(machine.R_s, *machine.L_dq, psi, machine.n_p)

    def rates(self) -> list[float]:
        """Return the inverse time constants of the currents [1/s]."""
        return [float(self.R_s) / min(float(self.L_d), float(self.L_q))]

    def rotor(self, direction: Array) -> Array:
        """Return the rotor's vector without current for a rotor in the direction `direction`."""
        return direction

    def rotor_rate(self, rotor: Array, current: Array, speed_e: Array) -> Array:
        """Return the time derivative of the rotor's vector at a current [A] and speed [rad/s]."""
        return jax.lax.complex(jnp.zeros(()), speed_e) * rotor

    def settled(self, rotor: Array) -> Array:
        """Correct the length of the rotor's vector after integration."""
        return rotor / length(rotor)

    def rotor_flux(self, rotor: Array) -> Array:
        """Return the flux without stator current [Wb]."""
        return self.psi_f

    def slip(self, i_q: Array, rotor_flux: Array) -> Array:
        """Return the electrical speed of the rotor's vector relative to the rotor [rad/s]."""
        return jnp.zeros(())

    def harmonics(self, rotor: Array) -> Array:
        """Return the harmonics of the magnet flux in rotor coordinates [Wb]."""
        sixth = rotor * rotor * rotor
        sixth = sixth * sixth
        return self.psi_f * (self.fifth * jnp.conj(sixth) + self.seventh * sixth)

    def flux(self, current: Array, rotor: Array) -> Array:
        """Return the flux linkage at a current."""
        return rotor * (self.flux_dq(current * jnp.conj(rotor)) + self.harmonics(rotor))

    def flux_dq(self, current: Array) -> Array:
        """Return the flux linkage at a current, both in rotor coordinates."""
        return jax.lax.complex(self.L_d * current.real + self.psi_f, self.L_q * current.imag)

    def current(self, flux: Array, rotor: Array) -> Array:
        """Return the current at a flux linkage."""
        x = flux * jnp.conj(rotor) - self.harmonics(rotor)
        return rotor * jax.lax.complex((x.real - self.psi_f) / self.L_d, x.imag / self.L_q)

    def torque(self, flux: Array, current: Array) -> Array:
        """Return the torque [N m]."""
        return 1.5 * self.n_p * (jnp.conj(flux) * current).imag

    def torque_dq(self, i_d: Array, i_q: Array) -> Array:
        """Return the torque of currents in rotor coordinates [N m]."""
        i = jax.lax.complex(i_d, i_q)
        return self.torque(self.flux_dq(i), i)

    def field_energy(self, current: Array, rotor: Array) -> Array:
        """Return the magnetic energy of the currents [J]."""
        i = current * jnp.conj(rotor)
        return 0.75 * (self.L_d * i.real**2 + self.L_q * i.imag**2)


class MappedMotor(Motor):
    """A motor with a flux map; controllers without a map use L_d, L_q and psi_f."""

    map: Map

    def __init__(
        self, R_s: Any, L_d: Any, L_q: Any, psi_f: Any, n_p: Any, flux_map: TableMap
    ) -> None:
        super().__init__(R_s, L_d, L_q, psi_f, n_p)
        self.map = Map.of(flux_map)

    def rates(self) -> list[float]:
        i = self.map.least + (self.map.most - self.map.least) * jnp.linspace(0, 1, 25)[:, None]
        d, q = (axis.ravel() for axis in jnp.meshgrid(i[:, 0], i[:, 1]))
        _, by_d, by_q = jax.vmap(self.map.at)(jax.lax.complex(d, q))
        smallest = min(float(by_d.real.min()), float(by_q.imag.min()))
        if not smallest > 0:
            raise ModelError(
                f"the flux map's smallest inductance in its range is {smallest:.3g} H, not positive"
            )
        return [float(self.R_s) / smallest]

    def flux_dq(self, current: Array) -> Array:
        return self.map.at(current)[0]

    def current(self, flux: Array, rotor: Array) -> Array:
        x = flux * jnp.conj(rotor) - self.harmonics(rotor)
        return rotor * self.map.current(x, self.L_d, self.L_q)

    def field_energy(self, current: Array, rotor: Array) -> Array:
        """Return the magnetic energy of the currents [J], ∫ i dλ on a straight path from i = 0."""
        i = current * jnp.conj(rotor)
        nodes, weights = np.polynomial.legendre.leggauss(ENERGY_NODES)
        total = jnp.zeros(())
        for x, w in zip((nodes + 1) / 2, weights / 2, strict=True):
            _, by_d, by_q = self.map.at(x * i)
            total += w * x * (jnp.conj(i) * (by_d * i.real + by_q * i.imag)).real
        return 1.5 * total


class CageMotor(Motor):
    """A cage induction machine in inverse-Γ form: ``λ = L_σ i + ψ``, ``ψ̇ = R_R (i - i_M) + jω ψ``.

    The rotor's vector is the rotor flux ψ [Wb]; psi_f is its rated value. With main flux
    saturation, ``i_M = ψ/L_M · (1 + s |ψ/ψ_R|⁴)/(1 + s)`` is the magnetizing current; L_M is its
    inductance at rated flux.

    Parameters
    ----------
    R_s, R_R : float
        Resistance of stator and rotor [Ω].
    L_sigma, L_M : float
        Leakage and magnetizing inductance [H].
    psi_R : float
        Rated rotor flux [Wb].
    n_p : int
    saturation : float
        s >= 0.
    """

    R_R: Array
    L_M: Array
    saturation: Array

    def __init__(
        self,
        R_s: Any,
        R_R: Any,
        L_sigma: Any,
        L_M: Any,
        psi_R: Any,
        n_p: Any,
        saturation: Any = 0.0,
    ) -> None:
        super().__init__(R_s, L_sigma, L_sigma, psi_R, n_p)
        self.R_R, self.L_M = positive("R_R", R_R), positive("L_M", L_M)
        self.saturation = not_negative("saturation", saturation)

    def rates(self) -> list[float]:
        return [(float(self.R_s) + float(self.R_R)) / float(self.L_d)]

    def rotor(self, direction: Array) -> Array:
        return 0 * direction

    def magnetizing(self, psi: Array) -> Array:
        """Return the inverse magnetizing inductance i_M/ψ [1/H] at a length of the rotor flux."""
        s = self.saturation
        return (1 + s * (psi / self.psi_f) ** 4) / ((1 + s) * self.L_M)

    def rotor_rate(self, rotor: Array, current: Array, speed_e: Array) -> Array:
        decay = self.R_R * self.magnetizing(length(rotor))
        return self.R_R * current + jax.lax.complex(-decay, speed_e) * rotor

    def settled(self, rotor: Array) -> Array:
        return rotor

    def rotor_flux(self, rotor: Array) -> Array:
        return length(rotor)

    def slip(self, i_q: Array, rotor_flux: Array) -> Array:
        return self.R_R * i_q / jnp.maximum(rotor_flux, LEAST_FLUX * self.psi_f)

    def flux(self, current: Array, rotor: Array) -> Array:
        return self.L_d * current + rotor

    def current(self, flux: Array, rotor: Array) -> Array:
        return (flux - rotor) / self.L_d

    def field_energy(self, current: Array, rotor: Array) -> Array:
        """Return the magnetic energy [J], including the energy of the main flux."""
        psi, s = length(rotor), self.saturation
        main = (1 + s / 3 * (psi / self.psi_f) ** 4) / ((1 + s) * self.L_M) * psi**2
        return 0.75 * (self.L_d * length(current) ** 2 + main)


class Mechanics(eqx.Module):
    """Rotor, load machine, and the coupling between rotor and load machine.

    Parameters
    ----------
    J : float
        Inertia of the rotor [kg m²], > 0; it includes the load if `stiffness` is None.
    viscous : float
        Viscous friction [N m s].
    coulomb : float
        Dry friction [N m], smoothed near standstill over `smoothing` [rad/s].
    fan : float
        Load torque divided by the square of the speed [N m s²].
    J_load, stiffness, damping : float, optional
        Inertia behind an elastic coupling, and the coupling's stiffness and damping [kg m², N m, N
        m s]. The load acts on this inertia.
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
        """Return the torque of friction and fan at a speed [N m]."""
        dry = self.coulomb * jnp.tanh(speed / self.smoothing)
        return self.viscous * speed + dry + self.fan * speed * jnp.abs(speed)


class PlantState(NamedTuple):
    """State of motor and mechanics."""

    flux: Array  # Flux linkage [Wb].
    rotor: Array  # Rotor's vector: direction exp(jθ_e), or rotor flux of a cage [Wb].
    speed: Array  # Mechanical speed [rad/s].
    load_speed: Array  # Speed behind an elastic coupling [rad/s].
    twist: Array  # Twist of the coupling [rad].


class Plant(eqx.Module):
    """Motor and mechanics as one differential equation."""

    motor: Motor
    mechanics: Mechanics

    def standstill(self, theta_e: Any = 0.0, speed: Any = 0.0) -> PlantState:
        """Return the state without current, at an angle [rad] and a speed [rad/s]."""
        rotor = self.motor.rotor(turn(real("theta_e", theta_e)))
        speed = real("speed", speed)
        return PlantState(self.motor.flux(0 * rotor, rotor), rotor, speed, speed, jnp.zeros(()))

    def current(self, state: PlantState) -> Array:
        """Return the current of the windings."""
        return self.motor.current(state.flux, state.rotor)

    def iron_current(self, state: PlantState) -> Array:
        """Return the current of the iron loss."""
        speed_e = self.motor.n_p * state.speed
        return jax.lax.complex(jnp.zeros(()), self.motor.iron_loss * speed_e) * state.flux

    def terminal_current(self, state: PlantState) -> Array:
        """Return the current of the terminals: that of the windings and of the iron loss."""
        return self.current(state) + self.iron_current(state)

    def rate(self, state: PlantState, voltage: Array, load: Array) -> PlantState:
        """Return the time derivative under a voltage [V] and a load torque [N m]."""
        motor, m = self.motor, self.mechanics
        i = self.current(state)
        torque = motor.torque(state.flux, i)
        if m.elastic:
            shaft = m.stiffness * state.twist + m.damping * (state.speed - state.load_speed)
            acceleration = (torque - shaft) / m.J
            load_rate = (shaft - load - m.resisting(state.load_speed)) / m.J_load
            twist_rate = state.speed - state.load_speed
        else:
            acceleration = (torque - load - m.resisting(state.speed)) / m.J
            load_rate, twist_rate = acceleration, jnp.zeros(())
        return PlantState(
            voltage - motor.R_s * (i + self.iron_current(state)),
            motor.rotor_rate(state.rotor, i, motor.n_p * state.speed),
            acceleration,
            load_rate,
            twist_rate,
        )

    def advance(
        self, state: PlantState, voltage: Array, load: Array, duration: Array, steps: int
    ) -> PlantState:
        """Integrate by fourth-order Runge-Kutta in equal steps, with held voltage and load."""
        h = duration / steps

        def step(_: Any, state: PlantState) -> PlantState:
            return runge_kutta_step(lambda state, _: self.rate(state, voltage, load), state, h)

        # A loop needs more run time; many unrolled steps need minutes of compilation.
        if steps <= UNROLLED:
            for k in range(steps):
                state = step(k, state)
        else:
            state = jax.lax.fori_loop(0, steps, step, state)
        return state._replace(rotor=self.motor.settled(state.rotor))
