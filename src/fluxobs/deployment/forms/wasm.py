"""A WebAssembly module without imports, and its door in JavaScript."""

from __future__ import annotations

import json
import shutil

from ...errors import FluxobsError
from ..certificate import certificate
from ..core import Core
from ..folder import joined
from ..templating import fill
from ..variables import c_values, check_every_step, output_variables, record_csv
from . import build


def files(core: Core) -> dict[str, str | bytes]:
    """Relative path → content.

    Raises
    ------
    FluxobsError
        The observer steps every few interrupts only, or no compiler for WebAssembly is here.
    """
    check_every_step(core, "a module")
    variables = output_variables(core)
    words = {
        "outputs": str(len(variables)),
        "values": c_values(core, "double"),
        "names": json.dumps([one.name for one in variables]),
        "booleans": json.dumps([one.name for one in variables if one.boolean]),
    }
    sources = joined(core.code, {"module.c": fill(core, "wasm/module.c", words)})
    made: dict[str, str | bytes] = {
        f"{core.prefix}.wasm": build.compile_wasm(_compiler(), sources),
        f"{core.prefix}.mjs": fill(core, "wasm/observer.mjs", words),
        "test/record.csv": record_csv(core),
        "test/check.mjs": fill(core, "wasm/check.mjs", words),
    }
    node = shutil.which("node")
    compared = build.compared(made, [node, "test/check.mjs", "--json"]) if node else []
    check = "node test/check.mjs replays the record"
    return joined(
        made,
        {f"source/{name}": text for name, text in sources.items()},
        {
            "README.md": fill(core, "wasm/README.md", words),
            "LICENSE": core.licence,
            "certificate.json": certificate(core, "wasm", check, compared),
        },
    )


def _compiler() -> list[str]:
    if not build.has_zig():
        raise FluxobsError("no compiler for WebAssembly: run `pip install ziglang`")
    return [*build.zig("wasm32-wasi"), "-mexec-model=reactor"]
