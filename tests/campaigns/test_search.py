"""The search for the worst scenario and rare failures, on functions with known answers."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy import optimize
from scipy.stats import norm

from fluxobs.campaigns import simulated as simulated_module
from fluxobs.campaigns.columns import schema
from fluxobs.campaigns.search import Rare, estimate_rare, evaluator, find_worst
from fluxobs.campaigns.specification import GoodTable, Specification
from fluxobs.errors import FluxobsError, UsageError

QUANTITIES = ("R", "L", "psi", "temperature")


def specification(**fields) -> Specification:
    vary = {name: {"normal": [1, 0.1], "within": [0.5, 1.5]} for name in QUANTITIES[:3]}
    vary |= {"temperature": {"normal": [50, 10]}, "theta_e": 0.0}
    defaults = {"machines": ["servo-400w"], "scenarios": 64, "observers": ["plain"], "vary": vary}
    return Specification(**defaults | fields)


def rows(error: np.ndarray) -> pl.DataFrame:
    s = specification()
    columns = dict.fromkeys(schema(s), None)
    length = len(error)
    values = {"number": np.arange(length), "rms": error, "worst": 2 * error, "valid": 1.0}
    return pl.DataFrame(
        {name: values.get(name, [None] * length) for name in columns}, schema_overrides=schema(s)
    )


def test_finds_the_worst_scenario():
    peak = {"R": 1.5, "L": -1.0, "psi": 0.5, "temperature": 2.0}  # normal scores
    peak_scores = np.array([peak[name] for name in specification().varied])
    generations = []

    def evaluate(scores, like):
        generations.append(len(scores))
        assert set(like) == {0}
        return rows(np.exp(-np.sum((scores - peak_scores) ** 2, axis=1)))

    worst = find_worst(specification(), "servo-400w", "plain", budget=2500, evaluate=evaluate)
    assert worst.row["rms"] > 0.9
    assert worst.tried == sum(generations)
    assert worst.history[-1] > worst.history[0]
    assert worst.values["R"] == pytest.approx(1.15, abs=0.04)
    assert worst.values["temperature"] == pytest.approx(70, abs=4)


def test_starts_at_the_worst_scenario_of_the_campaign():
    s = specification()
    start = rows(np.linspace(0.1, 1.0, 64)).with_columns(
        machine=pl.lit("servo-400w"), observer=pl.lit("plain")
    )

    def evaluate(scores, like):
        assert set(like) == {63}
        return rows(np.full(len(scores), 0.3))

    assert find_worst(s, "servo-400w", "plain", start, budget=64, evaluate=evaluate).like == 63


def test_no_valid_row_is_an_error():
    def evaluate(scores, like):
        return rows(np.zeros(len(scores)))

    with pytest.raises(FluxobsError, match="no tried scenario has a valid row"):
        find_worst(specification(), "servo-400w", "plain", budget=64, evaluate=evaluate)


@pytest.mark.parametrize("beta", [2.0, 3.0, 4.0])
def test_a_rare_failure_is_estimated_within_its_standard_deviation(beta):
    """Failures lie beyond a plane at the distance beta; their probability is a normal tail."""
    direction = np.array([1.0, 2.0, 0.0, -1.0]) / np.sqrt(6)

    def evaluate(scores, like):
        assert len(set(like)) == len(scores)
        return rows(np.exp(scores @ direction - beta))

    limit = GoodTable(rms=float(np.degrees(1.0)))
    errors = []
    for seed in range(12):
        rare = estimate_rare(
            specification(),
            *("servo-400w", "plain"),
            budget=2000,
            good=limit,
            seed=seed,
            evaluate=evaluate,
        )
        true = norm.sf(beta)
        errors.append((rare.probability - true) / rare.std)
        assert rare.std < 0.25 * true
        assert rare.tried <= 2200
    assert np.abs(errors).max() < 3.5
    assert np.mean(np.abs(errors) < 1.96) > 0.7


def test_no_failures():
    rare = estimate_rare(
        specification(),
        *("servo-400w", "plain"),
        budget=300,
        evaluate=lambda scores, like: rows(np.full(len(scores), 1e-3)),
    )
    assert rare.probability == 0.0
    assert str(rare).startswith("no failure among")


def test_wrong_names_are_refused():
    for machine, observer, message in (
        ("servo", "plain", "no machine 'servo'"),
        ("servo-400w", "ekf", "no observer 'ekf'"),
    ):
        with pytest.raises(UsageError, match=message):
            evaluator(specification(), machine, observer)
    with pytest.raises(UsageError, match="no quantity varies"):
        evaluator(specification(vary={"theta_e": 0.0}), "servo-400w", "plain")


def test_points_use_the_borrowed_course(monkeypatch):
    monkeypatch.setattr(simulated_module, "LANES", 4)
    # The compiled simulation of test_rows.py.
    course = {"duration": 0.3, "score_from": 0.1, "speeds": [0.5, 1.0], "ramp": 0.1, "stops": 0.0}
    evaluate = evaluator(specification(course=course), "servo-400w", "plain")
    evaluated = evaluate(np.zeros((3, 4)), [5, 5, 6])
    assert evaluated["number"].to_list() == [0, 1, 2]
    assert evaluated["rms_all"][0] == evaluated["rms_all"][1] != evaluated["rms_all"][2]


@pytest.mark.parametrize(
    ("rare", "low", "high"),
    [
        (Rare(0.1, 0.02, 50, 100, 40.0), 0.1 - 0.0392, 0.1 + 0.0392),
        (Rare(0.01, 0.02, 50, 100, 40.0), 0.0, 0.0492),
        (Rare(0.99, 0.02, 50, 100, 40.0), 0.9508, 1.0),
    ],
)
def test_interval_of_a_rare_failure(rare, low, high):
    assert rare.interval == pytest.approx((low, high), abs=1e-6)


@pytest.mark.parametrize(("effective", "unreliable"), [(9.9, True), (10.0, False)])
def test_a_rare_failure_in_words(effective, unreliable):
    text = str(Rare(0.0123, 0.001, 50, 100, effective))
    start = "0.012 (0.01 to 0.014), from 50 failures (effective number 10) among 100 scenarios"
    assert text.startswith(start)
    assert text.endswith("increase --budget") == unreliable


def watched(error, campaign=None, **options):
    """Return ((scores, borrowed courses) of each generation, estimate)."""
    generations = []

    def evaluate(scores, like):
        generations.append((scores, list(like)))
        return rows(error(scores))

    reported = []
    rare = estimate_rare(
        campaign or specification(),
        *("servo-400w", "plain"),
        evaluate=evaluate,
        progress=lambda k, of: reported.append((k, of)),
        **options,
    )
    assert (
        rare.tried
        == sum(len(scores) for scores, _ in generations)
        == sum(len(like) for _, like in generations)
    )
    assert reported[-1] == (options["budget"], options["budget"])
    return generations, rare


def test_moves_take_half_of_the_budget_and_new_courses():
    generations, rare = watched(lambda scores: np.full(len(scores), 1e-3), budget=2400)
    assert [len(scores) for scores, _ in generations] == [200] * 6 + [1200]
    numbers = [k for _, like in generations for k in like]
    assert numbers == list(range(64, 64 + 2400))
    assert (rare.failures, rare.effective) == (0, 0.0)
    two = specification(machines=["pmsm-2kw2", "servo-400w"])
    generations, _ = watched(lambda scores: np.full(len(scores), 1e-3), two, budget=100)
    assert [len(scores) for scores, _ in generations] == [64] * 7
    assert generations[0][1][0] == 128


def test_frequent_failures_need_one_move():
    generations, rare = watched(lambda scores: np.ones(len(scores)), budget=1200)
    assert [len(scores) for scores, _ in generations] == [100, 1100]
    assert rare.failures == 1100
    assert rare.probability == pytest.approx(1.0, abs=4 * rare.std)


@pytest.mark.parametrize(("share", "moves"), [(0.10, 6), (0.11, 1)])
def test_moves_end_when_more_than_a_tenth_fails(share, moves):
    def error(scores):
        failing = np.arange(len(scores)) < share * len(scores) - 1e-9
        return np.where(failing, 1.0, 1e-3)

    generations, _ = watched(error, budget=1200)
    assert len(generations) == moves + 1


def test_the_estimate_weights_samples_of_a_mixture():
    """Failures lie beyond 2.5 on the first axis. The mixture's densities come from SciPy."""
    generations, rare = watched(lambda x: np.exp(x[:, 0] - 2.5), budget=4000, good=ONE_RADIAN)
    last = generations[-1][0]
    fails = last[:, 0] > 2.5
    *_, previous = [scores for scores, _ in generations[:-1]]
    moved = last[last @ previous.mean(0) > 6.0]
    assert len(moved) > 100
    centre = optimize.minimize(
        lambda mean: -np.sum(np.log(mixture(last, mean))), previous.mean(0), method="BFGS"
    ).x
    assert 2.0 < centre[0] < 3.3
    weight = norm.pdf(last).prod(1) / mixture(last, centre)
    assert weight.max() <= 1 / 0.3
    assert rare.probability == pytest.approx(np.mean(weight * fails), rel=0.1)
    assert rare.std == pytest.approx(np.std(weight * fails) / np.sqrt(len(last)), rel=0.1)
    effective = np.sum(weight[fails]) ** 2 / np.sum(weight[fails] ** 2)
    assert rare.effective == pytest.approx(effective, rel=0.1)
    assert rare.failures == fails.sum()


ONE_RADIAN = GoodTable(rms=float(np.degrees(1.0)))


def mixture(scores, mean):
    return 0.3 * norm.pdf(scores).prod(1) + 0.7 * norm.pdf(scores - mean).prod(1)


def test_the_mean_moves_at_most_four_deviations():
    generations, _ = watched(lambda x: np.exp(x[:, 0] - 30.0), budget=4000, good=ONE_RADIAN)
    lengths = [np.linalg.norm(scores.mean(0)) for scores, _ in generations[:-1]]
    assert lengths[-1] == pytest.approx(4.0, abs=0.3)
    assert max(lengths) < 4.3


def test_the_search_begins_within_seven_tenths_of_a_deviation():
    generations, reported = [], []

    def evaluate(scores, like):
        generations.append(scores)
        assert set(like) == {64}
        return rows(np.exp(-np.sum((scores - 9.0) ** 2, axis=1) / 100))

    s = specification(machines=["pmsm-2kw2", "servo-400w"])
    worst = find_worst(
        s,
        *("servo-400w", "plain"),
        budget=1280,
        measure="rms",
        evaluate=evaluate,
        progress=lambda k, of: reported.append((k, of)),
    )
    assert {len(scores) for scores in generations} == {64}
    assert generations[0].std() == pytest.approx(0.7, abs=0.1)
    assert np.abs(generations[0].mean()) < 0.2
    assert np.abs(np.concatenate(generations)).max() <= 4.0
    assert worst.like == 64
    assert reported[0] == (64, 1280)
    assert worst.history[0] < worst.history[-1] == max(worst.history)
    assert worst.row["rms"] == max(worst.history)


def test_of_equal_errors_the_likely_one_is_preferred():
    """Errors are equal along the second axis; the search stays near the middle of this axis."""
    generations = []

    def evaluate(scores, like):
        generations.append(scores)
        return rows(np.exp(-((scores[:, 0] - 1.0) ** 2)))

    find_worst(specification(), "servo-400w", "plain", budget=2560, evaluate=evaluate)
    assert np.abs(generations[-1].mean(0)[1:]).max() < 0.3
    assert generations[-1].mean(0)[0] == pytest.approx(1.0, abs=0.1)
