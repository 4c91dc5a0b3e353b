"""A Rust crate without dependencies around the C sources."""

from __future__ import annotations

import re

from ... import _core_single
from ..certificate import certificate
from ..core import Core
from ..folder import joined
from ..templating import fill
from ..variables import Variable, c_values, check_every_step, output_variables, record_csv

#: What the door needs besides: a start from a known angle.
SEED = ("fluxobs_seed.h", "fluxobs_seed.c")
TEMPLATES = {
    "Cargo.toml": "Cargo.toml",
    "build.rs": "build.rs",
    "src/lib.rs": "lib.rs",
    "csrc/door.c": "door.c",
    "tests/record.rs": "record.rs",
    "README.md": "README.md",
}


def files(core: Core) -> dict[str, str | bytes]:
    """Relative path → content.

    Raises
    ------
    FluxobsError
        The observer steps every few interrupts only.
    """
    check_every_step(core, "a crate")
    words = _words(core)
    sources = joined(core.code, {name: core.runtime[name] for name in SEED})
    return joined(
        {f"csrc/{name}": text for name, text in sources.items()},
        {name: fill(core, f"rust/{template}", words) for name, template in TEMPLATES.items()},
        {
            "tests/record.csv": record_csv(core, "single"),
            "LICENSE": core.licence,
            "certificate.json": certificate(core, "rust", "cargo test replays the record"),
        },
    )


def _words(core: Core) -> dict[str, str]:
    variables = output_variables(core)
    crate = _snake_case(f"fluxobs_{core.prefix}")
    compiled = [name for name in core.code if name.endswith(".c")] + [SEED[1], "door.c"]
    bytes_of = _core_single.adaptive_state_bytes if core.adaptive else _core_single.state_bytes
    values = (
        f"{one.name}: x[{n}] > 0.5," if one.boolean else f"{one.name}: x[{n}],"
        for n, one in enumerate(variables)
    )
    numbers = (
        f"f32::from(u8::from(self.{one.name}))," if one.boolean else f"self.{one.name},"
        for one in variables
    )
    return {
        "crate": crate.replace("_", "-"),
        "rust_crate": crate,
        "rust_sources": ", ".join(f'"{name}"' for name in compiled),
        "rust_fields": "\n".join(_field(one) for one in variables),
        "rust_values": "\n".join(f"            {row}" for row in values),
        "rust_numbers": "\n".join(f"            {row}" for row in numbers),
        "outputs": str(len(variables)),
        "values": c_values(core, "fo_real"),
        "state_bytes": str(-(-bytes_of // 8) * 8),
    }


def _snake_case(name: str) -> str:
    """The name as the compiler of Rust wants a crate's: small letters, single underscores.

    Examples
    --------
    >>> _snake_case("fluxobs_M__1_")
    'fluxobs_m_1'
    """
    return re.sub("_+", "_", name.lower()).strip("_")


def _field(one: Variable) -> str:
    unit = f" [{one.unit}]" if one.unit else ""
    kind = "bool" if one.boolean else "f32"
    return f"    /// {one.about}{unit}.\n    pub {one.name}: {kind},"
