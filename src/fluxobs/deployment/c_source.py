"""Numbers and names in C99 syntax."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np

Precision = Literal["single", "double"]
PRECISIONS: tuple[Precision, ...] = ("single", "double")


def hex_float(value: float, precision: Precision = "double") -> str:
    """Return an exact literal: ``0x1.8p-3``, with the suffix f in single precision.

    Examples
    --------
    >>> hex_float(0.1875), hex_float(-0.5, "single")
    ('0x1.8p-3', '-0x1p-1f')
    """
    mantissa, exponent = value.hex().split("p")
    mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    return f"{mantissa}p{int(exponent)}" + ("f" if precision == "single" else "")


def literal(value: float, precision: Precision = "double") -> str:
    """Return the shortest decimal literal that a compiler reads back to the same number.

    C++ has hexadecimal literals only since 2017.

    Examples
    --------
    >>> literal(0.1), literal(0.1, "single"), literal(2.0), literal(1e-30)
    ('0.1', '0.1f', '2.0', '1e-30')
    """
    if precision == "double":
        return repr(float(value))
    return repr(float(str(np.float32(value)))) + "f"


def initializer(value: Any, precision: Precision) -> str:
    """Return a number as a literal, or a nested list of numbers as ``{1.0, …}``."""
    if isinstance(value, list):
        return "{" + ", ".join(initializer(item, precision) for item in value) + "}"
    return literal(float(value), precision)


def table(rows: Iterable[Iterable[float]], precision: Precision) -> str:
    """Return the rows of a two-dimensional array, one per line."""
    return "\n".join(
        "    {" + ", ".join(hex_float(float(x), precision) for x in row) + "}," for row in rows
    )


def inert(text: str) -> str:
    """Return a user's text with special characters replaced, safe anywhere in an export.

    The text may be part of a C comment, of Markdown, XML, JSON or a script.

    Examples
    --------
    >>> inert("map, hot (2).csv"), inert('*/ "@x@"\\n')
    ('map, hot (2).csv', '__ __x___')
    """
    return re.sub(r"[^A-Za-z0-9 ._+\-=,(){}]", "_", text)


def identifier(text: str) -> str:
    """Return the nearest identifier: ``servo-400w`` becomes ``servo_400w``."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_") or "motor"
    name = name if name[0].isalpha() else f"motor_{name}"
    return name[:40].rstrip("_")
