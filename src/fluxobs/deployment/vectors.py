"""Test vectors: a short record, and what the library returns for it, digit for digit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..observers import AdaptiveEstimate, Estimate, LeastSquaresObserver
from .c_source import PRECISIONS, Precision, hex_float, table
from .course import Course
from .header import Exported, plain

Array = NDArray[np.float64]

#: An expected row every so many samples: coprime to the turns in which samples differ.
EVERY = 9
#: Columns of an expected row; the first are equal bit for bit wherever they are computed.
EXACT_COLUMNS = 9
COLUMNS = (
    "flux[0]",
    "flux[1]",
    "psi_f",
    "drift[0]",
    "drift[1]",
    "theta_e_std",
    "innovation",
    "noise_share",
    "valid",
    "theta_e",
    "theta_e_tracked",
    "speed_e",
)


def expected(estimate: Estimate) -> Array:
    """All columns of an estimate, (rows, 12)."""
    e = estimate
    columns = (
        *(e.flux[:, 0], e.flux[:, 1], e.psi_f, e.drift[:, 0], e.drift[:, 1], e.theta_e_std),
        *(e.innovation, e.noise_share, e.valid, e.theta_e, e.theta_e_tracked, e.speed_e),
    )
    return np.stack([np.asarray(c, float) for c in columns], axis=-1)


def checksum(inputs: Array, rows: Array, precision: Precision) -> int:
    """FNV-1a over the numbers' bytes, least significant first; what is missing counts as 0."""
    kind = "<f4" if precision == "single" else "<f8"
    value = 0x811C9DC5
    for byte in (
        np.nan_to_num(np.concatenate([inputs.ravel(), rows.ravel()])).astype(kind).tobytes()
    ):
        value = ((value ^ byte) * 0x01000193) & 0xFFFFFFFF
    return value


def gathered(observer: LeastSquaresObserver, course: Course, update_every: int) -> Array:
    """Volt-seconds [Wb] of every row, as fo_gather sums them; test/check.c says of what.

    In the observer's precision, operation by operation, so that sums are equal bit for bit.
    """
    real: Any = np.float32 if observer.precision == "single" else np.float64
    p: dict[str, Any] = {
        name: np.array(value, dtype=real) for name, value in observer.parameters().items()
    }
    share = real(1) / real(update_every)
    scale = share * p["flux_base"]
    u, i = course.voltage.astype(real), course.current.astype(real)
    before = np.concatenate([np.zeros((1, 2), real), i[:-1]])
    source = u[:, :1] * p["hB"][:, 0] + u[:, 1:] * p["hB"][:, 1]
    total, last = np.zeros_like(u), before
    for k in range(1, update_every + 1):
        now = before + real(k) * share * (i - before) if k < update_every else i
        mean = real(12) * (last + now)
        drop = mean[:, :1] * p["hR"][:, 0] + mean[:, 1:] * p["hR"][:, 1]
        total, last = total + scale * (source - drop), now
    return np.asarray(total, float)


def run(observer: Exported, course: Course, update_every: int) -> Estimate:
    """What the exported observer has to return for the record."""
    if update_every == 1:
        return observer.run(course.voltage, course.current)
    volt_seconds = gathered(plain(observer), course, update_every)
    return observer.run(volt_seconds=volt_seconds, current=course.current)


def exact_columns(estimate: Estimate) -> int:
    """How many are equal bit for bit everywhere; none where angles go back into the filter."""
    return 0 if isinstance(estimate, AdaptiveEstimate) else EXACT_COLUMNS


def vectors_header(course: Course, estimates: Mapping[Precision, Estimate]) -> str:
    """The text of test/vectors.h: a record, and what :func:`run` returns for it."""
    inputs = np.concatenate([course.voltage, course.current], axis=1)
    samples = "\n".join(
        "    {" + ", ".join(f"FO_({hex_float(x)})" if x == x else "FO_MISSING" for x in row) + "},"
        for row in inputs
    )
    blocks = []
    for precision in PRECISIONS:
        everything = expected(estimates[precision])
        rows = everything[EVERY - 1 :: EVERY]
        guard = checksum(inputs, rows, precision)
        exact = checksum(
            everything[:, : exact_columns(estimates[precision])], np.zeros(0), precision
        )
        blocks.append(
            f"static const uint32_t expected_checksum = 0x{guard:08x}U;\n"
            f"static const uint32_t exact_checksum = 0x{exact:08x}U;\n"
            f"static const fo_real expected[{len(rows)}][EXPECTED_COLUMNS] = {{\n"
            f"{table(rows, precision)}\n}};"
        )
    single, double = blocks
    return f"""\
/* A short record, and what the fluxobs library returns for it. Generated; do not edit. */
#ifndef VECTORS_H
#define VECTORS_H

#include <math.h>
#include <stdint.h>

#include "fluxobs.h"

/* {", ".join(COLUMNS)} */
enum {{ SAMPLES = {len(inputs)}, EVERY = {EVERY}, EXPECTED_COLUMNS = {len(COLUMNS)} }};

#ifdef FO_SINGLE
#define FO_(x) x##f
#else
#define FO_(x) x
#endif
#define FO_MISSING ((fo_real)NAN)

/* Mean voltage over the interval that ends at the row (alpha, beta) [V]; current then [A]. */
static const fo_real samples[SAMPLES][4] = {{
{samples}
}};

#ifdef FO_SINGLE
{single}
#else
{double}
#endif

#endif
"""
