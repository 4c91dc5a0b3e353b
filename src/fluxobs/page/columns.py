"""Columns of numbers as compact text in an HTML file, exact or rounded.

A column is converted to whole numbers if possible. The differences of these numbers are split into
bytes, grouped by significance and compressed. Each character of the text holds seven bits, which
makes the text an eighth shorter than base64.
"""

from __future__ import annotations

import gzip
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array

#: Most decimal places tried to represent a column by whole numbers.
PLACES = 9
#: Largest rounding error, as a share of the noise of a column. Such an error adds 1 % to the noise.
ROUNDED = 1 / 4
#: Replacements of characters that HTML changes or that may end a script.
_ESCAPED = {0: 0x80, 13: 0x81, 60: 0x82}
#: Largest whole number whose differences fit into 32 bits.
LARGEST = 2**30


def exact(values: Array) -> dict[str, Any]:
    """Encode a column exactly: as whole numbers divided by a power of ten, or else as doubles.

    Parameters
    ----------
    values : (rows,) ndarray
        NaN where missing.
    """
    finite = values[np.isfinite(values)]
    for places in range(PLACES + 1):
        size = 10.0**places
        whole = np.round(finite * size)
        if np.abs(whole).max(initial=0.0) >= LARGEST:
            break
        # JavaScript decodes with the same division
        if np.array_equal(whole / size, finite) and len(finite) == len(values):
            return _whole(np.round(values * size).astype(np.int64), size, divide=True)
    raw = np.ascontiguousarray(values, dtype="<f8").view(np.uint8).reshape(-1, 8)
    return {"kind": "double", "rows": len(values), "data": _packed(raw)}


def rounded(values: Array, at_most: float | None = None) -> dict[str, Any]:
    """Encode a column for plots, rounded within a share of its noise or within `at_most`.

    Parameters
    ----------
    values : (rows,) ndarray
        NaN where missing.
    at_most : float, optional
        Largest rounding error; default ROUNDED times the noise.
    """
    present = np.isfinite(values)
    finite = values[present]
    span = float(np.ptp(finite)) if len(finite) else 0.0
    noise = float(np.median(np.abs(np.diff(finite, 3)))) / 3 if len(finite) > 3 else 0.0
    step = 2 * (at_most if at_most is not None else max(ROUNDED * noise, 1e-7 * span))
    largest = float(np.abs(finite).max(initial=0.0))
    step = max(step, largest / LARGEST, 1e-300)
    filled = np.where(present, values, 0.0)
    if not present.all():  # missing values repeat their neighbour and are flagged
        at = np.maximum.accumulate(np.where(present, np.arange(len(values)), 0))
        filled = np.where(present[at], values[at], 0.0)
    column = _whole(np.round(filled / step).astype(np.int64), step, divide=False)
    if not present.all():
        column["missing"] = flags(~present)
    return column


def flags(values: NDArray[np.bool_]) -> dict[str, Any]:
    """Encode a column of true and false."""
    bits = np.packbits(values, bitorder="little")
    return {"kind": "flags", "rows": len(values), "data": _packed(bits[:, None])}


def _whole(whole: NDArray[np.int64], size: float, divide: bool) -> dict[str, Any]:
    """Encode whole numbers by their differences, with the sign in the lowest bit."""
    steps = np.diff(whole, prepend=0)
    zigzag = ((steps << 1) ^ (steps >> 63)).astype("<u4")
    planes = zigzag.view(np.uint8).reshape(-1, 4)
    used = next((n for n in (4, 3, 2) if planes[:, n - 1].any()), 1)
    kind = "over" if divide else "times"
    data = _packed(planes[:, :used])
    return {"kind": kind, "size": size, "rows": len(whole), "planes": used, "data": data}


def _packed(bytes_of_rows: NDArray[np.uint8]) -> str:
    """Group bytes by significance, since they are alike in all rows; return packed text."""
    planes = np.ascontiguousarray(bytes_of_rows.T).tobytes()
    return as_text(gzip.compress(planes, 6, mtime=0))


def as_text(data: bytes) -> str:
    """Encode bytes as characters of seven bits, which a script element of HTML preserves."""
    bits = np.unpackbits(np.frombuffer(data, np.uint8))
    sevens = np.concatenate([bits, np.zeros(-len(bits) % 7, np.uint8)]).reshape(-1, 7)
    codes = (np.packbits(sevens, axis=1)[:, 0] >> 1).astype("<u2")
    for code, replacement in _ESCAPED.items():
        codes[codes == code] = replacement
    return codes.tobytes().decode("utf-16-le")
