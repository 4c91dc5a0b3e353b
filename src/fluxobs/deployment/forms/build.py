"""Compilers for the forms of an export that contain binaries."""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...errors import FluxobsError
from ..folder import write_folder

#: Options for double precision without fused operations, for the same bits on every system.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-DFO_SINGLE=0")


def has_zig() -> bool:
    """Whether ziglang of PyPI, the compiler for other systems, is installed."""
    return importlib.util.find_spec("ziglang") is not None


def zig(target: str) -> list[str]:
    """Return the zig command for a target such as ``x86_64-windows-gnu``."""
    return [sys.executable, "-m", "ziglang", "cc", "-target", target, "-s"]


def local_compiler() -> list[str] | None:
    """Return the command of the C compiler of this computer, or None."""
    named = os.environ.get("CC", "")
    candidates = (named.split(" ")[0], "cc", "gcc", "clang")
    path = next(filter(None, map(shutil.which, candidates)), None)
    return [path] if path else None


def host() -> tuple[str, str]:
    """Return processor and system of this computer: ``("x86_64", "linux")``."""
    processor = {"amd64": "x86_64", "arm64": "aarch64"}.get(
        platform.machine().lower(), platform.machine().lower()
    )
    return processor, platform.system().lower()


def compile_shared(
    compiler: Sequence[str], files: Mapping[str, str], libraries: Sequence[str] = ()
) -> bytes:
    """Return a shared library compiled from C sources.

    Raises
    ------
    FluxobsError
        The sources do not compile, or the compiler cannot be run.
    """
    return _compile(compiler, files, ["-fvisibility=hidden", "-shared"], libraries)


def compile_wasm(compiler: Sequence[str], files: Mapping[str, str]) -> bytes:
    """Return a WebAssembly module without imports; raise the errors of :func:`compile_shared`."""
    return _compile(compiler, files, ["-Wl,--strip-all"], [])


def _compile(
    compiler: Sequence[str],
    files: Mapping[str, str],
    flags: Sequence[str],
    libraries: Sequence[str],
) -> bytes:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        sources = sorted(name for name in files if name.endswith(".c"))
        command = [*compiler, *FLAGS, *flags, *sources, *libraries, "-o", "output"]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=600
            )
        except OSError as error:
            raise FluxobsError(f"{compiler[0]}: cannot be run: {error.strerror}") from None
        if done.returncode != 0:
            messages = done.stderr.strip().splitlines()
            raise FluxobsError(f"{' '.join(compiler)}: {messages[-1] if messages else 'failed'}")
        return (folder / "output").read_bytes()


def compared(files: Mapping[str, str | bytes], command: Sequence[str]) -> list[dict[str, Any]]:
    """Run the check of an export in its folder; return its JSON output for the certificate.

    Raises
    ------
    FluxobsError
        An output differs from the library's, or the check does not run here.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "export"
        write_folder(folder, files)
        done = subprocess.run(
            list(command), cwd=folder, capture_output=True, text=True, check=False, timeout=600
        )
    try:
        comparisons: list[dict[str, Any]] = json.loads(done.stdout)
    except ValueError:
        text = (done.stdout + done.stderr).strip()
        raise FluxobsError(f"the built export does not run here: {text[-300:]}") from None
    for result in comparisons:
        if result["different"]:
            raise FluxobsError(
                f"{result['what']}: {result['different']} rows differ from {result['with']}"
            )
    return comparisons
