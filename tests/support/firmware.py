"""Compile and run the exported C sources, and replay records through them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark import ParameterSet

ROOT = Path(__file__).parents[2]
#: The C sources, and the programs that test them.
FIRMWARE, HARNESS = ROOT / "firmware", ROOT / "tests" / "firmware"
STRICT = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion"]
STRICT += ["-Wshadow", "-Wdouble-promotion", "-Werror", "-pedantic"]
SANITIZERS = [
    "-g",
    "-fsanitize=address,undefined,float-divide-by-zero",
    "-fno-sanitize-recover=all",
]
_ZIG = (sys.executable, "-m", "ziglang")
#: Commands of two compilers; PyPI's ziglang is Clang.
COMPILERS = [pytest.param(("gcc",), id="gcc"), pytest.param((*_ZIG, "cc"), id="clang")]
CPP_COMPILERS = [pytest.param(("g++",), id="g++"), pytest.param((*_ZIG, "cc"), id="clang++")]


def cross_compiler(name: str) -> ParameterSet:
    """Return a test parameter, the name of a compiler; tests are skipped if it is missing."""
    missing = shutil.which(name) is None
    return pytest.param(
        name, marks=pytest.mark.skipif(missing, reason=f"no cross compiler: {name}")
    )


@dataclass
class Compiled:
    """Exported folders, compiled into programs that replay a record.

    Every folder must have the same observer source. This source is compiled once per compiler,
    precision and options.
    """

    scratch: Path
    objects: dict[tuple[object, ...], Path] = field(default_factory=dict)
    programs: dict[tuple[object, ...], Path] = field(default_factory=dict)

    def observer(self, folder: Path, *command: str) -> Path:
        source = (folder / "fluxobs.c").read_bytes()
        headers = tuple(
            (folder / n).read_bytes()
            for n in ("fluxobs_real.h", "fluxobs_internal.h", "fluxobs_algebra.h")
        )
        key = (command, source, headers)
        if key not in self.objects:
            target = self.scratch / f"observer{len(self.objects)}.o"
            subprocess.run([*command, "-c", folder / "fluxobs.c", "-o", target], check=True)
            self.objects[key] = target
        return self.objects[key]

    def program(
        self, folder: Path, compiler: Sequence[str], precision: str, extra: Sequence[str] = ()
    ) -> Path:
        """Return the program of an exported folder; `extra` options apply to all its sources."""
        key = (folder, *compiler, precision, *extra)
        if key not in self.programs:
            definition = f"-DFO_SINGLE={int(precision == 'single')}"
            command = [*compiler, *STRICT, definition, *extra]
            target = self.scratch / f"replay{len(self.programs)}"
            sources = [HARNESS / "replay.c", self.observer(folder, *command)]
            sources += [*folder.glob("fluxobs_map.c"), *folder.glob("*_observer.c")]
            subprocess.run([*command, f"-I{folder}", *sources, "-lm", "-o", target], check=True)
            self.programs[key] = target
        return self.programs[key]


def replayed(program: Path, voltage: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return the output of the program for a record, (rows, 12)."""
    rows = np.ascontiguousarray(np.concatenate([voltage, current], axis=1))
    process = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=False)
    assert process.returncode == 0, process.stderr.decode()
    return np.frombuffer(process.stdout).reshape(len(rows), -1)


def make_test(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `make test` in an exported folder."""
    return subprocess.run(
        ["make", "-C", folder, "test", *arguments], capture_output=True, text=True, check=False
    )
