"""The posterior of a whole log, and the forward run where nothing explains the currents."""

from dataclasses import replace

import numpy as np
import pytest

from fluxobs.estimation import posterior_log
from fluxobs.estimation.lag import LAGS
from fluxobs.estimation.passes import Passes
from fluxobs.estimation.posterior_log import PosteriorLog
from fluxobs.estimation.statistics import Statistics
from fluxobs.machines import example
from fluxobs.observers.unknowns import AUTO
from fluxobs.simulation.closed_form.demo import (
    CURRENT_OFFSET,
    INVERTER_VOLTAGE,
    VOLTAGE_OFFSET,
    demo_log,
)

SERVO = example("servo-400w")


def estimated(log):
    """Return the estimate of a log, its rows and their statistics."""
    run = Passes.begun(log, SERVO, (AUTO,), None, {}, causal=True).run
    whole = PosteriorLog(run, {}, lambda _: None, LAGS)
    (rows,) = whole.rows()
    statistics = Statistics(len(log))
    statistics.add(rows)
    return whole, rows, statistics


@pytest.fixture(scope="module")
def demo():
    return estimated(demo_log())


def test_every_row_of_the_demonstration(demo):
    _, rows, statistics = demo
    assert statistics.valid == statistics.rows
    assert statistics.rms_error < np.radians(0.3)
    assert (np.abs(rows.error) < 2 * rows.columns["theta_e_std"]).mean() > 0.95


def test_what_is_learnt_is_true(demo):
    whole, rows, statistics = demo
    learnt = whole.parameters(statistics)
    true = {"psi_f": SERVO.psi_f, "resistance": SERVO.R_s, "inverter_voltage": INVERTER_VOLTAGE}
    for name, value in true.items():
        std = getattr(learnt, name.replace("_voltage", "") + "_std")
        assert abs(getattr(learnt, name) - value) < 3 * std, name
    error, std = learnt.inductance_error[0], learnt.inductance_std[0]
    assert abs(error) < 3 * std < 0.15
    assert learnt.offset == pytest.approx(CURRENT_OFFSET, abs=3 * max(learnt.offset_std))
    drift = [rows.columns[f"drift_{axis}"].mean() for axis in ("alpha", "beta")]
    needed = [-offset for offset in VOLTAGE_OFFSET]
    assert drift == pytest.approx(needed, abs=3 * rows.columns["drift_std"].mean())


def test_the_items_of_the_budget_add_up(demo):
    whole, rows, _ = demo
    total = np.sqrt((rows.columns["theta_e_std"] ** 2).mean())
    shown = np.sqrt(sum(item.std**2 for item in whole.budget.contributions))
    assert whole.budget.std == pytest.approx(total, rel=0.01)
    assert shown == pytest.approx(total, rel=0.01)


@pytest.mark.parametrize("wrong", [0, 1, -1])
def test_the_lag_is_found(wrong):
    """Read with a voltage that acts a sample too early or too late."""
    whole, _, statistics = estimated(demo_log().lagged(wrong))
    lag, (fraction, std) = whole.lag(), whole.fractional_lag()
    assert lag.lag == 0
    assert lag.decided
    assert abs(fraction) < 3 * std < 0.1
    assert statistics.rms_error < np.radians(0.4)


def test_what_nothing_explains_has_the_forward_run(demo, monkeypatch):
    whole = demo[0]
    known = whole.posterior
    angle = known.rows["angle"].copy()
    angle[4000:] = np.nan
    half = replace(known, rows=known.rows | {"angle": angle})
    for posterior, first in ((half, 4000), (None, 0)):
        monkeypatch.setattr(posterior_log, "posterior_of", lambda *_, p=posterior, **__: p)
        other, rows, _ = estimated(demo_log())
        forward = Passes.begun(demo_log(), SERVO, (AUTO,), None, {}, causal=True)
        columns = [part.columns for part in forward.rows()]
        alone = {n: np.concatenate([c[n] for c in columns]) for n in ("theta_e", "valid")}
        for name, values in alone.items():
            assert np.array_equal(rows.columns[name][first:], values[first:])
        assert np.isfinite(other.budget.misfit) == (posterior is not None)
