"""The lag that nobody states: hypotheses, weighed by the log; priors of the rest."""

import numpy as np
import pytest

import fluxobs
from fluxobs.errors import FluxobsError
from fluxobs.estimation.hypotheses import mixed, weights_of
from fluxobs.machines.model.frames import wrap
from fluxobs.smoothing.record import SHARES
from support.records import SERVO, log_columns, steady
from support.smoothed import fast_run, record, shorten_windows


def late(columns):
    """Return the columns of a drive that logs each voltage one sample before it acts."""
    changed = {}
    for name, values in columns.items():
        early = np.concatenate([values[1:], values[-1:]])
        changed[name] = early if name.startswith("u_") else values
    return changed


@pytest.fixture(scope="module")
def samples():
    return fast_run()


@pytest.fixture(scope="module")
def usual(samples):
    """The estimate with the lag stated and the usual priors."""
    return fluxobs.estimate(log_columns(samples), SERVO, lag=0)


@pytest.mark.parametrize(
    ("lag", "columns"), [pytest.param(0.0, dict, marks=pytest.mark.slow), (-1.0, late)]
)
def test_a_log_with_load_steps_determines_the_lag(samples, lag, columns):
    result = fluxobs.estimate(columns(log_columns(samples)), SERVO)
    assert result.lag.lag == lag
    assert result.lag.decided
    assert result.log.layout.lag == lag
    assert ", learnt from the log (" in result.summary
    stated = fluxobs.estimate(columns(log_columns(samples)), SERVO, lag=lag)
    assert stated.lag is None
    valid = stated["valid"]
    difference = wrap(result["theta_e"] - stated["theta_e"])[valid]
    assert np.degrees(np.abs(difference).max()) < 2  # the first pass had another lag


def test_a_long_log_determines_the_lag_from_segments(samples, monkeypatch):
    shorten_windows(monkeypatch)
    result = fluxobs.estimate(late(log_columns(samples)), SERVO)
    assert result.lag.lag == -1
    error = np.abs(wrap(result["theta_e"] - samples.theta))
    assert result["valid"].mean() > 0.8
    assert np.degrees(error[result["valid"]].max()) < 5


@pytest.mark.parametrize("columns", [pytest.param(dict, marks=pytest.mark.slow), late])
def test_constant_speed_and_load_leave_both(columns):
    """The estimate lies between both lags, and its standard deviation contains the difference."""
    samples = steady(SERVO, 1e-4, 500.0, 3000, 6j, 0.15 - 0.1j, -0.1 + 0.05j, 0.02)
    result = fluxobs.estimate(columns(log_columns(samples)), SERVO)
    assert not result.lag.decided
    # A sample is 2.9° here; the other assumptions move too.
    assert result.lag.position_difference == pytest.approx(500.0 * 1e-4, rel=0.5)
    assert "not determined by the log" in result.summary
    error = np.abs(wrap(result["theta_e"] - samples.theta))
    assert (error < 2 * result["theta_e_std"]).all()
    stated = fluxobs.estimate(columns(log_columns(samples)), SERVO, lag=0)
    assert (result["theta_e_std"] > stated["theta_e_std"]).all()
    lag = {c.name: c for c in result.budget.contributions}.get("lag")
    if result["valid"].any():
        assert lag.std > 0.3 * result.lag.position_difference


def test_two_records_give_the_moments_of_their_mixture():
    records, weights = [record(1, 0.2), record(2, 0.5)], [0.7, 0.3]
    joint, square = mixed(records, weights, ["lag"] * (len(records) - 1))
    for name in ("theta_e", "speed_e", "torque", "psi_f", "resistance"):
        means = np.array([one.outputs[name] for one in records])
        stds = np.array([one.outputs[f"{name}_std"] for one in records])
        mean = np.tensordot(weights, means, 1)
        second = np.tensordot(weights, stds**2 + means**2, 1)
        np.testing.assert_allclose(joint.outputs[name], mean)
        np.testing.assert_allclose(joint.outputs[f"{name}_std"], np.sqrt(second - mean**2))
    difference = records[1].outputs["theta_e"] - records[0].outputs["theta_e"]
    assert square == pytest.approx(np.mean(difference**2))
    added = (joint.shares - records[0].shares)[:, 0, SHARES.index("lag")]
    np.testing.assert_allclose(added, 0.21 * (difference**2).reshape(3, 4).mean(axis=1))


def test_weights_are_those_of_bayes():
    np.testing.assert_allclose(weights_of([3.0, 3.0]), 0.5)
    np.testing.assert_allclose(weights_of([1000.0, 1000.0 + np.log(3)]), [0.75, 0.25])


def test_a_lag_in_the_options_or_in_the_record_is_not_learnt(samples):
    columns = log_columns(samples)
    assert fluxobs.read_log(columns).layout.lag_stated is False
    assert fluxobs.read_log(columns, lag="auto").layout.lag_stated is False
    assert fluxobs.read_log(columns, lag=0).layout.lag_stated
    causal = fluxobs.estimate(columns, SERVO, causal=True)
    assert causal.lag is None


# ---- priors -------------------------------------------------------------------------------------


def test_a_known_quantity_leaves_the_budget(samples, usual):
    columns = log_columns(samples)
    known = fluxobs.estimate(columns, SERVO, lag=0, priors={"lag": 0, "harmonics": 0, "L_d": 0.01})
    by_name = [{c.name: c.std for c in result.budget.contributions} for result in (usual, known)]
    assert by_name[1]["lag"] == by_name[1]["harmonics"] == 0
    assert by_name[1]["L_s"] < 0.2 * by_name[0]["L_s"]
    assert known.budget.std < usual.budget.std


def test_nothing_is_advised_that_is_stated_already(samples, usual):
    columns = log_columns(samples)
    assert "measure the inductances" in usual.budget.advice
    stated = SERVO.with_values(L_s_std=0.1 * SERVO.L_s)
    assert "inductances" not in fluxobs.estimate(columns, stated, lag=0).budget.advice


def test_the_scales_of_the_sensors_are_in_the_parameters(samples):
    columns = log_columns(samples)
    exact = fluxobs.estimate(columns, SERVO, lag=0, priors={"voltage_scale": 0, "current_scale": 0})
    rough = fluxobs.estimate(
        columns, SERVO, lag=0, priors={"voltage_scale": 0.03, "current_scale": 0.04}
    )
    np.testing.assert_array_equal(exact["theta_e_std"], rough["theta_e_std"])
    added = rough["resistance_std"] ** 2 - exact["resistance_std"] ** 2
    np.testing.assert_allclose(np.sqrt(added), 0.05 * rough["resistance"], rtol=0.05)
    added = rough["psi_f_std"] ** 2 - exact["psi_f_std"] ** 2
    np.testing.assert_allclose(np.sqrt(added), 0.03 * rough["psi_f"], rtol=0.05)


def test_a_record_file_states_standard_deviations(samples, tmp_path):
    path = tmp_path / "record.toml"
    path.write_text("lag = 0.0\npriors = { lag = 0.0, offset = 0.01 }\n")
    log = fluxobs.read_log(log_columns(samples), record=path)
    result = fluxobs.estimate(log, SERVO)
    by_name = {c.name: c.std for c in result.budget.contributions}
    assert by_name["lag"] == 0
    given = fluxobs.estimate(log, SERVO, priors={"lag": 0.2})
    assert {c.name: c.std for c in given.budget.contributions}["lag"] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"priors": {"lags": 0.1}}, "prior: unknown 'lags'; did you mean 'lag'"),
        ({"priors": {"lag": -1.0}}, "prior lag=-1: must be finite and not negative"),
        ({"priors": {"lag": 0.1}, "causal": True}, "the observer of a drive does not use it"),
        ({"priors": {"R_R": 0.1}}, "prior R_R: this machine (surface-pmsm) has no cage"),
        ({"priors": {"L_q": 0.1}}, "only one inductance: give L_d"),
        ({"priors": {"asymmetry": 0.01, "voltage_gain": 0.01}}, "give only one of them"),
    ],
)
def test_impossible_priors_are_refused(samples, options, message):
    with pytest.raises(FluxobsError, match="prior") as refused:
        fluxobs.estimate(log_columns(samples), SERVO, **options)
    assert message in str(refused.value)


def test_the_island_between_unknown_rows_is_not_valid():
    from fluxobs.smoothing.estimate import trusted

    rows = 3000
    angle = wrap(np.linspace(0, 60, rows))
    std = np.full(rows, np.radians(1.0))
    std[1000:1100] = std[1200:1300] = np.radians(20.0)  # 2 rad between them
    valid = trusted(angle, std, np.zeros(rows, bool))
    assert valid[:1000].all()
    assert valid[1300:].all()
    assert not valid[1000:1300].any()
    wider = np.where(std > 0.1, np.radians(5.0), std)  # not valid, but not lost
    assert trusted(angle, wider, np.zeros(rows, bool))[1100:1200].all()
