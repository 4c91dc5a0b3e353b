"""What a specification may say, and what it draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from fluxobs.campaigns.chunk import specification_of
from fluxobs.campaigns.distributions import Distribution, correlated, correlator
from fluxobs.campaigns.draws import COURSE, at_point, scenarios
from fluxobs.campaigns.specification import Specification, check, read_specification
from fluxobs.errors import FluxobsError, UsageError

U = (np.arange(100_000) + 0.5) / 100_000


def specification(**given):
    return Specification(
        **{"machines": ["servo-400w"], "scenarios": 64, "observers": ["plain"]} | given
    )


@pytest.mark.parametrize(
    ("given", "oracle"),
    [
        ({"uniform": [2, 3]}, stats.uniform(2, 1)),
        ({"log": [0.1, 10]}, stats.loguniform(0.1, 10)),
        ({"normal": [1, 0.1]}, stats.norm(1, 0.1)),
        ({"normal": [1, 0.1], "within": [0.9, 1.3]}, stats.truncnorm(-1, 3, 1, 0.1)),
        ({"lognormal": [2, 0.5]}, stats.lognorm(0.5, scale=2)),
    ],
)
def test_quantiles_are_those_of_scipy(given, oracle):
    np.testing.assert_allclose(Distribution(**given).at(U), oracle.ppf(U), rtol=1e-6)


def test_choice_and_grid_take_each_value_as_often():
    for kind in ("choice", "grid"):
        values, counts = np.unique(Distribution(**{kind: [1, 2, 5]}).at(U), return_counts=True)
        assert values.tolist() == [1, 2, 5]
        assert np.ptp(counts) <= 1


@given(st.floats(-0.95, 0.95))
def test_normal_scores_have_the_correlation(r):
    rng = np.random.default_rng(0)
    factor = correlator(["a", "b", "c"], {"a, c": r})
    u = correlated(rng.random((20_000, 3)), factor)
    found = np.corrcoef(stats.norm.ppf(u).T)
    np.testing.assert_allclose(found, [[1, 0, r], [0, 1, 0], [r, 0, 1]], atol=0.03)
    assert stats.kstest(u[:, 2], "uniform").pvalue > 1e-4


def test_impossible_correlations():
    with pytest.raises(UsageError, match="no joint distribution"):
        correlator(["a", "b", "c"], {"a, b": 0.9, "b, c": 0.9, "a, c": -0.9})
    with pytest.raises(UsageError, match="'d' does not vary"):
        correlator(["a"], {"a, d": 0.5})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"scenarios": 0}, "scenarios: input should be greater than or equal to 1"),
        ({"machine": ["x"]}, "unknown field 'machine'; did you mean 'machines'"),
        ({"vary": {"Rs": 2}}, "unknown quantity 'Rs'; did you mean 'R_s'"),
        ({"vary": {"R": {"normal": [1, 0.1], "uniform": [0, 1]}}}, "vary.R: give one of fixed"),
        ({"vary": {"R": {"normal": [1, 0]}}}, "vary.R: normal: the standard deviation must be"),
        ({"vary": {"R": {"uniform": [2, 1]}}}, "vary.R: uniform = .least, most. must rise"),
        ({"vary": {"R": {"normal": [1, 0.1], "within": [9, 10]}}}, "leaves nothing"),
        ({"vary": {"gain": 1.1, "gain_a": 1.2}}, "gain_a is given twice"),
        ({"vary": {"noise": -0.1}}, "vary: noise = -0.1 is impossible for a drive"),
        ({"good": {"valid": 90}}, "good.valid: input should be less than or equal to 1"),
        ({"good": {"losses": 2}}, 'only with loop = "closed"'),
        ({"sampling": "sobol", "scenarios": 100}, "take 64 or 128"),
        ({"vary": {"load": {"grid": [0.1, 0.5, 0.9]}}}, "has 3 places; take 63 or 66"),
        ({"vary": {"load": {"grid": [0.1] * 65}}}, "has 65 places; take 65"),
        (
            {"vary": {"load": {"grid": [0.1, 0.5, 0.9]}}, "sampling": "sobol", "scenarios": 60},
            "at each place of the grid; take 48 or 96",
        ),
        ({"observers": ["plain", "plain"]}, "observers need names of their own"),
        ({"limits": [{"good": 0.9, "observer": "plan"}]}, "no observer 'plan'; did you mean"),
        ({"course": {"duration": 1, "score_from": 2}}, "nothing of 1 s is left"),
        ({"course": {"speed": [[1, 0.5], [0, 0]]}}, "times must not decrease"),
        ({"observers": [{"kind": "plain", "gains": {"x": 1}}]}, "plain has no gains"),
    ],
)
def test_what_is_wrong_is_named(given, words):
    with pytest.raises(UsageError, match=words):
        specification(**given)


def test_what_only_machines_can_tell():
    with pytest.raises(UsageError, match=r"servo-400w .surface-pmsm. has no L_d; it has R_s, L_s"):
        check(specification(vary={"L_d": {"uniform": [0.9, 1.1]}}))


def test_a_file_is_named_with_its_mistake(tmp_path: Path):
    place = tmp_path / "s.toml"
    with pytest.raises(FluxobsError, match=r"s\.toml: cannot be read"):
        read_specification(place)
    place.write_text("machines = [")
    with pytest.raises(FluxobsError, match=r"s\.toml: not TOML"):
        read_specification(place)
    place.write_text("machines = ['m.toml']\nscenarios = 3\nobservers = ['plain']\nsed = 1\n")
    with pytest.raises(FluxobsError, match=r"s\.toml: unknown field 'sed'; did you mean 'seed'"):
        read_specification(place)
    place.write_text("machines = ['m.toml']\nscenarios = 3\nobservers = ['plain']\n")
    assert read_specification(place).machines == [str(tmp_path / "m.toml")]


VARY = {
    "R": {"normal": [1, 0.1]},
    "offset": {"uniform": [-0.02, 0.02]},
    "noise": 0.003,
    "temperature": {"grid": [0, 50, 100]},
}


@pytest.mark.parametrize("sampling", ["random", "sobol"])
def test_a_scenario_depends_on_its_number_alone(sampling):
    machines = ["servo-400w", "pmsm-2kw2"]
    s = specification(vary=VARY, sampling=sampling, machines=machines, scenarios=96)
    for start in (0, 96):
        whole = scenarios(s, start, start + 96)
        parts = [
            *scenarios(s, start, start + 1),
            *scenarios(s, start + 1, start + 38),
            *scenarios(s, start + 38, start + 96),
        ]
        assert parts == whole
    places = 3 if sampling == "sobol" else 1
    assert len({one.values["R"] for one in scenarios(s, 0, 96)}) == 96 / places


def test_machines_get_the_same_points_of_a_sequence_but_noise_of_their_own():
    machines = ["servo-400w", "pmsm-2kw2"]
    s = specification(vary=VARY, sampling="sobol", machines=machines, scenarios=96)
    first, second = scenarios(s, 3, 4)[0], scenarios(s, 99, 100)[0]
    assert first.values["R"] == second.values["R"]
    streams = [one.generator(COURSE).random() for one in (first, second)]
    assert streams[0] != streams[1]


def test_another_seed_draws_others():
    one, other = (
        scenarios(specification(vary=VARY, seed=seed, scenarios=3), 0, 1)[0] for seed in (0, 1)
    )
    assert one.values["R"] != other.values["R"]
    assert one.generator(COURSE).random() != other.generator(COURSE).random()


def test_grids_are_taken_in_turn():
    vary = {"temperature": {"grid": [0, 100]}, "load": {"grid": [0.1, 0.5, 0.9]}}
    s = specification(vary=vary, scenarios=12)
    drawn = [(one.values["load"], one.values["temperature"]) for one in scenarios(s, 0, 12)]
    assert drawn[:6] == [(x, t) for x in (0.1, 0.5, 0.9) for t in (0, 100)]
    assert drawn[6:] == drawn[:6]


def test_the_order_in_the_file_does_not_matter():
    s = specification(vary=VARY, scenarios=3)
    other = specification(vary=dict(reversed(VARY.items())), scenarios=3)
    assert scenarios(other, 0, 3) == scenarios(s, 0, 3)
    assert scenarios(specification_of(s.canonical()), 0, 3) == scenarios(s, 0, 3)


def test_neutral_values_are_left_out():
    values = at_point(specification(vary={"R": 1, "L": 1.1}), np.array([0.5]))
    assert values == {"L": 1.1}


def test_every_place_of_a_grid_sees_the_same_sobol_points():
    vary = {"R": {"uniform": [0, 1]}, "temperature": {"grid": [0, 100]}}
    s = specification(vary=vary, sampling="sobol")
    cold, hot = (
        [one.values["R"] for one in scenarios(s, 0, 64) if one.values["temperature"] == at]
        for at in (0, 100)
    )
    assert cold == hot
    assert [int(32 * value) for value in sorted(cold)] == list(range(32))


def test_sobol_points_fill_every_slice():
    s = specification(vary={"R": {"uniform": [0, 1]}, "L": {"uniform": [0, 1]}}, sampling="sobol")
    for name in ("R", "L"):
        values = sorted(one.values[name] for one in scenarios(s, 0, 64))
        assert [int(64 * value) for value in values] == list(range(64))
