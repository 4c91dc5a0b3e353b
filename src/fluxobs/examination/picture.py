"""The page of an examination as a picture."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from ..core.plots import STYLE, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .examine import Examination

COLOURS = {"fine": "#2a7f3f", "look at it": "#b3261e", "cannot be told": "#777777"}


def figure(page: Examination) -> Figure:
    """Draw the page: a line a thing."""
    import matplotlib as mpl

    rows = [
        (item.name, item.told, item.verdict, textwrap.wrap(item.words, 62) or [""])
        for item in page.items
    ]
    mistakes = [line for one in page.mistakes for line in textwrap.wrap(str(one), 120)]
    height = 0.24 * (sum(len(row[3]) for row in rows) + len(mistakes) + 4)
    with mpl.rc_context(STYLE):
        drawn = new_figure(figsize=(11, max(3.0, height)))
        axes = drawn.subplots()
        axes.axis("off")
        axes.set_xlim(0, 1)
        total = height / 0.24
        axes.set_ylim(total, 0)
        name = page.log.path.name if page.log is not None else ""
        kind = page.machine.kind if page.machine is not None else ""
        axes.set_title(f"Examination of {plain(name)}  ·  {kind}", loc="left")
        at = 1.0
        for line in mistakes:
            axes.text(0, at, plain(line), color=COLOURS["look at it"], va="center", fontsize=8)
            at += 1
        for x, title in ((0, "what"), (0.24, "value"), (0.42, "verdict"), (0.54, "")):
            axes.text(x, at, title, va="center", weight="bold", fontsize=8)
        at += 1
        for what, told, verdict, words in rows:
            axes.text(0, at, plain(what), va="center", fontsize=8)
            axes.text(0.24, at, plain(told), va="center", fontsize=8)
            axes.text(0.42, at, verdict, va="center", fontsize=8, color=COLOURS[verdict])
            for line in words:
                axes.text(0.54, at, plain(line), va="center", fontsize=8)
                at += 1
    return drawn
