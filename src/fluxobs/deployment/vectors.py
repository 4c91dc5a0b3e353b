"""Test vectors: a short record, and what the library returns for it, digit for digit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.arrays import Array
from ..observers import Estimate, LeastSquaresObserver, outputs
from ..simulation.closed_form.firmware_record import FirmwareRecord
from .c_source import PRECISIONS, Precision, hex_float, table
from .header import Exported, plain

#: Samples from one expected row to the next: coprime to the round in which samples take turns.
EVERY = 9


#: An expected row: the outputs of the plain observer.
ORDER = outputs(Estimate)
#: Names of the columns as C writes them.
COLUMNS = tuple(
    name
    for one in ORDER
    for name in ((f"{one.name}[0]", f"{one.name}[1]") if one.vector else (one.name,))
)


def expected(estimate: Estimate) -> Array:
    """All columns of an estimate, (rows, 12)."""
    columns = []
    for one in ORDER:
        value = np.asarray(getattr(estimate, one.name), float)
        columns += [*value.T] if one.vector else [value]
    return np.stack(columns, axis=-1)


def inputs(record: FirmwareRecord) -> Array:
    """Rows of (u_alpha, u_beta, i_alpha, i_beta) [V, A]."""
    return np.concatenate([record.voltage, record.current], axis=1)


def checksum(given: Array, rows: Array, precision: Precision) -> int:
    """FNV-1a over the numbers' bytes, least significant first; a missing number counts as 0."""
    kind = "<f4" if precision == "single" else "<f8"
    value = 0x811C9DC5
    for byte in np.nan_to_num(np.concatenate([given.ravel(), rows.ravel()])).astype(kind).tobytes():
        value = ((value ^ byte) * 0x01000193) & 0xFFFFFFFF
    return value


def gathered(observer: LeastSquaresObserver, record: FirmwareRecord, update_every: int) -> Array:
    """Volt-seconds [Wb] of every row, as fo_gather sums them with the inputs of test/check.c.

    Computed in the observer's precision, operation by operation: sums are equal bit for bit.
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
    """What the exported observer must return for the record."""
    if update_every == 1:
        return observer.run(record.voltage, record.current)
    volt_seconds = gathered(plain(observer), record, update_every)
    return observer.run(volt_seconds=volt_seconds, current=record.current)


def vectors_header(record: FirmwareRecord, estimates: Mapping[Precision, Estimate]) -> str:
    """The text of test/vectors.h: a record, and what :func:`run` returns for it."""
    given = inputs(record)
    samples = "\n".join(
        "    {" + ", ".join(f"FO_({hex_float(x)})" if x == x else "FO_MISSING" for x in row) + "},"
        for row in given
    )
    blocks = []
    for precision in PRECISIONS:
        everything = expected(estimates[precision])
        rows = everything[EVERY - 1 :: EVERY]
        guard = checksum(given, rows, precision)
        every = checksum(everything, np.zeros(0), precision)
        blocks.append(
            f"static const uint32_t expected_checksum = 0x{guard:08x}U;\n"
            f"static const uint32_t every_checksum = 0x{every:08x}U;\n"
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
enum {{ SAMPLES = {len(given)}, EVERY = {EVERY}, EXPECTED_COLUMNS = {len(COLUMNS)} }};

#if FO_SINGLE
#define FO_(x) x##f
#else
#define FO_(x) x
#endif
#define FO_MISSING ((fo_real)NAN)

/* Mean voltage over the interval that ends at the row (alpha, beta) [V]; current at the row [A]. */
static const fo_real samples[SAMPLES][4] = {{
{samples}
}};

#if FO_SINGLE
{single}
#else
{double}
#endif

#endif
"""
