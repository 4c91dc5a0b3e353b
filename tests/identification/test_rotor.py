"""identify --free R_R: the rotor of a cage, from changes of its flux or from its slip."""

from __future__ import annotations

import pytest

import fluxobs
from fluxobs import FluxobsError
from observers.test_cage import CONSTANT, MACHINE, RAMPS, H, record


def cage_log(psi, **given):
    voltage, current, _, _ = record(psi, **given)
    return fluxobs.read_log((voltage, current), sample_time=H, lag=1.0)


@pytest.mark.parametrize("wrong", [{}, {"R_R": 1.5, "L_M": 1.2}, {"R_R": 0.7}])
def test_flux_changes_identify_the_rotor(wrong):
    """A biased log without position gives the right R_R and L_M, even with a wrong machine file."""
    guess = MACHINE
    for name, factor in wrong.items():
        guess = guess.scaled([name], factor)
    identified = fluxobs.identify(cage_log(RAMPS), guess, free="R_R")
    by_name = {p.name: p for p in identified.parameters}
    assert set(by_name) == {"R_R", "L_M"}
    for name, share in (("R_R", 0.02), ("L_M", 0.005)):
        true = getattr(MACHINE, name)
        assert by_name[name].value == pytest.approx(true, rel=share)
        assert abs(by_name[name].value - true) < 3 * by_name[name].std
    assert abs(identified.machine.R_R - MACHINE.R_R) < 0.02 * MACHINE.R_R
    assert identified.machine.R_R_std > 0.1 * MACHINE.R_R  # includes heating until the next log


def test_a_constant_flux_does_not_identify_the_rotor():
    wrong = MACHINE.scaled(["R_R"], 1.5)
    with pytest.raises(FluxobsError, match="rotor flux changes by no more than 0%"):
        fluxobs.identify(cage_log(CONSTANT), wrong, free="R_R")
    identified = fluxobs.identify(cage_log(CONSTANT), wrong, free="R_s,R_R")
    assert set(identified.untold) == {"R_R", "L_M"}
    assert identified.machine.R_R == wrong.R_R
    assert identified.machine.R_s == pytest.approx(MACHINE.R_s, rel=0.02)


def test_flux_and_rotor_are_not_free_together():
    with pytest.raises(FluxobsError, match="psi_R, or R_R and L_M"):
        fluxobs.identify(cage_log(RAMPS), MACHINE, free="psi_R,R_R")


def speed_log(psi, seconds=2.4):
    voltage, current, _, mechanical = record(psi)
    rows = slice(0, round(seconds / H))
    channels = {
        "u_alpha": voltage[rows, 0],
        "u_beta": voltage[rows, 1],
        "i_alpha": current[rows, 0],
        "i_beta": current[rows, 1],
        "encoder": mechanical[rows],
    }
    return channels, {"sample_time": H, "lag": 1.0, "truth": {"speed_mech": "encoder"}}


@pytest.mark.parametrize("psi", [CONSTANT, RAMPS])
def test_a_speed_identifies_the_rotor_at_constant_flux(psi):
    log, layout = speed_log(psi)
    identified = fluxobs.identify(log, MACHINE.scaled(["R_R"], 1.4), free="R_s,R_R", **layout)
    by_name = {p.name: p for p in identified.parameters}
    assert set(by_name) == {"R_s", "R_R"}
    assert abs(by_name["R_R"].value - MACHINE.R_R) < 0.02 * MACHINE.R_R
    assert abs(by_name["R_R"].value - MACHINE.R_R) < 3 * by_name["R_R"].std + 0.005
    assert abs(identified.machine.R_R - MACHINE.R_R) < 0.02 * MACHINE.R_R
    assert identified.machine.L_M == MACHINE.L_M


def test_a_speed_identifies_the_rotor_resistance_alone():
    log, layout = speed_log(CONSTANT)
    identified = fluxobs.identify(log, MACHINE, free="R_R", **layout)
    assert [p.name for p in identified.parameters] == ["R_R"]
    assert str(identified).startswith("R_R = 2.09")


def test_a_log_too_short_for_the_slip_is_refused():
    log, layout = speed_log(CONSTANT, 0.06)
    with pytest.raises(FluxobsError, match=r"too few to identify R_R|never known"):
        fluxobs.identify(log, MACHINE, free="R_R", **layout)


def test_a_speed_scores_an_estimate():
    log, layout = speed_log(CONSTANT)
    result = fluxobs.estimate(log, MACHINE, **layout)
    assert "ratio of estimated to given speed" in " ".join(result.truth_fit.words)
