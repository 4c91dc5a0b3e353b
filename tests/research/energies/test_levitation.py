"""The levitation benchmark: controller, simulation, sensors, and position from flux."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import ModelError
from fluxobs.machines import example
from fluxobs.observers.levitation_tracker import LevitationTracker
from fluxobs.research import State, integrate
from fluxobs.research.energies.ida_pbc import IdaPbc
from fluxobs.research.energies.integrate import volt_seconds
from fluxobs.research.energies.library import maglev_2dof
from fluxobs.research.paper.levitation import SCENARIOS, filtered, record
from fluxobs.research.paper.section_v import LevitationRun, least_squares
from fluxobs.research.paper.studies import mechanics
from fluxobs.simulation.closed_form.sensors import Sensor, Steps

MACHINE = example("maglev-knospe")
TYPICAL = MACHINE.k_2 * 0.5 / MACHINE.g


def controller(alpha=0.01, G=5e3, flux=TYPICAL, position=0.0):
    return IdaPbc(MACHINE, alpha, -alpha, 1e-2, G, lambda t: flux, lambda t: position)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), alpha=st.sampled_from([0.01, 10.0]))
def test_shaped_energy_falls_by_its_dissipation(seed, alpha):
    """Ḣ_d = -∇H_dᵀ diag(R/Nc₁, R/Nc₂, R_a/D², 0) ∇H_d holds for constant references."""
    rng = np.random.default_rng(seed)
    law = controller(alpha)
    m = MACHINE
    phi = jnp.asarray(TYPICAL * rng.uniform(0.2, 2, 2))
    q, p = 1e-4 * rng.uniform(-1, 1), 1e-2 * rng.standard_normal()
    u = law(0.0, phi, q, p)
    sign = jnp.array([-1.0, 1.0])
    i = phi * (m.g + sign * q) / jnp.array([m.k_1, m.k_2])
    force = m.c_1 * phi[0] ** 2 / (2 * m.k_1) - m.c_2 * phi[1] ** 2 / (2 * m.k_2)
    rates = ((u - m.resistance * i) / m.N, m.D * p / m.J, m.D * force)

    def energy(phi, theta, p):
        return law.shaped_energy(0.0, phi, m.D * theta, p)

    slopes = jax.grad(energy, (0, 1, 2))(phi, q / m.D, p)
    rate = slopes[0] @ rates[0] + slopes[1] * rates[1] / m.D + slopes[2] * rates[2]
    loss = (
        m.resistance / (m.N * m.c_1) * slopes[0][0] ** 2
        + m.resistance / (m.N * m.c_2) * slopes[0][1] ** 2
        + law.R_a / m.D**2 * slopes[1] ** 2
    )
    size = sum(abs(float(term)) for term in (slopes[0] @ rates[0], slopes[2] * rates[2], loss))
    assert abs(float(rate + loss)) < 1e-9 * size


def closed_loop(law, start, duration=1.0, **options):
    system = maglev_2dof(MACHINE)
    c = jnp.array([MACHINE.c_1, MACHINE.c_2])

    def control(t, state):
        return law(t, state.flux / c, state.position[0], MACHINE.D * state.momentum[0])

    return integrate(
        system,
        control,
        np.arange(0, duration, 1e-3),
        State(c * start, jnp.zeros(1), jnp.zeros(1)),
        scale=State(c * TYPICAL, jnp.full(1, 1e-4), jnp.full(1, 0.1)),
        position_limit=(-MACHINE.g, MACHINE.g),
        rtol=1e-8,
        **options,
    )


@pytest.mark.slow
def test_both_solvers_agree_and_relations_hold_between_samples():
    implicit = closed_loop(controller(position=5e-5), TYPICAL)
    explicit = closed_loop(controller(position=5e-5), TYPICAL, stiff=False)
    np.testing.assert_allclose(implicit.flux, explicit.flux, rtol=1e-5)
    c = np.array([MACHINE.c_1, MACHINE.c_2])
    flux, rate, current = (values[:, 0] for values in implicit.inside([0.5]))
    residual = MACHINE.constraint.residual(flux / c, current)
    assert np.abs(residual).max() < 1e-14 * MACHINE.g * TYPICAL**2
    # Check the cubic's rate in the middle by Simpson's rule.
    end = implicit.flux[1:] - implicit.flux[:-1]
    simpson = implicit.h / 6 * (implicit.flux_rate[:-1] + 4 * rate + implicit.flux_rate[1:])
    np.testing.assert_allclose(simpson, end, atol=1e-12 * np.abs(implicit.flux).max())


@pytest.mark.slow
def test_leaving_the_air_gap_says_when_and_where():
    with pytest.raises(ModelError, match=r"left \(-0.00033, 0.00033\) after t = 0\.\d+ s, posit"):
        closed_loop(controller(position=2e-3), TYPICAL, duration=2.0)


def test_simulation_refuses_bad_time_and_state():
    with pytest.raises(ModelError, match="t must be uniform"):
        integrate(maglev_2dof(MACHINE), lambda t, s: jnp.zeros(2), [0.0, 1.0, 3.0], None)
    with pytest.raises(ValueError, match=r"initial.flux must have shape \(2,\)"):
        closed_loop(controller(), jnp.ones(3)[:, None])


@pytest.mark.parametrize("change", [{"alpha": -1.0}, {"G": 0.0}])
def test_controller_gains_are_checked(change):
    with pytest.raises(ModelError, match="alpha > 0 > beta, R_a > 0 and G > 0"):
        controller(**change)


def test_volt_seconds_integrate_to_the_flux():
    rng = np.random.default_rng(0)
    flux, drift = rng.standard_normal((20, 2)), np.array([0.3, -0.1])
    v = volt_seconds(flux, 0.1, drift)
    np.testing.assert_allclose(flux[0] + np.cumsum(v + 0.1 * drift, axis=0) - 0.1 * drift, flux)


def test_volt_seconds_use_the_drift_of_their_interval():
    """With a varying drift, row k's value belongs to the interval that ends there."""
    flux = np.array([[0.0], [1.0], [3.0]])
    v = volt_seconds(flux, 0.5, np.array([[9.0], [2.0], [4.0]]))
    np.testing.assert_allclose(v, [[0.0], [1.0 - 0.5 * 2], [2.0 - 0.5 * 4]])


@cache
def drive_of_s5():
    return record(SCENARIOS["S5"], quick=True)


def test_printed_regression_differs_and_the_corrected_one_holds():
    drive = drive_of_s5()
    rows, printed_rows = (regression.rows for regression in filtered(drive))
    Q1, Q2 = drive.constraint.Q1, drive.constraint.Q2

    def unexplained(rows):
        explained = np.einsum("ki,ki->k", rows.Phi_flux, drive.flux)
        explained += np.einsum("ki,ki->k", rows.Phi_drift, drive.drift)
        explained -= np.einsum("ki,ki->k", rows.Phi_a, drive.current_bias @ Q2.T)
        explained += rows.phi_c * np.einsum("ki,ij,kj->k", drive.drift, Q1, drive.drift)
        return np.asarray(rows.y) - explained

    span = slice(1000, 14900)
    size = np.sqrt(np.mean(np.square(rows.y[span])))
    # The parabolas in the filters limit the accuracy.
    assert np.abs(unexplained(rows)[span]).max() < 3e-8 * size
    assert np.sqrt(np.mean(unexplained(printed_rows)[span] ** 2)) > size


def test_position_and_velocity_from_the_flux():
    drive = drive_of_s5()
    run = LevitationRun(drive, None, {}, least_squares(drive))
    position, velocity = mechanics(run)
    assert position < 1e-9
    assert velocity < 1e-5
    with pytest.raises(ValueError, match="bandwidth must be positive"):
        LevitationTracker(MACHINE, 1e-3, 0.0)


def test_position_is_undefined_without_flux():
    position, length = MACHINE.position(np.zeros((1, 2)), np.ones((1, 2)))
    assert np.isnan(position[0])
    assert length[0] == 0


def test_sensor_bias_noise_and_quantisation():
    t = np.arange(10001) * 1e-2
    true = np.zeros((len(t), 2))
    bias = Steps(np.array([[-0.003, 0.0025], [0.001, 0.0008]]), np.array([50.0]))
    clean = Sensor(bias).measure(t, true, seed=0)
    np.testing.assert_array_equal(clean[t < 50][0], [-0.003, 0.0025])
    np.testing.assert_array_equal(clean[5000:][0], [0.001, 0.0008])
    noisy = Sensor(bias, noise=0.1).measure(t, true, seed=3)
    np.testing.assert_allclose((noisy - clean).std(), 0.1, rtol=0.03)
    np.testing.assert_array_equal(noisy, Sensor(bias, noise=0.1).measure(t, true, seed=3))
    coarse = Sensor(bias, noise=0.1, quantum=0.05).measure(t, true, seed=3)
    assert np.abs(coarse - noisy).max() <= 0.025 + 1e-12
    np.testing.assert_allclose(coarse / 0.05, np.round(coarse / 0.05), atol=1e-9)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Steps(np.zeros((1, 2)), np.array([1.0])), "values must have shape"),
        (lambda: Steps(np.zeros((3, 2)), np.array([2.0, 1.0])), "times must increase"),
        (lambda: Steps(np.full((1, 2), np.nan)), "values must be finite"),
        (lambda: Sensor(Steps(np.zeros((1, 2))), noise=-1.0), "noise must be a number >= 0"),
    ],
)
def test_bad_sensors(build, message):
    with pytest.raises(ValueError, match=message):
        build()
