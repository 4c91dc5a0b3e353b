"""Comparison with the texts, numbers and pictures stored in tests/expected.

``FLUXOBS_EXPECTED=write pytest …`` rewrites the files; read their differences before a commit.
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
#: Relative difference allowed between numbers: compilers round differently.
SHARE = 1e-5


def check(name: str, value: Any, share: float = SHARE) -> None:
    """Compare with tests/expected/NAME.json.

    Numbers in texts may differ in their last digit, other numbers by a relative tolerance.
    """
    path = FOLDER / f"{name}.json"
    actual = json.loads(json.dumps(plain(value)))
    if os.environ.get("FLUXOBS_EXPECTED") == "write":
        text = json.dumps(actual, indent=1, ensure_ascii=False)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", "utf-8")
    compare(actual, json.loads(path.read_text("utf-8")), name, share)


def compare(actual: Any, expected: Any, where: str, share: float) -> None:
    """Assert that two values from JSON are equal except for rounding."""
    if isinstance(expected, dict):
        assert list(actual) == list(expected), where
        for key, value in expected.items():
            compare(actual[key], value, f"{where}/{key}", share)
    elif isinstance(expected, list):
        assert len(actual) == len(expected), f"{where}: {actual} is not {expected}"
        for k, value in enumerate(expected):
            compare(actual[k], value, f"{where}/{k}", share)
    elif isinstance(expected, float):
        assert math.isclose(actual, expected, rel_tol=share, abs_tol=1e-9), (
            f"{where}: {actual} is not {expected}"
        )
    elif isinstance(expected, str):
        assert NUMBER.sub("#", actual) == NUMBER.sub("#", expected), where
        for new, old in zip(NUMBER.findall(actual), NUMBER.findall(expected), strict=True):
            assert abs(float(new) - float(old)) <= 1.01 * last_digit(old), (
                f"{where}: {actual!r} is not {expected!r}"
            )
    else:
        assert actual == expected, where


def last_digit(number: str) -> float:
    """Return the value of one unit of a number's last digit; 0 for whole numbers (exact)."""
    digits, _, exponent = number.partition("e")
    _, point, decimals = digits.partition(".")
    return 10.0 ** (int(exponent or 0) - len(decimals)) if point or exponent else 0.0


def plain(value: Any) -> Any:
    """Convert a value for JSON; describe figures."""
    if isinstance(value, Figure):
        return plain(describe(value))
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def pictures_of_reports(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Collect the figures of HTML reports and replace each figure by a number."""
    pictures: list[dict[str, Any]] = []

    def collect(figure: Figure, alt: str) -> str:
        pictures.append({"alt": alt, "figure": figure})
        return f"[picture {len(pictures)}]"

    monkeypatch.setattr(html, "picture", collect)
    return pictures


def describe(figure: Figure) -> dict[str, Any]:
    """Return everything that a figure shows: texts, lines, bands, bars, limits, colours."""
    legends = [[text.get_text() for text in legend.get_texts()] for legend in figure.legends]
    return {
        "size": figure.get_size_inches(),
        "title": figure.get_suptitle(),
        "legends": legends,
        "axes": [_axes(axes) for axes in figure.axes if axes.get_visible()],
    }


def _axes(axes: Any) -> dict[str, Any]:
    legend = axes.get_legend()
    return {
        "titles": [axes.get_title(loc=where) for where in ("left", "center")],
        "labels": [axes.get_xlabel(), axes.get_ylabel()],
        "scales": [axes.get_xscale(), axes.get_yscale(), str(axes.get_aspect())],
        "limits": [*axes.get_xlim(), *axes.get_ylim()],
        "legend": None if legend is None else [text.get_text() for text in legend.get_texts()],
        "texts": [
            [*text.get_position(), text.get_text(), text.get_fontsize()] for text in axes.texts
        ],
        "lines": [_line(line) for line in axes.lines],
        "bands": [_band(band) for band in axes.collections],
        "bars": [[*bar.get_bbox().bounds, to_hex(bar.get_facecolor())] for bar in axes.patches],
    }


def _extent(values: Any) -> list[float]:
    """Return count, number of finite values, and the minimum, maximum, mean and rms of these."""
    values = np.asarray(values, float).ravel()
    finite = values[np.isfinite(values)]
    if not len(finite):
        return [len(values), 0]
    statistics = finite.min(), finite.max(), finite.mean(), np.sqrt(np.mean(finite**2))
    return [len(values), len(finite), *map(float, statistics)]


def _line(line: Any) -> list[Any]:
    style = [line.get_linestyle(), line.get_marker(), line.get_linewidth(), line.get_markersize()]
    head = [line.get_label(), to_hex(line.get_color()), *style, line.get_drawstyle()]
    return [*head, _extent(line.get_xdata()), _extent(line.get_ydata())]


def _band(band: Any) -> list[Any]:
    corners = [path.vertices for path in band.get_paths()]
    points = np.concatenate(corners) if corners else np.empty((0, 2))
    colours = [to_hex(colour, keep_alpha=True) for colour in band.get_facecolor()[:4]]
    return [str(band.get_label()), colours, len(corners), *map(_extent, points.T)]
