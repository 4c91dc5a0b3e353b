"""Section V-B of the paper: two opposed coils under IDA-PBC, with biased measurements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from ..design.energies.ida_pbc import IdaPbc
from ..design.energies.integrate import Trajectory, integrate, volt_seconds
from ..design.energies.library import maglev_2dof
from ..design.energies.system import ElectromechanicalSystem, State
from ..design.regression import FilteredRegression, Regressors
from ..design.regression.filtered import filter_record, read_out_record
from ..machines import MagLev2DOF, example
from ..model.constraint import QuadraticConstraint
from ..synthetic.sensors import Steps

Array = NDArray[np.float64]

#: Values from the paper.
CORNER = 50.0
R_A = 1e-2
JUMP, DURATION = 50.0, 100.0
CURRENT_BIAS = np.array([[-0.003, 0.0025], [0.001, 0.0008]])
VOLTAGE_BIAS = np.array([[0.0, 0.0], [0.002, 0.0002]])
ROBUST_GAIN = 1e4
ADAPTIVE_GAIN = (1e20, 1e20, 1e20, 1e20, 2e13, 2e13, 20.0)


class PositionReference(eqx.Module):
    """q_d(t) of the paper [m]."""

    scale: float = 1.0

    def __call__(self, t: jax.Array) -> jax.Array:
        return self.scale * 1e-5 * (6 * jnp.sin(10 * t) + 4 * jnp.sin(20 * t) + 6 * jnp.sin(15 * t))


class BiasFlux(eqx.Module):
    """``mean (1 + depth sin(speed t))`` [Wb]: the flux common to both coils."""

    mean: jax.Array
    depth: jax.Array
    speed: jax.Array

    def __call__(self, t: jax.Array) -> jax.Array:
        return self.mean * (1 + self.depth * jnp.sin(self.speed * t))


@dataclass(frozen=True)
class LevitationScenario:
    """Controller settings and references.

    Attributes
    ----------
    name, title : str
    alpha, G : float
        Controller parameters; β = -α.
    bias_current : float
        Current that makes the reference flux φ* in the middle of the gap [A].
    depth : float
        Depth of modulation of the reference flux, at 7 rad/s.
    initial_flux : float
        Initial flux of both cores [Wb]; NaN for the reference.
    """

    name: str
    title: str
    alpha: float
    G: float
    bias_current: float
    depth: float
    initial_flux: float


SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        LevitationScenario("S1", "the paper's, α = 10, no bias flux", 10.0, 1e4, 0.0, 0.0, 1e-5),
        LevitationScenario("S2", "α = 10, 0.5 A of bias flux", 10.0, 1e4, 0.5, 0.0, 1e-5),
        LevitationScenario("S3", "α = 0.01, 0.5 A of bias flux", 0.01, 5e3, 0.5, 0.0, np.nan),
        LevitationScenario(
            "S5", "α = 0.01, bias flux modulated ±30 %", 0.01, 5e3, 0.5, 0.3, np.nan
        ),
    )
}


class _Control(eqx.Module):
    """The controller in the coordinates of the system: linkages c φ, momentum p/D."""

    law: IdaPbc
    c: jax.Array
    D: float

    def __call__(self, t: jax.Array, state: State) -> jax.Array:
        return self.law(t, state.flux / self.c, state.position[0], self.D * state.momentum[0])


@dataclass(frozen=True, eq=False)
class LevitationRecord:
    """Measured and true signals, rows h apart; fluxes are core fluxes.

    Attributes
    ----------
    jump : float
        Time at which the biases change [s].
    drift, current_bias : (rows, 2) ndarray
        True values over the interval that ends at each row, and at the row.
    current : (rows, 2) ndarray
        Measured current, with bias [A].
    volt_seconds : (rows, 2) ndarray
        ∫ (-R i_m + u_m)/N dt over the interval that ends at each row, exact [Wb].
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
        return np.asarray(PositionReference()(jnp.asarray(self.t)))

    @property
    def constraint(self) -> QuadraticConstraint:
        return self.machine.constraint


@cache
def _benchmark() -> tuple[MagLev2DOF, ElectromechanicalSystem]:
    """One system for all scenarios: its dynamics compile only once."""
    machine = example("maglev-knospe")
    assert isinstance(machine, MagLev2DOF)
    return machine, maglev_2dof(machine)


def record(scenario: LevitationScenario, h: float = 1e-3, quick: bool = False) -> LevitationRecord:
    """Simulates a scenario; if `quick`, for 30 s, with the biases jumping at 15 s."""
    duration, jump = (30.0, 15.0) if quick else (DURATION, JUMP)
    machine, system = _benchmark()
    c = np.array([machine.c_1, machine.c_2])
    phi = machine.k_2 * scenario.bias_current / machine.g
    reference = BiasFlux(jnp.asarray(phi), jnp.asarray(scenario.depth), jnp.asarray(7.0))
    law = IdaPbc(
        machine,
        jnp.asarray(scenario.alpha),
        jnp.asarray(-scenario.alpha),
        jnp.asarray(R_A),
        jnp.asarray(scenario.G),
        reference,
        PositionReference(),
    )
    start = phi if np.isnan(scenario.initial_flux) else scenario.initial_flux
    typical = machine.k_2 * 0.5 / machine.g
    trajectory = integrate(
        system,
        _Control(law, jnp.asarray(c), machine.D),
        np.arange(round(duration / h) + 1) * h,
        State(jnp.asarray(c * start), jnp.zeros(1), jnp.zeros(1)),
        scale=State(jnp.asarray(c * typical), jnp.full(1, 1e-4), jnp.full(1, 0.1)),
        position_limit=(-machine.g, machine.g),
        stiff=scenario.alpha > 1,  # well-damped poles near ±8600j, decayed after 0.1 s
        rtol=1e-7,
    )
    return measured(scenario, machine, trajectory, jump)


def measured(
    scenario: LevitationScenario,
    machine: MagLev2DOF,
    trajectory: Trajectory,
    jump: float,
    factor: float = 1.0,
) -> LevitationRecord:
    """Measures a trajectory, with the paper's biases times `factor`."""
    t, h = trajectory.t, trajectory.h
    current_bias = factor * Steps(CURRENT_BIAS, np.array([jump])).at(t - h / 2)
    voltage_bias = factor * Steps(VOLTAGE_BIAS, np.array([jump])).at(t - h / 2)
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


def filtered(given: LevitationRecord) -> tuple[Regressors, Regressors]:
    """Continuous regression at every row: corrected, and with Φ_λ as printed."""
    c = np.array([given.machine.c_1, given.machine.c_2])
    _, rate, current = given.trajectory.middle()
    known = given.trajectory.flux_rate / c
    # Signals at the start, middle and end of each interval, with the bias of that interval.
    drift, bias = given.drift[1:, None], given.current_bias[1:, None]
    y_m = np.stack([known[:-1], rate / c, known[1:]], axis=1) - drift
    i_m = np.stack([given.true_current[:-1], current, given.true_current[1:]], axis=1) + bias
    regression = FilteredRegression(given.constraint, CORNER)
    filters = filter_record(regression, given.h, jnp.asarray(y_m), jnp.asarray(i_m))
    measured_current = jnp.asarray(given.current)
    printed = FilteredRegression(given.constraint, CORNER, "printed")
    corrected = read_out_record(regression, filters, measured_current)
    return corrected, read_out_record(printed, filters, measured_current)
