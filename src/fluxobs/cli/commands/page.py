"""`fluxobs page`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .. import show
from ..options import ForceOption


def page(
    out: Annotated[
        Path | None,
        typer.Option(help="Write it there (.html), to pass on; default: open it in the browser."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Open the page that estimates in a browser, or write it to a file.

    One HTML file that works offline: drop a log, choose the machine, see what `fluxobs estimate`
    and `fluxobs check` say of it, and move parameters. Nothing leaves the computer.

    Example: fluxobs page --out fluxobs.html
    """
    import tempfile
    import webbrowser

    from ...core.output import check_new, write_text
    from ...core.plots import HTML
    from ...page import built

    text = built("page.html")
    if out is not None:
        check_new(out, (HTML,), force, "--out")
        write_text(out, text)
        show.say(f"Written: {out}")
        return
    path = Path(tempfile.mkdtemp(prefix="fluxobs-")) / "page.html"
    write_text(path, text)
    if webbrowser.open(path.as_uri()):
        show.say(f"Opened: {path}")
    else:
        show.say(f"No browser was found. Open {path} in one")
