"""An S-function as source; untested in Simulink, and says so."""

from __future__ import annotations

from ..certificate import certificate
from ..core import Core
from ..folder import joined
from ..templating import fill
from ..variables import c_values, check_every_step, output_variables, record_csv


def files(core: Core) -> dict[str, str | bytes]:
    """Relative path → content.

    Raises
    ------
    FluxobsError
        The observer steps every few interrupts only.
    """
    check_every_step(core, "an S-function")
    name = f"{core.prefix}_sfun"  # no source of the library ends like that
    variables = output_variables(core)
    words = {
        "name": name,
        "outputs": str(len(variables)),
        "values": c_values(core, "real_T"),
        "names": ", ".join(
            f"{one.name} [{one.unit}]" if one.unit else one.name for one in variables
        ),
        "mex_sources": ", ".join(f"'{source}'" for source in core.code if source.endswith(".c")),
    }
    check = "check.m replays the record in Simulink: nobody has run it yet"
    return joined(
        core.code,
        {
            f"{name}.c": fill(core, "simulink/sfun.c", words),
            "build.m": fill(core, "simulink/build.m", words),
            "check.m": fill(core, "simulink/check.m", words),
            "README.md": fill(core, "simulink/README.md", words),
            "test/record.csv": record_csv(core),
            "LICENSE": core.licence,
            "certificate.json": certificate(core, "simulink", check),
        },
    )
