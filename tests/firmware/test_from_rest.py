"""Start from rest under full load, and reversal at 1 % of the rated speed, with injection."""

from __future__ import annotations

import pytest

from fluxobs.machines import example
from support.at_rest import interior
from support.from_rest import build, drive, run

WRONG = {"exact": (1.0, 1.0), "+20 %": (1.2, 1.2), "-20 %": (0.8, 0.8), "apart": (0.8, 1.2)}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return a function that returns the program for a machine, compiled once."""
    programs = {}

    def get(machine, L_d=1.0, L_q=1.0):
        key = (machine, L_d, L_q)
        if key not in programs:
            programs[key] = build(machine, tmp_path_factory.mktemp("from rest"), L_d, L_q)
        return programs[key]

    return get


def check(result, back=15, valid=0.95, worst=10):
    assert result["starts"] == 1
    assert result["torque_at"] < 0.3
    assert result["back"] > -back
    assert result["valid"] > valid
    assert result["within"] > 0.93
    assert result["worst"] < worst


@pytest.mark.parametrize("inductances", WRONG.values(), ids=WRONG)
def test_interior_machine_holds_full_load_from_rest(built, inductances):
    machine = interior(1.5)
    for seed in range(3):
        values = drive(machine, seed, *inductances)
        result = run(built(machine, *inductances), values)
        check(result) if inductances == (1.0, 1.0) else check(result, back=60, valid=0.8)
        assert result["open"] == 0  # the saturation has told the polarity


@pytest.mark.parametrize("ratio", [1.2, 2.5])
def test_mild_and_strong_saliency(built, ratio):
    machine = interior(ratio)
    for seed in range(1, 4):
        check(run(built(machine), drive(machine, seed)))


def test_reluctance_machine_has_no_polarity(built):
    """Its position vector is short, and torque turns it for milliseconds."""
    machine = example("synrm-6kw7")
    for seed in range(3):
        check(run(built(machine), drive(machine, seed, saturation=0.0, J=0.05)), worst=20)


def test_polarity(built):
    """10 % in the difference of the inductances at ± 30 % of the rated current decide it."""
    machine = interior(1.5)
    for seed in range(50):
        result = run(built(machine), drive(machine, seed, hold=1.0, duration=0.1))
        assert result["open"] == 0
        assert abs(result["seed_error"]) < 20


def test_open_polarity_is_never_valid_at_a_creep(built):
    """Without saturation both half turns fit, also while the rotor creeps by turns."""
    machine = interior(1.5)
    for seed in range(6):
        values = drive(machine, seed, saturation=0.0, passive=1, load=4.0)
        result = run(built(machine), values)
        assert result["valid"] == 0 or result["within"] > 0.9


def test_surface_machine_cannot_be_started(built):
    machine = interior(1.5)
    values = drive(machine, 0, given_L_d=0.036, given_L_q=0.036)
    assert run(built(machine), values) == {"unable": 1}


def test_without_injection_nothing_starts(built):
    machine = interior(1.5)
    result = run(built(machine), drive(machine, 0, inject=0))
    assert result["starts"] == result["valid"] == 0
