"""identify --free R_R: the rotor of a cage, from changes of its flux."""

from __future__ import annotations

import pytest

import fluxobs
from fluxobs import FluxobsError
from observers.test_cage import CONSTANT, MACHINE, RAMPS, H, record


def cage_log(psi, **given):
    voltage, current, _, _ = record(psi, **given)
    return fluxobs.read_log((voltage, current), sample_time=H, lag=1.0)


@pytest.mark.parametrize("wrong", [{}, {"R_R": 1.5, "L_M": 1.2}, {"R_R": 0.7}])
def test_flux_changes_tell_the_rotor(wrong):
    """R_R and L_M from a biased log without a position, whatever the file says."""
    guess = MACHINE
    for name, factor in wrong.items():
        guess = guess.scaled([name], factor)
    found = fluxobs.identify(cage_log(RAMPS), guess, free="R_R")
    by_name = {p.name: p for p in found.parameters}
    assert set(by_name) == {"R_R", "L_M"}
    for name, share in (("R_R", 0.02), ("L_M", 0.005)):
        true = getattr(MACHINE, name)
        assert by_name[name].value == pytest.approx(true, rel=share)
        assert abs(by_name[name].value - true) < 3 * by_name[name].std
    assert abs(found.machine.R_R - MACHINE.R_R) < 0.02 * MACHINE.R_R
    assert found.machine.R_R_std > 0.1 * MACHINE.R_R  # heat until the next log


def test_a_standing_flux_does_not_tell_the_rotor():
    wrong = MACHINE.scaled(["R_R"], 1.5)
    with pytest.raises(FluxobsError, match="rotor flux changes by no more than 0%"):
        fluxobs.identify(cage_log(CONSTANT), wrong, free="R_R")
    found = fluxobs.identify(cage_log(CONSTANT), wrong, free="R_s,R_R")
    assert set(found.untold) == {"R_R", "L_M"}
    assert found.machine.R_R == wrong.R_R
    assert found.machine.R_s == pytest.approx(MACHINE.R_s, rel=0.02)


def test_flux_and_rotor_are_not_free_together():
    with pytest.raises(FluxobsError, match="psi_R, or R_R and L_M"):
        fluxobs.identify(cage_log(RAMPS), MACHINE, free="psi_R,R_R")
