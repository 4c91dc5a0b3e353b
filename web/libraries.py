"""What of others is in the page: for its notices, and the bill of materials of a wheel
(packaging/sbom.py)."""

from __future__ import annotations

import importlib.util
import json
from importlib import metadata
from pathlib import Path
from typing import Any

WEB = Path(__file__).parent
#: How the text of a licence begins, below its title and owner.
BEGINNINGS = ("Permission is hereby granted", "Redistribution and use")


def libraries() -> list[dict[str, Any]]:
    """Name, version, home, licence and its text of each: those of package-lock.json that are not
    tools, and what Zig links into the module: its run-time library, and the C library of WASI."""
    lock = json.loads((WEB / "package-lock.json").read_text("utf-8"))["packages"]
    found = [
        {
            "name": path.removeprefix("node_modules/"),
            "version": one["version"],
            "home": "npm",
            "licence": one["license"],
            "text": (WEB / path / "LICENSE").read_text("utf-8"),
        }
        for path, one in lock.items()
        if path and not one.get("dev")
    ]
    zig = Path(importlib.util.find_spec("ziglang").origin).parent
    runtime = {"name": "ziglang", "version": metadata.version("ziglang"), "home": "pypi"}
    runtime |= {"licence": "MIT", "text": (zig / "LICENSE").read_text("utf-8")}
    # Zig does not say which version of wasi-libc it holds.
    libc = {"name": "wasi-libc", "version": None, "home": "github/WebAssembly"}
    libc |= {"licence": "Apache-2.0 WITH LLVM-exception OR Apache-2.0 OR MIT"}
    return [*found, runtime, libc]


def notices(of: list[dict[str, Any]]) -> str:
    """What their licences want in every copy: each text once, below those whom it is from."""
    found: dict[str, list[str]] = {}
    for one in of:
        text = " ".join(one.get("text", "").split())
        begin = max(map(text.find, BEGINNINGS))
        if begin >= 0:
            owner = text[text.find("Copyright") : begin].strip()
            found.setdefault(text[begin:], []).append(f"{one['name']}: {owner}")
    return "\n\n".join("\n".join([*owners, text]) for text, owners in found.items()) + "\n"
