"""Speed and current control in rotor coordinates (FOC)."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ...errors import ModelError
from ..precision import not_negative, positive, real
from .motor import LEAST_FLUX, CageMotor, Motor
from .vectors import ROOT3, length, limit

#: Bandwidth of a cage's rotor flux [rad/s], 1.6 times its open-loop value. Largest share of the
#: voltage for the EMF; leakage and load steps need the rest. Largest share of the current limit for
#: i_d.
FLUX_BANDWIDTH, FLUX_VOLTAGE, FLUX_CURRENT = 15.0, 0.8, 0.8


class ControlState(NamedTuple):
    """Integrators of speed [N m] and current control [V, dq]; field-weakening current [A]."""

    torque: Array
    voltage: Array
    weakening: Array


class Control(eqx.Module):
    """PI speed control, maximum torque per ampere, PI current control with anti-windup.

    The current controller uses internal model control: L. Harnefors and H.-P. Nee, "Model-based
    current control of AC machines using the internal model control method", IEEE Trans. Industry
    Applications 34 (1998), doi:10.1109/28.658735. The current controller has gains α L, an active
    resistance α L - R, and back calculation from the realisable voltage. The speed controller is a
    PI controller with a double pole at α_s and back calculation from the realisable torque.

    :meth:`of` creates a controller with suitable gains.

    Parameters
    ----------
    motor : Motor
        Motor parameters that the controller assumes.
    inertia : float
        Inertia [kg m²].
    sample_time : float
        Sample time [s].
    current_bandwidth, speed_bandwidth : float
        Closed-loop bandwidths [rad/s].
    current_limit : float
        Peak current [A].
    i_d_min : float
        Smallest i_d [A]; it keeps the flux of reluctance machines observable.
    weakening : float
        Gain of the field weakening [A/(V s)]; 0 disables it.
    voltage_use : float
        Usable share of the linear voltage range udc/√3.
    """

    motor: Motor
    inertia: Array
    sample_time: Array
    current_bandwidth: Array
    speed_bandwidth: Array
    current_limit: Array
    i_d_min: Array
    weakening: Array
    voltage_use: Array

    @classmethod
    def of(
        cls,
        motor: Motor,
        inertia: Any,
        sample_time: Any,
        current_limit: Any,
        current_bandwidth: Any = None,
        speed_bandwidth: Any = None,
        i_d_min: Any = None,
        weakening: Any = 0.0,
        voltage_use: Any = 0.98,
    ) -> Self:
        """Create a controller with defaults for omitted parameters.

        The current bandwidth is 1/16 of the sampling frequency in rad/s, at most 2π 200 rad/s. The
        speed bandwidth is a tenth of the current bandwidth, at most 2π 8 rad/s. The smallest i_d of
        a reluctance machine is 0.3 of the current limit.
        """
        h = float(sample_time)
        default_bandwidth = min(2 * np.pi * 200, 2 * np.pi / h / 16)
        current_bandwidth = default_bandwidth if current_bandwidth is None else current_bandwidth
        default_speed_bandwidth = min(2 * np.pi * 8, float(current_bandwidth) / 10)
        if i_d_min is None:
            i_d_min = (0.3 if float(motor.psi_f) == 0 else -1.0) * current_limit
        values = {
            "inertia": inertia,
            "sample_time": sample_time,
            "current_bandwidth": current_bandwidth,
            "speed_bandwidth": default_speed_bandwidth
            if speed_bandwidth is None
            else speed_bandwidth,
            "current_limit": current_limit,
            "i_d_min": i_d_min,
            "weakening": weakening,
            "voltage_use": voltage_use,
        }
        kinds = {"i_d_min": real, "weakening": not_negative}
        checked = {
            name: kinds.get(name, positive)(name, value, ()) for name, value in values.items()
        }
        if not float(checked["voltage_use"]) <= 1:
            raise ModelError(f"voltage_use must be at most 1, got {voltage_use}")
        return cls(motor, **checked)

    def init(self) -> ControlState:
        zero = jnp.zeros(())
        return ControlState(zero, jax.lax.complex(zero, zero), zero)

    def most_torque(self) -> Array:
        """Return the torque at the current limit, without field weakening [N m]."""
        i_d = self._best_i_d(self.current_limit)
        i_d = jnp.maximum(i_d, self.i_d_min)
        return self.motor.torque_dq(i_d, jnp.sqrt(self.current_limit**2 - i_d**2))

    def _best_i_d(self, size: Array) -> Array:
        """Return the i_d that gives the largest torque at a current of this magnitude."""
        k, psi = self.motor.L_d - self.motor.L_q, self.motor.psi_f
        root = jnp.sqrt(psi**2 + 8 * (k * size) ** 2)
        return 2 * k * size**2 / jnp.maximum(psi + root, 1e-300)

    def current_for(
        self,
        torque: Array,
        weakening: Array,
        rotor_flux: Array,
        speed_e: Array,
        dc_link: Array,
    ) -> Array:
        """Return the current reference for a torque, with field weakening.

        Only cage machines use rotor flux [Wb], electrical speed [rad/s] and DC link [V].
        """
        k, psi = self.motor.L_d - self.motor.L_q, self.motor.psi_f
        largest = self.current_limit
        # This i_q is exact for surface and reluctance machines, a first guess for interior magnets.
        active_flux_i_q = torque / (1.5 * self.motor.n_p)
        root = jnp.sqrt(psi**2 + 4 * jnp.abs(k * active_flux_i_q))
        i_q = 2 * active_flux_i_q / jnp.maximum(psi + root, 1e-300)
        i_d = jnp.zeros(())
        for _ in range(4):
            # At the optimum i_q² = i_d² + (ψ/k) i_d: solve this quadratic for i_d.
            root = jnp.sqrt(psi**2 + 4 * (k * i_q) ** 2)
            i_d = 2 * k * i_q**2 / jnp.maximum(psi + root, 1e-300)
            i_d = jnp.maximum(i_d, self.i_d_min)
            active = psi + k * i_d
            i_q = (i_q + active_flux_i_q / jnp.where(active > 0, active, 1.0)) / 2
        # Zero flux gives no torque, so weakening ends at zero flux.
        floor = jnp.where(psi > 0, -psi / self.motor.L_d, self.i_d_min)
        i_d = jnp.clip(jnp.maximum(i_d - weakening, floor), -largest, largest)
        i_q = active_flux_i_q / jnp.maximum(psi + k * i_d, 1e-300)
        reach = jnp.sqrt(jnp.maximum(largest**2 - i_d**2, 0.0))
        return jax.lax.complex(i_d, jnp.clip(i_q, -reach, reach))

    def speed_step(
        self, state: ControlState, reference: Array, speed: Array
    ) -> tuple[ControlState, Array, Array]:
        """Return (state, torque for a speed error [N m], whether the current limit is reached)."""
        a, J, h = self.speed_bandwidth, self.inertia, self.sample_time
        error = reference - speed
        wanted = 2 * a * J * error + state.torque
        largest = self.most_torque()
        torque = jnp.clip(wanted, -largest, largest)
        # Back calculation: the integrator gets the error whose torque just reaches the limit.
        realised = error + (torque - wanted) / (2 * a * J)
        return (
            state._replace(torque=state.torque + h * a * a * J * realised),
            torque,
            jnp.abs(wanted) > largest,
        )

    def current_step(
        self,
        state: ControlState,
        reference: Array,
        current: Array,
        speed_e: Array,
        dc_link: Array,
        aligned: Array | bool = True,
    ) -> tuple[ControlState, Array, Array]:
        """Return (state, realisable dq voltage for a current error, whether its limit is reached).

        If the frame is not `aligned` with the rotor, L_d or L_q may act on an axis. Both axes then
        use the gains of the smaller inductance, without feed-forward of the EMF.
        """
        a, h = self.current_bandwidth, self.sample_time
        L_d, L_q = self._inductances(aligned)
        error = reference - current
        proportional = jax.lax.complex(a * L_d * error.real, a * L_q * error.imag)
        wanted = proportional + state.voltage + self._feed_forward(current, speed_e, aligned)
        largest = self.voltage_use * dc_link / ROOT3
        voltage = limit(wanted, largest)
        excess = voltage - wanted
        integrand = jax.lax.complex(
            a * a * L_d * error.real + a * excess.real, a * a * L_q * error.imag + a * excess.imag
        )
        size = length(wanted)
        # Field weakening: reduce flux while the voltage is near its limit, then restore it.
        weakening = state.weakening + h * self.weakening * (size - 0.95 * largest)
        weakening = jnp.clip(weakening, 0.0, 0.8 * self.current_limit)
        return (
            state._replace(voltage=state.voltage + h * integrand, weakening=weakening),
            voltage,
            size > largest,
        )

    def continued(
        self, state: ControlState, voltage: Array, current: Array, speed_e: Array, aligned: Array
    ) -> ControlState:
        """Set the integrator so that the next voltage is `voltage` at zero current error."""
        return state._replace(voltage=voltage - self._feed_forward(current, speed_e, aligned))

    def _inductances(self, aligned: Array | bool) -> tuple[Array, Array]:
        """Return the inductances of both axes; if not aligned, the smaller inductance for both."""
        m = self.motor
        smaller = jnp.minimum(m.L_d, m.L_q)
        return jnp.where(aligned, m.L_d, smaller), jnp.where(aligned, m.L_q, smaller)

    def _feed_forward(self, current: Array, speed_e: Array, aligned: Array | bool) -> Array:
        """Return the cross-coupling voltage minus the voltage of the active resistance a L - R."""
        m, a = self.motor, self.current_bandwidth
        L_d, L_q = self._inductances(aligned)
        speed_e = jnp.where(aligned, speed_e, 0.0)
        flux = m.flux_dq(current)
        return jax.lax.complex(
            -speed_e * flux.imag - (a * L_d - m.R_s) * current.real,
            speed_e * flux.real - (a * L_q - m.R_s) * current.imag,
        )

    def check(self) -> None:
        """Raise ModelError if the current loop with one sample of delay is unstable.

        The check treats each axis alone at standstill, with the controller's motor parameters and
        an exact discretisation.
        """
        h, a = float(self.sample_time), float(self.current_bandwidth)
        for axis, L in (("d", float(self.motor.L_d)), ("q", float(self.motor.L_q))):
            radius = np.abs(np.linalg.eigvals(self.current_loop(L))).max()
            if not radius < 1:
                raise ModelError(
                    f"current_bandwidth = {a:.4g} rad/s is unstable at sample_time = {h:g} s: "
                    f"poles up to {radius:.3g} on the {axis} axis; stay below {0.5 / h:.4g} rad/s"
                )
        speed = float(self.speed_bandwidth)
        if not 0 < speed < a:
            raise ModelError(
                f"speed_bandwidth = {speed:.4g} rad/s must be positive and below "
                f"current_bandwidth = {a:.4g} rad/s; a tenth of current_bandwidth is usual"
            )

    def current_loop(self, L: float) -> np.ndarray:
        """Return the transition matrix (3, 3) of an axis' current, pending voltage and integrator.

        The matrix is exact at standstill for zero reference, one sample of delay and held voltage.
        """
        h, a, R = float(self.sample_time), float(self.current_bandwidth), float(self.motor.R_s)
        decay = np.exp(-R * h / L)
        proportional = -(a * L + a * L - R)
        return np.array([[decay, (1 - decay) / R, 0], [proportional, 0, 1], [-h * a * a * L, 0, 1]])


class CageControl(Control):
    """Rotor-field-oriented control of an induction machine.

    i_d controls the rotor flux with :data:`FLUX_BANDWIDTH`. The flux reference is the rated value,
    or less if the voltage limit requires it. i_q produces the torque with the present flux. The
    principle is that of K. Hasse and F. Blaschke; see D. W. Novotny and T. A. Lipo, *Vector Control
    and Dynamics of AC Drives*, Oxford 1996.
    """

    motor: CageMotor

    def most_torque(self) -> Array:
        m = self.motor
        i_d = m.psi_f / m.L_M
        return 1.5 * m.n_p * m.psi_f * jnp.sqrt(self.current_limit**2 - i_d**2)

    def current_for(
        self,
        torque: Array,
        weakening: Array,
        rotor_flux: Array,
        speed_e: Array,
        dc_link: Array,
    ) -> Array:
        m, largest = self.motor, self.current_limit
        voltage = FLUX_VOLTAGE * self.voltage_use * dc_link / ROOT3
        target = jnp.minimum(m.psi_f, voltage / jnp.maximum(jnp.abs(speed_e), 1e-9))
        psi = jnp.maximum(rotor_flux, LEAST_FLUX * m.psi_f)
        i_d = target * m.magnetizing(target) + FLUX_BANDWIDTH * (target - psi) / m.R_R
        i_d = jnp.clip(i_d, 0.0, FLUX_CURRENT * largest)
        i_q = torque / (1.5 * m.n_p * psi)
        reach = jnp.sqrt(largest**2 - i_d**2)
        return jax.lax.complex(i_d, jnp.clip(i_q, -reach, reach))
