"""Drives have all quantities of their scenario, and rows have the scores of their record."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from fluxobs.campaigns import observed as observed_module
from fluxobs.campaigns import simulated as simulated_module
from fluxobs.campaigns.dataset import Chunk, Dataset, chunk_size
from fluxobs.campaigns.draws import Scenario
from fluxobs.campaigns.drives import cell_of, drive_of, motor_of
from fluxobs.campaigns.observed import Candidate, ObservedRecord, Parameters, _errors, candidate
from fluxobs.campaigns.quantities import PARAMETERS
from fluxobs.campaigns.rows import _batches, noise_of, true_parameters
from fluxobs.campaigns.scores import loop_measures, measures
from fluxobs.campaigns.simulated import ScoredTrace, lanes_for
from fluxobs.campaigns.specification import Specification
from fluxobs.errors import UsageError
from fluxobs.machines import example
from fluxobs.machines.heat import CAGE

COURSE = {"speed": [[0, 0], [1, 0.5]], "load": [[0.2, 0.4]], "duration": 2.0}
VALUES = {
    "inertia": 2.0,
    "viscous": 0.1,
    "coulomb": 0.2,
    "dead_time": 0.03,
    "drop": 0.01,
    "knee": 0.05,
    "offset_alpha": 0.02,
    "offset_beta": -0.03,
    "voltage_offset_alpha": 0.04,
    "voltage_offset_beta": -0.05,
    "noise": 0.006,
    "gain_a": 1.01,
    "gain_b": 0.98,
    "gain_c": 1.03,
    "quantum": 0.001,
    "range": 3.0,
    "jitter": 0.07,
    "lag": -0.2,
    "heat": 0.1,
    "fifth": 0.02,
    "seventh": -0.01,
    "iron_loss": 0.03,
    "dc_link": 0.9,
    "dc_link_gain": 1.02,
    "speed": 0.8,
    "load": 0.5,
    "theta_e": 1.5,
}


def specification(**fields) -> Specification:
    defaults = {"machines": ["servo-400w"], "scenarios": 64, "observers": ["plain"]}
    return Specification(**defaults | {"course": COURSE} | fields)


def drawn(values: dict[str, float], machine: str = "servo-400w", **fields):
    s = specification(machines=[machine], **fields)
    return cell_of(s, machine), *drive_of(s, Scenario(0, machine, values, seed=0))


def test_shares_are_of_the_rated_values():
    cell, drive, course = drawn(VALUES)
    rated, h = cell.rated, cell.rated.sample_time
    current = example("servo-400w").rated_current
    rated_speed = rated.speed_e / example("servo-400w").n_p
    assert cell.current == current
    assert cell.voltage == pytest.approx(rated.speed_e * example("servo-400w").psi_f)
    mechanics, inverter, sensors = drive.plant.mechanics, drive.inverter, drive.sensors
    assert float(mechanics.J) == pytest.approx(2 * rated.J)
    assert float(mechanics.viscous) == pytest.approx(0.1 * rated.torque / rated_speed)
    assert float(mechanics.coulomb) == pytest.approx(0.2 * rated.torque)
    assert float(mechanics.smoothing) == pytest.approx(1e-3 * rated_speed)
    assert float(inverter.dead_time) == pytest.approx(0.03 * h)
    assert float(inverter.drop) == pytest.approx(0.01 * rated.dc_link)
    assert float(inverter.smoothing) == pytest.approx(0.05 * current)
    assert float(sensors.noise) == pytest.approx(0.006 * current)
    assert np.asarray(sensors.gain) == pytest.approx([1.01, 0.98, 1.03])
    assert float(sensors.quantum) == pytest.approx(0.001 * current)
    assert float(sensors.range) == pytest.approx(3 * current)
    assert float(sensors.jitter) == pytest.approx(0.07 * h)
    assert float(sensors.lag) == pytest.approx(-0.2 * h)
    assert float(sensors.dc_link_gain) == pytest.approx(1.02)
    assert np.asarray(sensors.offset.values)[0] == pytest.approx([0.02 * current, -0.03 * current])
    assert np.asarray(course.voltage_offset.values)[0] == pytest.approx(
        [0.04 * cell.voltage, -0.05 * cell.voltage]
    )
    assert np.asarray(course.speed.times) == pytest.approx([0, 1])
    assert np.asarray(course.speed.values) == pytest.approx([0, 0.8 * 0.5 * rated_speed])
    assert np.asarray(course.load.values) == pytest.approx([0.5 * 0.4 * rated.torque])
    assert np.asarray(course.dc_link.values) == pytest.approx([0.9 * rated.dc_link])
    assert float(course.theta_e) == 1.5
    motor = drive.plant.motor
    assert (float(motor.fifth), float(motor.seventh)) == (0.02, -0.01)
    # At the rated EMF, the current of the iron loss is the given share of the rated current.
    assert float(motor.iron_loss) * cell.voltage == pytest.approx(0.03 * current)
    assert np.asarray(course.heat.times) == pytest.approx([0, 2])
    assert np.asarray(course.heat.values) == pytest.approx([1.0, 1.1])


def test_an_offset_changes_over_the_record():
    cell, drive, _ = drawn({"offset_alpha": 0.02, "offset_change_beta": 0.01})
    offset = drive.sensors.offset
    assert np.asarray(offset.times) == pytest.approx([0, 2])
    assert np.asarray(offset.values) == pytest.approx(
        cell.current * np.array([[0.02, 0.0], [0.02, 0.01]])
    )


def test_a_drive_without_tolerances_is_the_nominal_one():
    cell, drive, course = drawn({})
    inverter, sensors = drive.inverter, drive.sensors
    assert float(inverter.dead_time) == float(inverter.drop) == float(sensors.noise) == 0.0
    assert float(inverter.smoothing) == pytest.approx(0.02 * cell.current)
    assert float(sensors.range) == pytest.approx(1e6 * cell.current)
    assert np.asarray(sensors.gain).tolist() == [1, 1, 1]
    assert float(drive.plant.mechanics.J) == cell.rated.J
    assert np.asarray(course.dc_link.values) == pytest.approx([cell.rated.dc_link])
    for name in ("viscous", "coulomb", "dead_time", "drop", "noise", "quantum", "jitter"):
        # A distribution may round to a slightly negative value, which must count as zero.
        _, tiny, _ = drawn({name: -1e-13})
        assert float(tiny.inverter.dead_time) >= 0
        assert float(tiny.sensors.noise) >= 0


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_parameter_varies_by_its_name(name):
    for machine in map(example, ("servo-400w", "ipm-2kw2", "induction-2kw2")):
        if getattr(machine, name, None) is not None:
            motor = motor_of(machine, {name: 1.25})
            nominal = motor_of(machine, {})
            for other in ("R_s", "L_d", "L_q", "psi_f", "R_R", "L_sigma", "L_M"):
                if hasattr(motor, other):
                    scaled = other == name or (
                        name in ("L_s", "L_sigma") and other in ("L_d", "L_q")
                    )
                    factor = 1.25 if scaled else 1.0
                    value = float(getattr(nominal, other))
                    assert float(getattr(motor, other)) == pytest.approx(factor * value)


def test_all_inductances_of_a_cage_machine():
    machine = example("induction-2kw2")
    motor = motor_of(machine, {"L": 1.2, "temperature": 45.0})
    assert float(motor.L_d) == pytest.approx(1.2 * machine.L_sigma)
    assert float(motor.L_M) == pytest.approx(1.2 * machine.L_M)
    assert float(motor.R_R) == pytest.approx(machine.R_R * (1 + 25 * CAGE))


def test_a_parameter_that_vanishes_is_refused():
    machine = example("servo-400w")
    for values in ({"R": 0.0}, {"R": -1.0}, {"psi": 1.0, "temperature": 20 + 1 / 0.0011}):
        with pytest.raises(UsageError, match="not positive"):
            motor_of(machine, values)


def test_true_parameters_of_a_drive():
    cell, drive, _ = drawn({"dc_link": 0.8, "dead_time": 0.02, "drop": 0.01, "R": 1.1, "psi": 0.9})
    simulated = SimpleNamespace(drive=drive, scenario=SimpleNamespace(values={"dc_link": 0.8}))
    true = true_parameters(simulated, cell)
    machine = example("servo-400w")
    assert true.resistance == pytest.approx(1.1 * machine.R_s)
    assert true.psi_f == pytest.approx(0.9 * machine.psi_f)
    assert true.inverter_voltage == pytest.approx((0.02 * 0.8 + 0.01) * cell.rated.dc_link)
    at_rated_voltage = SimpleNamespace(drive=drive, scenario=SimpleNamespace(values={}))
    assert true_parameters(at_rated_voltage, cell).inverter_voltage == pytest.approx(
        (0.02 + 0.01) * cell.rated.dc_link
    )


@pytest.mark.parametrize(
    ("distribution", "noise"),
    [(None, 0.001), (0.0, 0.001), (0.0005, 0.001), (0.003, 0.003), ({"uniform": [0, 0.01]}, 0.005)],
)
def test_the_noise_that_observers_assume(distribution, noise):
    vary = {} if distribution is None else {"noise": distribution}
    assert noise_of(specification(vary=vary)) == pytest.approx(noise)


@pytest.mark.parametrize(
    ("loop", "rows", "lanes"),
    [
        ("open", 1000, 64),
        ("open", 1 << 16, 64),
        ("open", (1 << 16) + 1, 32),
        ("open", 1 << 23, 8),
        ("closed", 1 << 14, 256),
        ("closed", (1 << 14) + 1, 128),
    ],
)
def test_lanes_whose_rows_fit_into_memory(loop, rows, lanes):
    s = SimpleNamespace(loop=loop, course=SimpleNamespace(duration=rows * 2.0**-13))
    assert lanes_for(s, 2.0**-13) == lanes
    assert simulated_module.MAX_SAMPLES == 64 * (1 << 16)


def test_batches():
    assert list(_batches(iter(range(7)), 3)) == [[0, 1, 2], [3, 4, 5], [6]]
    assert list(_batches(iter(range(6)), 3)) == [[0, 1, 2], [3, 4, 5]]


@pytest.mark.parametrize(
    ("scenarios", "duration", "observers", "size"),
    [
        (64, 2.0, 1, 64),  # at least one batch
        (10_000_000, 2.0, 1, 64 * 3),  # 20000 rows, 48 ms a drive, 3 s a batch
        (10_000_000, 2.0, 3, 64 * 1),
        (10_000_000, 1e-2, 1, 64 * 64),  # limited by the number of batches
        (64 * 16 * 3, 1e-2, 1, 64 * 3),  # at least sixteen chunks
        (64 * 16 * 3 - 1, 1e-2, 1, 64 * 2),
    ],
)
def test_a_chunk_is_ten_seconds_of_work(scenarios, duration, observers, size):
    s = SimpleNamespace(
        scenarios=scenarios,
        observers=[None] * observers,
        course=SimpleNamespace(duration=duration),
    )
    assert chunk_size(s, 64, 1e-4) == size


def test_chunks_of_each_machine(tmp_path):
    s = specification(machines=["servo-400w", "pmsm-2kw2"], scenarios=5)
    dataset = Dataset(tmp_path, s, 2)
    chunks = list(dataset.chunks())
    assert chunks == [(0, 2), (2, 4), (4, 5), (5, 7), (7, 9), (9, 10)]
    assert str(chunks[0]) == "scenarios 0 to 1"
    assert chunks[3].file == "00000005.parquet"
    (tmp_path / "rows").mkdir()
    (tmp_path / "rows" / Chunk(2, 4).file).touch()
    assert dataset.lacking() == 8
    assert Chunk(2, 4) not in list(dataset.missing())


ROWS = 100
T = 1e-2 * np.arange(ROWS)


def trace(**signals) -> ScoredTrace:
    defaults = dict.fromkeys(ScoredTrace._fields, np.zeros(ROWS))
    defaults |= {"reference": np.full(ROWS, 10.0), "speed": np.full(ROWS, 10.0)}
    return ScoredTrace(**defaults | {"tripped": np.zeros(ROWS, bool)} | signals)


def test_scores_of_a_loop():
    from fluxobs.simulation.drive.sensorless import RUNNING

    mode = np.full(ROWS, RUNNING)
    mode[:20] = mode[50:60] = RUNNING - 1  # started, lost once
    speed = np.full(ROWS, 10.0)
    speed[70:75], speed[80:90], speed[5] = 8.99, 9.01, 0.0
    row = loop_measures(T, trace(mode=mode, speed=speed), 0.1)
    assert row["handed_over"] == pytest.approx(0.2)
    assert row["in_loop"] == pytest.approx(70 / 90)
    assert (row["losses"], row["tripped"]) == (1, False)
    assert row["unfollowed"] == pytest.approx(5 / 90)
    tripped = np.arange(ROWS) == 99
    row = loop_measures(T, trace(mode=mode, tripped=tripped), 0.1)
    assert (row["losses"], row["tripped"]) == (2, True)


def test_a_loop_that_never_began_at_standstill():
    still = trace(reference=np.zeros(ROWS), speed=np.ones(ROWS), mode=np.zeros(ROWS))
    row = loop_measures(T, still, 0.0)
    assert row["handed_over"] is None
    assert row["in_loop"] == 0.0
    assert row["unfollowed"] == 0.0
    slow = trace(reference=np.full(ROWS, 0.5), speed=np.zeros(ROWS))
    assert loop_measures(T, slow, 0.0)["unfollowed"] == 1.0


def scored(error, valid=True, std=1.0, start=0.0):
    record = ObservedRecord(
        error, np.full(ROWS, np.nan), np.full(ROWS, valid), None if std is None else std + 0 * T, {}
    )
    return measures(T, trace(), np.full(ROWS, 2.0), record, example("servo-400w"), start)


def test_a_position_that_is_not_finite_counts_as_half_a_turn():
    error = np.zeros(ROWS)
    error[50:60] = np.nan
    row = scored(error)
    assert row["worst"] == pytest.approx(np.pi)
    assert row["lost"] == pytest.approx(0.1)
    assert row["rms_all"] == pytest.approx(np.pi * np.sqrt(0.1))
    assert row["speed_rms"] == pytest.approx(2.0)  # a speed that is not finite counts as zero


def test_percentiles_and_rows_that_are_scored():
    row = scored(np.arange(ROWS) / 100, start=0.5)
    assert row["p50"] == pytest.approx(np.percentile(np.arange(50, 100) / 100, 50))
    assert row["p99"] == pytest.approx(np.percentile(np.arange(50, 100) / 100, 99))
    assert row["first_valid"] == 0.0
    assert scored(np.ones(ROWS))["settled"] is None


@pytest.mark.parametrize(("ratio", "covered"), [(1.99, 1.0), (2.0, 1.0), (2.01, 0.0)])
def test_covered_is_within_two_deviations(ratio, covered):
    assert scored(np.full(ROWS, 0.25 * ratio), std=0.25)["covered"] == covered


@pytest.mark.parametrize(
    ("degrees", "std", "wrong"),
    [(10.1, 2.0, 1.0), (9.9, 0.1, 0.0), (10.1, 2.03, 0.0), (40.1, 8.0, 1.0), (39.9, 8.0, 0.0)],
)
def test_wrong_exceeds_five_deviations_and_ten_degrees(degrees, std, wrong):
    assert scored(np.full(ROWS, np.radians(degrees)), std=np.radians(std))["wrong"] == wrong


def test_without_a_std_nothing_is_covered_or_wrong():
    row = scored(np.zeros(ROWS), std=None)
    assert row["covered"] is None
    assert row["wrong"] is None


def test_errors_of_parameters_on_the_last_valid_row():
    believed = example("servo-400w")
    observer = Candidate(None, believed, None, 0.0)
    estimate = SimpleNamespace(
        valid=np.array([True, True, False]),
        resistance=np.array([9.0, 2.0, 9.0]),
        resistance_std=np.array([1.0, 0.5, 1.0]),
        inverter_voltage=np.array([9.0, 3.0, 9.0]),
        inverter_voltage_std=np.array([1.0, 0.0, 1.0]),
        psi_f=np.array([9.0, 1.0, 9.0]),
        psi_f_std=np.array([1.0, 0.25, 1.0]),
    )
    true = Parameters(1.0, 2.0, 3.0)
    assert _errors(observer, estimate, true) == {"resistance": 2.0, "psi_f": -4.0}
    estimate.valid = np.zeros(3, bool)
    assert _errors(observer, estimate, true) == {}


def test_an_observer_without_a_validity_flag_is_trusted_above_a_twentieth_of_the_speed(
    monkeypatch,
):
    # The gains of this observer do not depend on the simulated record.
    nothing = np.zeros((10, 2))
    monkeypatch.setattr(observed_module, "nominal_record", lambda cell: (nothing, nothing))
    s = specification(observers=["gradient (Ortega, Lee)"])
    cell = cell_of(s, "servo-400w")
    observer = candidate(s.observers[0], cell, 0.01)
    assert observer.trusted == pytest.approx(cell.rated.speed_e / 20)
    assert not observer.compiled
    assert not observer.adaptive


def test_ratings_that_the_file_does_not_hold(tmp_path):
    text = 'kind = "surface-pmsm"\nR_s = 0.4\nL_s = 1e-3\nn_p = 4\npsi_f = 0.01\n'
    path = tmp_path / "m.toml"
    path.write_text(text)
    s = specification(machines=[str(path)], drive={"J": 1e-4, "torque": 1.0})
    with pytest.raises(UsageError, match="rated_current is missing"):
        cell_of(s, str(path))
    complete = tmp_path / "n.toml"
    complete.write_text(f"{text}rated_current = 5.0\n")
    with pytest.raises(UsageError, match="give its speed_e, dc_link, sample_time in"):
        cell_of(s, str(complete))
    ratings = {"J": 1e-4, "torque": 1.0, "sample_time": 1e-4, "speed_e": 500.0, "dc_link": 48.0}
    rated = cell_of(specification(machines=[str(complete)], drive=ratings), str(complete)).rated
    assert (rated.J, rated.torque, rated.sample_time) == (1e-4, 1.0, 1e-4)
    changed = cell_of(specification(drive={"J": 1.0}), "servo-400w").rated
    assert changed.J == 1.0
    assert changed.torque == cell_of(specification(), "servo-400w").rated.torque


def test_columns_of_the_loop():
    from fluxobs.campaigns.columns import schema

    closed = schema(specification(loop="closed"))
    assert (closed["losses"], closed["tripped"]) == (pl.Int64, pl.Boolean)
    assert "losses" not in schema(specification())
