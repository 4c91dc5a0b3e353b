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
        typer.Option(help="File to write the page to, .html; default: open it in the browser."),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Open the estimator in the browser, or write its page.

    The page is one HTML file that works offline: drop a log on it, choose the machine, see the
    results of `fluxobs estimate` and `fluxobs check`, and vary parameters. No data leave the
    computer.

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
        show.say(f"No browser was found. Open this file in a browser: {path}")
