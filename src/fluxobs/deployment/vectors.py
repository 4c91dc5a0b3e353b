"""Test vectors: a short record, and what the library returns for it, digit for digit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..observers import Estimate, LeastSquaresObserver
from .c_source import PRECISIONS, Precision, hex_float, table
from .course import Course

#: An expected row every so many samples: coprime to the turns in which samples differ.
EVERY = 9
#: Columns of an expected row.
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


def expected(estimate: Estimate) -> NDArray[np.float64]:
    """All columns of an estimate, (rows, 12)."""
    e = estimate
    columns = (
        *(e.flux[:, 0], e.flux[:, 1], e.psi_f, e.drift[:, 0], e.drift[:, 1], e.theta_e_std),
        *(e.innovation, e.noise_share, e.valid, e.theta_e, e.theta_e_tracked, e.speed_e),
    )
    return np.stack([np.asarray(c, float) for c in columns], axis=-1)


def checksum(inputs: NDArray[np.float64], rows: NDArray[np.float64], precision: Precision) -> int:
    """FNV-1a over the numbers' bytes, least significant first; what is missing counts as 0."""
    kind = "<f4" if precision == "single" else "<f8"
    value = 0x811C9DC5
    for byte in (
        np.nan_to_num(np.concatenate([inputs.ravel(), rows.ravel()])).astype(kind).tobytes()
    ):
        value = ((value ^ byte) * 0x01000193) & 0xFFFFFFFF
    return value


def vectors_header(course: Course, observers: Mapping[Precision, LeastSquaresObserver]) -> str:
    """The text of test/vectors.h."""
    inputs = np.concatenate([course.voltage, course.current], axis=1)
    samples = "\n".join(
        "    {" + ", ".join(f"FO_({hex_float(x)})" if x == x else "FO_MISSING" for x in row) + "},"
        for row in inputs
    )
    blocks = []
    for precision in PRECISIONS:
        rows = expected(observers[precision].run(course.voltage, course.current))[
            EVERY - 1 :: EVERY
        ]
        guard = checksum(inputs, rows, precision)
        blocks.append(
            f"static const uint32_t expected_checksum = 0x{guard:08x}U;\n"
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
