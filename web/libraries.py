"""What of others is in the page: for its notices, and the bill of materials of a wheel
(packaging/sbom.py)."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

WEB = Path(__file__).parent
#: Parts of the WebAssembly module; the licences are those of LLVM and of wasi-libc.
LLVM = "Apache-2.0 WITH LLVM-exception"
#: How the text of a licence begins, below its title and owner.
BEGINNINGS = ("Permission is hereby granted", "Redistribution and use")


def libraries() -> list[dict[str, Any]]:
    """Name, version, home, licence and its text of each: those of package-lock.json that are not
    tools, and what clang links into the module."""
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
    said = subprocess.run(["clang", "-dumpversion"], check=True, capture_output=True, text=True)
    runtime = {"name": "compiler-rt", "version": said.stdout.strip(), "home": "github/llvm"}
    # Nothing in an installed wasi-libc says which one it is.
    libc = {"name": "wasi-libc", "version": None, "home": "github/WebAssembly"}
    return [*found, runtime | {"licence": LLVM}, libc | {"licence": f"{LLVM} OR Apache-2.0 OR MIT"}]


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
