"""Compiling and running the C sources as exported, and replaying records through them."""

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
    """A parameter: the name of a compiler that may be missing."""
    missing = shutil.which(name) is None
    return pytest.param(
        name, marks=pytest.mark.skipif(missing, reason=f"no cross compiler: {name}")
    )


@dataclass
class Compiled:
    """Exported folders as programs that replay a record.

    The observer's source is the same in every folder, which is checked; it is compiled once for a
    compiler, a precision and options.
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
            made = self.scratch / f"observer{len(self.objects)}.o"
            subprocess.run([*command, "-c", folder / "fluxobs.c", "-o", made], check=True)
            self.objects[key] = made
        return self.objects[key]

    def program(
        self, folder: Path, compiler: Sequence[str], precision: str, extra: Sequence[str] = ()
    ) -> Path:
        """Of an exported folder; `extra` options go to all of its sources."""
        key = (folder, *compiler, precision, *extra)
        if key not in self.programs:
            chosen = f"-DFO_SINGLE={int(precision == 'single')}"
            command = [*compiler, *STRICT, chosen, *extra]
            made = self.scratch / f"replay{len(self.programs)}"
            parts = [HARNESS / "replay.c", self.observer(folder, *command)]
            parts += [*folder.glob("fluxobs_map.c"), *folder.glob("*_observer.c")]
            subprocess.run([*command, f"-I{folder}", *parts, "-lm", "-o", made], check=True)
            self.programs[key] = made
        return self.programs[key]


def replayed(program: Path, voltage: np.ndarray, current: np.ndarray) -> np.ndarray:
    """What the program returns for a record, (rows, 12)."""
    rows = np.ascontiguousarray(np.concatenate([voltage, current], axis=1))
    done = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout).reshape(len(rows), -1)


def make_test(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """`make test` in an exported folder."""
    return subprocess.run(
        ["make", "-C", folder, "test", *arguments], capture_output=True, text=True, check=False
    )
