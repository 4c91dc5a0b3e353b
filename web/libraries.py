"""Third-party software in the page, for its notices and a wheel's bill of materials.

packaging/sbom.py makes the bill of materials.
"""

from __future__ import annotations

import importlib.util
import json
from importlib import metadata
from pathlib import Path
from typing import Any

WEB = Path(__file__).parent
#: First words of a licence below its title and owner.
BEGINNINGS = ("Permission is hereby granted", "Redistribution and use")


def libraries() -> list[dict[str, Any]]:
    """Return name, version, home, licence and licence text of each library in the page.

    The libraries are the packages of package-lock.json except tools. Zig also links its run-time
    library and the C library of WASI into the module.
    """
    lock = json.loads((WEB / "package-lock.json").read_text("utf-8"))["packages"]
    packages = [
        {
            "name": path.removeprefix("node_modules/"),
            "version": entry["version"],
            "home": "npm",
            "licence": entry["license"],
            "text": (WEB / path / "LICENSE").read_text("utf-8"),
        }
        for path, entry in lock.items()
        if path and not entry.get("dev")
    ]
    zig = Path(importlib.util.find_spec("ziglang").origin).parent
    runtime = {"name": "ziglang", "version": metadata.version("ziglang"), "home": "pypi"}
    runtime |= {"licence": "MIT", "text": (zig / "LICENSE").read_text("utf-8")}
    # Zig does not state the version of its wasi-libc.
    libc = {"name": "wasi-libc", "version": None, "home": "github/WebAssembly"}
    libc |= {"licence": "Apache-2.0 WITH LLVM-exception OR Apache-2.0 OR MIT"}
    return [*packages, runtime, libc]


def notices(components: list[dict[str, Any]]) -> str:
    """Return the notices that the licences require: each text once, after its copyright owners."""
    owners_of: dict[str, list[str]] = {}
    for component in components:
        text = " ".join(component.get("text", "").split())
        begin = max(map(text.find, BEGINNINGS))
        if begin >= 0:
            owner = text[text.find("Copyright") : begin].strip()
            owners_of.setdefault(text[begin:], []).append(f"{component['name']}: {owner}")
    return "\n\n".join("\n".join([*owners, text]) for text, owners in owners_of.items()) + "\n"
