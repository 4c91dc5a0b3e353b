"""Checks of specifications, and draws of scenarios from specifications."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from fluxobs.campaigns.chunk import specification_of
from fluxobs.campaigns.courses import course_of, max_knots
from fluxobs.campaigns.distributions import Distribution, correlated, correlator
from fluxobs.campaigns.draws import (
    COURSE,
    NOISE,
    POINT,
    Scenario,
    at_point,
    points,
    scenarios,
    total,
)
from fluxobs.campaigns.specification import (
    CourseTable,
    Specification,
    check,
    read_specification,
)
from fluxobs.errors import FluxobsError, UsageError

U = (np.arange(100_000) + 0.5) / 100_000


def specification(**fields):
    return Specification(
        **{"machines": ["servo-400w"], "scenarios": 64, "observers": ["plain"]} | fields
    )


@pytest.mark.parametrize(
    ("fields", "oracle"),
    [
        ({"uniform": [2, 3]}, stats.uniform(2, 1)),
        ({"log": [0.1, 10]}, stats.loguniform(0.1, 10)),
        ({"normal": [1, 0.1]}, stats.norm(1, 0.1)),
        ({"normal": [1, 0.1], "within": [0.9, 1.3]}, stats.truncnorm(-1, 3, 1, 0.1)),
        ({"lognormal": [2, 0.5]}, stats.lognorm(0.5, scale=2)),
    ],
)
def test_quantiles_are_those_of_scipy(fields, oracle):
    np.testing.assert_allclose(Distribution(**fields).at(U), oracle.ppf(U), rtol=1e-6)


def test_choice_and_grid_take_all_values_equally_often():
    for kind in ("choice", "grid"):
        values, counts = np.unique(Distribution(**{kind: [1, 2, 5]}).at(U), return_counts=True)
        assert values.tolist() == [1, 2, 5]
        assert np.ptp(counts) <= 1


@settings(max_examples=15, deadline=None)
@given(st.floats(-0.95, 0.95))
def test_normal_scores_have_the_correlation(r):
    rng = np.random.default_rng(0)
    factor = correlator(["a", "b", "c"], {"a, c": r})
    u = correlated(rng.random((20_000, 3)), factor)
    correlation = np.corrcoef(stats.norm.ppf(u).T)
    np.testing.assert_allclose(correlation, [[1, 0, r], [0, 1, 0], [r, 0, 1]], atol=0.03)
    assert stats.kstest(u[:, 2], "uniform").pvalue > 1e-4


def test_impossible_correlations():
    with pytest.raises(UsageError, match="no joint distribution"):
        correlator(["a", "b", "c"], {"a, b": 0.9, "b, c": 0.9, "a, c": -0.9})
    with pytest.raises(UsageError, match="'d' is not drawn at random"):
        correlator(["a"], {"a, d": 0.5})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"scenarios": 0}, "scenarios must be at least 1"),
        ({"machine": ["x"]}, "unknown field 'machine'; did you mean 'machines'"),
        ({"vary": {"Rs": 2}}, "unknown quantity 'Rs'; did you mean 'R_s'"),
        ({"vary": {"R": {"normal": [1, 0.1], "uniform": [0, 1]}}}, "vary.R: give one of fixed"),
        ({"vary": {"R": {"normal": [1, 0]}}}, "vary.R: normal: the standard deviation must be"),
        ({"vary": {"R": {"uniform": [2, 1]}}}, "vary.R: uniform = .least, most. must be ascending"),
        ({"vary": {"R": {"normal": [1, 0.1], "within": [9, 10]}}}, "cuts off the whole"),
        ({"vary": {"gain": 1.1, "gain_a": 1.2}}, "gain_a is given twice"),
        ({"vary": {"noise": -0.1}}, "vary: noise = -0.1 is impossible for a drive"),
        ({"good": {"valid": 90}}, "good.valid must be at most 1"),
        ({"good": {"losses": 2}}, 'applies only with loop = "closed"'),
        ({"sampling": "sobol", "scenarios": 100}, "take 64 or 128"),
        ({"vary": {"load": {"grid": [0.1, 0.5, 0.9]}}}, "has 3 places; take 63 or 66"),
        ({"vary": {"load": {"grid": [0.1] * 65}}}, "has 65 places; take 65"),
        (
            {"vary": {"load": {"grid": [0.1, 0.5, 0.9]}}, "sampling": "sobol", "scenarios": 60},
            "at each place of the grid; take 48 or 96",
        ),
        ({"observers": ["plain", "plain"]}, "observers need different names"),
        ({"limits": [{"good": 0.9, "observer": "plan"}]}, "no observer 'plan'; did you mean"),
        ({"course": {"duration": 1, "score_from": 2}}, "must be below duration = 1 s"),
        ({"course": {"speed": [[1, 0.5], [0, 0]]}}, "times must not decrease"),
        ({"observers": [{"kind": "plain", "gains": {"x": 1}}]}, "plain has no gains"),
    ],
)
def test_messages_name_the_wrong_field(fields, message):
    with pytest.raises(UsageError, match=message):
        specification(**fields)


def test_parameters_that_a_machine_lacks_cannot_vary():
    with pytest.raises(UsageError, match=r"servo-400w .surface-pmsm. has no L_d; it has R_s, L_s"):
        check(specification(vary={"L_d": {"uniform": [0.9, 1.1]}}))


def test_messages_name_the_file(tmp_path: Path):
    path = tmp_path / "s.toml"
    with pytest.raises(FluxobsError, match=r"s\.toml: cannot be read"):
        read_specification(path)
    path.write_text("machines = [")
    with pytest.raises(FluxobsError, match=r"s\.toml: not TOML"):
        read_specification(path)
    path.write_text("machines = ['m.toml']\nscenarios = 3\nobservers = ['plain']\nsed = 1\n")
    with pytest.raises(FluxobsError, match=r"s\.toml: unknown field 'sed'; did you mean 'seed'"):
        read_specification(path)
    path.write_text("machines = ['m.toml']\nscenarios = 3\nobservers = ['plain']\n")
    assert read_specification(path).machines == [str(tmp_path / "m.toml")]


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
        all_at_once = scenarios(s, start, start + 96)
        in_pieces = [
            *scenarios(s, start, start + 1),
            *scenarios(s, start + 1, start + 38),
            *scenarios(s, start + 38, start + 96),
        ]
        assert in_pieces == all_at_once
    places = 3 if sampling == "sobol" else 1
    assert len({scenario.values["R"] for scenario in scenarios(s, 0, 96)}) == 96 / places


def test_machines_share_sobol_points_but_not_noise():
    machines = ["servo-400w", "pmsm-2kw2"]
    s = specification(vary=VARY, sampling="sobol", machines=machines, scenarios=96)
    first, second = scenarios(s, 3, 4)[0], scenarios(s, 99, 100)[0]
    assert first.values["R"] == second.values["R"]
    streams = [scenario.generator(COURSE).random() for scenario in (first, second)]
    assert streams[0] != streams[1]


def test_another_seed_draws_other_scenarios():
    first, second = (
        scenarios(specification(vary=VARY, seed=seed, scenarios=3), 0, 1)[0] for seed in (0, 1)
    )
    assert first.values["R"] != second.values["R"]
    assert first.generator(COURSE).random() != second.generator(COURSE).random()


def test_grids_are_taken_in_turn():
    vary = {"temperature": {"grid": [0, 100]}, "load": {"grid": [0.1, 0.5, 0.9]}}
    s = specification(vary=vary, scenarios=12)
    drawn = [
        (scenario.values["load"], scenario.values["temperature"])
        for scenario in scenarios(s, 0, 12)
    ]
    assert drawn[:6] == [(x, t) for x in (0.1, 0.5, 0.9) for t in (0, 100)]
    assert drawn[6:] == drawn[:6]


def test_the_order_in_the_file_does_not_matter():
    s = specification(vary=VARY, scenarios=3)
    reversed_order = specification(vary=dict(reversed(VARY.items())), scenarios=3)
    assert scenarios(reversed_order, 0, 3) == scenarios(s, 0, 3)
    assert scenarios(specification_of(s.canonical()), 0, 3) == scenarios(s, 0, 3)


def test_neutral_values_are_left_out():
    values = at_point(specification(vary={"R": 1, "L": 1.1}), np.array([0.5]))
    assert values == {"L": 1.1}


def test_all_grid_places_use_the_same_sobol_points():
    vary = {"R": {"uniform": [0, 1]}, "temperature": {"grid": [0, 100]}}
    s = specification(vary=vary, sampling="sobol")
    cold, hot = (
        [
            scenario.values["R"]
            for scenario in scenarios(s, 0, 64)
            if scenario.values["temperature"] == temperature
        ]
        for temperature in (0, 100)
    )
    assert cold == hot
    assert [int(32 * value) for value in sorted(cold)] == list(range(32))


def test_sobol_points_fill_every_slice():
    s = specification(vary={"R": {"uniform": [0, 1]}, "L": {"uniform": [0, 1]}}, sampling="sobol")
    for name in ("R", "L"):
        values = sorted(scenario.values[name] for scenario in scenarios(s, 0, 64))
        assert [int(64 * value) for value in values] == list(range(64))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "give one of fixed, .*, got none"),
        ({"fixed": 1, "choice": [1]}, "got fixed, choice"),
        ({"uniform": [1, 1]}, r"uniform = \[least, most\] must be ascending"),
        ({"log": [2, 2]}, r"log = \[least, most\] must be ascending"),
        ({"log": [0, 2]}, r"log = \[least, most\] must be positive"),
        ({"normal": [0, 0]}, "normal: the standard deviation must be positive, got 0"),
        ({"lognormal": [1, -1]}, "lognormal: the standard deviation must be positive, got -1"),
        ({"lognormal": [0, 1]}, "lognormal: the median must be positive, got 0"),
        ({"normal": [0, 1], "within": [1, 1]}, r"within = \[least, most\] must be ascending"),
        ({"uniform": [0, 1], "within": [0, 1]}, "within applies only to normal"),
        ({"normal": [0, 1], "within": [6.0, 9.0]}, "cuts off the whole"),
        ({"lognormal": [1, 0.5], "within": [-2.0, 0.0]}, "cuts off the whole"),
    ],
)
def test_invalid_distributions(fields, message):
    with pytest.raises(ValueError, match=message):
        Distribution(**fields)


def test_distributions_at_their_limits():
    """The normal tail beyond 5.99 is 1.05e-9, just above the limit of 1e-9."""
    Distribution(normal=[0, 1], within=[5.99, 20])
    Distribution(log=[1e-9, 1])
    assert Distribution(normal=[-1, 1e-9]).at(np.array([0.5])) == -1


@pytest.mark.parametrize("within", [[1.0, 5.0], [-1.0, 3.0], [0.0, 3.0]])
def test_a_truncated_lognormal(within):
    lower, upper = (np.log(x / 2) / 0.5 if x > 0 else -np.inf for x in within)
    truncated = stats.truncnorm(lower, upper, 0, 0.5)
    quantiles = Distribution(lognormal=[2, 0.5], within=within).at(U)
    np.testing.assert_allclose(quantiles, 2 * np.exp(truncated.ppf(U)), rtol=1e-6)


def test_rounding_stays_within_a_truncation():
    quantiles = Distribution(normal=[0, 1], within=[-0.1, 0.3]).at(np.array([0.0, 1.0]))
    assert quantiles == pytest.approx([-0.1, 0.3], abs=1e-12)
    assert -0.1 <= quantiles[0] < quantiles[1] <= 0.3


def test_a_choice_includes_both_ends():
    assert Distribution(choice=[1, 2]).at(np.array([0.0, 0.499, 0.5, 1.0])).tolist() == [1, 1, 2, 2]
    assert Distribution(fixed=3).at(U[:2]).tolist() == [3, 3]


def test_only_a_fixed_value_is_equal_in_all_drives():
    assert not Distribution(fixed=0).varies
    assert Distribution(choice=[1]).varies


@pytest.mark.parametrize("value", [True, "1", [1, 2], None])
def test_values_that_are_not_distributions(value):
    with pytest.raises(UsageError, match="give a number, or a table"):
        specification(vary={"R": value})


@pytest.mark.parametrize(
    ("correlations", "message"),
    [
        ({"a": 0.5}, "name two quantities"),
        ({"a, b, c": 0.5}, "name two quantities"),
        ({"a, a": 0.5}, "name two quantities"),
        ({"a, b": 0.5, "b, a": 0.5}, "'b, a': it is given twice"),
        ({"a, b": 1.0}, "must be between -1 and 1, got 1"),
        ({"a, b": -1.0}, "must be between -1 and 1, got -1"),
    ],
)
def test_invalid_correlations(correlations, message):
    with pytest.raises(UsageError, match=message):
        correlator(["a", "b", "c"], correlations)


def test_the_factor_gives_the_correlations():
    factor = correlator(["a", "b", "c"], {"a, b": 0.999, "c ,b": -0.01})
    expected = [[1, 0.999, 0], [0.999, 1, -0.01], [0, -0.01, 1]]
    np.testing.assert_allclose(factor @ factor.T, expected, atol=1e-12)


def test_correlated_quantities_of_a_drive():
    """With normal scores z of a point, b = r a + √(1 − r²) z."""
    vary = {"L": {"normal": [0, 1]}, "R": {"normal": [0, 1]}, "theta_e": 0.0}
    s = specification(vary=vary, correlation={"R, L": 0.6})
    values = at_point(s, stats.norm.cdf([0.5, 2.0]))
    assert values == pytest.approx({"L": 0.5, "R": 0.6 * 0.5 + 0.8 * 2.0})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"score_from": 2.0}, "score_from = 2 s must be below duration = 2 s"),
        ({"speeds": [0.0, 1.0]}, "speeds = .* must be positive and ascending"),
        ({"speeds": [0.6, 0.5]}, "speeds = .* must be positive and ascending"),
        ({"segment": [0.0, 1.0]}, "segment = .* must be positive and ascending"),
        ({"loads": [0.1, 0.0]}, "loads = .* must be ascending"),
        ({"stops": 1.01}, "stops is a share, at most 1"),
        ({"reversals": 1.01}, "reversals is a share, at most 1"),
        ({"stops": -0.1}, "stops must be at least"),
        ({"load": [[0, 0], [1, 1], [0.5, 1]]}, "load: times must not decrease"),
        ({"load": "rundom"}, "give .random., or"),
        ({"speed": [[0, 1, 2]]}, "give .random., or"),
        ({"speed": []}, "give .random., or"),
    ],
)
def test_invalid_courses(fields, message):
    with pytest.raises(UsageError, match=message):
        specification(course=fields)


def test_courses_at_their_limits():
    specification(
        course={
            "score_from": 1.999,
            "speeds": [0.5, 0.5],
            "segment": [0.5, 0.5],
            "loads": [0.3, 0.3],
            "stops": 1.0,
            "reversals": 1.0,
            "load": [[0, 0], [0, 1]],
        }
    )


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"kind": "plain", "unknowns": ["drift"]},
            "unknowns applies only to adaptive, not to plain",
        ),
        ({"kind": "ekf", "unknowns": ["drift"]}, "unknowns applies only to adaptive, not to ekf"),
        ({"kind": "ekf", "memory": 0.1}, "memory applies only to plain and adaptive; ekf"),
        ({"kind": "adaptive", "gains": {"x": 1}}, "adaptive has no gains"),
        ({"kind": "plain", "machine": {"J": 1.1}}, "factors on R, L, psi; got 'J'"),
        (3, "give a name, or a table"),
    ],
)
def test_invalid_observers(table, message):
    with pytest.raises(UsageError, match=message):
        specification(observers=[table])


def test_observers_with_all_settings():
    plain, adaptive, other = specification(
        observers=[
            {"kind": "plain", "memory": 0.1, "machine": {"R": 1.1, "L": 0.9, "psi": 1.2}},
            {"kind": "adaptive", "memory": 0.1, "unknowns": ["drift"], "name": "mine"},
            {"kind": "ekf", "gains": {"q": 1.0}},
        ]
    ).observers
    assert (plain.name, adaptive.name, other.name) == ("plain", "mine", "ekf")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"scenarios": 10_000_001}, "scenarios must be at most 10000000"),
        ({"seed": -1}, "seed must be at least 0"),
        (
            {"machines": ["servo-400w", "servo-400w"]},
            "machines: each machine may be given only once",
        ),
        ({"limits": [{"good": 1.1}]}, "good must be at most 1"),
        ({"limits": [{"good": 0.9, "machine": "servo"}]}, "limits: no machine 'servo'"),
        ({"good": {"losses": -1}}, "losses must be at least 0"),
        ({"vary": {"R": 0}}, "R = 0 is impossible"),
        ({"vary": {"temperature": -200}}, "temperature = -200 is impossible"),
        ({"vary": {"range": 0}}, "range = 0 is impossible"),
        ({"vary": {"knee": 0}}, "knee = 0 is impossible"),
        ({"sampling": "sobol", "scenarios": 3}, "need a power of two; take 2 or 4"),
        ({"vary": {"load": {"grid": [1, 2, 3]}}, "scenarios": 3, "sampling": "random"}, None),
        ({"vary": {"load": {"grid": [1, 2, 3]}}, "scenarios": 2}, "has 3 places; take 3$"),
        ({"vary": {"load": {"grid": [1, 2, 3]}}, "scenarios": 5}, "has 3 places; take 3 or 6"),
        ({"loop": "closed", "good": {"losses": 0}}, None),
        ({"vary": {"temperature": -199}}, None),
        ({"scenarios": 10_000_000}, None),
        ({"sampling": "sobol", "scenarios": 1}, None),
    ],
)
def test_campaigns_at_their_limits(fields, message):
    if message is None:
        specification(**fields)
    else:
        with pytest.raises(UsageError, match=message):
            specification(**fields)


@pytest.mark.parametrize("name", ["viscous", "coulomb", "dead_time", "drop", "noise", "quantum"])
def test_quantities_that_may_be_zero_but_not_negative(name):
    specification(vary={name: 0})
    with pytest.raises(UsageError, match=f"{name} = -0.001 is impossible"):
        specification(vary={name: -1e-3})


def test_defaults():
    s = specification()
    assert s.vary["theta_e"].uniform == [-np.pi, np.pi]
    assert (s.seed, s.loop, s.sampling, s.good.rms) == (0, "open", "random", 2.0)
    assert s.places == 1


def test_group_names_of_quantities_and_names_of_observers():
    s = specification(vary={"gain": {"uniform": [0.9, 1.1]}}, observers=["plain", "adaptive"])
    assert s.varied == ("gain_a", "gain_b", "gain_c", "theta_e")
    assert s.observer().name == "plain"
    assert s.observer("adaptive").kind == "adaptive"
    with pytest.raises(UsageError, match="no observer 'adaptve'; did you mean 'adaptive'"):
        s.observer("adaptve")


def test_machine_files_are_called_by_their_names_if_these_differ():
    s = specification(machines=["servo-400w", "/a/m.toml", "/b/m.toml", "/b/n.toml"])
    assert [s.called(machine) for machine in s.machines] == [
        "servo-400w",
        "/a/m.toml",
        "/b/m.toml",
        "n",
    ]


def test_a_scenario_can_borrow_course_and_noise():
    drawn = scenarios(specification(scenarios=3), 0, 3)
    borrower = Scenario(0, "servo-400w", {}, seed=0, like=2)
    for stream in (COURSE, NOISE):
        assert borrower.generator(stream).random() == drawn[2].generator(stream).random()
    own_numbers = [drawn[0].generator(stream).random() for stream in (POINT, COURSE, NOISE)]
    assert len(set(own_numbers)) == 3


def test_scenarios_of_all_machines():
    s = specification(machines=["servo-400w", "pmsm-2kw2"], scenarios=5)
    assert total(s) == 10
    assert [scenario.machine for scenario in scenarios(s, 5, 7)] == ["pmsm-2kw2"] * 2
    assert points(specification(vary={"theta_e": 0.0}), 3, 7).shape == (4, 0)


def courses(count=300, **table):
    table = CourseTable(**table)
    drawn = [Scenario(k, "servo-400w", {}, seed=0) for k in range(count)]
    return [course_of(table, scenario) for scenario in drawn]


def test_specified_courses_are_used():
    speed, load = [(0.0, 0.0), (1.0, 0.5)], [(0.0, 0.3)]
    assert courses(1, speed=speed, load=load) == [(speed, load)]


def test_random_courses_keep_their_limits():
    table = {"speeds": [0.1, 0.6], "loads": [-0.3, 0.5], "segment": [0.4, 0.7], "ramp": 0.2}
    reached, loads, lengths = [], [], []
    for speed, load in courses(**table):
        t, x = np.array(speed).T
        assert t[0] == x[0] == 0
        assert (np.diff(t) >= 0).all()
        slopes = np.diff(x)[np.diff(t) > 0] / np.diff(t)[np.diff(t) > 0]
        assert np.abs(slopes).max() == pytest.approx(1 / 0.2, rel=1e-9)
        reached.append(abs(x[1]))
        times, torques = np.array(load).T
        assert load[0] == (0.0, 0.0)
        assert (times[1::2] == times[2::2]).all()  # steps
        assert (torques[1::2] == torques[:-1:2]).all()
        assert times[-1] < 2.0
        assert 2.0 - times[-1] <= 0.7
        lengths += [times[1], *np.diff(times[1::2])]
        loads += [*torques[2::2]]
    assert stats.kstest(reached, stats.loguniform(0.1, 0.6).cdf).pvalue > 1e-3
    assert stats.kstest(loads, stats.uniform(-0.3, 0.8).cdf).pvalue > 1e-3
    assert stats.kstest(lengths, stats.uniform(0.4, 0.3).cdf).statistic < 0.1
    assert max(len(knots) for pair in courses(**table) for knots in pair) <= max_knots(
        CourseTable(**table)
    )


def targets(**table):
    """Speeds at the ends of the segments, which are longer than a ramp."""
    defaults = {"segment": [0.5, 0.5], "ramp": 0.01, "speeds": [0.5, 1.0], "load": [[0, 0]]}
    ends = [np.array(speed)[1::2, 1] for speed, _ in courses(**defaults | table)]
    return np.array(ends)


def test_shares_of_stops_and_reversals():
    first, *later = targets(stops=0.25, reversals=0.0).T
    assert (first != 0).all()
    assert (first > 0).mean() == pytest.approx(0.5, abs=0.1)
    assert np.mean(np.equal(later, 0)) == pytest.approx(0.25, abs=0.04)
    signs = np.sign(targets(stops=0.0, reversals=0.2))
    assert signs.shape == (300, 4)
    assert np.mean(signs[:, 1:] != signs[:, :-1]) == pytest.approx(0.2, abs=0.04)


def test_a_drive_that_stops_in_every_segment_starts():
    speeds = targets(stops=1.0)
    assert (np.abs(speeds[:, 0]) >= 0.5).all()
    assert (speeds[:, 1:] == 0).all()


def test_max_knots_bounds_all_courses():
    assert max_knots(CourseTable(duration=2.0, segment=[0.5, 1.0])) == 2 * 5 + 2
    many = [[0.01 * k, 0.0] for k in range(50)]
    assert max_knots(CourseTable(load=many)) == 50
