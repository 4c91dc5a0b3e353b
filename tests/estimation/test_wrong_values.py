"""Logs that contradict the machine file or each other: named, and never sure and wrong."""

from functools import cache

import numpy as np
import pytest

import fluxobs
from fluxobs.estimation.hypotheses import ODDS, other_inductances, with_inductance
from fluxobs.machines import SurfacePMSM
from fluxobs.simulation.closed_form.signals import driven
from fluxobs.smoothing.record import SmoothingModel
from support.records import PMSM, SERVO, white, wrapped_degrees

pytestmark = pytest.mark.mistakes

H, ROWS, PARTS = 1e-4, 8_000, 6
T = H * np.arange(ROWS)
FINE = np.linspace(0, T[-1], (ROWS - 1) * PARTS + 1)
SPEED = np.interp(FINE, [0, 0.25, 0.5, 0.8], [300.0, 600.0, 350.0, 500.0])
LOAD = np.interp(FINE, [0, 0.2, 0.203, 0.45, 0.453, 0.8], [0.4, 0.4, 1.0, 1.0, 0.6, 0.6])


class Plant:
    """What the signals need of a machine."""

    def __init__(self, R_s, flux_dq):
        self.R_s, self.flux_dq = R_s, flux_dq


def log_of(plant, size, noise=0.002):
    run = driven(plant, H, SPEED, 1j * size * LOAD, PARTS, 0.7)
    voltage = np.append(run.voltage, run.voltage[-1])
    return voltage, run.current + noise * size * white(ROWS, 3), run.theta_e


def estimated(voltage, current, theta, machine):
    result = fluxobs.estimate((voltage, current), machine, sample_time=H, lag=0)
    return result, np.abs(wrapped_degrees(result["theta_e"] - theta)), result["valid"]


@pytest.mark.parametrize("ratio", [1.0, 2.2])
def test_a_salient_machine_given_as_surface(ratio):
    psi, L = PMSM.psi_f, PMSM.L_s
    plant = Plant(PMSM.R_s, lambda i: psi + L * i.real + 1j * ratio * L * i.imag)
    result, error, valid = estimated(*log_of(plant, 5.0), PMSM)
    assert error[valid].max(initial=0) < 10
    named = [text for text in result.warnings if "L_s in the machine file does not fit" in text]
    assert len(named) == (ratio > 1)
    if ratio > 1:
        assert result.learnt.inductance_error[0] > 0.5
        assert np.sqrt(np.mean(error**2)) < 5  # 9 degrees with the inductance of the file
    else:
        assert valid.mean() > 0.98
        assert result.budget.wrong_inductance == 0


def test_hypotheses_of_the_inductance():
    scales = fluxobs.estimate(fluxobs.demo_log(), SERVO).scales
    model = SmoothingModel.of(SERVO, scales, H, SERVO.psi_f, 0.02, 400.0, {})
    prior = model.prior()
    assert other_inductances(model, prior) == []
    low = other_inductances(model, prior.with_deviation("L_d", -0.15))
    high = other_inductances(model, prior.with_deviation("L_d", 0.15))
    assert all(factor < 1 for factor, _ in low)
    assert all(factor > 1 for factor, _ in high)
    assert sum(np.exp(-cost) for _, cost in high) == pytest.approx(ODDS)
    assert other_inductances(model, prior.with_deviation("L_d", 0.9)) == []  # a contradiction
    other = with_inductance(model, 1.6)
    assert other.map["L_d"] == pytest.approx(1.6 * model.map["L_d"])
    assert other.map["psi"] == model.map["psi"]
    assert with_inductance(model, 1.0) is model


def test_the_gain_of_the_sensors_falls_with_the_duty_cycle():
    plant = Plant(PMSM.R_s, PMSM.flux_dq)
    voltage, current, theta = log_of(plant, 5.0)
    turns = np.exp(2j * np.pi / 3 * np.arange(3))
    link = 1.8 * np.abs(voltage).max()
    phases = [
        (current * turn.conj()).real * (1 - 0.1 * (0.5 + (voltage * turn.conj()).real / link))
        for turn in turns
    ]
    read = 2 / 3 * sum(phase * turn for phase, turn in zip(phases, turns, strict=True))
    result, error, valid = estimated(voltage, read, theta, PMSM)
    assert valid.mean() > 0.98
    assert error[valid].max() < 3  # 9 degrees without the assumption
    assert abs(result.learnt.inductance_error[0]) < 0.1


def test_magnets_that_weaken_while_the_speed_changes():
    psi, L = PMSM.psi_f, PMSM.L_s

    def flux(i):
        lost = 0.2 * np.clip((FINE - 0.4) / 0.005, 0, 1)
        return psi * (1 - lost) + L * i

    result, error, valid = estimated(*log_of(Plant(PMSM.R_s, flux), 5.0), PMSM)
    assert valid.mean() > 0.8
    assert error[valid].max() < 3
    assert any("contradict the record before and behind them" in text for text in result.warnings)


def test_the_scale_of_the_voltages_is_in_the_standard_deviations():
    plant = Plant(PMSM.R_s, PMSM.flux_dq)
    voltage, current, theta = log_of(plant, 5.0)
    result, error, valid = estimated(1.1 * voltage, current, theta, PMSM)
    learnt = result.learnt
    assert error[valid].max() < 3
    assert abs(learnt.psi_f - PMSM.psi_f) < 4 * learnt.psi_f_std
    assert abs(learnt.resistance - PMSM.R_s) < 4 * learnt.resistance_std


ROTATED = {
    "phases b and c exchanged": (lambda i: i.conj(), "phases b and c are exchanged"),
    "windings of a delta": (
        lambda i: i / 3**0.5 * np.exp(1j * np.pi / 6),
        "currents are those of the delta's windings, i_ab i_bc i_ca",
    ),
    "windings of a delta, other order": (
        lambda i: i / 3**0.5 * np.exp(-1j * np.pi / 6),
        "currents are those of the delta's windings, i_ac i_ba i_cb",
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("phases b and c exchanged", marks=pytest.mark.slow),
        pytest.param("windings of a delta", marks=pytest.mark.slow),
        "windings of a delta, other order",
    ],
)
def test_currents_of_other_phases_are_named_and_no_row_is_valid(name):
    read, words = ROTATED[name]
    voltage, current, _ = log_of(Plant(SERVO.R_s, SERVO.flux_dq), 8.0)
    columns = {"t": T}
    for letter, vector in (("u", voltage), ("i", read(current))):
        for k, phase in enumerate("abc"):
            columns[f"{letter}_{phase}"] = (vector * np.exp(-2j * np.pi / 3 * k)).real
    result = fluxobs.estimate(columns, SERVO, lag=0)
    assert not result["valid"].any()
    assert any(words in text for text in result.warnings)


def test_a_check_does_not_contradict_the_estimate():
    """Gains, a lag of a third of a sample and iron loss look like a wrong inductance to a check."""
    voltage, current, theta = log_of(Plant(PMSM.R_s, PMSM.flux_dq), 5.0)
    read = current + 0.01 * current.conj() + 0.02 + 0.03j
    between = 0.7 * voltage + 0.3 * np.append(voltage[:1], voltage[:-1])
    result, error, valid = estimated(between, read, theta, PMSM)
    assert valid.mean() > 0.95
    assert error[valid].max() < 5
    assert not [text for text in result.warnings if text.startswith(("scale:", "lag:"))]


def test_a_surface_machine_without_a_flux_in_its_file():
    machine = SurfacePMSM(R_s=PMSM.R_s, L_s=PMSM.L_s, n_p=PMSM.n_p)
    result, error, valid = estimated(*log_of(Plant(PMSM.R_s, PMSM.flux_dq), 5.0), machine)
    assert valid.mean() > 0.95
    assert error[valid].max() < 3
    assert result.learnt.psi_f == pytest.approx(PMSM.psi_f, rel=0.02)


# ---- every advice has a situation, and following it removes the warning ----------------------


def _plain(machine=PMSM, size=5.0):
    voltage, current, _ = log_of(Plant(machine.R_s, machine.flux_dq), size)
    return voltage, current


def _salient():
    psi, L = PMSM.psi_f, PMSM.L_s
    return log_of(Plant(PMSM.R_s, lambda i: psi + L * i.real + 2.2j * L * i.imag), 5.0)[:2]


def _repeated():
    voltage, current = (x.copy() for x in _plain())
    voltage[5000:5060], current[5000:5060] = voltage[4999], current[4999]
    return voltage, current


def _sagging():
    voltage, current = _plain()
    return voltage / (1 - 0.2 * np.abs(current) / 5), current


def _weakening():
    psi, L = PMSM.psi_f, PMSM.L_s
    lost = 0.2 * np.clip((FINE - 0.4) / 0.005, 0, 1)
    return log_of(Plant(PMSM.R_s, lambda i: psi * (1 - lost) + L * i), 5.0)[:2]


def _slow():
    return tuple(x[::18] for x in _plain())


def _resting():
    current = 5.0 + 0.01 * white(4000, 1)
    return PMSM.R_s * current.real + 0j * current, current


IPM = fluxobs.example("ipm-2kw2").with_values(L_d=PMSM.L_s, L_q=2.2 * PMSM.L_s)
IPM = IPM.with_values(psi_f=PMSM.psi_f, R_s=PMSM.R_s)
#: Situation (log, machine, options), warning, and the situation to which its advice leads.
ADVICE = {
    "faulty rows": ((_repeated, PMSM, {}), "Bad rows: 60 repeated", (_plain, PMSM, {})),
    "wrong inductance": ((_salient, PMSM, {}), "Measure L_q under load", (_salient, IPM, {})),
    "sagging link": ((_sagging, PMSM, {}), "log the measured DC-link voltage", (_plain, PMSM, {})),
    "a jump": ((_weakening, PMSM, {}), "These stretches contradict", (_plain, PMSM, {})),
    "slow log": (
        (_slow, PMSM, {"sample_time": 18 * H}),
        "samples per electrical period",
        (_plain, PMSM, {}),
    ),
    "standstill": ((_resting, PMSM, {}), "at or near standstill", (_plain, PMSM, {})),
    "exchanged phases": (
        (lambda: (_plain()[0], _plain()[1].conj()), PMSM, {}),
        "phases b and c are exchanged",
        (_plain, PMSM, {}),
    ),
    "too short": (
        (lambda: tuple(x[:200] for x in _resting()), PMSM, {}),
        "too short to settle",
        (_plain, PMSM, {}),
    ),
}


def _warnings(situation):
    log, machine, options = situation
    given = {"sample_time": H, "lag": 0} | options
    return given, fluxobs.estimate(log(), machine, **given).warnings


@cache
def _warnings_of_the_right_log():
    return _warnings((_plain, PMSM, {}))[1]


@pytest.mark.parametrize("name", ADVICE)
def test_advice_has_a_situation_and_can_be_followed(name):
    bad, words, mended = ADVICE[name]
    given, texts = _warnings(bad)
    assert any(words in text for text in texts), texts
    for text in texts:  # nothing that is stated already is asked for
        assert "state --lag" not in text or "lag" not in given, text
    right = mended == (_plain, PMSM, {})
    texts = _warnings_of_the_right_log() if right else _warnings(mended)[1]
    assert not any(words in text for text in texts)


def test_advice_does_not_ask_for_what_is_stated():
    measured = PMSM.with_values(L_s_std=0.01 * PMSM.L_s, psi_f_std=0.001, R_s_std=0.05)
    result = fluxobs.estimate(_plain(), measured, sample_time=H, lag=0)
    assert not {"L_d", "magnet flux", "resistance"} & {
        item for item in result.budget.stated if item in result.budget.advice
    }
