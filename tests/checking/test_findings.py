"""Findings from a search result: thresholds tested from both sides, numbers in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from fluxobs.checking.findings import Finding
from fluxobs.checking.mistakes import AS_GIVEN, FACTOR, FILE, LAG, PHASES, SCALES, SIGN, Mistake
from fluxobs.checking.relation import RelationFit
from fluxobs.checking.search import (
    Candidate,
    SearchResult,
    _complete_scale,
    _describe_fit,
    _likely_value,
    _make_finding,
    _report_no_fit,
    possible_mistakes,
)
from fluxobs.machines import example
from support.records import PMSM

pytestmark = pytest.mark.mistakes

SYNRM, IPM = example("synrm-6kw7"), example("ipm-2kw2")
PRECISE = np.full(4, 0.05)


def fit(misfit=10.0, share=0.01, values=(0, 0, 0, 0), std=PRECISE, distance=0.0):
    position = np.full((2, 4), 0.3j)
    return RelationFit(misfit, distance, share, np.array(values, float), np.array(std), position)


def candidate(mistake=AS_GIVEN, whole=None, **given):
    size = given.pop("size", 100.0)
    return Candidate(mistake, whole or mistake, fit(**given), 5.0 if mistake.kind else 0.0, size)


def result(others=(), mistakes=(), alternatives=None, **best):
    chosen = candidate(**best)
    return SearchResult(chosen, chosen, list(mistakes), alternatives or {}, [chosen, *others], 2.0)


def test_the_cost_of_a_candidate():
    """The cost is misfit divided by level, plus distance from the prior, plus odds."""
    assert candidate(SIGN[0], misfit=12.0, distance=1.5).cost(2.0) == 6.0 + 1.5 + 5.0


@pytest.mark.parametrize(("more", "alike"), [(7.9, True), (8.1, False)])
def test_what_fits_equally_well(more, alike):
    """The limit is a cost difference of 4 without the odds: a misfit of 8, as the level is 2."""
    other = candidate(LAG[2], misfit=10.0 + more)
    finding = _make_finding("lag", result([other]), -1.0, "psi_f")
    assert finding.as_given
    assert finding.words == "-1"
    assert finding.others == (("0",) if alike else ())
    assert finding.sure == ("" if alike else "every alternative needs implausible parameters")


@pytest.mark.parametrize(
    ("shares", "sure"),
    [
        ((0.0104,), "every alternative needs implausible parameters"),
        ((0.0106, 0.05), "every alternative raises the residual at least 1.1-fold"),
        ((0.05, np.inf), "every alternative raises the residual at least 5.0-fold"),
        ((np.inf,), "with every alternative the position is never known"),
        ((), "with every alternative the position is never known"),
    ],
)
def test_how_sure_a_finding_is(shares, sure):
    others = [candidate(PHASES[0], misfit=1e4, share=share) for share in shares]
    others.append(candidate(SIGN[0], misfit=1e4, share=0.011))  # of another kind
    finding = _make_finding("phases", result(others), 0.0, "psi_f")
    assert (finding.sure, finding.others) == (sure, ())
    assert finding.words == "currents and voltages have the same phase order"


def test_a_finding_that_is_not_as_given():
    taken = Mistake("scale", "psi_f is wrong")
    finding = _make_finding(
        "scale", result(mistakes=[SIGN[0], taken], alternatives={"scale": ("b",)}), 0.0, "psi_R"
    )
    assert finding == Finding("scale", "psi_R is wrong", False, ("b",))
    lag = _make_finding("lag", result(mistakes=[LAG[0]], alternatives={"lag": ()}), 0.5, "psi_f")
    assert lag == Finding("lag", "-1.5", False, ())


def test_the_parameters_that_fit():
    std = [0.09, 0.11, 0.05, 0.01]
    best = candidate(values=[np.log(1.25), 0.5, np.log(0.8), 0.0], std=std)
    text = "R_s fits at 1.25 times and psi_f fits at 0.8 times the machine file's value"
    assert _describe_fit(best, PMSM) == text
    assert _describe_fit(candidate(std=np.full(4, 0.11)), PMSM) == ""
    both = _describe_fit(candidate(values=[0, np.log(2), 0, 0], std=[1, 0.05, 1, 1]), IPM)
    assert both == "L_d and L_q fit at 2 times the machine file's value"
    assert "psi_f" not in _describe_fit(candidate(), SYNRM)


@pytest.mark.parametrize(("drop", "reported"), [(0.029, False), (0.031, True)])
def test_the_inverter_is_reported_beyond_three_standard_deviations(drop, reported):
    best = candidate(values=[0, 0, 0, drop], std=[1, 1, 1, 0.01], size=200.0)
    message = f"the inverter loses about {200 * drop:.2g} V per phase (inverter_voltage)"
    assert _describe_fit(best, PMSM) == (message if reported else "")
    assert _describe_fit(best, PMSM.with_values(inverter_voltage=1.0)) == ""


def scaled(
    whole, values, std=PRECISE, machine=PMSM, frame="alphabeta", as_given=False, sure="sure"
):
    best = candidate(whole, values=values, std=std)
    return _complete_scale(
        Finding("scale", "words", as_given, (), sure), best, machine, "fits", frame
    )


def test_a_scale_names_the_value_that_fits():
    finding = scaled(FILE[0], [0, 0, np.log(2), 0])
    assert finding.words == f"words: {2 * PMSM.psi_f:.3g} Wb fits"
    assert finding.sure == "fits; sure"
    assert scaled(SCALES[0], [0, 0, 0, 0]).words == "words"
    assert scaled(FILE[0], [0, 0, 0, 0], as_given=True).words == "words"
    other = Finding("sign", "words", False)
    assert _complete_scale(other, candidate(FILE[0]), PMSM, "fits", "dq") is other


@pytest.mark.parametrize(("std", "identifiable"), [(0.09, True), (0.11, False)])
def test_an_unidentifiable_resistance(std, identifiable):
    finding = scaled(SCALES[0], [0, 0, 0, 0], [std, 0.05, 0.05, 0.05])
    assert finding.sure == "fits; sure" + (
        "" if identifiable else "; steps of load or speed would show R_s"
    )


@pytest.mark.parametrize(
    ("ratio", "frame", "asked"),
    [
        (3 * 1.04, "dq", True),
        (3 * 0.96, "dq", True),
        (3 * 1.06, "dq", False),
        (3 * 0.94, "dq", False),
        (3.0, "alphabeta", False),
    ],
)
def test_a_mechanical_angle_makes_the_flux_n_p_times_as_large(ratio, frame, asked):
    words = scaled(FILE[0], [0, 0, np.log(ratio), 0], frame=frame).words
    assert ("is theta_e the mechanical angle? Then give --scale theta_e=3" in words) == asked


@pytest.mark.parametrize(
    ("whole", "message"),
    [
        (FILE[1], f"{1.5 * PMSM.R_s:.3g} Ω fits"),
        (FILE[2], f"L_s = {2 * PMSM.L_s:.3g} H fits"),
        (FACTOR[0], "multiply them by about 2, unless the file describes another machine"),
        (FACTOR[1], "multiply them by about 0.5, unless the file describes another machine"),
    ],
)
def test_the_likely_value(whole, message):
    """The likely value is taken from the parameter with the smallest standard deviation."""
    values = [np.log(1.5), np.log(2), np.log(4), 0]
    best = candidate(whole, values=values, std=[0.09, 0.01, 0.05, 0.1])
    assert _likely_value(best, PMSM) == message


def test_the_likely_inductances_of_both_axes():
    best = candidate(FILE[2], values=[0, np.log(2), 0, 0])
    L_d, L_q = IPM.L_dq
    assert _likely_value(best, IPM) == f"L_d = {2 * L_d:.3g} H fits, L_q = {2 * L_q:.3g} H fits"


@pytest.mark.parametrize(
    ("drops", "message"),
    [
        (0.29, "the drop at R_s would be 3.45 times the voltage"),
        (0.31, "hardly more than the resistive drop"),
        (1.49, "hardly more than the resistive drop"),
        (1.51, "and are its kind, R_s and inductances right?"),
    ],
)
def test_no_explanation_fits(drops, message):
    """The ratio of the median voltage to the median resistive drop decides the message."""
    current = np.array([[2.0, 2j, -100.0]])
    voltage = drops * PMSM.R_s * np.array([[2.0, 2.0, 0.0]])
    search = SimpleNamespace(data=SimpleNamespace(voltage={0: voltage}, current=current))
    finding = _report_no_fit(SimpleNamespace(), PMSM, search, [], candidate(share=0.4))
    assert message in finding.findings[0].words
    assert (finding.residual, finding.residual_given, finding.sound) == (0.4, 0.4, False)


def test_possible_mistakes_of_a_machine_and_a_log():
    def kinds(machine=PMSM, frame="alphabeta", names=()):
        log = SimpleNamespace(frame=frame, names=names)
        return [mistake.words for mistake in possible_mistakes(machine, log)]

    usual = kinds()
    assert len(usual) == len(set(usual)) == 3 + 1 + 6 + 4 + 2 + 12 + 2 + 6
    # Currents of a delta's windings: only with the currents of phases.
    assert len(kinds(frame="abc")) == len(usual) + 2
    assert len(kinds(frame="line")) == len(usual) + 1
    assert len(kinds(frame="line", names=("i_a", "i_c"))) == len(usual) + 3
    assert len(kinds(names=("i_a", "i_b", "i_c"))) == len(usual)
    without = kinds(SYNRM)
    assert not any(words.startswith("psi_f") for words in without)
    assert "the scale of the voltages is wrong" not in without
    # Without magnets, a common scale of voltages and currents has no effect either.
    assert len(without) == len(usual) - 6
