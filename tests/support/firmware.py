"""Compile and run the exported C sources, and replay records through them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from _pytest.mark import ParameterSet

from .compiling import build_program, command, compiled

ROOT = Path(__file__).parents[2]
#: The C sources, and the programs that test them.
FIRMWARE, HARNESS = ROOT / "firmware", ROOT / "tests" / "firmware"
#: `make warnings` has the same options with -O2; less optimisation compiles in half the time.
STRICT = ["-std=c99", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion"]
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


def firmware_objects(
    sources: Iterable[Path], *flags: str, includes: Sequence[Path] = ()
) -> list[Path]:
    """Return the object files of firmware sources, compiled by GCC with the strict options.

    Tests that need no other options share these objects.
    """
    options = [*STRICT, *flags, *(f"-I{folder}" for folder in includes)]
    return [compiled(["gcc"], options, source) for source in sorted(sources)]


@dataclass
class Compiled:
    """Exported folders, compiled into programs that replay a record."""

    scratch: Path
    programs: dict[tuple[object, ...], Path] = field(default_factory=dict)

    def program(
        self, folder: Path, compiler: Sequence[str], precision: str, extra: Sequence[str] = ()
    ) -> Path:
        """Return the program of an exported folder; `extra` options apply to all its sources."""
        key = (folder, *compiler, precision, *extra)
        if key not in self.programs:
            definition = f"-DFO_SINGLE={int(precision == 'single')}"
            target = self.scratch / f"replay{len(self.programs)}"
            sources = [HARNESS / "replay.c", folder / "fluxobs.c"]
            sources += [*folder.glob("fluxobs_map.c"), *folder.glob("*_observer.c")]
            options = [*STRICT, definition, *extra, f"-I{folder}"]
            self.programs[key] = build_program(compiler, options, sources, target)
        return self.programs[key]


def replayed(program: Path, voltage: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return the output of the program for a record, (rows, 12)."""
    rows = np.ascontiguousarray(np.concatenate([voltage, current], axis=1))
    process = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=False)
    assert process.returncode == 0, process.stderr.decode()
    return np.frombuffer(process.stdout).reshape(len(rows), -1)


def make_test(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `make test` in an exported folder; sources that are known are not compiled again.

    Without other arguments, the compiler does not optimise: that takes a third of the time.
    """
    usual = {"CC": command(), "CFLAGS": "-O0"}
    given = {word.partition("=")[0] for word in arguments}
    more = [f"{name}={value}" for name, value in usual.items() if name not in given]
    return subprocess.run(
        ["make", "-C", folder, "test", *more, *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
