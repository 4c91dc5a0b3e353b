"""A folder of C99: the observer, its parameters, an example interrupt, a host test."""

from __future__ import annotations

from ..blob import blob
from ..certificate import certificate
from ..configuration import configuration_files
from ..core import Core
from ..folder import joined
from ..templating import fill
from ..vectors import vectors_header

TEMPLATES = {
    "README.md": "README.md",
    "Makefile": "Makefile",
    "example_isr.c": "example_isr.c",
    "telemetry.h": "telemetry.h",
    "telemetry.c": "telemetry.c",
    "test/check.h": "check.h",
    "test/check.c": "check.c",
    "test/host_test.c": "host_test.c",
}


def files(core: Core) -> dict[str, str | bytes]:
    """Return the contents of the files, by relative path."""
    runtime = joined(core.runtime, configuration_files(core.prefix, core.single))
    return joined(
        core.code,
        {f"runtime/{name}": text for name, text in runtime.items()},
        {f"{core.prefix}_parameters.bin": blob(core.single)},
        {name: fill(core, f"c/{template}") for name, template in TEMPLATES.items()},
        {
            "LICENSE": core.licence,
            "test/vectors.h": vectors_header(core.record, core.estimates),
            "certificate.json": certificate(core, "c", "make test replays the record"),
        },
    )
