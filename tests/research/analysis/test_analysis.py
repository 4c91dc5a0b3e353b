"""Stability, excitation, identifiability and bounds agree with independent results."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fluxobs import ModelError
from fluxobs.machines.model.immersion import Immersion
from fluxobs.research.analysis import (
    bound_on_record,
    compare_invisible,
    decay_rate,
    excitation,
    immersion_gramian,
    observability_gramian,
    over_gain,
    peak_gain,
    persistency,
    robust_bound,
)
from fluxobs.research.analysis.bounds import disturbance
from fluxobs.research.analysis.identifiability import rank
from fluxobs.research.paper import counter_example as paper_case
from fluxobs.research.paper.pmsm import counter_example, servo
from fluxobs.research.regression import Parametrisation, SampledRegression
from fluxobs.research.regression.laws import RobustObserver, run
from support.trajectories import CASES


@cache
def example_orbit():
    return counter_example(256)


@cache
def paper_study():
    return paper_case.study()


def constants():
    return Parametrisation(example_orbit().constraint, "voltage-bias", 1.0)


def regressor():
    return np.asarray(constants().psi_record(example_orbit().rows))


def test_erratum_6_persistently_excited_and_unstable_at_every_gain():
    orbit, psi = example_orbit(), regressor()
    assert np.linalg.eigvalsh(orbit.h * psi.T @ psi)[0] == pytest.approx(0.26, abs=0.005)
    study = over_gain(psi, orbit.h, constants(), paper_case.GAINS)
    expected = [1.147, 1.504, 2.882, 6.854, 9.698, 10.163, 10.212, 10.217]
    np.testing.assert_allclose(study.multipliers(2 * np.pi), expected, atol=6e-4)
    assert study.uncertainty.max() < 1e-4
    assert study.unstable.all()


@pytest.mark.parametrize("gain", [0.01, 1.0, 100.0])
def test_multipliers_against_an_ode_solver(gain):
    """Another library gives these multipliers from the regressor's Fourier series."""
    psi = regressor()
    spectrum = np.fft.rfft(psi, axis=0)[:60] * 2 / len(psi)
    spectrum[0] /= 2
    k = np.arange(60)
    G_a = np.zeros((5, 5))
    G_a[:2, 2:4] = np.eye(2)

    def field(time, flat):
        row = np.real(np.exp(1j * k * time) @ spectrum)
        return ((G_a - gain * np.outer(row, row)) @ flat.reshape(5, 5)).ravel()

    end = solve_ivp(
        field, (0, 2 * np.pi), np.eye(5).ravel(), method="DOP853", rtol=1e-8, atol=1e-10
    ).y[:, -1]
    largest = np.abs(np.linalg.eigvals(end.reshape(5, 5))).max()
    multiplier = over_gain(psi, example_orbit().h, constants(), [gain]).multipliers(2 * np.pi)[0]
    assert multiplier == pytest.approx(largest, rel=1e-6)


def test_the_repaired_law_converges_where_the_printed_one_diverges():
    errors = paper_study().errors
    assert errors["printed, γ_a = 1"][-1] > 1e6
    assert errors["repaired, Γ = G = 1"][-1] < 1e-7
    assert errors["repaired, Γ = 100, G = 1"][-1] == pytest.approx(1.73e-3, rel=0.02)


def test_the_growth_of_the_printed_law_is_its_multiplier():
    """Another integrator runs the law for 30 periods.

    The multipliers are a pair, 6.854 ∠ ±46.3°, so single periods differ: compare the mean.
    """
    errors = paper_study().errors["printed, γ_a = 1"]
    assert (errors[-1] / errors[1]) ** (1 / 29) == pytest.approx(6.854, rel=5e-3)


def test_gram_of_a_sine():
    """∫ over one period of (cos, sin)(cos, sin)ᵀ is half the period times I."""
    t = np.arange(3001) * 1e-3
    signal = np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)], axis=1)
    excited = excitation(signal, 1e-3, 1.0)
    np.testing.assert_allclose([excited.alpha, excited.ratio], [0.5, 1.0], rtol=1e-6)
    # A window that is too short sees only one direction; per-unit scaling scales the columns.
    table = persistency(signal, 1e-3, [0.05, 1.0])
    assert table[0][2] < 0.02 < table[1][2]
    scaled = excitation(signal, 1e-3, 1.0, scale=[2.0, 1.0])
    np.testing.assert_allclose(scaled.ratio, 0.25, rtol=1e-6)
    with pytest.raises(ModelError, match="a window of 5 s does not fit"):
        excitation(signal, 1e-3, 5.0)


def rows_at_constant_speed(speed):
    """Return exact samples of a PMSM at constant speed and current, with only a voltage bias."""
    L, psi, h = 0.4, 1.0, 0.02
    k = np.arange(1500)
    angle = speed * h * k
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    i = 0.5 * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    flux = L * i + psi * axis
    drift = np.array([0.1, -0.2])
    v = np.diff(flux, axis=0, prepend=flux[:1]) - h * drift
    relation = example_orbit().constraint
    rows, _ = SampledRegression(relation, 1.0, h).run(v, i)
    return rows.part(slice(1000, None)), relation, h


def test_constant_speed_is_not_exciting_but_observable():
    """Ψ has rank 3 of 5; the observability Gramian has rank 5, because the drift moves the flux."""
    rows, relation, h = rows_at_constant_speed(1.0)
    unknown = Parametrisation(relation, "voltage-bias", 1.0)
    psi = np.column_stack([rows.Phi_flux, unknown.record(rows)])
    assert np.linalg.matrix_rank(psi.T @ psi, tol=1e-8 * len(psi)) == 3
    gramian = observability_gramian(rows, unknown, h, 9.0)
    assert rank(gramian) == 5


@cache
def signals_of(name, h, rows):
    case, t = CASES[name](), jnp.arange(rows) * h
    signals = jax.jit(jax.vmap(lambda time: (case.flux(time), case.current(time))))
    return case, *map(np.asarray, signals(t))


@pytest.mark.parametrize("kind", ["structured", "printed", "voltage-bias"])
@pytest.mark.parametrize("name", sorted(CASES))
def test_constraint_and_record_agree_on_invisible_directions(name, kind):
    """The Hessian predicts the directions that an exciting record's observability Gramian shows."""
    corner = {"pmsm": 60.0, "synrm": 60.0, "maglev": 50.0, "three-port": 8.0}[name]
    h = 0.05 / corner
    case, flux, current = signals_of(name, h, 6000)
    n = case.constraint.n
    delta = case.current_bias if kind != "voltage-bias" else np.zeros(n)
    v = np.diff(flux, axis=0, prepend=flux[:1]) - h * case.drift
    rows, _ = SampledRegression(case.constraint, corner, h).run(v, current + delta)
    rows = rows.part(slice(2000, None))
    unknown = Parametrisation(case.constraint, kind, corner)
    psi = np.column_stack([rows.Phi_flux, unknown.record(rows)])
    scale = 1 / np.sqrt(np.mean(psi**2, axis=0))
    comparison = compare_invisible(
        case.constraint, rows, unknown, h, 3999 * h, scale, tolerance=1e-13
    )
    assert comparison.agree, (
        comparison.predicted.shape,
        comparison.measured.shape,
        comparison.angle,
    )


def test_erratum_7_printed_constants_are_violated_at_the_start():
    """For constant Φ, Γ φ² = 100, T = 0.01, b = 0, the intended m_r is 0.41, but must be >= 1."""
    phi, Gamma, T = 1.0, 100.0, 0.01
    eta = decay_rate([[Gamma]], T, phi**2 * T, phi)
    printed = np.exp(eta * T) / eta * np.sqrt(Gamma) * phi
    assert printed == pytest.approx(0.41, abs=0.005)
    t = np.linspace(0, 0.1, 50)
    error = np.exp(-Gamma * phi**2 * t)
    assert printed < error[0]
    assert (robust_bound([[Gamma]], T, phi**2 * T, phi, 1.0, 0.0, t) >= error).all()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), spread=st.floats(1.0, 10.0))
def test_the_corrected_bound_holds(seed, spread):
    """The bound holds for random regressors, gains and disturbances, simulated with exact steps."""
    rng = np.random.default_rng(seed)
    h, count = 0.01, 2000
    phase = rng.uniform(0, 2 * np.pi, 3)
    t = np.arange(count) * h
    phi = np.stack([np.cos(3 * t + phase[0]), np.sin(3 * t + phase[1])], axis=1)
    phi += 0.3 * np.sin(7 * t + phase[2])[:, None]
    rotation = np.linalg.qr(rng.standard_normal((2, 2)))[0]
    Gamma = rotation @ np.diag([1.0, spread]) @ rotation.T
    window = 2.2
    excited = excitation(phi, h, window)
    push = rng.standard_normal(2)
    error, errors = rng.standard_normal(2), []
    start = np.linalg.norm(error)
    for row in phi:
        errors.append(np.linalg.norm(error))
        direction = Gamma @ row
        rate = row @ direction
        error = error - direction * (1 - np.exp(-rate * h)) / rate * (row @ error) + h * push
    bound = robust_bound(
        Gamma,
        window,
        excited.alpha,
        np.linalg.norm(phi, axis=1).max(),
        start,
        np.linalg.norm(push),
        t,
    )
    assert (np.array(errors) <= 1.02 * bound).all()


def test_bound_on_a_motor_record_contains_the_error():
    record = servo(quick=True)
    skip, half = round(15 / 200 / record.h), len(record.t) // 2
    rows = record.rows.part(slice(skip, half))
    unknown = Parametrisation(record.constraint, "structured", 200.0)
    size = np.mean(np.square(rows.Phi_flux))
    Gamma = 20.0 / size * np.eye(2)
    flux, _ = run(
        RobustObserver(Gamma, 2), record.h, jnp.asarray(record.volt_seconds[skip:half]), rows
    )
    error = np.linalg.norm(np.asarray(flux) - record.flux[skip:half], axis=1)
    bound = bound_on_record(
        rows, unknown, Gamma, record.h, 0.05, error[0], record.drift[0], record.current_bias[0]
    )
    assert (error <= bound).all()
    # Doubling the disturbance doubles the steady part of the bound.
    single, double = (robust_bound(Gamma, 0.05, 1e-4, 0.1, 0.0, b, np.inf) for b in (1.0, 2.0))
    assert double == pytest.approx(2 * single)


def test_the_disturbance_in_the_bound_drives_the_error():
    """In λ̃' = -Γ Φ Φᵀ λ̃ + b, b is the rate of the error while the estimate is exact."""
    record = servo(quick=True)
    at = len(record.t) // 4
    unknown = Parametrisation(record.constraint, "structured", 200.0)
    rows = record.rows.part(slice(at, at + 1))
    Gamma = np.array([[30.0, 5.0], [5.0, 20.0]]) / np.mean(np.square(record.rows.Phi_flux))
    b = disturbance(rows, unknown, Gamma, record.drift[0], record.current_bias[0])[0]
    row = rows.part(0)
    y_m = np.array([0.3, -0.2])
    rate = RobustObserver(Gamma, 2).derivative(jnp.asarray(record.flux[at]), jnp.asarray(y_m), row)
    np.testing.assert_allclose(b, np.asarray(rate) - (y_m + record.drift[0]), rtol=1e-5)


def test_uniform_observability_of_the_immersion():
    """The Gramian equals an explicit sum, in which each row's transitions move it to the end."""
    rng = np.random.default_rng(3)
    relation = example_orbit().constraint
    immersion = Immersion((relation,), ("drift",))
    v, i = rng.standard_normal((2, 6, 2))
    scale, h = 1 + rng.random(immersion.size), 0.1
    total = np.zeros((immersion.size, immersion.size))
    for k in range(6):
        forward = np.eye(immersion.size)
        for later in range(k + 1, 6):
            forward = immersion.transition(h, v[later]) @ forward
        row = immersion.output_rows(i[k])[0] @ np.linalg.inv(forward) * scale
        total += h * row.T @ row
    gramian = immersion_gramian(immersion, h, v, i, scale)
    np.testing.assert_allclose(gramian, total, atol=1e-9 * np.abs(total).max())


def test_a_drift_hardly_changes_the_multipliers_of_the_counter_example():
    """Numbers of an independent computation with θ = (0.1, -0.05)."""
    case = counter_example(256, drift=(0.1, -0.05))
    form = Parametrisation(case.constraint, "voltage-bias", 1.0)
    psi = np.asarray(form.psi_record(case.rows))
    multipliers = over_gain(psi, case.h, form, (1e-2, 1.0, 1e2)).multipliers(2 * np.pi)
    np.testing.assert_allclose(multipliers, [1.500, 6.742, 10.056], atol=6e-4)


def test_the_peak_gain_is_that_of_a_constant_and_of_a_fast_regressor():
    """One direction at a time: 1/(γ φ²) if it is fixed; with a fast rotation twice that."""
    h, gamma, size = 1e-3, 3.0, 1.4
    fixed = np.tile([size, 0.0], (9000, 1))
    Gamma = gamma * np.eye(2)
    # The other direction forgets nothing: the gain is the length of the record.
    assert peak_gain(fixed, Gamma, h, [8999], 4000) == pytest.approx(4.0, rel=1e-3)
    angle = 200.0 * h * np.arange(9000)
    turning = size * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    expected = 2 / (gamma * size**2)
    assert peak_gain(turning, Gamma, h, [8000, 8500], 8000) == pytest.approx(expected, rel=0.03)


def test_the_peak_gain_is_attained():
    """The disturbance of the proof, simulated with an ODE solver, reaches the bound."""
    rng = np.random.default_rng(4)
    h, rows = 0.01, 600
    t = h * np.arange(rows)
    Phi = np.stack([np.sin(3 * t) + 0.3, np.cos(2 * t + 1)], axis=-1)
    Gamma = np.array([[2.0, 0.4], [0.4, 1.0]])
    gain = peak_gain(Phi, Gamma, h, [rows - 1], rows - 1)

    def steps(k):
        q = Phi[k] @ Gamma @ Phi[k]
        return np.eye(2) - (1 - np.exp(-q * h)) / q * np.outer(Gamma @ Phi[k], Phi[k])

    best = 0.0
    for angle in np.linspace(0, np.pi, 16, endpoint=False):
        v = np.array([np.cos(angle), np.sin(angle)])
        adjoint = [v]
        for k in reversed(range(rows - 1)):
            adjoint.append(steps(k).T @ adjoint[-1])
        b = np.array(adjoint[::-1])
        b /= np.linalg.norm(b, axis=1)[:, None]

        def rate(time, error, b=b):
            k = min(int(time / h), rows - 1)
            return -Gamma @ Phi[k] * (Phi[k] @ error) + b[k]

        error = solve_ivp(rate, (0, t[-1]), [0, 0], max_step=h, rtol=1e-6).y[:, -1]
        best = max(best, float(np.linalg.norm(error)))
    assert best == pytest.approx(gain, rel=0.02)
    # No disturbance of this size exceeds it.
    for _ in range(5):
        b = rng.standard_normal((rows, 2))
        b /= np.linalg.norm(b, axis=1)[:, None]
        error = np.zeros(2)
        for k in range(rows - 1):
            error = steps(k) @ (error + h * b[k])
        assert np.linalg.norm(error) <= gain * 1.01
