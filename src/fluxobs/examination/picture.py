"""Picture of an examination."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from ..core.plots import STYLE, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .examine import Examination

COLOURS = {"fine": "#2a7f3f", "look at it": "#b3261e", "cannot be told": "#777777"}


def figure(examination: Examination) -> Figure:
    """Draw the mistakes and the items, one on each line."""
    import matplotlib as mpl

    rows = [
        (item.name, item.told, item.verdict, textwrap.wrap(item.words, 62) or [""])
        for item in examination.items
    ]
    mistakes = [
        line for finding in examination.mistakes for line in textwrap.wrap(str(finding), 120)
    ]
    height = 0.24 * (sum(len(row[3]) for row in rows) + len(mistakes) + 4)
    with mpl.rc_context(STYLE):
        drawing = new_figure(figsize=(11, max(3.0, height)))
        axes = drawing.subplots()
        axes.axis("off")
        axes.set_xlim(0, 1)
        total = height / 0.24
        axes.set_ylim(total, 0)
        name = examination.log.path.name if examination.log is not None else ""
        kind = examination.machine.kind if examination.machine is not None else ""
        axes.set_title(f"Examination of {plain(name)}  ·  {kind}", loc="left")
        y = 1.0
        for line in mistakes:
            axes.text(0, y, plain(line), color=COLOURS["look at it"], va="center", fontsize=8)
            y += 1
        for x, title in ((0, "what"), (0.24, "value"), (0.42, "verdict"), (0.54, "")):
            axes.text(x, y, title, va="center", weight="bold", fontsize=8)
        y += 1
        for name, value, verdict, remarks in rows:
            axes.text(0, y, plain(name), va="center", fontsize=8)
            axes.text(0.24, y, plain(value), va="center", fontsize=8)
            axes.text(0.42, y, verdict, va="center", fontsize=8, color=COLOURS[verdict])
            for line in remarks:
                axes.text(0.54, y, plain(line), va="center", fontsize=8)
                y += 1
    return drawing
