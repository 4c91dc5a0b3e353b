"""Yields, indices and pairs, against closed forms."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy import stats

from fluxobs.campaigns import statistics
from fluxobs.campaigns.specification import GoodTable, Specification
from fluxobs.campaigns.statistics import Yield, indices, is_good, pair, verdicts, yield_of


@pytest.mark.parametrize(("good", "of"), [(0, 10), (10, 10), (987, 1000), (1, 7)])
def test_interval_is_that_of_the_exact_test(good, of):
    low, high = Yield(good, of).interval
    exact = stats.binomtest(good, of).proportion_ci(0.95, "exact")
    assert (low, high) == pytest.approx((exact.low, exact.high))


def test_intervals_cover_as_often_as_they_say():
    rng, share = np.random.default_rng(0), 0.97
    drawn = rng.binomial(300, share, 2000)
    inside = [low <= share <= high for low, high in (Yield(int(k), 300).interval for k in drawn)]
    assert np.mean(inside) >= 0.95


def rows(**columns) -> pl.DataFrame:
    length = len(next(iter(columns.values())))
    usual = {"failed": [None] * length, "rms": [0.01] * length, "valid": [1.0] * length}
    usual |= {"worst": [0.02] * length, "first_valid": [0.1] * length, "losses": [0] * length}
    return pl.DataFrame(usual | columns, schema_overrides={"failed": pl.String})


def test_good_needs_everything_that_is_asked():
    two = np.radians(2.0)
    frame = rows(
        rms=[0.01, two * 1.01, None, 0.01, 0.01, 0.01],
        valid=[0.9, 1.0, 0.0, 0.5, 1.0, 1.0],
        failed=[None, None, None, None, "no number", None],
        losses=[0, 0, 0, 0, 0, 2],
    )
    found = frame.select(is_good(GoodTable(rms=2.0, valid=0.8, losses=0))).to_series().to_list()
    assert found == [True, False, False, False, False, False]
    found = frame.select(is_good(GoodTable(rms=None))).to_series().to_list()
    assert found == [True, True, False, True, False, True]


def test_limits_name_observer_and_machine():
    s = Specification(
        machines=["servo-400w", "pmsm-2kw2"],
        scenarios=2,
        observers=["plain", "adaptive"],
        limits=[{"good": 0.5, "observer": "adaptive"}, {"good": 1.0, "machine": "pmsm-2kw2"}],
    )
    frame = rows(
        machine=["servo-400w"] * 4 + ["pmsm-2kw2"] * 4,
        observer=["plain", "adaptive"] * 4,
        rms=[1.0, 0.01, 1.0, 1.0, 0.01, 0.01, 0.01, 0.01],
    )
    found = [(one.machine, one.observer, one.met) for one in verdicts(s, frame)]
    assert found == [
        ("servo-400w", "adaptive", True),
        ("pmsm-2kw2", "adaptive", True),
        ("pmsm-2kw2", "plain", True),
        ("pmsm-2kw2", "adaptive", True),
    ]
    assert "too few scenarios to be sure" in str(verdicts(s, frame)[0])
    assert not verdicts(s, frame.with_columns(rms=pl.lit(1.0)))[0].met


def ishigami(rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs, and the function whose indices are known: 0.314, 0.442, 0."""
    x = np.random.default_rng(seed).uniform(-np.pi, np.pi, (rows, 3))
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return x, y


def test_indices_are_those_of_ishigami():
    x, y = ishigami(4000, 0)
    frame = pl.DataFrame({"a": x[:, 0], "b": x[:, 1], "c": x[:, 2], "rms": 10 ** (y / 10)})
    found = {one.quantity: one for one in indices(frame, ("a", "b", "c"))}
    for name, wanted in (("a", 0.3139), ("b", 0.4424), ("c", 0.0)):
        assert found[name].share == pytest.approx(wanted, abs=0.02)
        assert found[name].low - 0.01 <= wanted <= found[name].high + 0.01


def test_chance_alone_has_no_index():
    rng = np.random.default_rng(1)
    found = [
        indices(pl.DataFrame({"a": rng.random(500), "rms": 10 ** -rng.random(500)}), ("a",), seed)[
            0
        ]
        for seed in range(40)
    ]
    assert np.mean([one.share for one in found]) < 0.02
    assert np.mean([one.low > 0 for one in found]) <= 0.1


def test_a_choice_is_binned_by_its_values():
    rng = np.random.default_rng(2)
    a = rng.choice([0.0, 1.0], 400)
    frame = pl.DataFrame({"a": a, "rms": 10 ** (a + 0.5 * rng.standard_normal(400))})
    wanted = 0.25 / (0.25 + 0.25)
    assert indices(frame, ("a",))[0].share == pytest.approx(wanted, abs=0.08)


def test_a_pair_counts_every_scenario_once():
    rng = np.random.default_rng(3)
    a, b = rng.random((2, 600))
    frame = rows(a=a, b=b, rms=np.where(a + b > 1, 1.0, 0.001))
    found = pair(frame, GoodTable(), "a", "b")
    assert found.of.sum() == 600
    assert found.good.sum() == yield_of(frame, GoodTable()).good
    share = found.good / found.of
    assert share[0, 0] == 1.0
    assert share[-1, -1] == 0.0


def test_words():
    table = GoodTable(rms=2, worst=10, valid=0.9, losses=0)
    assert statistics.in_words(table) == (
        "2° rms, 10° at most, valid on 90 % of the rows, never lost"
    )
