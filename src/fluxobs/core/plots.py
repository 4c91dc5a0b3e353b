"""Colours, style and files of all pictures. The first picture drawn loads Matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import FluxobsError
from .output import check_place, replacing
from .printable import visible

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREY = "#1f5fa8", "#d9762b", "#8a8a8a"
FORMATS = (".png", ".pdf", ".svg")
#: Reports for a browser.
HTML = ".html"
#: File endings that --report accepts.
REPORTS = (HTML, *FORMATS)
STYLE: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "lines.linewidth": 1.0,
}


def new_figure(**options: Any) -> Figure:
    """Return a figure without a window; the caller shows or saves it."""
    from matplotlib.figure import Figure

    return Figure(layout="constrained", **options)


def write(figure: Figure, path: Path) -> None:
    """Save a figure, complete or not at all; every run writes the same bytes.

    A PNG states the figure's title as metadata.
    """
    import matplotlib as mpl

    ending = path.suffix.lower()
    title = {"Title": figure.get_suptitle()} if figure.get_suptitle() else {}
    metadata: dict[str, Any] = {
        ".png": title,
        ".svg": {"Date": None},
        ".pdf": {"CreationDate": None},
    }
    with replacing(path) as file, mpl.rc_context({"svg.hashsalt": "fluxobs"}):
        figure.savefig(file, format=ending[1:], dpi=130, metadata=metadata[ending])


def plain(text: str) -> str:
    """Prepare a user's text as a label: no formula, and only characters that can be drawn."""
    return visible(text).replace("$", r"\$")


def check_path(path: Path) -> None:
    """Raise FluxobsError early if the report could not be written at the end."""
    if path.suffix.lower() not in REPORTS:
        raise FluxobsError(f"{path}: --report must end in {', '.join(REPORTS)}")
    check_place(path)


def legend(axes: Axes, **options: Any) -> None:
    """Place the legend above the axes at the right, where the legend hides no data."""
    axes.legend(
        loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, **({"ncols": 2} | options)
    )
