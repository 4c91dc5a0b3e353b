"""A Rust crate without dependencies that contains the C sources."""

from __future__ import annotations

import re

from ... import _core_single
from ..certificate import certificate
from ..core import Core
from ..folder import joined
from ..templating import fill
from ..variables import Variable, c_values, check_every_step, output_variables, record_csv

#: Sources that door.c needs to start from a known angle.
SEED = ("fluxobs_observers.h", "fluxobs_seed.h", "fluxobs_seed.c")
TEMPLATES = {
    "Cargo.toml": "Cargo.toml",
    "build.rs": "build.rs",
    "src/lib.rs": "lib.rs",
    "csrc/door.c": "door.c",
    "tests/record.rs": "record.rs",
    "README.md": "README.md",
}


def files(core: Core) -> dict[str, str | bytes]:
    """Return the contents of the files, by relative path.

    Raises
    ------
    FluxobsError
        The observer steps only every few interrupts.
    """
    check_every_step(core, "a crate")
    placeholders = _placeholders(core)
    sources = joined(core.code, {name: core.runtime[name] for name in SEED})
    return joined(
        {f"csrc/{name}": text for name, text in sources.items()},
        {
            name: fill(core, f"rust/{template}", placeholders)
            for name, template in TEMPLATES.items()
        },
        {
            "tests/record.csv": record_csv(core, "single"),
            "LICENSE": core.licence,
            "certificate.json": certificate(core, "rust", "cargo test replays the record"),
        },
    )


def _placeholders(core: Core) -> dict[str, str]:
    variables = output_variables(core)
    crate = _snake_case(f"fluxobs_{core.prefix}")
    sources = [*core.code, *SEED, "door.c"]
    compiled = [name for name in sources if name.endswith(".c")]
    bytes_of = _core_single.adaptive_state_bytes if core.adaptive else _core_single.state_bytes
    values = (
        f"{output.name}: x[{n}] > 0.5," if output.boolean else f"{output.name}: x[{n}],"
        for n, output in enumerate(variables)
    )
    numbers = (
        f"f32::from(u8::from(self.{output.name}))," if output.boolean else f"self.{output.name},"
        for output in variables
    )
    return {
        "crate": crate.replace("_", "-"),
        "rust_crate": crate,
        "rust_sources": ", ".join(f'"{name}"' for name in compiled),
        "rust_fields": "\n".join(_field(output) for output in variables),
        "rust_values": "\n".join(f"            {row}" for row in values),
        "rust_numbers": "\n".join(f"            {row}" for row in numbers),
        "outputs": str(len(variables)),
        "values": c_values(core, "fo_real"),
        "state_bytes": str(-(-bytes_of // 8) * 8),
    }


def _snake_case(name: str) -> str:
    """Return the name as Rust requires for a crate: lower case, single underscores.

    Examples
    --------
    >>> _snake_case("fluxobs_M__1_")
    'fluxobs_m_1'
    """
    return re.sub("_+", "_", name.lower()).strip("_")


def _field(output: Variable) -> str:
    unit = f" [{output.unit}]" if output.unit else ""
    kind = "bool" if output.boolean else "f32"
    return f"    /// {output.about}{unit}.\n    pub {output.name}: {kind},"
