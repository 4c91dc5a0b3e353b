"""A WebAssembly module without imports, and its JavaScript wrapper."""

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
    """Return the contents of the files, by relative path.

    Raises
    ------
    FluxobsError
        The observer steps only every few interrupts, or no compiler for WebAssembly is installed.
    """
    check_every_step(core, "a module")
    variables = output_variables(core)
    placeholders = {
        "outputs": str(len(variables)),
        "values": c_values(core, "double"),
        "names": json.dumps([variable.name for variable in variables]),
        "booleans": json.dumps([variable.name for variable in variables if variable.boolean]),
    }
    sources = joined(core.code, {"module.c": fill(core, "wasm/module.c", placeholders)})
    module: dict[str, str | bytes] = {
        f"{core.prefix}.wasm": build.compile_wasm(_compiler(), sources),
        f"{core.prefix}.mjs": fill(core, "wasm/observer.mjs", placeholders),
        "test/record.csv": record_csv(core),
        "test/check.mjs": fill(core, "wasm/check.mjs", placeholders),
    }
    node = shutil.which("node")
    compared = build.compared(module, [node, "test/check.mjs", "--json"]) if node else []
    check = "node test/check.mjs replays the record"
    return joined(
        module,
        {f"source/{name}": text for name, text in sources.items()},
        {
            "README.md": fill(core, "wasm/README.md", placeholders),
            "LICENSE": core.licence,
            "certificate.json": certificate(core, "wasm", check, compared),
        },
    )


def _compiler() -> list[str]:
    if not build.has_zig():
        raise FluxobsError("no compiler for WebAssembly: run `pip install ziglang`")
    return [*build.zig("wasm32-wasi"), "-mexec-model=reactor"]
