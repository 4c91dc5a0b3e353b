"""Yields, indices and pairs equal closed forms."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from scipy import stats

from fluxobs.campaigns import statistics
from fluxobs.campaigns.specification import GoodTable, Specification
from fluxobs.campaigns.statistics import (
    Verdict,
    Yield,
    indices,
    is_good,
    pair,
    verdicts,
    yield_of,
)


@pytest.mark.parametrize(("good", "of"), [(0, 10), (10, 10), (987, 1000), (1, 7)])
def test_interval_equals_the_exact_test(good, of):
    lower, upper = Yield(good, of).interval
    exact = stats.binomtest(good, of).proportion_ci(0.95, "exact")
    assert (lower, upper) == pytest.approx((exact.low, exact.high))


def test_intervals_have_their_coverage():
    rng, share = np.random.default_rng(0), 0.97
    drawn = rng.binomial(300, share, 2000)
    inside = [
        lower <= share <= upper for lower, upper in (Yield(int(k), 300).interval for k in drawn)
    ]
    assert np.mean(inside) >= 0.95


def rows(**columns) -> pl.DataFrame:
    length = len(next(iter(columns.values())))
    defaults = {"failed": [None] * length, "rms": [0.01] * length, "valid": [1.0] * length}
    defaults |= {"worst": [0.02] * length, "first_valid": [0.1] * length, "losses": [0] * length}
    return pl.DataFrame(defaults | columns, schema_overrides={"failed": pl.String})


def test_a_good_scenario_meets_all_conditions():
    two = np.radians(2.0)
    frame = rows(
        rms=[0.01, two * 1.01, None, 0.01, 0.01, 0.01],
        valid=[0.9, 1.0, 0.0, 0.5, 1.0, 1.0],
        failed=[None, None, None, None, "no number", None],
        losses=[0, 0, 0, 0, 0, 2],
    )
    good = frame.select(is_good(GoodTable(rms=2.0, valid=0.8, losses=0))).to_series().to_list()
    assert good == [True, False, False, False, False, False]
    good = frame.select(is_good(GoodTable(rms=None))).to_series().to_list()
    assert good == [True, True, False, True, False, True]


def test_limits_apply_to_their_observer_and_machine():
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
    results = [(verdict.machine, verdict.observer, verdict.met) for verdict in verdicts(s, frame)]
    assert results == [
        ("servo-400w", "adaptive", True),
        ("pmsm-2kw2", "adaptive", True),
        ("pmsm-2kw2", "plain", True),
        ("pmsm-2kw2", "adaptive", True),
    ]
    assert "more scenarios are needed to be sure" in str(verdicts(s, frame)[0])
    assert not verdicts(s, frame.with_columns(rms=pl.lit(1.0)))[0].met


def ishigami(rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and values of the Ishigami function, which has the indices 0.314, 0.442, 0."""
    x = np.random.default_rng(seed).uniform(-np.pi, np.pi, (rows, 3))
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return x, y


def test_indices_are_those_of_ishigami():
    x, y = ishigami(4000, 0)
    frame = pl.DataFrame({"a": x[:, 0], "b": x[:, 1], "c": x[:, 2], "rms": 10 ** (y / 10)})
    estimated = {index.quantity: index for index in indices(frame, ("a", "b", "c"))}
    for name, exact in (("a", 0.3139), ("b", 0.4424), ("c", 0.0)):
        assert estimated[name].share == pytest.approx(exact, abs=0.02)
        assert estimated[name].low - 0.01 <= exact <= estimated[name].high + 0.01


def test_chance_alone_has_no_index():
    rng = np.random.default_rng(1)
    estimated = [
        indices(pl.DataFrame({"a": rng.random(500), "rms": 10 ** -rng.random(500)}), ("a",), seed)[
            0
        ]
        for seed in range(40)
    ]
    assert np.mean([index.share for index in estimated]) < 0.02
    assert np.mean([index.low > 0 for index in estimated]) <= 0.1


def test_a_choice_is_binned_by_its_values():
    rng = np.random.default_rng(2)
    a = rng.choice([0.0, 1.0], 400)
    frame = pl.DataFrame({"a": a, "rms": 10 ** (a + 0.5 * rng.standard_normal(400))})
    exact = 0.25 / (0.25 + 0.25)
    assert indices(frame, ("a",))[0].share == pytest.approx(exact, abs=0.08)


def test_a_pair_counts_every_scenario_once():
    rng = np.random.default_rng(3)
    a, b = rng.random((2, 600))
    frame = rows(a=a, b=b, rms=np.where(a + b > 1, 1.0, 0.001))
    counts = pair(frame, GoodTable(), "a", "b")
    assert counts.of.sum() == 600
    assert counts.good.sum() == yield_of(frame, GoodTable()).good
    share = counts.good / counts.of
    assert share[0, 0] == 1.0
    assert share[-1, -1] == 0.0


def test_the_criterion_in_words():
    table = GoodTable(rms=2, worst=10, valid=0.9, losses=0)
    assert statistics.in_words(table) == (
        "2° rms, 10° at most, valid on 90 % of the rows, never lost"
    )


@pytest.mark.parametrize(
    ("field", "column", "limit", "best", "worst"),
    [
        ("rms", "rms", 2.0, np.radians(1.99), np.radians(2.01)),
        ("worst", "worst", 2.0, np.radians(1.99), np.radians(2.01)),
        ("valid", "valid", 0.75, 0.75, 0.749),
        ("first_valid", "first_valid", 0.5, 0.5, 0.501),
        ("losses", "losses", 1, 1, 2),
        ("losses", "losses", 0, 0, 1),
    ],
)
def test_a_limit_of_good_from_both_sides(field, column, limit, best, worst):
    table = GoodTable(**{"rms": None} | {field: limit})
    frame = rows(**{column: [best, worst, None]})
    assert frame.select(is_good(table)).to_series().to_list() == [True, False, False]
    failed = rows(**{column: [best], "failed": ["no number"]})
    assert not failed.select(is_good(table)).item()


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ({"rms": 2}, "2° rms"),
        ({"worst": 10}, "10° at most"),
        ({"valid": 0.9}, "valid on 90 % of the rows"),
        ({"first_valid": 0.25}, "valid after 0.25 s"),
        ({"losses": 3}, "lost 3 times at most"),
        ({}, "valid at least once"),
    ],
)
def test_each_limit_in_words(limits, text):
    assert statistics.in_words(GoodTable(**{"rms": None} | limits)) == text


def test_a_yield_in_words():
    exact = stats.binomtest(37, 40).proportion_ci(0.95, "exact")
    text = f"92.5 % ({100 * exact.low:.1f} to {100 * exact.high:.1f} %)"
    assert str(Yield(37, 40)) == text


@pytest.mark.parametrize(
    ("limit", "sure"), [(0.795, True), (0.80, False), (0.98, False), (0.986, True)]
)
def test_a_verdict_is_sure_outside_of_the_interval(limit, sure):
    """37 of 40 have the exact interval 79.6 to 98.4 %."""
    verdict = Verdict("m", "o", limit, Yield(37, 40))
    assert verdict.met == (limit < 0.925)
    outcome = "met" if limit < 0.925 else "missed"
    assert str(verdict).startswith(f"{outcome}: o on m: 92.5 % (79.6 to 98.4 %), wanted ")
    assert f"wanted {100 * limit:g} %" in str(verdict)
    assert ("more scenarios are needed" in str(verdict)) != sure


def test_a_limit_that_is_just_reached_is_met():
    assert Verdict("m", "o", 0.5, Yield(1, 2)).met


def test_rows_of_machine_and_observer():
    frame = rows(machine=["a", "a", "b"], observer=["x", "y", "x"])
    for machine, observer, count in (
        *((None, None, 3), ("a", None, 2), (None, "x", 2)),
        *(("a", "x", 1), ("b", "y", 0)),
    ):
        assert len(statistics.group(frame, machine, observer)) == count


def test_without_a_valid_row_the_error_is_that_of_an_unknown_angle():
    """A uniform error over a turn has π/√3 rms. Errors below 1e-6 rad count as equal."""
    responses = statistics.response(rows(rms=[None, 0.01, 1e-6, 1e-9]))
    uniform = np.sqrt(np.mean(np.linspace(-np.pi, np.pi, 100_001) ** 2))
    np.testing.assert_allclose(10**responses, [uniform, 0.01, 1e-6, 1e-6], rtol=1e-4)


def by_bins(x, y, bins):
    """Return ε² of one-way analysis of variance (Kelley) over bins with equally many rows."""
    groups = np.array_split(y[np.argsort(x, kind="stable")], bins)
    f = stats.f_oneway(*groups).statistic
    between, within = bins - 1, len(y) - bins
    return between * (f - 1) / (between * f + within)


@pytest.mark.parametrize(("n", "bins"), [(80, 4), (100, 5), (640, 32), (2560, 32)])
def test_an_index_is_the_effect_size_of_an_analysis_of_variance(n, bins):
    rng = np.random.default_rng(n)
    x = rng.permutation(n).astype(float)
    y = np.sin(4 * x / n) + rng.standard_normal(n)
    assert statistics._first_order(x, y) == pytest.approx(by_bins(x, y, bins))


def test_few_rows_have_two_bins():
    x, y = np.arange(30.0), np.random.default_rng(4).standard_normal(30)
    assert statistics._first_order(x, y) == pytest.approx(by_bins(x, y, 2))


def test_few_values_have_one_bin_each():
    """Three values with unequal counts are three bins; a fourth value gives four equal bins."""
    rng = np.random.default_rng(5)
    x = np.repeat([0.0, 1.0, 2.0, 3.0], [10, 20, 20, 30])
    y = x + rng.standard_normal(80)
    f = stats.f_oneway(*(y[x == value] for value in range(4))).statistic
    assert statistics._first_order(x, y) == pytest.approx(3 * (f - 1) / (3 * f + 76))
    modified = x.copy()
    modified[0] = -1.0
    assert statistics._first_order(modified, y) == pytest.approx(by_bins(modified, y, 4))


def frame_of(n, seed=0):
    rng = np.random.default_rng(seed)
    a, b = rng.random((2, n))
    return pl.DataFrame({"a": a, "b": b, "c": 1.0, "rms": 10 ** (a - 2 * b)})


def test_indices_need_eighty_rows():
    assert indices(frame_of(79), ("a", "b")) == []
    assert [index.quantity for index in indices(frame_of(80), ("a", "b"))] == ["b", "a"]


def test_constant_quantities_have_no_index():
    assert {index.quantity for index in indices(frame_of(80), ("a", "b", "c"))} == {"a", "b"}
    assert indices(frame_of(80).with_columns(rms=0.1), ("a", "b")) == []


def test_the_interval_is_that_of_two_hundred_resamplings_about_the_estimate():
    frame = frame_of(200)
    x, y = frame["a"].to_numpy(), np.log10(frame["rms"].to_numpy())
    rng = np.random.default_rng(11)
    picks = [rng.integers(200, size=200) for _ in range(200)]
    resampled = np.array([by_bins(x[pick], y[pick], 10) for pick in picks])
    (index,) = indices(frame, ("a",), seed=11)
    share = by_bins(x, y, 10)
    assert index.share == pytest.approx(share)
    lower, upper = np.percentile(resampled - resampled.mean() + share, [2.5, 97.5])
    assert (index.low, index.high) == pytest.approx((lower, upper))


def test_an_index_is_not_negative():
    rng = np.random.default_rng(1)
    frame = pl.DataFrame({"a": rng.random(80), "rms": 10 ** rng.random(80)})
    x, y = frame["a"].to_numpy(), np.log10(frame["rms"].to_numpy())
    assert by_bins(x, y, 4) < 0  # with this seed
    (index,) = indices(frame, ("a",))
    assert index.share == 0.0
    assert index.low == 0.0


@pytest.mark.parametrize(("n", "cells"), [(10, 2), (269, 2), (270, 3), (1920, 8), (4000, 8)])
def test_cells_of_a_pair_hold_about_thirty_rows(n, cells):
    a, b = np.random.default_rng(n).random((2, n))
    frame = rows(a=a, b=b, rms=np.full(n, 0.001))
    counts = pair(frame, GoodTable(), "a", "b")
    assert (counts.x, counts.y) == ("a", "b")
    assert counts.of.shape == counts.good.shape == (cells, cells)
    np.testing.assert_allclose(counts.x_edges, np.percentile(a, np.linspace(0, 100, cells + 1)))
    np.testing.assert_allclose(counts.y_edges, np.percentile(b, np.linspace(0, 100, cells + 1)))
    assert counts.of.sum() == n
