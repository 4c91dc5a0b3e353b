"""HTML elements for notebooks, and whole documents made of these elements."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape as _escaped
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .printable import visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def escape(text: str, quote: bool = True) -> str:
    """Escape plain text for HTML; show control characters and invalid characters as codes."""
    return _escaped(visible(text), quote)


def paragraph(text: str) -> str:
    """Return a paragraph of plain text."""
    return f"<p>{escape(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """Return a bullet list of plain texts, or an empty string if there are no texts."""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """Return a table of plain texts."""
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    names = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table>{title}<thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>"


def picture(figure: Figure, alt_text: str) -> str:
    """Return a figure as an embedded PNG, with alternative text."""
    import io

    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=90)
    return image(png.getvalue(), alt_text)


def image(png: bytes, alt_text: str) -> str:
    """Return a PNG file's bytes as an embedded picture, with alternative text."""
    import base64

    data = base64.b64encode(png).decode("ascii")
    return (
        f'<img alt="{escape(alt_text, quote=True)}" style="max-width:100%" '
        f'src="data:image/png;base64,{data}">'
    )


def from_markdown(text: str, folder: Path) -> str:
    """Convert Markdown with tables to HTML; embed the pictures, which are PNG files in `folder`."""
    from markdown_it import MarkdownIt

    renderer = MarkdownIt("commonmark", {"html": False}).enable("table")

    def embed_image(this: Any, tokens: Any, index: int, options: Any, env: Any) -> str:
        token = tokens[index]
        return image((folder / str(token.attrs["src"])).read_bytes(), token.content)

    renderer.add_render_rule("image", embed_image)
    return str(renderer.render(text))


#: Style of a document. Pictures have a white background even in dark mode.
_STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 0 auto; padding: 16px; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
caption, th, td { text-align: left; padding: 2px 12px 2px 0; vertical-align: top; }
th, td { border-bottom: 1px solid #8886; font-variant-numeric: tabular-nums; }
img { background: #fff; } code { overflow-wrap: anywhere; }
"""


def document(title: str, *parts: str) -> str:
    """Return a self-contained HTML page, which loads nothing from elsewhere.

    Parameters
    ----------
    title : str
        Plain text.
    parts : str
        HTML made by the functions above.
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
