"""Columns of a levitation's estimates, and the facts of a run, in closed form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import fluxobs
from fluxobs.estimation.columns import _immersed
from fluxobs.estimation.truth import TruthFit, TruthParameter
from fluxobs.logs.time.aligned import Aligned
from fluxobs.observers import ImmersionEstimate
from fluxobs.presentation.result_data import facts
from support.records import SERVO, log_columns, steady

ROWS = 6


class Magnet:
    """A machine whose position is flux plus current of port 1, with the flux's deviation."""

    ports = ("1", "2")
    position_span = 2.0
    shortest = 0.5
    position_output = SimpleNamespace(name="position")

    def position(self, flux, current):
        return flux[:, 0] + current[:, 0], np.hypot(*flux.T)

    def position_std(self, flux, flux_std, current):
        return flux_std[:, 0]


def immersed(unknowns=("drift",), **changed):
    """Return the columns of six valid rows, with changed outputs."""
    ones = np.ones((ROWS, 2))
    fields = {name: ones.copy() for name in ImmersionEstimate.__annotations__}
    fields |= {"valid": np.ones(ROWS, bool), "flux_std": 0.01 * ones}
    fields |= {"current_bias_valid": np.ones(ROWS, bool), "current_bias": 0.25 * ones}
    estimates = ImmersionEstimate(**(fields | changed))
    batch = Aligned(np.arange(6.0), 3.0 * ones, ones, None)
    observer = SimpleNamespace(
        flux_base=np.array([2.0, 9.0]), immersion=SimpleNamespace(unknowns=unknowns)
    )
    return _immersed(Magnet(), observer, batch, estimates)


def test_the_position_follows_from_the_current_without_its_bias():
    columns, valid = immersed()
    np.testing.assert_array_equal(columns["position"], 1.0 + 3.0 - 0.25)
    np.testing.assert_array_equal(columns["position_std"], 0.01)
    assert valid.all()
    assert columns["valid"] is valid


def test_a_position_is_valid_within_five_percent_of_its_span():
    std = np.zeros((ROWS, 2))
    std[:, 0] = [0.01, 0.0999, 0.1, 0.1001, 0.2, np.nan]
    assert immersed(flux_std=std)[1].tolist() == [True, True, False, False, False, False]


def test_a_position_is_valid_where_the_flux_is_long_enough():
    """The limit is half of the flux base."""
    flux = np.zeros((ROWS, 2))
    flux[:, 1] = [0.9, 0.999, 1.0, 1.001, -1.5, np.nan]
    assert immersed(flux=flux)[1].tolist() == [False, False, False, True, True, False]


def test_rows_that_the_observer_calls_invalid_stay_invalid():
    assert immersed(valid=np.arange(ROWS) > 2)[1].tolist() == [False] * 3 + [True] * 3


def test_the_noise_share_is_the_larger_of_the_ports():
    share = np.stack([np.arange(6.0), 5 - np.arange(6.0)], axis=1)
    np.testing.assert_array_equal(immersed(noise_share=share)[0]["noise_share"], [5, 4, 3, 3, 4, 5])


def test_a_current_bias_is_written_if_it_is_an_unknown():
    assert not any("current_bias" in name for name in immersed()[0])
    bias_valid = np.arange(ROWS) != 1
    columns, valid = immersed(
        ("drift", "current-bias"), valid=np.arange(ROWS) != 4, current_bias_valid=bias_valid
    )
    np.testing.assert_array_equal(columns["current_bias_1"], 0.25)
    np.testing.assert_array_equal(columns["current_bias_valid"], valid & bias_valid)


# ---- facts ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run():
    samples = steady(SERVO, 1e-4, 500.0, 2000, 6j, noise=0.02)
    return fluxobs.estimate(log_columns(samples), SERVO, unknowns="drift")


def test_facts_are_the_numbers_of_a_run(run):
    statistics = replace(
        run.statistics,
        rows=200,
        valid=50,
        start=1.0,
        first_valid=1.5,
        sums={"drift_alpha": 5.0, "drift_beta": -10.0},
        scored=40,
        error=8.0,
        error_squared=40 * 0.09,
        error_max=0.7,
    )
    zero = TruthParameter("zero", 0.3, 0.1, "rad")
    fit = TruthFit("theta_e", (zero,), -3, ("words",), 0.25, np.nan)
    numbers = facts(replace(run, statistics=statistics), ["a warning"], fit)
    assert (numbers["rows"], numbers["valid_share"], numbers["first_valid"]) == (200, 0.25, 0.5)
    assert numbers["drift"] == [0.1, -0.2]
    assert numbers["error"] == pytest.approx({"rows": 40, "rms": 0.3, "most": 0.7, "mean": 0.2})
    assert numbers["parameters"] == {}
    assert numbers["warnings"] == ["a warning"]
    assert numbers["truth"] == {
        "channel": "theta_e",
        "pole_pairs": -3,
        "parameters": {"zero": {"value": 0.3, "std": 0.1, "unit": "rad"}},
        "rms": 0.25,
        "most": None,
        "words": ["words"],
    }


def test_facts_of_a_run_without_a_position(run):
    statistics = replace(run.statistics, valid=0, first_valid=None, scored=0)
    numbers = facts(replace(run, statistics=statistics), [], None)
    assert (numbers["valid_share"], numbers["first_valid"], numbers["drift"]) == (0.0, None, None)
    assert (numbers["error"], numbers["truth"]) == (None, None)


# ---- the export -----------------------------------------------------------------------------


def test_why_an_observer_cannot_be_exported(run):
    assert run.firmware is None
    incomplete = replace(run, machine=SERVO.with_values(psi_f=None, rated_current=None))
    assert incomplete.firmware == (
        f"To export this observer, add psi_f ({run.plain.flux_base:.3g} here) "
        f"and rated_current ({run.scales.current:.3g} here) to the machine file."
    )
    assert incomplete.export_command("motor.toml") is None
    with_inverter = replace(run, machine=SERVO.with_values(inverter_voltage=0.4))
    assert "does not correct the inverter" in with_inverter.firmware


def test_the_command_repeats_every_setting(run):
    plain = run.plain
    assert replace(run, priors={"psi_f": 0.002}).export_command("my motor.toml") == (
        f"fluxobs export --machine 'my motor.toml' --unknowns drift --prior psi_f=0.002 "
        f"--sample-time {plain.sample_time!r} --memory {plain.memory!r} "
        f"--current-noise {plain.current_noise!r} --drift-prior {plain.drift_prior!r} --out FOLDER"
    )
