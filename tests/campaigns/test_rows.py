"""Rows do not depend on their batch and have the right measures."""

from __future__ import annotations

from types import SimpleNamespace

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
from fluxobs.campaigns.rows import record_of, rows_for, rows_of
from fluxobs.campaigns.scores import measures
from fluxobs.campaigns.simulated import ScoredTrace
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
        monkeypatch.setattr(simulated_module, name, 4)


def specification(**fields) -> Specification:
    defaults = {
        "machines": ["servo-400w"],
        "scenarios": 96,
        "observers": ["plain", "adaptive", "gradient (Ortega, Lee)"],
        "course": COURSE,
        "vary": VARY,
    }
    return Specification(**defaults | fields)


def frame(s: Specification, drawn: list[Scenario]) -> pl.DataFrame:
    return pl.DataFrame(rows_for(s, drawn), schema=schema(s)).sort("number", "observer")


@pytest.mark.parametrize(
    "machine", ["servo-400w", pytest.param("ipm-5kw6", marks=pytest.mark.slow)]
)
def test_rows_do_not_depend_on_their_batch(machine):
    s = specification(machines=[machine])
    all_rows = rows_of(s, 0, 6).sort("number", "observer")  # more than one batch
    assert all_rows["failed"].null_count() == len(all_rows)
    assert all_rows["rms"].null_count() < 3
    order = [5, 0, 4]
    drawn = [scenarios(s, number, number + 1)[0] for number in order]
    some_rows = frame(s, drawn)
    assert some_rows.equals(all_rows.filter(pl.col("number").is_in(order)))


@pytest.mark.slow
def test_rows_in_the_loop_do_not_depend_on_their_batch():
    s = specification(loop="closed", observers=["adaptive", "speed-adaptive (Hinkkanen)"])
    s = s.model_copy(update={"course": s.course.model_copy(update={"duration": 0.5})})
    all_rows = rows_of(s, 0, 12).sort("number", "observer")
    order = [11, 3]
    some_rows = frame(s, [scenarios(s, number, number + 1)[0] for number in order])
    assert some_rows.equals(all_rows.filter(pl.col("number").is_in(order)))
    hinkkanen = all_rows.filter(pl.col("observer") != "adaptive")
    assert (hinkkanen["handed_over"] > 0.1).all()
    assert hinkkanen["in_loop"].max() > 0.1


def test_an_impossible_scenario_is_a_failed_row():
    course = COURSE | {"load": [[0.1, 0.0], [0.1, 0.5]]}
    s = specification(vary={"load": {"choice": [0.2, 50.0]}, "noise": 0.003}, course=course)
    rows = rows_of(s, 0, 8)
    failed = rows.filter(pl.col("failed").is_not_null())
    assert 0 < len(failed) < len(rows)
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
        flux, scaled_flux = (complex(m.flux_dq(jnp.asarray(i))) for m in (nominal, scaled))
        expected = 0.9 * (flux.real - psi) + 1.1 * psi + 1j * 0.45 * flux.imag
        assert scaled_flux == pytest.approx(expected, rel=1e-9)
        current = complex(scaled.current(jnp.asarray(scaled_flux), jnp.asarray(1 + 0j)))
        assert current == pytest.approx(i, abs=1e-6)


def test_a_cage_warms_up():
    machine = example("induction-2kw2")
    motor = motor_of(machine, {"temperature": 70.0})
    assert float(motor.R_R) == pytest.approx(machine.R_R * (1 + 0.0040 * 50))


def test_measures_equal_a_brute_force_sum():
    rng, count, h = np.random.default_rng(3), 500, 1e-3
    t = h * np.arange(count)
    theta = rng.uniform(-np.pi, np.pi, count)
    error = 0.05 * rng.standard_normal(count)
    valid = rng.random(count) < 0.7
    std = np.full(count, 0.05)
    zeros = np.zeros(count)
    trace = ScoredTrace(*(zeros,) * len(ScoredTrace._fields))._replace(theta_e=theta)
    record = ObservedRecord(
        np.angle(np.exp(1j * (theta + error))), zeros + 3.0, valid, std, {"psi_f": 1.5}
    )
    row = measures(t, trace, zeros + 1.0, record, example("servo-400w"), 0.1)
    errors = [abs(e) for e, v, time in zip(error, valid, t, strict=True) if v and time >= 0.1]
    assert row["rms"] == pytest.approx(np.sqrt(sum(e * e for e in errors) / len(errors)))
    assert row["worst"] == pytest.approx(max(errors))
    assert row["p50"] == pytest.approx(sorted(errors)[len(errors) // 2], abs=1e-3)
    assert row["valid"] == pytest.approx(len(errors) / 400)
    assert row["first_valid"] == pytest.approx(t[list(valid).index(True)])
    assert row["covered"] == pytest.approx(sum(e <= 0.1 for e in errors) / len(errors))
    assert row["wrong"] == 0.0
    assert row["speed_rms"] == pytest.approx(2.0)
    assert row["psi_f_z"] == 1.5
    assert row["lost"] == 0.0


def test_measures_without_a_valid_row():
    zeros = np.zeros(100)
    trace = ScoredTrace(*(zeros,) * len(ScoredTrace._fields))
    record = ObservedRecord(zeros + 3.0, zeros, zeros > 0, zeros, {})
    row = measures(1e-3 * np.arange(100), trace, zeros, record, example("servo-400w"), 0.0)
    assert row["valid"] == 0.0
    assert row["rms"] is None
    assert row["first_valid"] is None
    assert row["settled"] is None
    assert row["rms_all"] == pytest.approx(3.0)


def test_observers_assume_the_noise_of_the_specification():
    assert rows_module.noise_of(specification(vary={"noise": {"uniform": [0.0, 0.02]}})) == 0.01
    assert rows_module.noise_of(specification(vary={})) == 0.001


def test_sure_and_wrong_exceeds_five_deviations_and_ten_degrees():
    zeros = np.zeros(100)
    trace = ScoredTrace(*(zeros,) * len(ScoredTrace._fields))
    error, std = zeros.copy(), np.full(100, np.radians(1.0))
    error[10:13] = np.radians(9.0)  # nine deviations, but small
    error[20:25] = np.radians(11.0)
    error[30:40], std[30:40] = np.radians(40.0), np.radians(9.0)  # less than five
    record = ObservedRecord(error, zeros, zeros == 0, std, {})
    row = measures(1e-3 * np.arange(100), trace, zeros, record, example("servo-400w"), 0.0)
    assert row["wrong"] == 0.05


def test_a_share_of_the_samples_is_lost():
    ones = np.ones(1000) + 0j
    trace = SimpleNamespace(theta_e=np.zeros(1000), current=ones, voltage=ones)
    for share, least, most in ((0.0, 0, 0), (0.2, 150, 250)):
        scenario = Scenario(1, "servo-400w", {"lost": share}, 3)
        record = record_of(SimpleNamespace(trace=trace, scenario=scenario), 1e-4)
        assert least <= np.isnan(record.current[:, 0]).sum() <= most


def test_the_whole_log_is_estimated_with_lost_samples():
    observers = [{"kind": "whole-log", "name": "both"}, "plain"]
    s = specification(scenarios=4, observers=observers, vary={"lost": 0.01, "noise": 0.003})
    rows = frame(s, scenarios(s, 0, 4))
    both = rows.filter(pl.col("observer") == "both")
    assert both["failed"].is_null().all()
    assert (both["valid"] > 0.9).all()
    assert (both["rms"] < 2.0).all()


@pytest.mark.parametrize(
    ("machine", "assumed"),
    [
        ("servo-400w", "drone-900kv"),
        # XLA compiles a flux map for long.
        pytest.param("synrm-6kw7-saturated", "synrm-6kw7", marks=pytest.mark.slow),
    ],
)
def test_an_observer_may_assume_another_machine_file(machine, assumed):
    s = specification(
        scenarios=2,
        machines=[machine],
        vary={},
        observers=["whole-log", {"kind": "whole-log", "name": "other", "file": assumed}],
    )
    rows = frame(s, scenarios(s, 0, 2))
    known, other = (rows.filter(pl.col("observer") == name) for name in ("whole-log", "other"))
    assert (known["valid"] > other["valid"]).all()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"observers": ["whole-log"], "loop": "closed"}, "needs all samples of a log"),
        ({"vary": {"lost": 0.01}, "loop": "closed", "observers": ["plain"]}, "lost applies only"),
        ({"vary": {"lost": 0.01}}, "cannot run with lost samples"),
        ({"observers": [{"kind": "whole-log", "file": "servo"}]}, "file: no shipped machine"),
        ({"observers": [{"kind": "whole-log", "gains": {"k": 1.0}}]}, "has no gains"),
    ],
)
def test_settings_of_the_whole_log(fields, message):
    with pytest.raises(UsageError, match=message):
        specification(**fields)
