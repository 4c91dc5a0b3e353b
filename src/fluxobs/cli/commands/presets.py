"""`fluxobs presets`."""

from __future__ import annotations

from typing import Annotated

import typer

from .. import show


def presets(
    name: Annotated[
        str | None, typer.Argument(help="Preset to print, as a template for your own record file.")
    ] = None,
) -> None:
    """List the presets, the layouts of the logs of known tools.

    Example: fluxobs presets mesc > my-tool.toml
    """
    from ...logs.meaning.presets import preset_names, preset_text

    if name is not None:
        typer.echo(preset_text(name), nl=False)
        return
    names = preset_names()
    width = max(map(len, names))
    for preset in names:
        show.say(f"{preset:{width}}  {preset_text(preset).splitlines()[0].removeprefix('# ')}")
