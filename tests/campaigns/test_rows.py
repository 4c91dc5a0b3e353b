"""Rows: the same whatever they are simulated with, and what they say."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import polars as pl
import pytest

from fluxobs.campaigns import rows as rows_module
from fluxobs.campaigns import simulated as simulated_module
from fluxobs.campaigns.columns import schema
from fluxobs.campaigns.draws import Scenario, scenarios
from fluxobs.campaigns.drives import drive_of, motor_of
from fluxobs.campaigns.observed import ObservedRecord
from fluxobs.campaigns.rows import rows_for, rows_of
from fluxobs.campaigns.scores import measures
from fluxobs.campaigns.simulated import Kept
from fluxobs.campaigns.specification import Specification
from fluxobs.errors import UsageError
from fluxobs.machines import example
from fluxobs.machines.heat import COPPER, NEODYMIUM

VARY = {
    "R": {"normal": [1, 0.1]},
    "gain": {"uniform": [0.99, 1.01]},
    "noise": 0.003,
    "dead_time": {"uniform": [0, 0.01]},
    "lag": {"uniform": [-0.1, 0.1]},
}
COURSE = {"duration": 0.3, "score_from": 0.1, "speeds": [0.5, 1.0], "ramp": 0.1, "stops": 0.0}


@pytest.fixture(autouse=True)
def _small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LANES", "IN_LOOP"):
        monkeypatch.setattr(simulated_module, name, 16)


def specification(**given) -> Specification:
    usual = {
        "machines": ["servo-400w"],
        "scenarios": 96,
        "observers": ["plain", "adaptive", "gradient (Ortega, Lee)"],
        "course": COURSE,
        "vary": VARY,
    }
    return Specification(**usual | given)


def frame(s: Specification, drawn: list[Scenario]) -> pl.DataFrame:
    return pl.DataFrame(rows_for(s, drawn), schema=schema(s)).sort("number", "observer")


@pytest.mark.parametrize(
    "machine", ["servo-400w", pytest.param("ipm-5kw6", marks=pytest.mark.slow)]
)
def test_rows_do_not_depend_on_what_they_are_simulated_with(machine):
    s = specification(machines=[machine])
    whole = rows_of(s, 0, 20).sort("number", "observer")  # more than one batch
    assert whole["failed"].null_count() == len(whole)
    assert whole["rms"].null_count() < 10
    order = [11, 19, 0, 7, 16]
    drawn = [scenarios(s, number, number + 1)[0] for number in order]
    again = frame(s, drawn)
    assert again.equals(whole.filter(pl.col("number").is_in(order)))


@pytest.mark.slow
def test_rows_in_the_loop_do_not_depend_on_what_they_are_simulated_with():
    s = specification(loop="closed", observers=["adaptive", "speed-adaptive (Hinkkanen)"])
    s = s.model_copy(update={"course": s.course.model_copy(update={"duration": 0.5})})
    whole = rows_of(s, 0, 12).sort("number", "observer")
    order = [11, 3]
    again = frame(s, [scenarios(s, number, number + 1)[0] for number in order])
    assert again.equals(whole.filter(pl.col("number").is_in(order)))
    hinkkanen = whole.filter(pl.col("observer") != "adaptive")
    assert (hinkkanen["handed_over"] > 0.1).all()
    assert hinkkanen["in_loop"].max() > 0.1


def test_a_scenario_that_cannot_be_is_a_row_that_says_so():
    course = COURSE | {"load": [[0.1, 0.0], [0.1, 0.5]]}
    s = specification(vary={"load": {"choice": [0.2, 50.0]}, "noise": 0.003}, course=course)
    found = rows_of(s, 0, 8)
    failed = found.filter(pl.col("failed").is_not_null())
    assert 0 < len(failed) < len(found)
    assert "cannot be held" in failed["failed"][0]
    assert set(failed["load"]) == {50.0}
    assert failed["rms"].null_count() == len(failed)


def test_impossible_value_is_named():
    with pytest.raises(UsageError, match="range = -1 is impossible"):
        specification(vary={"range": -1})
    s = specification(vary={"range": {"uniform": [-2, -1]}})
    row = scenarios(s, 0, 1)[0]
    with pytest.raises(UsageError, match=r"range = -1\.\d+ is impossible"):
        drive_of(s, row)


def test_temperature_and_tolerances_of_a_motor():
    machine = example("ipm-2kw2")
    motor = motor_of(machine, {"R": 1.1, "L": 0.9, "L_q": 0.8, "psi": 1.05, "temperature": 120.0})
    assert float(motor.R_s) == pytest.approx(1.1 * (1 + 100 * COPPER) * machine.R_s)
    assert float(motor.L_d) == pytest.approx(0.9 * machine.L_d)
    assert float(motor.L_q) == pytest.approx(0.9 * 0.8 * machine.L_q)
    assert float(motor.psi_f) == pytest.approx(1.05 * (1 + 100 * NEODYMIUM) * machine.psi_f)


def test_a_flux_map_keeps_its_shape():
    machine = example("ipm-5kw6")
    nominal, scaled = motor_of(machine, {}), motor_of(machine, {"L": 0.9, "L_q": 0.5, "psi": 1.1})
    psi = complex(nominal.flux_dq(jnp.asarray(0j))).real
    for i in (0j, 5 - 3j, -8 + 12j):
        one, other = (complex(m.flux_dq(jnp.asarray(i))) for m in (nominal, scaled))
        wanted = 0.9 * (one.real - psi) + 1.1 * psi + 1j * 0.45 * one.imag
        assert other == pytest.approx(wanted, rel=1e-9)
        back = complex(scaled.current(jnp.asarray(other), jnp.asarray(1 + 0j)))
        assert back == pytest.approx(i, abs=1e-6)


def test_a_cage_warms_up():
    machine = example("induction-2kw2")
    motor = motor_of(machine, {"temperature": 70.0})
    assert float(motor.R_R) == pytest.approx(machine.R_R * (1 + 0.0040 * 50))


def test_measures_are_those_of_a_brute_force_sum():
    rng, rows, h = np.random.default_rng(3), 500, 1e-3
    t = h * np.arange(rows)
    theta = rng.uniform(-np.pi, np.pi, rows)
    error = 0.05 * rng.standard_normal(rows)
    valid = rng.random(rows) < 0.7
    std = np.full(rows, 0.05)
    nothing = np.zeros(rows)
    true = Kept(*(nothing,) * len(Kept._fields))._replace(theta_e=theta)
    found = ObservedRecord(
        np.angle(np.exp(1j * (theta + error))), nothing + 3.0, valid, std, {"psi_f": 1.5}
    )
    row = measures(t, true, nothing + 1.0, found, example("servo-400w"), 0.1)
    mine = [abs(e) for e, v, at in zip(error, valid, t, strict=True) if v and at >= 0.1]
    assert row["rms"] == pytest.approx(np.sqrt(sum(e * e for e in mine) / len(mine)))
    assert row["worst"] == pytest.approx(max(mine))
    assert row["p50"] == pytest.approx(sorted(mine)[len(mine) // 2], abs=1e-3)
    assert row["valid"] == pytest.approx(len(mine) / 400)
    assert row["first_valid"] == pytest.approx(t[list(valid).index(True)])
    assert row["covered"] == pytest.approx(sum(e <= 0.1 for e in mine) / len(mine))
    assert row["wrong"] == 0.0
    assert row["speed_rms"] == pytest.approx(2.0)
    assert row["psi_f_z"] == 1.5
    assert row["lost"] == 0.0


def test_no_valid_row_tells_nothing():
    nothing = np.zeros(100)
    true = Kept(*(nothing,) * len(Kept._fields))
    found = ObservedRecord(nothing + 3.0, nothing, nothing > 0, nothing, {})
    row = measures(1e-3 * np.arange(100), true, nothing, found, example("servo-400w"), 0.0)
    assert row["valid"] == 0.0
    assert row["rms"] is None
    assert row["first_valid"] is None
    assert row["settled"] is None
    assert row["rms_all"] == pytest.approx(3.0)


def test_observers_assume_the_noise_of_the_specification():
    assert rows_module.noise_of(specification(vary={"noise": {"uniform": [0.0, 0.02]}})) == 0.01
    assert rows_module.noise_of(specification(vary={})) == 0.001


def test_sure_and_wrong_is_beyond_five_deviations_and_ten_degrees():
    nothing = np.zeros(100)
    true = Kept(*(nothing,) * len(Kept._fields))
    error, std = nothing.copy(), np.full(100, np.radians(1.0))
    error[10:13] = np.radians(9.0)  # nine deviations, but small
    error[20:25] = np.radians(11.0)
    error[30:40], std[30:40] = np.radians(40.0), np.radians(9.0)  # less than five
    found = ObservedRecord(error, nothing, nothing == 0, std, {})
    row = measures(1e-3 * np.arange(100), true, nothing, found, example("servo-400w"), 0.0)
    assert row["wrong"] == 0.05
