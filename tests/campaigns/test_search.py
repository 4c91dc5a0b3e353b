"""The search for the worst and the estimate of what is rare, on functions with known answers."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy.stats import norm

from fluxobs.campaigns import simulated as simulated_module
from fluxobs.campaigns.columns import schema
from fluxobs.campaigns.search import estimate_rare, evaluator, find_worst
from fluxobs.campaigns.specification import GoodTable, Specification
from fluxobs.errors import FluxobsError, UsageError

QUANTITIES = ("R", "L", "psi", "temperature")


def specification(**given) -> Specification:
    vary = {name: {"normal": [1, 0.1], "within": [0.5, 1.5]} for name in QUANTITIES[:3]}
    vary |= {"temperature": {"normal": [50, 10]}, "theta_e": 0.0}
    usual = {"machines": ["servo-400w"], "scenarios": 64, "observers": ["plain"], "vary": vary}
    return Specification(**usual | given)


def rows(error: np.ndarray) -> pl.DataFrame:
    s = specification()
    columns = dict.fromkeys(schema(s), None)
    length = len(error)
    values = {"number": np.arange(length), "rms": error, "worst": 2 * error, "valid": 1.0}
    return pl.DataFrame(
        {name: values.get(name, [None] * length) for name in columns}, schema_overrides=schema(s)
    )


def test_the_worst_is_found():
    peak = {"R": 1.5, "L": -1.0, "psi": 0.5, "temperature": 2.0}  # normal scores
    top = np.array([peak[name] for name in specification().varied])
    seen = []

    def evaluate(scores, like):
        seen.append(len(scores))
        assert set(like) == {0}
        return rows(np.exp(-np.sum((scores - top) ** 2, axis=1)))

    found = find_worst(specification(), "servo-400w", "plain", budget=2500, evaluate=evaluate)
    assert found.row["rms"] > 0.9
    assert found.tried == sum(seen)
    assert found.history[-1] > found.history[0]
    assert found.values["R"] == pytest.approx(1.15, abs=0.04)
    assert found.values["temperature"] == pytest.approx(70, abs=4)


def test_it_begins_at_the_worst_of_the_campaign():
    s = specification()
    start = rows(np.linspace(0.1, 1.0, 64)).with_columns(
        machine=pl.lit("servo-400w"), observer=pl.lit("plain")
    )

    def evaluate(scores, like):
        assert set(like) == {63}
        return rows(np.full(len(scores), 0.3))

    assert find_worst(s, "servo-400w", "plain", start, budget=64, evaluate=evaluate).like == 63


def test_nothing_valid_is_said():
    def evaluate(scores, like):
        return rows(np.zeros(len(scores)))

    with pytest.raises(FluxobsError, match="no scenario that was tried has a valid row"):
        find_worst(specification(), "servo-400w", "plain", budget=64, evaluate=evaluate)


@pytest.mark.parametrize("beta", [2.0, 3.0, 4.0])
def test_a_rare_failure_is_estimated_within_what_it_says(beta):
    """Failure beyond a plane at the distance beta: its probability is that of a normal tail."""
    direction = np.array([1.0, 2.0, 0.0, -1.0]) / np.sqrt(6)

    def evaluate(scores, like):
        assert len(set(like)) == len(scores)
        return rows(np.exp(scores @ direction - beta))

    limit = GoodTable(rms=float(np.degrees(1.0)))
    off = []
    for seed in range(12):
        found = estimate_rare(
            specification(),
            *("servo-400w", "plain"),
            budget=2000,
            good=limit,
            seed=seed,
            evaluate=evaluate,
        )
        true = norm.sf(beta)
        off.append((found.probability - true) / found.std)
        assert found.std < 0.25 * true
        assert found.tried <= 2200
    assert np.abs(off).max() < 3.5
    assert np.mean(np.abs(off) < 1.96) > 0.7


def test_what_never_fails():
    found = estimate_rare(
        specification(),
        *("servo-400w", "plain"),
        budget=300,
        evaluate=lambda scores, like: rows(np.full(len(scores), 1e-3)),
    )
    assert found.probability == 0.0
    assert str(found).startswith("no failure among")


def test_mistakes():
    for machine, observer, words in (
        ("servo", "plain", "no machine 'servo'"),
        ("servo-400w", "ekf", "no observer 'ekf'"),
    ):
        with pytest.raises(UsageError, match=words):
            evaluator(specification(), machine, observer)
    with pytest.raises(UsageError, match="nothing varies"):
        evaluator(specification(vary={"theta_e": 0.0}), "servo-400w", "plain")


def test_points_are_simulated_with_the_course_they_borrow(monkeypatch):
    monkeypatch.setattr(simulated_module, "LANES", 8)
    course = {"duration": 0.2, "score_from": 0.05, "speeds": [0.5, 1.0], "ramp": 0.1}
    run = evaluator(specification(course=course), "servo-400w", "plain")
    found = run(np.zeros((3, 4)), [5, 5, 6])
    assert found["number"].to_list() == [0, 1, 2]
    assert found["rms_all"][0] == found["rms_all"][1] != found["rms_all"][2]
