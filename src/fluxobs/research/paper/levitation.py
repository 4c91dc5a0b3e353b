"""Section V-B of the paper: two opposed coils under IDA-PBC, with biased measurements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import Array
from ...machines import MagLev2DOF, example
from ...machines.model.constraint import QuadraticConstraint
from ...simulation.closed_form.sensors import Steps
from ..energies.ida_pbc import IdaPbc
from ..energies.integrate import Trajectory, integrate, volt_seconds
from ..energies.library import maglev_2dof
from ..energies.orbit import PeriodicOrbit, periodic_orbit
from ..energies.system import ElectromechanicalSystem, State
from ..regression import FilteredRegression, Orbit, Regressors
from ..regression.filtered import PLACES, Filters, filter_record, read_out_record

#: Values from the paper.
CORNER = 50.0
R_A = 1e-2
JUMP, DURATION = 50.0, 100.0
CURRENT_BIAS = np.array([[-0.003, 0.0025], [0.001, 0.0008]])
VOLTAGE_BIAS = np.array([[0.0, 0.0], [0.002, 0.0002]])
ROBUST_GAIN = 1e4
ADAPTIVE_GAIN = (1e20, 1e20, 1e20, 1e20, 2e13, 2e13, 20.0)

#: Our choices, because the paper does not give them: G of the controller, initial flux of both
#: cores [Wb], modulation frequency of the reference flux [rad/s].
G_OF_PAPER, INITIAL_FLUX, MODULATION = 1e4, 1e-5, 7.0
#: Frequency of the moving offsets [rad/s], faster than a change with temperature.
OFFSET_SPEED = 0.1
#: Samples per second on a periodic orbit.
SAMPLES = 2048 / (2 * np.pi)


def _fading(t: jax.Array, until: jax.Array) -> jax.Array:
    """Return one until a time, then a value that decreases to zero within about a second."""
    return jax.nn.sigmoid((until - t) * 10)


class PositionReference(eqx.Module):
    """Reference q_d(t) of the paper [m]; at rest after `until` [s]."""

    until: jax.Array

    def __call__(self, t: jax.Array) -> jax.Array:
        swing = 6 * jnp.sin(10 * t) + 4 * jnp.sin(20 * t) + 6 * jnp.sin(15 * t)
        return 1e-5 * swing * _fading(t, self.until)


class BiasFlux(eqx.Module):
    """Flux common to both coils [Wb]: ``mean (1 + depth sin(speed t))``, constant after `until`."""

    mean: jax.Array
    depth: jax.Array
    speed: jax.Array
    until: jax.Array

    def __call__(self, t: jax.Array) -> jax.Array:
        swing = self.depth * jnp.sin(self.speed * t)
        return self.mean * (1 + swing * _fading(t, self.until))


@dataclass(frozen=True)
class LevitationScenario:
    """Controller settings and references.

    Attributes
    ----------
    name, title : str
    alpha, G : float
        Controller parameters; β = -α.
    bias_current : float
        Current that gives the reference flux φ* in the middle of the gap [A].
    depth : float
        Modulation depth of the reference flux at the frequency :data:`MODULATION`.
    initial_flux : float
        Initial flux of both cores [Wb]; NaN means the reference flux.
    excited_until : float
        Time at which the references come to rest [s].
    """

    name: str
    title: str
    alpha: float
    G: float
    bias_current: float
    depth: float
    initial_flux: float
    excited_until: float = 1e9

    @property
    def period(self) -> float:
        """Common period of the references [s]: 2π/5, or 2π if the flux is modulated."""
        return 2 * np.pi / (1.0 if self.depth else 5.0)


SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        LevitationScenario(
            "S1", "the paper's, α = 10, no bias flux", 10.0, G_OF_PAPER, 0.0, 0.0, INITIAL_FLUX
        ),
        LevitationScenario(
            "S2", "α = 10, 0.5 A of bias flux", 10.0, G_OF_PAPER, 0.5, 0.0, INITIAL_FLUX
        ),
        LevitationScenario("S3", "α = 0.01, 0.5 A of bias flux", 0.01, 5e3, 0.5, 0.0, np.nan),
        LevitationScenario(
            "S5", "α = 0.01, bias flux modulated ±30 %", 0.01, 5e3, 0.5, 0.3, np.nan
        ),
    )
}


class _Control(eqx.Module):
    """The controller in the system's coordinates, with linkages c φ and momentum p/D."""

    law: IdaPbc
    c: jax.Array
    D: float

    def __call__(self, t: jax.Array, state: State) -> jax.Array:
        return self.law(t, state.flux / self.c, state.position[0], self.D * state.momentum[0])


@dataclass(frozen=True, eq=False)
class LevitationRecord:
    """Measured and true signals, with one row per sample time h; fluxes are core fluxes.

    Attributes
    ----------
    jump : float
        Time at which the biases change [s].
    drift, current_bias : (rows, 2) ndarray
        True values: drift over the interval that ends at each row, current bias at the row.
    current : (rows, 2) ndarray
        Measured current, with bias [A].
    volt_seconds : (rows, 2) ndarray
        Exact ∫ (-R i_m + u_m)/N dt over the interval that ends at each row [Wb].
    """

    scenario: LevitationScenario
    machine: MagLev2DOF
    trajectory: Trajectory
    jump: float
    t: Array
    flux: Array
    true_current: Array
    current: Array
    drift: Array
    current_bias: Array
    volt_seconds: Array

    @property
    def h(self) -> float:
        return self.trajectory.h

    @property
    def reference(self) -> Array:
        """q_d(t) [m]."""
        until = jnp.asarray(self.scenario.excited_until)
        return np.asarray(PositionReference(until)(jnp.asarray(self.t)))

    @property
    def constraint(self) -> QuadraticConstraint:
        return self.machine.constraint


@cache
def benchmark() -> tuple[MagLev2DOF, ElectromechanicalSystem]:
    """Return (machine, system), shared by all scenarios so that the dynamics compile only once."""
    machine = example("maglev-knospe")
    assert isinstance(machine, MagLev2DOF)
    return machine, maglev_2dof(machine)


def closed_loop(scenario: LevitationScenario) -> tuple[_Control, State, State]:
    """Return (controller in the system's coordinates, initial state, sizes of the states)."""
    machine, _ = benchmark()
    c = np.array([machine.c_1, machine.c_2])
    phi = machine.k_2 * scenario.bias_current / machine.g
    until = jnp.asarray(scenario.excited_until)
    law = IdaPbc(
        machine,
        jnp.asarray(scenario.alpha),
        jnp.asarray(-scenario.alpha),
        jnp.asarray(R_A),
        jnp.asarray(scenario.G),
        BiasFlux(jnp.asarray(phi), jnp.asarray(scenario.depth), jnp.asarray(MODULATION), until),
        PositionReference(until),
    )
    start = phi if np.isnan(scenario.initial_flux) else scenario.initial_flux
    typical = machine.k_2 * 0.5 / machine.g
    return (
        _Control(law, jnp.asarray(c), machine.D),
        State(jnp.asarray(c * start), jnp.zeros(1), jnp.zeros(1)),
        State(jnp.asarray(c * typical), jnp.full(1, 1e-4), jnp.full(1, 0.1)),
    )


def record(scenario: LevitationScenario, h: float = 1e-3, quick: bool = False) -> LevitationRecord:
    """Simulate a scenario; if `quick`, the run lasts 30 s and the biases jump at 15 s."""
    duration, jump = (30.0, 15.0) if quick else (DURATION, JUMP)
    machine, system = benchmark()
    control, start, scale = closed_loop(scenario)
    trajectory = integrate(
        system,
        control,
        np.arange(round(duration / h) + 1) * h,
        start,
        scale=scale,
        position_limit=(-machine.g, machine.g),
        stiff=scenario.alpha > 1,  # well-damped poles near ±8600j, which decay within 0.1 s
        rtol=1e-7,
    )
    return measured(scenario, machine, trajectory, jump)


@cache
def orbit(name: str) -> PeriodicOrbit:
    """Return the periodic orbit to which a scenario settles, with :data:`SAMPLES` per second.

    The references have a common period: 10, 15, 20 and, if the flux is modulated, 7 rad/s. S1 has
    no orbit: without bias flux, its flux decreases more and more slowly.
    """
    scenario = SCENARIOS[name]
    machine, system = benchmark()
    control, start, scale = closed_loop(scenario)
    return periodic_orbit(
        system,
        control,
        scenario.period,
        round(SAMPLES * scenario.period),
        start,
        scale,
        position_limit=(-machine.g, machine.g),
        stiff=scenario.alpha > 1,
        rtol=1e-11,
    )


def measured_orbit(name: str, segment: int) -> tuple[Orbit, Array]:
    """Return (measured orbit, drift) with the biases before (0) or after (1) the jump."""
    machine, _ = benchmark()
    trajectory = orbit(name).trajectory
    c = np.array([machine.c_1, machine.c_2])
    bias, voltage_bias = CURRENT_BIAS[segment], VOLTAGE_BIAS[segment]
    drift = machine.R @ bias - machine.B @ voltage_bias
    y_m = trajectory.flux_rate[:-1] / c - drift
    return Orbit(SCENARIOS[name].period, y_m, trajectory.current[:-1] + bias), drift


def measured(
    scenario: LevitationScenario,
    machine: MagLev2DOF,
    trajectory: Trajectory,
    jump: float,
    factor: float = 1.0,
    swing: float = 0.0,
) -> LevitationRecord:
    """Measure a trajectory with the paper's biases multiplied by `factor`.

    Every bias moves by `swing` times its size at :data:`OFFSET_SPEED`.
    """
    t, h = trajectory.t, trajectory.h
    moving = (factor * (1 + swing * np.sin(OFFSET_SPEED * (t - h / 2))))[:, None]
    current_bias = moving * Steps(CURRENT_BIAS, np.array([jump])).at(t - h / 2)
    voltage_bias = moving * Steps(VOLTAGE_BIAS, np.array([jump])).at(t - h / 2)
    drift = current_bias @ machine.R.T - voltage_bias @ machine.B.T
    flux = trajectory.flux / np.array([machine.c_1, machine.c_2])
    return LevitationRecord(
        scenario,
        machine,
        trajectory,
        jump,
        t,
        flux,
        trajectory.current,
        trajectory.current + current_bias,
        drift,
        current_bias,
        volt_seconds(flux, h, drift),
    )


class FilteredRecord(NamedTuple):
    """Regression at every row; at the jump, also with the current just after the jump.

    The row at the jump itself has the biases before the jump.
    """

    rows: Regressors
    after_jump: Regressors


def filtered(record: LevitationRecord) -> tuple[FilteredRecord, FilteredRecord]:
    """Return the continuous regressions (corrected, with printed Φ_λ) at every row."""
    c = np.array([record.machine.c_1, record.machine.c_2])
    _, rate, current = record.trajectory.inside(PLACES)
    # Each interval has its own bias, which jumps between two intervals.
    y_m = rate / c - record.drift[1:, None]
    i_m = current + record.current_bias[1:, None]
    regression = FilteredRegression(record.constraint, CORNER)
    filters = filter_record(regression, record.h, y_m, i_m)
    jump = int(np.searchsorted(record.t, record.jump - record.h / 2))
    after = record.true_current[jump] + record.current_bias[jump + 1]

    def read(form: Literal["corrected", "printed"]) -> FilteredRecord:
        reader = FilteredRegression(record.constraint, CORNER, form)
        at_jump = Filters(*(xi[[jump]] for xi in filters))
        return FilteredRecord(
            read_out_record(reader, filters, record.current),
            read_out_record(reader, at_jump, after[None]).part(0),
        )

    return read("corrected"), read("printed")
