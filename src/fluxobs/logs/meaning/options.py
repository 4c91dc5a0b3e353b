"""Types of the keyword arguments that say how to read a log; for editors and type checkers.

The meaning of each is in :class:`~fluxobs.logs.meaning.layout.Layout`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, TypedDict

from ...machines.model.frames import Frame
from .layout import Align


class LayoutOptions(TypedDict, total=False):
    """The fields of a layout."""

    currents: Frame | None
    sample_time: float | None
    lag: float | Literal["auto"] | None
    held: bool | None
    udc: float | None
    columns: Mapping[str, str] | None
    unit: Mapping[str, str] | None
    adc: Mapping[str, str] | None
    scale: Mapping[str, float] | None
    offset: Mapping[str, float] | None
    truth: Mapping[str, str] | None
    fit_truth: bool | None
    start: float | None
    stop: float | None
    header: str | None
    join: Sequence[str] | None
    align: Align | None


class ReadOptions(LayoutOptions, total=False):
    """All arguments of :func:`fluxobs.read_log` but the source."""

    record: str | Path | None
    preset: str | None
    frame: Frame | None
