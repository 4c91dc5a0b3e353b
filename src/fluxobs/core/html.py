"""Small pieces of HTML: what a notebook shows of a result, and documents made of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape as _escaped
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .printable import visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def escape(text: str, quote: bool = True) -> str:
    """Plain text as HTML; what is no character is shown as its code."""
    return _escaped(visible(text), quote)


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
    import io

    made = io.BytesIO()
    figure.savefig(made, format="png", dpi=90)
    return image(made.getvalue(), words)


def image(png: bytes, words: str) -> str:
    """The bytes of a PNG file as a picture, with words for who does not see it."""
    import base64

    data = base64.b64encode(png).decode("ascii")
    return (
        f'<img alt="{escape(words, quote=True)}" style="max-width:100%" '
        f'src="data:image/png;base64,{data}">'
    )


def from_markdown(text: str, folder: Path) -> str:
    """Markdown with tables; its pictures, PNG files in a folder, stand in it."""
    from markdown_it import MarkdownIt

    written = MarkdownIt("commonmark", {"html": False}).enable("table")

    def embedded(renderer: Any, tokens: Any, at: int, options: Any, env: Any) -> str:
        token = tokens[at]
        return image((folder / str(token.attrs["src"])).read_bytes(), token.content)

    written.add_render_rule("image", embedded)
    return str(written.render(text))


#: Of a document; pictures are drawn on white, also where the rest is dark.
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 0 auto; padding: 16px; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
caption, th, td { text-align: left; padding: 2px 12px 2px 0; vertical-align: top; }
th, td { border-bottom: 1px solid #8886; font-variant-numeric: tabular-nums; }
img { background: #fff; } code { overflow-wrap: anywhere; }
"""


def document(title: str, *parts: str) -> str:
    """A page of its own that asks for nothing from elsewhere.

    Parameters
    ----------
    title : str
        Plain text.
    parts : str
        HTML, from the functions above.
    """
    body = "\n".join(parts)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "style-src 'unsafe-inline'; img-src data:\">"
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><h1>{escape(title)}</h1>\n{body}\n</body></html>\n"
    )
