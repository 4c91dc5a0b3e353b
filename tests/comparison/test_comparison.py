"""Scores, error bound, scenarios and comparison of observers."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from fluxobs.comparison import report
from fluxobs.comparison.bound import Unknowns, position_bound, two_sided_bound
from fluxobs.comparison.catalogue import CATALOGUE
from fluxobs.comparison.compare import LANES, compare_scenario, setting_for
from fluxobs.comparison.scenarios import SCENARIOS, believed_machine, run_scenario, scenario
from fluxobs.comparison.scoring import Truth, score, scored_error
from fluxobs.errors import ModelError
from fluxobs.machines import example
from support.records import steady

FEW = [
    entry
    for entry in CATALOGUE
    if entry.name in ("least squares", "gradient (Ortega, Lee)", "extended EMF with PLL")
]


def truth(rows=1000, half_turn=False, score_from=0.2):
    machine = example("synrm-6kw7" if half_turn else "pmsm-2kw2")
    t = np.arange(rows) * 1e-3
    return Truth(t, 5 * t, np.full(rows, 5.0), np.exp(5j * t), score_from, machine)


# ---- scores ----------------------------------------------------------------------------------


def test_scores_of_known_errors():
    truth_ = truth()
    theta = truth_.theta_e + 0.1 + 2 * np.pi * np.arange(1000)
    scores = score(theta, truth_.speed_e + 2.0, truth_.flux * 1.01, truth_)
    assert scores.rms == pytest.approx(0.1)
    assert scores.worst == pytest.approx(0.1)
    assert scores.speed == pytest.approx(2.0)
    assert scores.flux == pytest.approx(0.01)
    assert (scores.settled, scores.lost) == (0.0, 0.0)


def test_settling_and_loss():
    truth_ = truth()
    error = np.zeros(1000)
    error[:120] = 1.0  # settles after 120 ms …
    error[60:100] = 0.0  # … not in a gap shorter than 50 ms
    error[500:600] = 2.0  # lost on 100 of 800 scored rows
    scores = score(truth_.theta_e + error, truth_.speed_e, truth_.flux, truth_)
    assert scores.settled == pytest.approx(0.12)
    assert scores.lost == pytest.approx(100 / 800)
    never = score(truth_.theta_e + 1.0, truth_.speed_e, truth_.flux, truth_)
    assert np.isnan(never.settled)


def test_reluctance_machines_ignore_half_a_turn_and_nan_counts_as_half_a_turn():
    assert np.allclose(scored_error(truth().theta_e + np.pi, truth(half_turn=True)), 0)
    error = scored_error(np.full(1000, np.nan), truth())
    assert np.allclose(np.abs(error), np.pi)


# ---- bound -----------------------------------------------------------------------------------


def test_bound_equals_the_information_of_all_samples():
    """For R = 0, the recursion equals the inverse of the summed information of all samples."""
    h, L, noise, psi, omega = 1e-3, 0.03, 0.02, 0.5, 40.0
    theta = 0.4 + omega * h * np.arange(200)
    drift_prior = 0.2
    bound = position_bound(theta, np.full(200, psi), h, L, 0.0, noise, drift_prior)
    variance = (L * noise) ** 2
    for rows in (50, 200):
        information = np.diag(1 / np.array([psi, psi, drift_prior, drift_prior, psi]) ** 2)
        # The unknowns apply at the first row; g is the regressor of row k.
        for k in range(rows):
            c, s, age = np.cos(theta[k]), np.sin(theta[k]), k * h
            g = np.array([c, s, age * c, age * s, -1.0])
            information += np.outer(g, g) / variance
        transition = np.eye(5)
        transition[0, 2] = transition[1, 3] = (rows - 1) * h
        P = transition @ np.linalg.inv(information) @ transition.T
        tangent = np.array([-np.sin(theta[rows - 1]), np.cos(theta[rows - 1]), 0, 0, 0])
        expected = np.sqrt((tangent @ P @ tangent + variance) / psi**2)
        assert bound[rows - 1] == pytest.approx(expected, rel=1e-6)


def test_the_bound_from_both_sides_equals_the_information_of_all_samples():
    """With saliency and R: the angle of each row, from one inverse of the joint information."""
    machine, h, n = example("ipm-2kw2"), 1e-3, 60
    theta = 0.4 + 40.0 * h * np.arange(n)
    i = (-1.0 + 3.0j) * np.linspace(0.5, 1.0, n)
    stator = i * np.exp(1j * theta)
    noise, drift, psi_std, R_std = 0.02, 0.2, 0.05, 0.3
    unknowns = Unknowns(noise, drift, psi_std=psi_std, resistance_std=R_std)
    exact = machine.with_values(R_s=1e-9)  # its noise in the flux is neglected below
    current = np.stack([stator.real, stator.imag], axis=1)
    bound = two_sided_bound(exact, theta, current, h, unknowns)
    L_d, L_q, psi = machine.L_d, machine.L_q, machine.psi_f
    auxiliary = psi + (L_d - L_q) * i.conj()
    size, along = np.abs(auxiliary), auxiliary / np.abs(auxiliary)
    charge = h * np.cumsum(np.concatenate([[[0, 0]], current[1:]]), axis=0)
    prior = [np.median(size), np.median(size), drift, drift, psi_std, R_std]
    information = np.diag(1 / np.array(prior) ** 2)

    def regressor(k, direction):
        """Derivatives of the residual along a direction, by the unknowns at the first row."""
        stator = direction * np.exp(1j * theta[k])
        x, y = stator.real, stator.imag
        return np.array([x, y, k * h * x, k * h * y, -direction.real, -charge[k] @ [x, y]])

    def noise_along(direction):
        return (noise * L_d * direction.real) ** 2 + (noise * L_q * direction.imag) ** 2

    for k in range(n):
        row = regressor(k, along[k])
        information += np.outer(row, row) / noise_along(along[k])
    joint = np.linalg.inv(information)
    for k in (0, 20, n - 1):
        across = regressor(k, 1j * along[k])
        variance = across @ joint @ across + noise_along(1j * along[k])
        assert bound[k] == pytest.approx(np.sqrt(variance) / size[k], rel=1e-4)


def test_the_least_squares_reaches_the_bound():
    machine, h = example("pmsm-2kw2"), 1.25e-4
    sigma, mean_squares = 0.02, []
    setting = None
    for seed in range(4):
        data = steady(machine, h, 300.0, 6000, 4j, 0.1, 1.0, noise=sigma, seed=seed)
        setting = setting or setting_for(h, data.voltage, data.current, machine, 471.0)
        observer = FEW[0].build(setting, {"memory": 0.1})
        estimate = observer.run(data.voltage, data.current)
        error = np.angle(np.exp(1j * (estimate.theta_e - data.theta)))[2000:]
        mean_squares.append(np.mean(error**2))
    bound = position_bound(
        data.theta, np.full(6000, machine.psi_f), h, machine.L_s, machine.R_s, sigma, 2.0
    )[2000:]
    ratio = np.sqrt(np.mean(mean_squares) / np.mean(bound**2))
    assert 0.97 < ratio < 1.05


# ---- scenarios -------------------------------------------------------------------------------


def test_required_scenarios_exist():
    for name in (
        "ideal",
        "current-bias-plus",
        "current-bias-minus",
        "voltage-bias-plus",
        "voltage-bias-minus",
        "bias-drifts",
        "noise",
        "R-50",
        "R-80",
        "R-120",
        "R-150",
        "L-80",
        "L-120",
        "psi-80",
        "psi-120",
        "dead-time",
        "low-speed-1",
        "load-step",
        "reversal",
        "unknown-start",
        "dc-link-sag",
        "gain-mismatch",
        "sensor-saturation",
    ):
        assert scenario(name).about
    with pytest.raises(ModelError, match=r"no scenario 'calm'; there are ideal, noise"):
        scenario("calm")


def test_records_match_their_scenario():
    """The record contains biases, noise and clipped currents; the drive tracks the references."""
    run, machine, rated = run_scenario(scenario("current-bias-plus"), "pmsm-2kw2")
    offset = np.mean(run.trace.measured_current - run.trace.current)
    assert abs(offset) == pytest.approx(0.05 * machine.rated_current, rel=0.01)
    noise = np.std((run.trace.measured_current - run.trace.current).real)
    assert noise == pytest.approx(machine.rated_current / 300, rel=0.03)
    row = np.searchsorted(run.t, 1.65)
    assert machine.n_p * run.trace.speed[row] / rated.speed_e == pytest.approx(1.0, abs=0.01)
    assert run.trace.torque[row] == pytest.approx(rated.torque, rel=0.03)
    saturated, _, _ = run_scenario(scenario("sensor-saturation"), "pmsm-2kw2")
    assert np.abs(saturated.trace.current).max() > 1.02 * machine.rated_current


def test_assumed_parameters_are_scaled():
    ipm = believed_machine(example("ipm-2kw2"), {"L": 0.5, "R": 2.0, "psi": 3.0})
    assert (ipm.L_d, ipm.L_q) == pytest.approx((18e-3, 25.5e-3))
    assert (ipm.R_s, ipm.psi_f) == pytest.approx((7.2, 1.635))
    assert believed_machine(example("synrm-6kw7"), {"psi": 2.0}) == example("synrm-6kw7")


# ---- comparison ------------------------------------------------------------------------------


def test_grids_fit_into_the_lanes_and_begin_with_recommended_gains():
    data = steady(example("pmsm-2kw2"), 1.25e-4, 300.0, 2000)
    setting = setting_for(1.25e-4, data.voltage, data.current, example("pmsm-2kw2"), 471.0)
    for entry in CATALOGUE:
        candidates = list(entry.candidates(setting))
        assert 2 <= len(candidates) <= LANES, entry.name
        assert candidates[0] == entry.recommended(setting)


@pytest.fixture(scope="module")
def both_biases():
    return compare_scenario(scenario("both-biases"), "pmsm-2kw2", entries=FEW)


@pytest.mark.slow
def test_the_least_squares_is_at_the_bound_where_others_have_a_bias(both_biases):
    least_squares = both_biases.result("least squares").tuned
    assert least_squares.rms / both_biases.bound < 1.05
    assert both_biases.best.name.startswith("least squares")
    for name in ("gradient (Ortega, Lee)", "extended EMF with PLL"):
        assert both_biases.result(name).tuned.rms > 10 * least_squares.rms
    for result in both_biases.results:
        assert result.tuned.rms <= result.recommended.rms


@pytest.mark.slow
def test_report(both_biases, tmp_path):
    text = report.verdict(both_biases)
    assert "times the Cramér-Rao bound" in text
    assert "The least squares is the best observer" in text
    assert report.table(both_biases).row_count == len(both_biases.results)
    report.draw(both_biases, tmp_path / "one.png")
    report.draw_summary([both_biases, both_biases], tmp_path / "all.png")
    report.write_csv([both_biases], tmp_path / "scores.csv")
    assert (tmp_path / "one.png").stat().st_size > 10_000
    assert (tmp_path / "all.png").stat().st_size > 10_000
    frame = pl.read_csv(tmp_path / "scores.csv")
    assert len(frame) == 2 * len(both_biases.results)
    row = frame.filter((pl.col("observer") == "least squares") & (pl.col("gains") == "tuned"))
    assert row["rms_deg"][0] == pytest.approx(
        np.degrees(both_biases.result("least squares").tuned.rms), rel=1e-4
    )


def test_scenarios_that_violate_the_model_state_a_limit():
    """The `limit` of a scenario explains the error of the least squares."""
    for name in ("R-50", "dead-time", "bias-jumps", "gain-mismatch", "low-speed-1"):
        assert SCENARIOS[name].limit


def test_the_bound_with_resistance_equals_batch_least_squares():
    """Noise through the resistive drop, with the weights of the cubic: the brute-force sum.

    The batch has the flux at the last row, the drift, ψ, and the noise of every sample as unknowns;
    each row's relation is exact in them.
    """
    h, L, R, noise, psi, drift_prior = 1e-3, 0.004, 2.0, 0.05, 0.5, 0.2
    rows = 24
    theta = 0.4 + 250.0 * h * np.arange(rows)
    bound = position_bound(theta, np.full(rows, psi), h, L, R, noise, drift_prior)
    unknowns = 5 + 2 * rows
    cubic = np.array([9, 19, -5, 1]) / 24
    # Flux error at row k: initial error, drift, and the resistive drop of the noises.
    flux = np.zeros((rows, 2, unknowns))
    for axis in (0, 1):
        for k in range(rows):
            flux[k, axis, axis], flux[k, axis, 2 + axis] = 1.0, k * h
            for interval in range(1, k + 1):
                for j, weight in enumerate(cubic):
                    if interval - j >= 0:
                        flux[k, axis, 5 + 2 * (interval - j) + axis] -= h * R * weight
    prior = np.array([psi, psi, drift_prior, drift_prior, psi, *[noise] * (2 * rows)]) ** 2
    # The recursion's first samples have noises before the record, which the batch lacks.
    P = np.diag(prior)
    for k in range(rows):
        own = np.zeros((2, unknowns))
        own[:, 5 + 2 * k : 7 + 2 * k] = L * np.eye(2)
        e = np.array([np.cos(theta[k]), np.sin(theta[k])])
        residual = e @ (flux[k] - own)
        residual[4] -= 1.0
        gain = P @ residual
        P = P - np.outer(gain, gain) / (residual @ gain)
    across = np.array([-e[1], e[0]]) @ (flux[-1] - own)
    assert bound[-1] == pytest.approx(np.sqrt(across @ P @ across) / psi, rel=2e-3)
