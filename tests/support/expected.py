"""Texts, numbers and pictures as they were, in tests/expected.

``FLUXOBS_EXPECTED=write pytest …`` writes the files anew; read their differences before a commit.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from fluxobs.core import html

FOLDER = Path(__file__).parents[1] / "expected"
#: A number in a text.
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?")
#: Numbers may differ by this share: compilers round differently.
SHARE = 1e-5


def check(name: str, value: Any, share: float = SHARE) -> None:
    """Compare with tests/expected/NAME.json: texts but for the last digit of their numbers, other
    numbers but for a share."""
    path = FOLDER / f"{name}.json"
    found = json.loads(json.dumps(plain(value)))
    if os.environ.get("FLUXOBS_EXPECTED") == "write":
        text = json.dumps(found, indent=1, ensure_ascii=False)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", "utf-8")
    compare(found, json.loads(path.read_text("utf-8")), name, share)


def compare(found: Any, expected: Any, where: str, share: float) -> None:
    """Demand that two values out of JSON are the same but for rounding."""
    if isinstance(expected, dict):
        assert list(found) == list(expected), where
        for key, value in expected.items():
            compare(found[key], value, f"{where}/{key}", share)
    elif isinstance(expected, list):
        assert len(found) == len(expected), f"{where}: {found} is not {expected}"
        for k, value in enumerate(expected):
            compare(found[k], value, f"{where}/{k}", share)
    elif isinstance(expected, float):
        assert math.isclose(found, expected, rel_tol=share, abs_tol=1e-9), (
            f"{where}: {found} is not {expected}"
        )
    elif isinstance(expected, str):
        assert NUMBER.sub("#", found) == NUMBER.sub("#", expected), where
        for new, old in zip(NUMBER.findall(found), NUMBER.findall(expected), strict=True):
            assert abs(float(new) - float(old)) <= 1.01 * last_digit(old), (
                f"{where}: {found!r} is not {expected!r}"
            )
    else:
        assert found == expected, where


def last_digit(number: str) -> float:
    """What the last digit of a written number counts; whole numbers are exact."""
    digits, _, exponent = number.partition("e")
    _, point, decimals = digits.partition(".")
    return 10.0 ** (int(exponent or 0) - len(decimals)) if point or exponent else 0.0


def plain(value: Any) -> Any:
    """A value as JSON can hold it; figures are described."""
    if isinstance(value, Figure):
        return plain(described(value))
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(one) for one in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def pictures_of_reports(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Collect the figures of HTML reports, which hold a numbered mark in place of each."""
    pictures: list[dict[str, Any]] = []

    def collect(figure: Figure, alt: str) -> str:
        pictures.append({"alt": alt, "figure": figure})
        return f"[picture {len(pictures)}]"

    monkeypatch.setattr(html, "picture", collect)
    return pictures


def described(figure: Figure) -> dict[str, Any]:
    """All that a figure shows: texts, lines, bands, bars, limits, colours."""
    legends = [[text.get_text() for text in one.get_texts()] for one in figure.legends]
    return {
        "size": figure.get_size_inches(),
        "title": figure.get_suptitle(),
        "legends": legends,
        "axes": [_axes(one) for one in figure.axes if one.get_visible()],
    }


def _axes(axes: Any) -> dict[str, Any]:
    legend = axes.get_legend()
    return {
        "titles": [axes.get_title(loc=where) for where in ("left", "center")],
        "labels": [axes.get_xlabel(), axes.get_ylabel()],
        "scales": [axes.get_xscale(), axes.get_yscale(), str(axes.get_aspect())],
        "limits": [*axes.get_xlim(), *axes.get_ylim()],
        "legend": None if legend is None else [text.get_text() for text in legend.get_texts()],
        "texts": [[*one.get_position(), one.get_text(), one.get_fontsize()] for one in axes.texts],
        "lines": [_line(one) for one in axes.lines],
        "bands": [_band(one) for one in axes.collections],
        "bars": [[*one.get_bbox().bounds, to_hex(one.get_facecolor())] for one in axes.patches],
    }


def _extent(values: Any) -> list[float]:
    """Count, count of numbers, least, most, mean and rms of values, in this order."""
    values = np.asarray(values, float).ravel()
    known = values[np.isfinite(values)]
    if not len(known):
        return [len(values), 0]
    ends = known.min(), known.max(), known.mean(), np.sqrt(np.mean(known**2))
    return [len(values), len(known), *map(float, ends)]


def _line(line: Any) -> list[Any]:
    style = [line.get_linestyle(), line.get_marker(), line.get_linewidth(), line.get_markersize()]
    look = [line.get_label(), to_hex(line.get_color()), *style, line.get_drawstyle()]
    return [*look, _extent(line.get_xdata()), _extent(line.get_ydata())]


def _band(band: Any) -> list[Any]:
    corners = [path.vertices for path in band.get_paths()]
    places = np.concatenate(corners) if corners else np.empty((0, 2))
    colours = [to_hex(one, keep_alpha=True) for one in band.get_facecolor()[:4]]
    return [str(band.get_label()), colours, len(corners), *map(_extent, places.T)]
