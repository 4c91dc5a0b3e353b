"""Test vectors: a short record and the library's outputs for it, with all digits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.arrays import Array
from ..observers import Estimate, LeastSquaresObserver, outputs
from ..simulation.closed_form.firmware_record import FirmwareRecord
from .c_source import PRECISIONS, Precision, hex_float, table
from .header import Exported, plain

#: Samples per expected row; coprime to the cycle over which the observer distributes its work.
EVERY = 9


#: Outputs of the plain observer; an expected row holds their values.
ORDER = outputs(Estimate)
#: Names of the columns in C.
COLUMNS = tuple(
    name
    for output in ORDER
    for name in ((f"{output.name}[0]", f"{output.name}[1]") if output.vector else (output.name,))
)


def expected(estimate: Estimate) -> Array:
    """Return all columns of an estimate; shape (rows, 12)."""
    columns = []
    for output in ORDER:
        value = np.asarray(getattr(estimate, output.name), float)
        columns += [*value.T] if output.vector else [value]
    return np.stack(columns, axis=-1)


def inputs(record: FirmwareRecord) -> Array:
    """Return rows of (u_alpha, u_beta, i_alpha, i_beta) [V, A]."""
    return np.concatenate([record.voltage, record.current], axis=1)


def checksum(samples: Array, rows: Array, precision: Precision) -> int:
    """Return FNV-1a over the numbers' bytes, least significant first; NaN counts as 0."""
    kind = "<f4" if precision == "single" else "<f8"
    value = 0x811C9DC5
    numbers = np.nan_to_num(np.concatenate([samples.ravel(), rows.ravel()]))
    for byte in numbers.astype(kind).tobytes():
        value = ((value ^ byte) * 0x01000193) & 0xFFFFFFFF
    return value


def gathered(observer: LeastSquaresObserver, record: FirmwareRecord, update_every: int) -> Array:
    """Return the volt-seconds [Wb] of each row, as fo_gather sums them for test/check.c.

    The operations and the precision are those of the C code, so that sums are equal bit for bit.
    """
    real: Any = np.float32 if observer.precision == "single" else np.float64
    p: dict[str, Any] = {
        name: np.array(value, dtype=real) for name, value in observer.parameters().items()
    }
    share = real(1) / real(update_every)
    scale = share * p["flux_base"]
    u, i = record.voltage.astype(real), record.current.astype(real)
    before = np.concatenate([np.zeros((1, 2), real), i[:-1]])
    source = u[:, :1] * p["hB"][:, 0] + u[:, 1:] * p["hB"][:, 1]
    total, last = np.zeros_like(u), before
    for k in range(1, update_every + 1):
        now = before + real(k) * share * (i - before) if k < update_every else i
        mean = real(12) * (last + now)
        drop = mean[:, :1] * p["hR"][:, 0] + mean[:, 1:] * p["hR"][:, 1]
        total, last = total + scale * (source - drop), now
    return np.asarray(total, float)


def run(observer: Exported, record: FirmwareRecord, update_every: int) -> Estimate:
    """Return the estimates that the exported observer must return for the record."""
    if update_every == 1:
        return observer.run(record.voltage, record.current)
    volt_seconds = gathered(plain(observer), record, update_every)
    return observer.run(volt_seconds=volt_seconds, current=record.current)


def vectors_header(record: FirmwareRecord, estimates: Mapping[Precision, Estimate]) -> str:
    """Return the text of test/vectors.h: a record and the outputs of :func:`run` for it."""
    samples = inputs(record)
    sample_rows = "\n".join(
        "    {" + ", ".join(f"FO_({hex_float(x)})" if x == x else "FO_MISSING" for x in row) + "},"
        for row in samples
    )
    blocks = []
    for precision in PRECISIONS:
        all_rows = expected(estimates[precision])
        rows = all_rows[EVERY - 1 :: EVERY]
        guard = checksum(samples, rows, precision)
        every = checksum(all_rows, np.zeros(0), precision)
        blocks.append(
            f"static const uint32_t expected_checksum = 0x{guard:08x}U;\n"
            f"static const uint32_t every_checksum = 0x{every:08x}U;\n"
            f"static const fo_real expected[{len(rows)}][EXPECTED_COLUMNS] = {{\n"
            f"{table(rows, precision)}\n}};"
        )
    single, double = blocks
    return f"""\
/* A short record and the outputs of the fluxobs library for it. Generated; do not edit. */
#ifndef VECTORS_H
#define VECTORS_H

#include <math.h>
#include <stdint.h>

#include "fluxobs.h"

/* {", ".join(COLUMNS)} */
enum {{ SAMPLES = {len(samples)}, EVERY = {EVERY}, EXPECTED_COLUMNS = {len(COLUMNS)} }};

#if FO_SINGLE
#define FO_(x) x##f
#else
#define FO_(x) x
#endif
#define FO_MISSING ((fo_real)NAN)

/* Mean voltage over the interval that ends at the row (alpha, beta) [V]; current at the row [A]. */
static const fo_real samples[SAMPLES][4] = {{
{sample_rows}
}};

#if FO_SINGLE
{single}
#else
{double}
#endif

#endif
"""
