"""PMSM cases that the paper omits: a servo motor and the counter-example of erratum 6."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import Array
from ...machines import SurfacePMSM, example
from ...machines.model.constraint import QuadraticConstraint
from ...simulation.closed_form.sensors import Steps
from ..energies.integrate import volt_seconds
from ..regression import FilteredRegression, Orbit, Regressors, periodic_regression
from ..regression.filtered import PLACES, filter_record, read_out_record


@dataclass(frozen=True, eq=False)
class MotorRecord:
    """Closed-form trajectory of a surface PMSM with biased measurements and sample time h.

    The fields are those of :class:`fluxobs.research.paper.levitation.LevitationRecord`; `rows` is
    the continuous regression at the samples.
    """

    machine: SurfacePMSM
    h: float
    t: Array
    theta_e: Array
    flux: Array
    current: Array
    drift: Array
    current_bias: Array
    volt_seconds: Array
    rows: Regressors

    @property
    def constraint(self) -> QuadraticConstraint:
        return self.machine.constraint


def motor_signals(
    machine: SurfacePMSM,
    angle: Callable[[jax.Array], jax.Array],
    i_q: Callable[[jax.Array], jax.Array],
) -> Callable[[jax.Array], tuple[jax.Array, ...]]:
    """Return closed forms of flux, flux rate, current and electrical angle as functions of time."""
    L, psi = machine.L_s, machine.psi_f or 0.0

    def current_at(time: jax.Array) -> jax.Array:
        return i_q(time) * jnp.array([-jnp.sin(angle(time)), jnp.cos(angle(time))])

    def flux_at(time: jax.Array) -> jax.Array:
        return L * current_at(time) + psi * jnp.array([jnp.cos(angle(time)), jnp.sin(angle(time))])

    def signals(time: jax.Array) -> tuple[jax.Array, ...]:
        flux, rate = jax.jvp(flux_at, (time,), (jnp.ones_like(time),))
        return flux, rate, current_at(time), angle(time)

    return signals


def motor_record(
    machine: SurfacePMSM,
    angle: Callable[[jax.Array], jax.Array],
    i_q: Callable[[jax.Array], jax.Array],
    t: Array,
    corner: float,
    current_bias: Steps,
    voltage_bias: Steps,
) -> MotorRecord:
    """Return the record of a motor from its angle and torque current as functions of time."""
    h = float(t[1] - t[0])
    signals = motor_signals(machine, angle, i_q)
    # Times at the start, middle and end of every interval.
    fine = jnp.asarray(t[:-1, None] + h * PLACES)
    flux, rate, current, theta_e = map(np.asarray, jax.jit(jax.vmap(jax.vmap(signals)))(fine))

    def at_samples(fine: Array) -> Array:
        return np.concatenate([fine[:, 0], fine[-1:, 2]])

    delta = current_bias.at(t - h / 2)
    drift = delta @ machine.R.T - voltage_bias.at(t - h / 2) @ machine.B.T
    measured = at_samples(current) + delta
    regression = FilteredRegression(machine.constraint, corner)
    filters = filter_record(regression, h, rate - drift[1:, None], current + delta[1:, None])
    return MotorRecord(
        machine,
        h,
        t,
        at_samples(theta_e),
        at_samples(flux),
        measured,
        drift,
        delta,
        volt_seconds(at_samples(flux), h, drift),
        read_out_record(regression, filters, measured),
    )


#: Corner of the filters for the servo motor [rad/s].
SERVO_CORNER = 200.0


def servo(quick: bool = False) -> MotorRecord:
    """Return a 400 W servo motor with varying speed and load; the offsets jump at half time."""
    machine = example("servo-400w")
    assert isinstance(machine, SurfacePMSM)
    duration = 2.0 if quick else 4.0
    t = np.array(np.arange(round(duration / 1e-4) + 1) * 1e-4, dtype=np.float64)
    half = np.array([duration / 2])
    return motor_record(
        machine,
        lambda time: 300 * time + 12 * jnp.sin(8 * time),
        lambda time: 5 + 4 * jnp.sin(20 * time),
        t,
        SERVO_CORNER,
        Steps(np.array([[0.15, -0.1], [-0.1, 0.2]]), half),
        Steps(np.array([[0.0, 0.05], [0.1, 0.0]]), half),
    )


class MotorOrbit(NamedTuple):
    """One period of a motor without biases: measurements and flux [Wb]."""

    constraint: QuadraticConstraint
    orbit: Orbit
    flux: Array
    rows: Regressors

    @property
    def h(self) -> float:
        """Sample time [s]."""
        return self.orbit.period / len(self.flux)


def counter_example(samples: int = 256, drift: tuple[float, float] = (0.0, 0.0)) -> MotorOrbit:
    """Erratum 6, per-unit: Ψ is persistently exciting; Proposition 2 is unstable at every gain.

    Parameters: θ_e = t + 0.8 sin t, L = 0.4, i_dq = (0, 0.5), ψ = 1, ν = 1. The record is one
    period (2π) in steady state. The `drift` of a voltage bias is in the measurement; the table of
    the errata has none.
    """
    machine = SurfacePMSM(R_s=0.05, L_s=0.4, n_p=1, psi_f=1.0)
    signals = motor_signals(
        machine, lambda time: time + 0.8 * jnp.sin(time), lambda time: 0.5 + 0 * time
    )
    t = jnp.arange(samples) * (2 * np.pi / samples)
    flux, rate, current, _ = (np.asarray(values) for values in jax.jit(jax.vmap(signals))(t))
    orbit = Orbit(2 * np.pi, rate - np.asarray(drift), current)
    rows = periodic_regression(machine.constraint, 1.0, orbit)
    return MotorOrbit(machine.constraint, orbit, flux, rows)
