"""`fluxobs presets`."""

from __future__ import annotations

from typing import Annotated

import typer

from .. import show


def presets(
    name: Annotated[str | None, typer.Argument(help="Print this one, to start your own.")] = None,
) -> None:
    """List the records that come with the package, for the logs of known tools (--preset NAME).

    Example: fluxobs presets mesc > my-tool.toml
    """
    from ...logs.presets import preset_names, preset_text

    if name is not None:
        typer.echo(preset_text(name), nl=False)
        return
    names = preset_names()
    width = max(map(len, names))
    for one in names:
        show.say(f"{one:{width}}  {preset_text(one).splitlines()[0].removeprefix('# ')}")
