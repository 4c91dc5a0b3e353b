"""Closed loop of IDA-PBC with an observer's flux, position and momentum, under sensor offsets.

In Section V-B, the controller uses the true state. Here the controller gets the true state only at
the start, as from a sensor on a test bench, and later the observer's estimate. The offsets jump
during the run. The plant is simulated between samples with held voltages. The four-pole bearing is
two independent pairs of coils. The electrostatic actuator is such a pair with charge instead of
flux and voltage instead of current.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import Array
from ...machines import MagLev2DOF
from ...observers.immersed import ImmersionState
from ...observers.levitation_tracker import LevitationTracker, TrackerState
from ...simulation.runge_kutta import runge_kutta_step
from ..analysis import balanced_repaired
from ..energies.ida_pbc import IdaPbc
from ..energies.library.electrostatic import EPSILON_0
from ..regression import Parametrisation, Regressors, SampledRegression
from ..regression.laws import RepairedAdaptiveObserver
from .levitation import (
    CURRENT_BIAS,
    MODULATION,
    R_A,
    VOLTAGE_BIAS,
    BiasFlux,
    PositionReference,
    benchmark,
)
from .section_v import levitation_observer

#: Plant steps per sample.
SUBSTEPS = 20
#: Duration of uninterrupted validity after which the estimate is used. Unit of the rig.
TRUST = 1.0
#: Relative standard deviation below which the loop uses an estimate that is not yet valid.
CERTAIN = 0.05
#: Displacement, divided by the gap, above which the body is lost.
LOST = 0.98


@dataclass(frozen=True, eq=False)
class Rig:
    """A pair of opposed electrodes or coils under IDA-PBC, with sensor errors.

    Attributes
    ----------
    name : str
    machine : MagLev2DOF
    law : IdaPbc
    stiffness, damping : float
        Spring [N/m] and friction [N s/m], in addition to the field.
    unit : float
        Duration of one "second" of Section V-B [s]; all times scale with this unit.
    typical : float
        Bias flux [Wb].
    current_bias, voltage_bias : (2, 2) ndarray
        Current offsets [A] and voltage offsets [V] before and after the jump.
    noise : (float, float)
        Standard deviations of a current and a mean voltage sample.
    """

    name: str
    machine: MagLev2DOF
    law: IdaPbc
    stiffness: float
    damping: float
    unit: float
    typical: float
    current_bias: Array
    voltage_bias: Array
    noise: tuple[float, float] = (0.0, 0.0)

    @property
    def start(self) -> Array:
        """Return the state (φ_1, φ_2, q, q̇) in the middle of the gap."""
        return np.array([self.typical, self.typical, 0.0, 0.0])

    def currents(self, x: Any) -> Any:
        """Return the true currents [A] of a state."""
        m = self.machine
        return x[:2] * (m.g + np.array([-1.0, 1.0]) * x[2]) / np.array([m.k_1, m.k_2])

    def controller(self) -> Callable[[float, Any, Any, Any], Array]:
        """Return the control law, which maps t, core fluxes, position and velocity to voltages."""
        m, law = self.machine, jax.jit(lambda *state: self.law(*state))
        return lambda t, phi, q, speed: np.asarray(law(t, phi, q, m.J / m.D * speed))


@dataclass(frozen=True)
class LoopResult:
    """Result of one closed-loop run.

    Attributes
    ----------
    handed_over : float or None
        Time at which the controller started to use the estimate [unit of the rig]; None if never.
    lost : float or None
        Time at which the body touched a pole; None if it never touched.
    before, after : float
        Rms distance from the reference, divided by the gap: between hand-over and jump, and at the
        end. inf if the body was lost earlier.
    peak : float
        Largest displacement after the jump, divided by the gap.
    flux_error : float
        Rms flux error at the end, divided by the flux.
    valid : float
        Share of samples reported as valid after the hand-over.
    """

    handed_over: float | None
    lost: float | None
    before: float
    after: float
    peak: float
    flux_error: float
    valid: float


class Estimator(Protocol):
    """Observer in the loop."""

    def step(self, v: Array, current: Array) -> tuple[Array, Array, bool]:
        """Return (flux, current bias, whether they are valid) after a sample."""
        ...


class FromLeastSquares:
    """Least squares for drift and current bias.

    After a restart, the loop cannot wait for `valid`, which needs another memory. The loop uses the
    estimate as soon as its standard deviation is small; until then it integrates with the last
    drift.
    """

    def __init__(self, rig: Rig, h: float) -> None:
        m = rig.machine
        bias = float(np.abs(rig.current_bias).max())
        drift = bias * m.resistance / m.N + float(np.abs(rig.voltage_bias).max()) / m.N
        memory = (0.5 if rig.noise[0] else 0.1) * rig.unit
        bias_current = rig.typical * m.g / m.k_2
        self.observer = levitation_observer(
            m, h, memory, rig.noise, bias_current, 2 * drift, 2 * bias
        )
        self.state: ImmersionState = self.observer.init()
        self.h = h
        self.flux, self.drift, self.bias = np.zeros(2), np.zeros(2), np.zeros(2)

    def step(self, v: Array, current: Array) -> tuple[Array, Array, bool]:
        self.state, estimate = self.observer.step(self.state, current=current, volt_seconds=v)
        certain = bool((estimate.flux_std < CERTAIN * np.abs(estimate.flux)).all())
        if estimate.valid or certain:
            self.flux, self.drift = estimate.flux, estimate.drift
            self.bias = estimate.current_bias
        else:
            self.flux = self.flux + v + self.h * self.drift
        return self.flux, self.bias, bool(estimate.valid)


class FromRepairedLaw:
    """Repaired Proposition 2 on the exact regression; this law cannot detect its own errors."""

    def __init__(self, rig: Rig, h: float, nominal: tuple[Array, Array]) -> None:
        m = rig.machine
        corner = 50.0 / rig.unit
        self.regression = SampledRegression(m.constraint, corner, h)
        constants = Parametrisation(m.constraint, "structured", corner)
        rows, _ = self.regression.run(*nominal)
        start = round(15 / corner / h)
        excited_rows = rows.part(slice(start, None))
        self.observer: RepairedAdaptiveObserver = balanced_repaired(
            excited_rows, constants, h, 8 / rig.unit, 2 / rig.unit, round(2 * rig.unit / h)
        )
        self.moments, self.state = self.regression.init(), self.observer.init()
        self.count, self.start, self.settled = 0, start, round(12 * rig.unit / h)

        def advance(moments: Any, state: Any, v: Any, i: Any, use: Any) -> Any:
            moments, row, _ = self.regression.step(moments, v, i)
            row = Regressors(*(use * entry for entry in row))
            return moments, self.observer.step(state, h, v, row)

        self._advance = jax.jit(advance)

    def step(self, v: Array, current: Array) -> tuple[Array, Array, bool]:
        use = 1.0 if self.count > self.start else 0.0
        self.moments, self.state = self._advance(self.moments, self.state, v, current, use)
        self.count += 1
        flux, constants = self.observer.estimate(self.state)
        return np.asarray(flux), np.asarray(constants[2:4]), self.count > self.settled


def _plant(rig: Rig, h: float) -> Callable[[Any, Any], Any]:
    """Return the map from state (φ_1, φ_2, q, q̇) and held voltages to the state after h."""
    m = rig.machine
    k, c = jnp.array([m.k_1, m.k_2]), jnp.array([m.c_1, m.c_2])
    sign, mass = jnp.array([-1.0, 1.0]), m.J / m.D**2

    def rate(x: jax.Array, u: jax.Array) -> jax.Array:
        phi, q, speed = x[:2], x[2], x[3]
        force = -sign @ (c * phi**2 / (2 * k)) - rig.stiffness * q - rig.damping * speed
        return jnp.concatenate(
            [(u - m.resistance * rig.currents(x)) / m.N, jnp.stack([speed, force / mass])]
        )

    def step(x: jax.Array, u: jax.Array) -> jax.Array:
        def substep(_: int, x: jax.Array) -> jax.Array:
            return runge_kutta_step(lambda x, _: rate(x, u), x, h / SUBSTEPS)

        end: jax.Array = jax.lax.fori_loop(0, SUBSTEPS, substep, x)
        return end

    compiled: Callable[[Any, Any], Any] = jax.jit(step)
    return compiled


def simulate(
    rig: Rig,
    make: Callable[[Rig, float], Estimator],
    h: float,
    jump: float = 15.0,
    stop: float = 30.0,
    seed: int = 0,
) -> LoopResult:
    """Run a rig with an observer. Times are in units of the rig, but h is in seconds."""
    m, unit = rig.machine, rig.unit
    plant, estimator = _plant(rig, h), make(rig, h)
    tracker = LevitationTracker(m, h, 100.0 / unit)
    control = rig.controller()
    rng = np.random.default_rng(seed)
    x = rig.start
    count, jump_at = round(stop * unit / h), round(jump * unit / h)
    trusted, needed, valid_count = None, round(TRUST * unit / h), 0
    track = TrackerState()
    path, target = np.full(count, np.nan), np.empty(count)
    error, size = np.full(count, np.nan), np.full(count, np.nan)
    ok = np.zeros(count, bool)
    lost = None
    phi, q, speed = x[:2], x[2], x[3]
    for n in range(count):
        t = n * h
        u = control(t, phi, q, speed)
        before = x
        x = np.asarray(plant(x, u))
        if not np.isfinite(x).all() or abs(x[2]) > LOST * m.g:
            lost = (n + 1) * h / unit
            break
        segment = int(n >= jump_at)
        bias = rig.current_bias[segment]
        theta = m.R @ bias - m.B @ rig.voltage_bias[segment]
        noise_i, noise_u = (scale * rng.standard_normal(2) for scale in rig.noise)
        current = rig.currents(x) + bias + noise_i
        v = x[:2] - before[:2] - h * theta + h * noise_u / m.N
        flux, bias_estimate, valid = estimator.step(v, current)
        track = tracker.step(track, flux, current - bias_estimate)
        valid_count = valid_count + 1 if valid else 0
        if trusted is None and valid_count >= needed:
            trusted = n
        phi, q, speed = (
            (x[:2], x[2], x[3]) if trusted is None else (flux, track.position, track.velocity)
        )
        path[n], target[n] = x[2], float(rig.law.position_reference((n + 1) * h))
        error[n], size[n] = np.linalg.norm(flux - x[:2]), np.linalg.norm(x[:2])
        ok[n] = valid

    def rms(values: Array, span: slice) -> float:
        used = values[span]
        return float(np.sqrt(np.mean(used**2))) if len(used) and np.isfinite(used).all() else np.inf

    late = slice(count - (count - jump_at) // 4, None)
    distance = (path - target) / m.g
    in_control = slice(trusted if trusted is not None else count, jump_at)
    after_jump = path[jump_at:]
    return LoopResult(
        None if trusted is None else trusted * h / unit,
        lost,
        rms(distance, in_control),
        rms(distance, late),
        float(np.nanmax(np.abs(after_jump))) / m.g if np.isfinite(after_jump).any() else np.inf,
        rms(error, late) / rms(size, late) if lost is None else np.inf,
        float(ok[trusted:].mean()) if trusted is not None else 0.0,
    )


def nominal_record(rig: Rig, h: float, duration: float = 15.0) -> tuple[Array, Array]:
    """Return (volt-seconds, currents) of the loop that uses the true state, without offsets."""
    plant, control, x = _plant(rig, h), rig.controller(), rig.start
    v, i = [], []
    for n in range(round(duration * rig.unit / h)):
        before, x = x, np.asarray(plant(x, control(n * h, x[:2], x[2], x[3])))
        v.append(x[:2] - before[:2])
        i.append(rig.currents(x))
    return np.array(v), np.array(i)


def _rig(
    name: str, machine: MagLev2DOF, current: float, stiffness: float = 0.0, damping: float = 0.0
) -> Rig:
    """Return a rig with bias current [A] and a controller scaled from scenario S5.

    Displacements scale with the gap, times with √(mass · gap / force), and offsets with the bias.
    """
    m, knospe = machine, benchmark()[0]

    def flux(machine: MagLev2DOF, i: float) -> float:
        return machine.k_2 * i / machine.g

    def rate(machine: MagLev2DOF, phi: float) -> float:
        force = machine.c_2 * phi**2 / (2 * machine.k_2)
        return float(np.sqrt(force / (machine.J / machine.D**2 * machine.g)))

    def shape(machine: MagLev2DOF, phi: float) -> tuple[float, float, float]:
        """Return the ratios that scale α, G and R_a."""
        k, c, g, D = machine.k_2, machine.c_2, machine.g, machine.D
        alpha = D * phi / g
        return alpha, D / alpha * c * phi**3 / k / g**2, D**2 / machine.J

    phi, phi_5 = flux(m, current), flux(knospe, 0.5)
    unit = rate(knospe, phi_5) / rate(m, phi)
    ratios, ratios_5 = shape(m, phi), shape(knospe, phi_5)
    alpha = 0.01 * ratios[0] / ratios_5[0]
    never = jnp.asarray(1e9)
    swing, shift = (
        BiasFlux(jnp.asarray(phi), jnp.asarray(0.3), jnp.asarray(MODULATION), never),
        PositionReference(never),
    )
    law = IdaPbc(
        m,
        jnp.asarray(alpha),
        jnp.asarray(-alpha),
        jnp.asarray(R_A * unit * ratios[2] / ratios_5[2]),
        jnp.asarray(5e3 * ratios[1] / ratios_5[1]),
        lambda t: swing(t / unit),
        lambda t: shift(t / unit) * (m.g / knospe.g),
    )
    volts = m.resistance * current / (knospe.resistance * 0.5)
    return Rig(
        name,
        m,
        law,
        stiffness,
        damping,
        unit,
        phi,
        CURRENT_BIAS * current / 0.5,
        VOLTAGE_BIAS * volts,
    )


def levitation() -> Rig:
    """Return Knospe's benchmark as in scenario S5."""
    return _rig("levitation", benchmark()[0], 0.5)


def bearing_axis() -> Rig:
    """Return one axis of the library's four-pole bearing; the other axis is identical."""
    machine = MagLev2DOF(k_1=1e-5, k_2=1e-5, g=1e-3, R=1.0, N=1.0, D=1.0, J=0.5, c_1=1.0, c_2=1.0)
    return _rig("four-pole bearing, one axis", machine, 1.0)


def electrostatic() -> Rig:
    """Return the library's plate between two electrodes: ε A = 3.5e-19 F m, resistors of 220 MΩ.

    Charge replaces flux, voltage replaces current. The large resistors make the charge controllable
    within a sample; with the library's 1 MΩ, the voltage source would fix the charge.
    """
    k = EPSILON_0 * 4e-8
    machine = MagLev2DOF(k_1=k, k_2=k, g=2e-6, R=1.0, N=2.2e8, D=1.0, J=1e-9, c_1=1.0, c_2=1.0)
    return _rig("electrostatic actuator", machine, 5.0, stiffness=1.0, damping=1e-6)


def noisy(rig: Rig) -> Rig:
    """Return the rig with the scaled noise of Section V's study: 1 mA and 10 mV at 1 kHz."""
    scale = rig.current_bias[0, 0] / CURRENT_BIAS[0, 0]
    volts = rig.voltage_bias[1, 0] / VOLTAGE_BIAS[1, 0]
    return replace(rig, name=f"{rig.name}, noise", noise=(1e-3 * scale, 1e-2 * volts))


#: Sample time in units of the rig. For the levitation, it is 2 ms.
SAMPLE = 2e-3


def rigs() -> tuple[Rig, ...]:
    """Return all rigs of the study."""
    return levitation(), noisy(levitation()), bearing_axis(), electrostatic()


def study(rig: Rig) -> dict[str, LoopResult]:
    """Run all observers on a rig; return a mapping from observer to result."""
    h = SAMPLE * rig.unit
    nominal = nominal_record(rig, h)
    return {
        "least squares": simulate(rig, FromLeastSquares, h),
        "adaptive, repaired": simulate(rig, lambda rig, h: FromRepairedLaw(rig, h, nominal), h),
    }
