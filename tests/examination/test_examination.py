"""Simulated faults of a drive are found within their standard deviations; a good drive passes."""

import json

import numpy as np
import pytest

import fluxobs
from fluxobs.examination.item import Item, judge
from fluxobs.machines import example
from fluxobs.simulation.closed_form.demo import LOG, MACHINE

pytestmark = pytest.mark.mistakes

TABLE = np.genfromtxt(LOG, delimiter=",", names=True)
WHOLE = {name: TABLE[name] for name in TABLE.dtype.names}
#: The first second: run-up and load step.
GOOD = {name: values[:5000] for name, values in WHOLE.items()}
SERVO = example(MACHINE)
TURNS = np.exp(-2j * np.pi / 3 * np.arange(3))


def phases(letter):
    z = GOOD[f"{letter}_alpha"] + 1j * GOOD[f"{letter}_beta"]
    return {f"{letter}_{p}": (z * turn).real for p, turn in zip("abc", TURNS, strict=True)}


def three_phases(**changed):
    return {"t": GOOD["t"]} | phases("u") | phases("i") | changed


def page(columns=GOOD, machine=SERVO, rows=None, **layout):
    first_rows = {name: values[:rows] for name, values in columns.items()}
    examination = fluxobs.check(first_rows, machine, **layout)
    return examination, {item.name: item for item in examination.items}


def test_a_good_drive_passes():
    examination, items = page()
    assert examination.sound
    assert {item.verdict for item in items.values()} <= {"fine", "cannot be told"}
    for name, true in (
        ("resistance of a phase", 0.36),
        ("magnet flux", 0.0125),
        ("inverter voltage", 0.15),
        ("lag of the voltage", 0.0),
        ("winding temperature", 20.0),
    ):
        item = items[name]
        assert abs(item.value - true) < 3 * item.std + 0.01 * abs(true), item
    assert "bridge off" in items["offsets of the current sensors"].words


@pytest.mark.slow
def test_a_warm_winding_and_weak_magnets():
    """The machine file has the values of the cold, new motor."""
    cold, new_flux = 0.36 / (1 + 0.00393 * 90), 0.0125 / 0.85
    _, items = page(WHOLE, SERVO.with_values(R_s=cold, psi_f=new_flux))
    temperature = items["winding temperature"]
    assert abs(temperature.value - 110) < 3 * temperature.std
    assert temperature.std < 15  # the scales of the sensors alone are 8 K
    assert items["magnet flux"].verdict == "look at it"
    assert "demagnetised" in items["magnet flux"].words
    _, hot = page(WHOLE, SERVO.with_values(R_s=0.36 / (1 + 0.00393 * 150)))
    assert hot["winding temperature"].verdict == "look at it"
    examined = fluxobs.check(WHOLE, SERVO, cold_resistance=cold)
    assert abs(next(i for i in examined.items if "temperature" in i.name).value - 110) < 8


def test_offsets_at_rest():
    """With the bridge off for half a second, the log starts with noise and sensor offsets."""
    rng = np.random.default_rng(1)
    rest = 2500
    columns = {}
    for name, values in GOOD.items():
        before = np.zeros(rest)
        if name.startswith("i_"):
            offset = {"i_alpha": 0.15, "i_beta": -0.10}[name]
            before = offset + 0.02 * rng.standard_normal(rest)
        columns[name] = np.concatenate([before, values])
    columns["t"] = np.arange(len(columns["t"])) * 2e-4
    _, items = page(columns)
    for name, offset in (("i_alpha", 0.15), ("i_beta", -0.10)):
        item = items[f"offset of {name}"]
        assert abs(item.value - offset) < 4 * item.std
        assert item.verdict == ("look at it" if abs(offset) > 0.12 else "fine")


def test_three_sensors_of_different_gain_and_offset():
    columns = three_phases()
    columns["i_a"] = 1.04 * columns["i_a"]
    columns["i_b"] = columns["i_b"] + 0.5
    _, items = page(columns)
    gain = items["gain of i_a"]
    assert abs(gain.value - 4.0) < 4 * gain.std + 1e-3
    assert gain.verdict == "look at it"
    assert items["gain of i_b"].verdict == "fine"
    total = items["sum of the three offsets"]
    assert abs(total.value - 0.5) < 0.05
    assert total.verdict == "look at it"


def test_one_of_three_sensors_is_inverted():
    columns = three_phases()
    columns["i_b"] = -columns["i_b"]
    _, items = page(columns, rows=2000)
    gain = items["gain of i_b"]
    assert gain.verdict == "look at it"
    assert gain.value is None
    assert "--scale i_b=-1" in gain.words


def test_clipping_and_coarse_steps():
    columns = three_phases()
    columns["i_a"] = np.clip(columns["i_a"], -6.0, 6.0)
    columns["i_b"] = np.round(columns["i_b"] / 0.5) * 0.5
    _, items = page(columns, rows=2000)
    assert items["clipping"].verdict == "look at it"
    assert "i_a" in items["clipping"].words
    assert items["resolution of the currents"].verdict == "look at it"
    assert items["resolution of the currents"].value == pytest.approx(0.5)


@pytest.mark.slow
def test_lost_samples_and_a_slow_logger():
    keep = np.ones(len(WHOLE["t"]), bool)
    keep[[500, 501, 2000, 4000]] = False
    _, items = page({name: values[keep] for name, values in WHOLE.items()})
    assert items["missing samples"].value == 4
    assert items["missing samples"].verdict == "look at it"
    empty = {name: values.copy() for name, values in WHOLE.items()}
    empty["i_alpha"][[700, 900]] = np.nan
    _, items = page(empty)
    assert items["missing samples"].value == 2
    assert "2 rows have an empty value" in items["missing samples"].words
    slow = {name: values[::6] for name, values in WHOLE.items()}
    examination = fluxobs.check(slow, SERVO)
    period = next((i for i in examination.items if i.name == "samples a period"), None)
    assert period is None or period.verdict == "look at it"


def test_an_encoder_off_its_axis():
    shaft = np.unwrap(GOOD["theta_e"]) / SERVO.n_p
    columns = {n: v for n, v in GOOD.items() if n != "theta_e"}
    columns["encoder_deg"] = np.degrees(np.mod(shaft + 0.7 + 0.02 * np.cos(shaft), 2 * np.pi))
    _, items = page(columns)
    assert items["eccentricity, once a turn"].verdict == "look at it"
    assert items["eccentricity, once a turn"].value == pytest.approx(np.degrees(0.02), rel=0.1)
    assert items["encoder zero"].verdict == "fine"  # no value is wrong


def test_a_stopped_encoder_is_not_called_eccentric_or_late():
    shaft = np.unwrap(GOOD["theta_e"]) / SERVO.n_p
    shaft[3000:] = shaft[3000]
    columns = {n: v for n, v in GOOD.items() if n != "theta_e"}
    _, items = page(columns | {"encoder_deg": np.degrees(np.mod(shaft, 2 * np.pi))})
    remaining = items["remaining error of the truth"]
    assert remaining.verdict == "look at it"
    assert "stands still" in remaining.words
    for name in ("encoder delay", "eccentricity, once a turn"):
        assert items[name].verdict == "cannot be told"


def test_a_misread_log_is_not_examined():
    columns = GOOD | {"i_beta": GOOD["i_alpha"]}
    examination, items = page(columns, rows=2000)
    assert not examination.sound
    assert items["parameters of the drive"].verdict == "cannot be told"


def test_facts_are_json(tmp_path):
    examination, _ = page()
    facts = json.loads(json.dumps(examination.facts))
    assert facts["sound"] is True
    assert {"name", "verdict", "value", "std", "unit", "words"} == set(facts["items"][0])
    examination.write(tmp_path / "page.png")
    with pytest.raises(fluxobs.FluxobsError, match="exists"):
        examination.write(tmp_path / "page.png")


def test_verdicts():
    assert judge(0.5, 0.1, 1.0) == "fine"
    assert judge(1.5, 0.1, 1.0) == "look at it"
    # It does not exceed the limit by two standard deviations, but may exceed it.
    assert judge(1.1, 0.1, 1.0) == "cannot be told"
    assert judge(0.9, 0.1, 1.0) == "fine"
    assert judge(0.5, 0.9, 1.0) == "cannot be told"
    assert judge(9.0, 0.9, 1.0) == "look at it"
    assert Item("R", "fine", "", 0.35981, 0.0018, "Ω").told == "0.3598 ± 0.0018 Ω"
    assert Item("n", "fine", "", 4.0, None, "rows").told == "4 rows"
