"""The plan of a drive: what the observer will know."""

from dataclasses import replace

import numpy as np
import pytest

from fluxobs.campaigns.drives import planned_cell
from fluxobs.errors import UsageError
from fluxobs.machines import example, rotating
from fluxobs.planning import limits
from fluxobs.planning.limits import Map, map_of, simulate_map
from fluxobs.planning.report import plan_data, plan_figure, plan_text
from fluxobs.planning.setup import Sensors, observer_of, quantities, rating_of

NAME = "servo-400w"
SPEEDS = np.geomspace(0.03, 0.5, 5)


@pytest.fixture(scope="module", autouse=True)
def short_simulations():
    """Half the duration, and two of the five better sensors."""
    better = {name: limits.BETTER[name] for name in ("offset of the sensors", "dead time and drop")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(limits, "BETTER", better)
        for name in ("UP", "LOADED", "THERE", "HOLD", "DURATION"):
            patch.setattr(limits, name, getattr(limits, name) / 2)
        yield


@pytest.fixture(scope="module")
def planned():
    machine = rotating(example(NAME), "a test")
    cell = planned_cell(NAME, rating_of(machine, NAME))
    sensors = Sensors.usual(cell.current, cell.rated)
    return limits.plan_drive(cell, sensors, None, (0.0, 0.5), SPEEDS)


def test_a_speed_is_valid_from_the_crossing_on():
    speeds = np.array([0.01, 0.02, 0.04, 0.08])
    valid = np.array([[0.0, 0.25, 0.75, 1.0], [1.0, 0.0, 1.0, 1.0], [1, 1, 1, 1], [0, 0, 0, 0]])
    known = Map(speeds, np.arange(4.0), valid, valid, valid)
    lowest = known.lowest()
    # Half-way between 25 % and 75 % in the logarithm; a gap above it does not count.
    assert lowest[0] == pytest.approx(0.02 * 2**0.5)
    assert lowest[1] == pytest.approx(0.02 * 2**0.5)
    assert lowest[2] == 0.01
    assert np.isnan(lowest[3])


def test_the_plan_of_a_servo(planned):
    """A servo under load is known from a few percent of its speed on, at no load from about ten."""
    lowest = planned.known.lowest()
    assert 0.03 < lowest[1] < 0.08 < lowest[0] < 0.2
    assert planned.load == 0.0
    std = np.degrees(planned.known.std)
    assert 0.5 < std[1, -1] < 3.0
    ok = planned.known.valid > limits.VALID
    assert (planned.known.error[ok] < 2 * planned.known.std[ok]).all()
    best = planned.gains[0]
    assert best.what in ("dead time and drop", "inverter", "offset of the sensors")
    assert best.lowest < 0.9
    text = plan_text(planned)
    assert "Lowest valid speed" in text
    assert best.remedy in text
    data = plan_data(planned)
    assert data["lowest_valid_speed"] == pytest.approx(lowest.tolist())
    assert plan_figure(planned).axes


def test_a_better_sensor_never_hurts():
    """With a quarter of the offset and noise, the plan's standard deviation is smaller."""
    machine = rotating(example(NAME), "a test")
    cell = planned_cell(NAME, rating_of(machine, NAME))
    usual = Sensors.usual(cell.current, cell.rated)
    better = replace(usual, offset=0.25 * usual.offset, noise=0.25 * usual.noise)
    stds = []
    for sensors in (usual, better):
        # As many lanes as the plan has at one load: the program is compiled already.
        traces = simulate_map(cell, quantities(sensors, cell, limits.SIGNS), (0.0,), SPEEDS)
        known = map_of(observer_of(sensors, cell), cell, traces, (0.0,), SPEEDS)
        stds.append(known.std[:, -3:])
    assert (stds[1] < stds[0]).all()


def test_the_observer_knows_the_sensors():
    machine = rotating(example(NAME), "a test")
    cell = planned_cell(NAME, rating_of(machine, NAME))
    sensors = Sensors.usual(cell.current, cell.rated, bits=8, noise=0.0)
    observer = observer_of(sensors, cell)
    assert observer.offset_std == sensors.offset
    assert sensors.total_noise == pytest.approx(sensors.step / 12**0.5)
    assert sensors.step == pytest.approx(2 * 2.5 * cell.current / 256)


def test_ratings():
    machine = rotating(example(NAME), "a test")
    with pytest.raises(UsageError, match="give its speed, dc_link, sample_time"):
        rating_of(machine, "motor.toml")
    given = {"speed_e": 1256.0, "dc_link": 48.0, "sample_time": 1e-4}
    rated = rating_of(machine, "motor.toml", **given)
    # 90 % of 3/2 n_p ψ I, the torque of the rated current.
    torque = 0.9 * 1.5 * machine.n_p * machine.psi_f * machine.rated_current
    assert rated.torque == pytest.approx(torque, rel=1e-6)
    assert rating_of(machine, NAME, torque=0.5).torque == 0.5
    with pytest.raises(UsageError, match="rated_current is missing"):
        rating_of(machine.with_values(rated_current=None), NAME)
    for name, value in (("noise", -1.0), ("noise", np.nan), ("bits", 0.0), ("range", 0.0)):
        with pytest.raises(UsageError, match="is impossible"):
            Sensors.usual(12.0, rated, **{name: value})
    with pytest.raises(UsageError, match="must be positive"):
        rating_of(machine, NAME, dc_link=0.0)
