"""Columns in a report: exact columns to the last bit, rounded columns within their noise."""

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fluxobs.page.columns import as_text, exact, flags, rounded


def bytes_of(text):
    """Decode text as web/app/report.js does."""
    replaced = {0x80: 0, 0x81: 13, 0x82: 60}
    sevens = np.array([replaced.get(ord(c), ord(c)) for c in text], np.uint8)
    bits = np.unpackbits(sevens[:, None], axis=1)[:, 1:].ravel()
    return np.packbits(bits[: len(bits) // 8 * 8]).tobytes()


def unpacked(column):
    """Decode a column as web/app/report.js does."""
    rows, raw = column["rows"], np.frombuffer(gzip.decompress(bytes_of(column["data"])), np.uint8)
    if column["kind"] == "flags":
        return np.unpackbits(raw, bitorder="little")[:rows].astype(bool)
    if column["kind"] == "double":
        return np.ascontiguousarray(raw.reshape(8, rows).T).view("<f8").ravel()
    planes = raw.reshape(column["planes"], rows).astype(np.int64)
    zigzag = sum(plane << (8 * n) for n, plane in enumerate(planes))
    whole = np.cumsum((zigzag >> 1) ^ -(zigzag & 1))
    values = whole / column["size"] if column["kind"] == "over" else whole * column["size"]
    if "missing" in column:
        values[unpacked(column["missing"])] = np.nan
    return values


@given(st.binary(max_size=300))
def test_bytes_as_text_are_restored_and_safe_in_html(data):
    text = as_text(data)
    assert bytes_of(text) == data
    assert not set(text) & {"\0", "\r", "<"}
    assert text.encode("utf-8").decode("utf-8") == text


@given(arrays(float, st.integers(1, 50), elements=st.floats(allow_nan=True, width=64)))
def test_an_exact_column_is_exact(values):
    np.testing.assert_array_equal(unpacked(exact(values)), values)


@given(arrays(int, st.integers(1, 50), elements=st.integers(-(10**8), 10**8)), st.integers(0, 6))
def test_decimals_are_kept_as_whole_numbers(whole, places):
    values = whole / 10.0**places
    column = exact(values)
    assert column["kind"] == "over"
    np.testing.assert_array_equal(unpacked(column), values)


@given(
    arrays(float, st.integers(1, 200), elements=st.floats(-1e6, 1e6) | st.just(np.nan)),
    st.floats(1e-6, 1.0),
)
def test_a_rounded_column_stays_within_its_largest_error(values, at_most):
    found = unpacked(rounded(values, at_most))
    assert (np.isnan(found) == np.isnan(values)).all()
    limit = max(at_most, np.nanmax(np.abs(values), initial=0.0) / 2**30)
    assert np.nanmax(np.abs(found - values), initial=0.0) <= limit * (1 + 1e-9)


def test_rounding_is_below_the_noise():
    noise = 1e-3
    values = np.sin(np.arange(20_000) / 100) + noise * np.random.default_rng(1).normal(size=20_000)
    error = unpacked(rounded(values)) - values
    assert np.sqrt(np.mean(error**2)) < 0.2 * noise
    assert len(rounded(values)["data"]) < 1.3 * len(values)


@pytest.mark.parametrize("rows", [1, 7, 8, 9, 1000])
def test_flags(rows):
    values = np.random.default_rng(2).random(rows) > 0.5
    np.testing.assert_array_equal(unpacked(flags(values)), values)
