"""Compilers for those forms of an export that hold binaries."""

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

#: Double precision, the same bits everywhere.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-DFO_SINGLE=0")


def has_zig() -> bool:
    """Whether the compiler for other systems is installed: PyPI's ziglang."""
    return importlib.util.find_spec("ziglang") is not None


def zig(target: str) -> list[str]:
    """Its command for a target, such as ``x86_64-windows-gnu``."""
    return [sys.executable, "-m", "ziglang", "cc", "-target", target, "-s"]


def local_compiler() -> list[str] | None:
    """The C compiler of this computer."""
    named = os.environ.get("CC", "")
    found = next(filter(None, map(shutil.which, (named.split(" ")[0], "cc", "gcc", "clang"))), None)
    return [found] if found else None


def host() -> tuple[str, str]:
    """Processor and system of this computer: ``("x86_64", "linux")``."""
    processor = {"amd64": "x86_64", "arm64": "aarch64"}.get(
        platform.machine().lower(), platform.machine().lower()
    )
    return processor, platform.system().lower()


def compile_shared(
    compiler: Sequence[str], files: Mapping[str, str], libraries: Sequence[str] = ()
) -> bytes:
    """A shared library of C sources.

    Raises
    ------
    FluxobsError
        They do not compile, or the compiler cannot be run.
    """
    return _compile(compiler, files, ["-fvisibility=hidden", "-shared"], libraries)


def compile_wasm(compiler: Sequence[str], files: Mapping[str, str]) -> bytes:
    """A WebAssembly module without imports; raises FluxobsError like :func:`compile_shared`."""
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
        command = [*compiler, *FLAGS, *flags, *sources, *libraries, "-o", "made"]
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=600
            )
        except OSError as error:
            raise FluxobsError(f"{compiler[0]}: cannot be run: {error.strerror}") from None
        if done.returncode != 0:
            said = done.stderr.strip().splitlines()
            raise FluxobsError(f"{' '.join(compiler)}: {said[-1] if said else 'failed'}")
        return (folder / "made").read_bytes()


def compared(made: Mapping[str, str | bytes], command: Sequence[str]) -> list[dict[str, Any]]:
    """What the check of an export, run in its folder, says in JSON: for the certificate.

    Raises
    ------
    FluxobsError
        Something differs from the library's outputs, or does not run here.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "export"
        write_folder(folder, made)
        done = subprocess.run(
            list(command), cwd=folder, capture_output=True, text=True, check=False, timeout=600
        )
    try:
        found: list[dict[str, Any]] = json.loads(done.stdout)
    except ValueError:
        said = (done.stdout + done.stderr).strip()
        raise FluxobsError(f"what was built does not run here: {said[-300:]}") from None
    for one in found:
        if one["different"]:
            raise FluxobsError(f"{one['what']}: {one['different']} rows differ from {one['with']}")
    return found
