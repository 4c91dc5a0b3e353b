"""Small pieces of HTML: what a notebook shows of a result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{escape(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """A list of plain texts; nothing if there are none."""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """A table of plain texts."""
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    names = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table>{title}<thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>"


def picture(figure: Figure, words: str) -> str:
    """A figure as it is drawn, with words for who does not see it."""
    import base64
    import io

    made = io.BytesIO()
    figure.savefig(made, format="png", dpi=90)
    data = base64.b64encode(made.getvalue()).decode("ascii")
    return (
        f'<img alt="{escape(words, quote=True)}" style="max-width:100%" '
        f'src="data:image/png;base64,{data}">'
    )
