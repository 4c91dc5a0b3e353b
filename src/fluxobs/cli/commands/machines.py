"""`fluxobs machines`."""

from __future__ import annotations

import typer

from .. import show


def machines() -> None:
    """List the shipped machines: --machine accepts their names."""
    from ...machines import example, example_names, example_text

    for name in example_names():
        machine = example(name)
        title = example_text(name).splitlines()[0].removeprefix("# ")
        values = ", ".join(
            f"{key} = {value:g}" if isinstance(value, int | float) else key
            for key, value in machine.parameters().items()
            if value is not None
        )
        show.say(f"{name}\n    {machine.kind}: {values}\n    {title}")
    typer.echo("\nSI units; R and L are per phase (star), psi_f and rated_current are peak values.")
