"""The reproduction agrees with other solvers, closed forms and the paper's text."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from fluxobs.machines import example
from fluxobs.research.paper import closed_loop, levitation_errata, stability
from fluxobs.research.paper import levitation as lev
from fluxobs.research.paper.converged import converged_run
from fluxobs.research.paper.later_line import observability
from fluxobs.research.paper.levitation import (
    ADAPTIVE_GAIN,
    CORNER,
    SCENARIOS,
    filtered,
    measured,
    record,
)
from fluxobs.research.paper.section_v import levitation_observer, levitation_run, sizes
from fluxobs.research.paper.studies import parameters
from fluxobs.research.regression import Parametrisation, Regressors


def test_the_settings_are_those_of_the_paper():
    """Every number is that of Section V-B, except G and φ(0), which the paper does not give."""
    m = example("maglev-knospe")
    assert (m.J, m.k_1, m.k_2, m.resistance, m.N) == (9.67e-2, 2.2e-8, 2.2e-8, 1.6, 321)
    assert (m.c_1, m.c_2, m.g, m.D) == (293.5, 293.5, 3.3e-4, 0.145)
    assert (lev.CORNER, lev.R_A, lev.ROBUST_GAIN) == (50, 1e-2, 1e4)
    assert lev.ADAPTIVE_GAIN == (1e20, 1e20, 1e20, 1e20, 2e13, 2e13, 20)
    assert (lev.JUMP, lev.DURATION) == (50, 100)
    np.testing.assert_array_equal(lev.CURRENT_BIAS, [[-0.003, 0.0025], [0.001, 0.0008]])
    np.testing.assert_array_equal(lev.VOLTAGE_BIAS, [[0, 0], [0.002, 0.0002]])
    scenario = SCENARIOS["S1"]
    assert (scenario.alpha, scenario.bias_current, scenario.depth) == (10, 0, 0)
    assert (scenario.G, scenario.initial_flux) == (1e4, 1e-5)
    t = jnp.array(0.37)
    assert float(lev.PositionReference(jnp.asarray(1e9))(t)) == pytest.approx(
        1e-5 * (6 * np.sin(3.7) + 4 * np.sin(7.4) + 6 * np.sin(5.55))
    )


@cache
def main():
    """Return the first seconds of S5 with a jump, in which the laws are already stiff."""
    return record(SCENARIOS["S5"], quick=True)


@pytest.mark.slow
def test_the_record_settles_to_the_periodic_orbit():
    trajectory, drive = lev.orbit("S5").trajectory, main()
    assert np.abs(lev.orbit("S5").multipliers).max() < 1e-6
    k = np.searchsorted(drive.t, np.arange(2 * np.pi, 6 * np.pi, 0.5))
    phase = np.mod(drive.t[k], 2 * np.pi)
    spline = CubicSpline(trajectory.t, trajectory.flux)
    np.testing.assert_allclose(spline(phase), drive.trajectory.flux[k], rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("segment", "expected"), [(0, 0.00815), (1, 0.01703)])
def test_growth_on_the_orbit_against_another_solver(segment, expected):
    """With the printed gains, LSODA gives this monodromy matrix from the regressor's spline."""
    psi, h = stability.psi_on_orbit("S5", segment)
    constants = stability.printed_constants()
    study = stability.over_gain(psi, h, constants, (1.0,), np.array(ADAPTIVE_GAIN))
    assert study.exponent[0] == pytest.approx(expected, abs=5e-5)
    root = np.sqrt(np.array(ADAPTIVE_GAIN))
    closed = np.vstack([psi, psi[:1]]) * root
    spline = CubicSpline(h * np.arange(len(closed)), closed, bc_type="periodic")
    N = np.zeros((7, 7))
    N[:2, 2:4] = np.eye(2)  # the gains of flux and drift are equal

    def jacobian(t, x):
        row = spline(t)
        return N - np.outer(row, row)

    columns = [
        solve_ivp(
            lambda t, x: jacobian(t, x) @ x,
            (0, 2 * np.pi),
            start,
            method="LSODA",
            jac=jacobian,
            rtol=1e-8,
            atol=1e-11,
        ).y[:, -1]
        for start in np.eye(7)
    ]
    largest = np.abs(np.linalg.eigvals(np.array(columns).T)).max()
    assert np.log(largest) / (2 * np.pi) == pytest.approx(study.exponent[0], rel=3e-3)


@pytest.mark.slow
def test_a_scalar_gain_is_unstable_at_every_gain_and_in_the_limit():
    study = stability.scalar_gain()
    assert study.alpha == pytest.approx(6.43e-5, rel=0.01)
    for unit, multipliers in study.multipliers.items():
        # With the drift in fluxes per second, one gain is stable; higher gains are unstable.
        assert (multipliers > 1.0).sum() == len(study.gains) - (unit == 0.155)
        assert multipliers[-1] > 1.05
        assert multipliers[-1] == pytest.approx(multipliers[-2], rel=1e-2)
    plain = study.multipliers[1.0]
    assert plain[0] == pytest.approx(1.0326, abs=1e-3)
    assert plain[-1] == pytest.approx(6.11e4, rel=0.01)
    # As γ → ∞, the error stays orthogonal to Ψ and loses one dimension: x' = N x - ψ (ψᵀN x +
    # ψ'ᵀx)/|ψ|².
    psi, h = stability.psi_on_orbit("S5", 0)
    scaled, units = stability.unit_regressor(psi)
    N = np.zeros((7, 7))
    N[:2, 2:4] = np.diag(units[2:4] / units[:2])
    closed = CubicSpline(
        h * np.arange(len(scaled) + 1), np.vstack([scaled, scaled[:1]]), bc_type="periodic"
    )
    slope = closed.derivative()

    def across(t, flat):
        x, row = flat.reshape(7, 6), closed(t)
        return (N @ x - np.outer(row, (row @ N + slope(t)) @ x) / (row @ row)).ravel()

    start = np.linalg.svd(closed(0)[None])[2][1:].T
    end = solve_ivp(across, (0, 2 * np.pi), start.ravel(), method="DOP853", rtol=1e-8, atol=1e-10)
    limit = np.abs(np.linalg.eigvals(start.T @ end.y[:, -1].reshape(7, 6))).max()
    assert limit == pytest.approx(plain[-1], rel=1e-3)


@cache
def converged(form):
    """Return the printed law before and after an early jump, with its record and regression."""
    whole = main()
    cut = slice(0, 1601)
    trajectory = whole.trajectory
    short = type(trajectory)(
        trajectory.system,
        *(
            getattr(trajectory, name)[cut]
            for name in (
                "t",
                "flux",
                "flux_rate",
                "current",
                "position",
                "velocity",
                "momentum",
                "voltage",
            )
        ),
    )
    drive = measured(whole.scenario, whole.machine, short, 0.8)
    regression = filtered(drive)[form == "printed"]
    constants = Parametrisation(drive.constraint, "printed", CORNER)
    return (
        drive,
        regression,
        constants,
        converged_run(drive, regression, ADAPTIVE_GAIN, constants, 300),
    )


@pytest.mark.parametrize("form", ["corrected", "printed"])
def test_printed_law_against_another_solver(form):
    """LSODA integrates the published law for the estimate instead of the error."""
    drive, regression, constants, run = converged(form)
    assert run.change < 1e-3
    root = np.sqrt(np.array(ADAPTIVE_GAIN))
    jump = int(np.searchsorted(drive.t, drive.jump - 5e-4))
    x = np.r_[np.cumsum(drive.volt_seconds[:301], axis=0)[-1], np.zeros(5)] / root
    y_m = drive.trajectory.flux_rate / np.array([drive.machine.c_1, drive.machine.c_2])
    for rows, drift in (
        (slice(300, jump + 1), drive.drift[0]),
        (slice(jump, None), drive.drift[-1]),
    ):
        used = regression.rows.part(rows)
        if rows.start == jump:  # the first row belongs to the biases after the jump
            used = Regressors(
                *(
                    np.concatenate([np.asarray(after)[None], entries[1:]])
                    for after, entries in zip(regression.after_jump, used, strict=True)
                )
            )
        psi = CubicSpline(drive.t[rows], np.asarray(constants.psi_record(used)) * root)
        y = CubicSpline(drive.t[rows], np.asarray(used.y))
        input_rate = CubicSpline(drive.t[rows], y_m[rows] - drift)

        def field(t, x, psi=psi, y=y, input_rate=input_rate):
            rate = psi(t) * (y(t) - psi(t) @ x)
            rate[:2] += (input_rate(t) + root[2:4] * x[2:4]) / root[:2]
            return rate

        def jacobian(t, x, psi=psi):
            matrix = -np.outer(psi(t), psi(t))
            matrix[:2, 2:4] += np.diag(root[2:4] / root[:2])
            return matrix

        x = solve_ivp(
            field,
            (drive.t[rows][0], drive.t[rows][-1]),
            x,
            method="LSODA",
            jac=jacobian,
            rtol=1e-6,
            atol=1e-10 * np.abs(x).max(),
        ).y[:, -1]
    truth = np.r_[drive.flux[-1], constants.constants(drive.drift[-1], drive.current_bias[-1])]
    error = x * root - truth
    np.testing.assert_allclose(run.error[-1, :2], error[:2], rtol=5e-3)
    np.testing.assert_allclose(run.error[-1, 2:4], error[2:4], rtol=5e-3)


def test_parameter_errors_start_at_their_size_and_end_at_zero():
    drive = main()
    run = levitation_run(drive, all_observers=False)
    for name in ("adaptive, printed gain", "adaptive, repaired"):
        # Zero estimates have errors of 100 % of θ and 100 % of the block from δ_i.
        assert run.courses[name].constants[10] == pytest.approx(np.sqrt(2), rel=1e-6)
    for name in ("adaptive, repaired", "least squares"):
        before = np.searchsorted(run.courses[name].t, drive.jump) - 2
        assert run.courses[name].constants[before] < 1e-3, name
        assert run.courses[name].constants[-1] < 1e-3, name
    theta = np.linalg.norm(drive.drift[0])
    assert run.courses["adaptive, printed gain"].parameters[10] == pytest.approx(theta, rel=1e-6)
    # With the printed gain, the robust law equals the voltage model, which integrates the drift.
    t = run.courses["voltage model"].t
    at = np.searchsorted(t, 10.0)
    for name in ("voltage model", "robust, printed gain"):
        error = run.courses[name].flux[at] * np.linalg.norm(drive.flux, axis=1).max()
        exact = np.linalg.norm(-drive.flux[0] - 10.0 * drive.drift[0])
        assert error == pytest.approx(exact, rel=1e-3), name
    # The scale of each constant's errors is its largest entry, within a factor of two.
    printed = Parametrisation(drive.constraint, "printed", CORNER)
    size = sizes(drive)[1]
    for name, block in (("θ", slice(0, 2)), ("θᵀQ1θ", slice(4, 5))):
        both = [printed.constants(drive.drift[k], drive.current_bias[k])[block] for k in (0, -1)]
        assert 0.5 < np.abs(both).max() / size[2:][block].max() < 2, name
    estimates = parameters(run)
    assert estimates["before"]["drift"].known > 0.9
    np.testing.assert_allclose(estimates["after"]["current bias"].estimate, [1e-3, 8e-4], rtol=1e-3)


def test_noise_of_the_relation_by_monte_carlo():
    """The least squares weights its relation by the scatter due to noise.

    Current noise acts immediately; voltage noise is summed over the memory.
    """
    m, h, memory = example("maglev-knospe"), 1e-3, 0.5
    noise, rng, count = (1e-3, 1e-2), np.random.default_rng(3), 4000
    size = m.k_2 * 0.5 / m.g
    flux = np.full((count, 2), size)
    current = 0.5 + noise[0] * rng.standard_normal((count, 2))
    volt_seconds = h * noise[1] * rng.standard_normal((count, round(memory / h), 2)) @ m.B.T
    sensed = m.constraint.residual(flux, current).std()
    drifted = m.constraint.residual(flux + volt_seconds.sum(axis=1), np.full((count, 2), 0.5)).std()
    for noise_std, scatter in (((noise[0], 0.0), sensed), ((0.0, noise[1]), drifted)):
        sigma = levitation_observer(m, h, memory, noise_std).constraint_noise[0]
        assert sigma == pytest.approx(scatter, rel=0.5)


def test_erratum_8():
    """The literal model grows at R g/k (1 - 1/(N c)), z̃₂ slows a pole, φ* = 0 has no minimum."""
    study, m = levitation_errata.study(), example("maglev-knospe")
    growth = m.resistance * m.g / m.k_1 * (1 - 1 / (m.N * m.c_1))
    assert growth == pytest.approx(2.40e4, rel=2e-3)
    assert study.literal_growth == pytest.approx(growth, rel=2e-3)
    assert study.poles[1].real == pytest.approx(-17.86, abs=0.01)
    assert study.printed_poles[1].real == pytest.approx(-2.59, abs=0.01)
    assert study.poles[2] == pytest.approx(-41.12 + 8641.2j, abs=0.1) or study.poles[
        2
    ] == pytest.approx(-41.12 - 8641.2j, abs=0.1)
    assert study.stiffness > 1e-6
    assert abs(study.stiffness_without_flux) < 1e-15


def test_observability_distinguishes_scenarios():
    """With 1 mA of noise, the flux is known within a few percent in S5, but unknown in S3."""
    strong = observability(main())
    weak = observability(record(SCENARIOS["S3"], quick=True))
    assert strong.flux_std < 0.05 < 0.3 < weak.flux_std
    assert weak.least < 1e-2 * strong.least


def test_the_loop_closes_on_the_least_squares_and_survives_the_jump():
    rig = closed_loop.levitation()
    result = closed_loop.simulate(
        rig, closed_loop.FromLeastSquares, closed_loop.SAMPLE, jump=2.5, stop=4.0
    )
    assert result.handed_over < 2.0
    assert result.lost is None
    assert result.flux_error < 1e-6
    assert result.peak < 0.5
    # With the true state, tracking is not better: the remaining distance is the law's own lag.
    assert result.before == pytest.approx(0.13, abs=0.02)


def test_rigs_are_scaled_versions_of_one_problem():
    """In their own units, the actuator without spring, the bearing and the levitation agree."""
    paths = []
    for rig in (closed_loop.levitation(), closed_loop.bearing_axis()):
        v, _ = closed_loop.nominal_record(rig, closed_loop.SAMPLE * rig.unit, 3.0)
        paths.append(np.cumsum(v, axis=0) / rig.typical)
    assert np.abs(paths[0] - paths[1]).max() < 0.1
    # The scaling must not change these dimensionless groups.
    groups = []
    for rig in closed_loop.rigs():
        m, law, phi = rig.machine, rig.law, rig.typical
        force = m.c_2 * phi**2 / (2 * m.k_2)
        mass = m.J / m.D**2
        groups.append(
            [
                float(law.alpha) * m.g / (m.D * phi),
                float(law.G) * m.g / force,
                float(law.R_a) * mass / rig.unit,
                force * rig.unit**2 / (mass * m.g),
                rig.current_bias[0, 0] * m.k_2 / (m.g * phi),
                float(law.flux_reference(0.3 * rig.unit)) / phi,
                float(law.position_reference(0.3 * rig.unit)) / m.g,
            ]
        )
    np.testing.assert_allclose(groups, np.tile(groups[0], (len(groups), 1)), rtol=1e-6)
    noise = closed_loop.noisy(closed_loop.levitation()).noise
    assert noise == pytest.approx((1e-3, 1e-2))
