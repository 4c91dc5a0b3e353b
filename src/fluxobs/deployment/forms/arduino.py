"""A library for the Arduino IDE and PlatformIO, with a sensor class for SimpleFOC."""

from __future__ import annotations

from ..certificate import certificate
from ..core import Core
from ..costs import read_costs
from ..folder import joined
from ..templating import fill, slowest_speed
from ..variables import check_every_step
from ..vectors import vectors_header

TEMPLATES = {
    "README.md": "arduino/README.md",
    "library.properties": "arduino/library.properties",
    "library.json": "arduino/library.json",
    "src/FluxobsSensor.h": "arduino/FluxobsSensor.h",
    "examples/SimpleFOC/SimpleFOC.ino": "arduino/SimpleFOC.ino",
    "examples/SelfTest/SelfTest.ino": "arduino/SelfTest.ino",
    "examples/SelfTest/check.h": "c/check.h",
    "examples/SelfTest/check.c": "c/check.c",
}


def files(core: Core) -> dict[str, str | bytes]:
    """Return the contents of the files, by relative path.

    Raises
    ------
    FluxobsError
        The observer steps only every few interrupts.
    """
    check_every_step(core, "an Arduino library")
    placeholders = _placeholders(core)
    code = joined(core.code, core.runtime)
    vectors = vectors_header(core.record, core.estimates)
    check = "the example SelfTest replays the record"
    return joined(
        {f"src/{name}": text for name, text in code.items()},
        {name: fill(core, template, placeholders) for name, template in TEMPLATES.items()},
        {
            "examples/SelfTest/vectors.h": vectors,
            "LICENSE": core.licence,
            "certificate.json": certificate(core, "arduino", check),
        },
    )


def _placeholders(core: Core) -> dict[str, str]:
    sample_time = core.plain.sample_time
    slowest = slowest_speed(core) / core.machine.n_p
    fast, *_, slow = read_costs()["adaptive" if core.adaptive else "plain"]["builds"]
    rows = len(core.record.voltage)
    return {
        "fo_type": "fo_adaptive" if core.adaptive else "fo_observer",
        "slowest_shaft": f"{slowest:.3g} rad/s",
        "try_speed": f"{3 * slowest:.1f}",
        "rated": f"{core.machine.rated_current or 1.0:.1f}",
        "least_us": f"{1e5 * sample_time:.4g}",
        "most_us": f"{1e7 * sample_time:.0f}",
        "fast": str(fast["mean"]),
        "slow": str(slow["mean"]),
        "flash": str(round((16 * rows + 48 * rows / 9) / 1000 + 12)),
        "url": "https://github.com/fluxobs/fluxobs",
    }
