"""Text of identifications, limits for disagreeing logs (from both sides), R_R from the slip."""

from types import SimpleNamespace

import numpy as np
import pytest

from fluxobs import FluxobsError
from fluxobs.identification import report, rotor_resistance
from fluxobs.identification.pooled import LogFit, Pooled, _find_differences
from fluxobs.identification.segment_fit import SegmentFit
from fluxobs.identification.values import Parameter, in_the_file
from support.records import PMSM


def apart(value, others, std=0.03):
    told = {str(k): {"R_s": pair} for k, pair in enumerate(others)}
    return _find_differences("x", told | {"x": {"R_s": (value, std)}})


@pytest.mark.parametrize(("sigmas", "disagrees"), [(3.9, False), (4.1, True), (-4.1, True)])
def test_four_standard_deviations_disagree(sigmas, disagrees):
    """The limit combines deviations of the log and of four other logs' median, and scatter."""
    others = [(1.0, 0.02), (1.01, 0.02), (0.99, 0.08), (1.0, 0.01)]
    std = np.sqrt((0.03 / 3) ** 2 + (1.4826 * 0.005) ** 2 + (0.02 / 3 / 2) ** 2)
    differences = apart(1 + sigmas * std, others)
    assert ("R_s" in differences) == disagrees
    for by, size in differences.values():
        assert by == pytest.approx(sigmas * std)
        assert size == pytest.approx(abs(sigmas))


@pytest.mark.parametrize(("share", "disagrees"), [(0.0095, False), (0.0105, True), (-0.0105, True)])
def test_less_than_a_hundredth_is_ignored(share, disagrees):
    others = [(-2.0, 1e-6)] * 3
    assert bool(apart(-2.0 * (1 + share), others, std=1e-6)) == disagrees


def test_only_parameters_of_other_logs_are_compared():
    told = {"x": {"L_s": (1.0, 0.1), "R_s": (9.0, 0.1)}, "a": {"R_s": (1.0, 0.1)}}
    assert set(_find_differences("x", told)) == {"R_s"}


def alone(told, apart, failed=""):
    return LogFit("day.csv", {n: (v, 0.1) for n, v in told.items()}, failed, apart)


def test_the_difference_of_a_log_as_text():
    log = alone({"R_s": 1.2, "inverter": 2.0}, {"R_s": (0.2, 5.4), "inverter": (2.0, 4.6)})
    assert log.words == (
        "day.csv: R_s = 1.2, 5 standard deviations from the others (+20.0 %); "
        "inverter = 2, 5 standard deviations from the others; likely cause: copper +51 K"
    )
    assert alone({}, {}, "no").words == "day.csv: no parameter can be identified: no"


@pytest.mark.parametrize(
    ("told", "by", "cause"),
    [
        ({"R_s": 1.2}, {"R_s": 0.2}, "; likely cause: copper +51 K"),
        (
            {"R_s": 1.2, "psi_f": 1.0},
            {"R_s": 0.2},
            "; likely cause: copper +51 K with unchanged magnets, or a bad contact",
        ),
        (
            {"R_s": 1.2, "psi_f": 0.945},
            {"R_s": 0.2, "psi_f": -0.055},
            "; likely cause: heat, copper +51 K, magnets +50 K",
        ),
        (
            {"R_s": 0.9, "psi_f": 1.1},
            {"R_s": -0.1, "psi_f": 0.1},
            "; likely cause: heat, copper -25 K, magnets -91 K",
        ),
        (
            {"R_s": 1.2, "psi_f": 1.1},
            {"R_s": 0.2, "psi_f": 0.1},
            "; likely cause: another motor, or changed magnets",
        ),
        ({"psi_f": 1.1}, {"psi_f": 0.1}, "; likely cause: another motor, or changed magnets"),
        (
            {"R_s": 1.2, "L_s": 2.0},
            {"R_s": 0.2, "L_s": 1.0},
            "; likely cause: another motor, or other saturation",
        ),
        ({"inverter": 2.0}, {"inverter": 1.0}, ""),
    ],
)
def test_the_likely_cause_of_a_difference(told, by, cause):
    """Copper's resistance grows by 0.393 % per kelvin, magnets lose 0.11 %."""
    log = alone(told, {name: (value, 6.0) for name, value in by.items()})
    assert log.words.endswith(cause or "standard deviations from the others (+100.0 %)")


def pooled(*logs, twice=()):
    together = SimpleNamespace(lines=lambda: ["machine"], facts={"rows": 7}, machine=PMSM)
    return Pooled(together, logs, dict(twice))


GOOD = alone({"R_s": 1.0}, {})
BAD = alone({}, {}, "no turn")
HOT = alone({"R_s": 1.2}, {"R_s": (0.2, 6.0)})


def test_many_logs_in_lines():
    assert pooled(GOOD, GOOD).lines() == ["machine", "2 logs agree"]
    assert pooled(GOOD, GOOD, BAD).lines()[1:] == [f"Not usable: {BAD.words}", "2 logs agree"]
    assert pooled(GOOD, HOT).lines()[1:] == [f"Disagrees with the others: {HOT.words}"]
    last_line = "Only one log is usable: there is no other to compare it with"
    assert pooled(GOOD, BAD).lines()[-1] == last_line
    assert pooled(GOOD, GOOD, twice={"b": "a"}.items()).lines()[1] == (
        "b is a copy of a: it counts once"
    )


def test_many_logs_as_facts():
    facts = pooled(HOT, BAD).facts
    assert facts["rows"] == 7
    assert facts["logs"] == [
        {
            "log": "day.csv",
            "told": {"R_s": [1.2, 0.1]},
            "failed": None,
            "apart": {"R_s": [0.2, 6.0]},
        },
        {"log": "day.csv", "told": {}, "failed": "no turn", "apart": {}},
    ]


PARAMETERS = [
    Parameter("R_s", "Ω", 1.0, 1.23456, 0.0123),
    Parameter("inverter", "V", None, 0.5, 0.1),
    Parameter("lag", "samples", 0.0, 0.251, 0.01),
    Parameter("L_s", "H", 0.02, 0.02, None),
]


def fitted(used=99, psi_f=0.5, free=("psi_f",), converged=True):
    segment = type("", (), {"__len__": lambda _: used, "start": np.array([0.3, 0.4])})()
    empty = type("", (), {"__len__": lambda _: 0, "start": np.array([0.0, 1.5])})()

    def fit(rms, free):
        values = {"psi_f": psi_f}
        return SimpleNamespace(rms=lambda: rms, values=values, free=free, converged=converged)

    segments = SimpleNamespace(
        segments=[segment, empty],
        before=fit(0.01, free),
        after=fit(0.005, ("R_s",)),
        machine=PMSM,
    )
    segments.flux = SegmentFit.flux.fget(segments)
    return SimpleNamespace(
        parameters=PARAMETERS,
        untold={"L_s": "no current along d"},
        map=None,
        run=None,
        rows=100,
        machine=PMSM.with_values(inverter_current=0.125),
        source="a.csv",
        segment_fit=segments,
        mechanics=None,
    )


def test_a_report_in_lines():
    lines = report.lines(fitted())
    assert lines[:4] == [
        "R_s = 1.235 ± 0.012 Ω (given 1)",
        "inverter = 0.5 ± 0.1 V (not given), its sign smoothed at inverter_current = 0.125 A",
        "lag = 0.251 ± 0.01 samples (given 0); the machine file has no lag: state it with the log",
        "L_s held at 0.02 H: no current along d",
    ]
    assert lines[4].startswith("This log cannot identify L_s: held at the given value")
    residual = "Residual: 2.00% of the flux with the given values (psi_f fitted), "
    assert lines[5:] == [residual + "1.00% with the identified ones"]


def test_the_residual_of_a_machine_without_magnets():
    """The residual refers to the mean initial flux of the segments, here 0.5 and 1.5 Wb."""
    lines = report.lines(fitted(psi_f=0.0, free=()))
    residual = "Residual: 1.00% of the flux with the given values, "
    assert lines[-1] == residual + "0.50% with the identified ones"


@pytest.mark.parametrize(("used", "said"), [(99, False), (98, True)])
def test_rows_that_were_not_used(used, said):
    lines = report.lines(fitted(used=used))
    assert any(line.startswith(f"{used} of 100 rows were used") for line in lines) == said


def test_a_fit_that_did_not_converge_warns():
    assert report.lines(fitted(converged=False))[-1].startswith("Warning: the fit did not converge")


def test_parameters_of_the_machine_file():
    assert in_the_file(PARAMETERS) == {"R_s": (1.23456, 0.0123), "inverter_voltage": (0.5, 0.1)}


def learnt_rotor_resistance(monkeypatch, rows=480, q=3.0, noise=0.0, rated=20.0, spoil=0):
    """Estimate R_R from rows with a slip of R_R i_q/ψ, where R_R is 1.7 Ω and ψ is 0.8 Wb."""
    rng = np.random.default_rng(0)
    theta = 0.1 * np.arange(rows)
    load = q * np.linspace(1.0, 2.0, rows) * np.where(np.arange(rows) % 2, 1.0, -1.0)
    i = (4.0 + 1j * load) * np.exp(1j * theta)
    speed = 100 + np.linspace(0, 1, rows)
    valid = np.arange(rows) >= spoil
    slips = 1.7 * load / 0.8 + noise * rng.standard_normal(rows)
    estimate = SimpleNamespace(
        theta_e=theta, valid=valid, speed_e=2 * speed + slips, psi_f=np.full(rows, 0.8)
    )
    excerpt = SimpleNamespace(truth=speed, voltage=None, current=np.stack([i.real, i.imag], axis=1))
    observer = SimpleNamespace(run=lambda voltage, current: estimate)
    scales = SimpleNamespace(current=20.0)
    monkeypatch.setattr(rotor_resistance, "plain_for", lambda log, machine: (observer, scales))
    monkeypatch.setattr(rotor_resistance, "excerpts", lambda log: [excerpt])
    machine = SimpleNamespace(rated_current=rated, n_p=2)
    return (
        rotor_resistance.resistance_from_speed(SimpleNamespace(path="a.csv"), machine),
        load,
        slips,
    )


def test_the_rotor_resistance_of_a_slip(monkeypatch):
    (value, std), _, _ = learnt_rotor_resistance(monkeypatch)
    assert value == pytest.approx(1.7)
    assert std < 1e-12


def test_its_standard_deviation_is_the_scatter_of_24_blocks(monkeypatch):
    (value, std), load, slips = learnt_rotor_resistance(monkeypatch, noise=1.0)
    x, y = (load / 0.8).reshape(24, -1), slips.reshape(24, -1)
    assert value == pytest.approx((x * y).sum() / (x * x).sum())
    scores = (x * (y - value * x)).sum(axis=1)
    assert std == pytest.approx(np.sqrt(24 / 23 * (scores**2).sum()) / (x * x).sum())


@pytest.mark.parametrize(("q", "rated", "told"), [(2.01, 20.0, True), (0.99, 20.0, False)])
def test_rows_with_a_tenth_of_the_rated_current_are_used(monkeypatch, q, rated, told):
    for given in (rated, None):
        if told:
            assert learnt_rotor_resistance(monkeypatch, q=q, rated=given)[0][0] == pytest.approx(
                1.7
            )
        else:
            with pytest.raises(FluxobsError, match="known on 0 rows"):
                learnt_rotor_resistance(monkeypatch, q=q, rated=given)


@pytest.mark.parametrize(("spoil", "told"), [(240, True), (241, False)])
def test_ten_rows_per_block_are_enough(monkeypatch, spoil, told):
    if told:
        assert learnt_rotor_resistance(monkeypatch, spoil=spoil)[0][0] == pytest.approx(1.7)
    else:
        with pytest.raises(FluxobsError, match="known on 239 rows"):
            learnt_rotor_resistance(monkeypatch, spoil=spoil)
