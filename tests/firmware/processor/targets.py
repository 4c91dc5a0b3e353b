"""Sizes of the exported folder on every usual processor: code, state, parameters and stack.

    python tests/firmware/processor/targets.py           # omits processors without a compiler
    python tests/firmware/processor/targets.py --write   # writes docs/numbers/targets.json

Code is the part of the sources that a linker keeps for a program that calls fo_reset and fo_step,
without the C library; for WebAssembly it is the module. Stack is the deepest path of calls within
the sources, by the compiler's own graph. Exits with 1 if a target does not compile. Other versions
of a compiler give other sizes.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from in_docs import SOURCES, Numbers, add_table, read

import fluxobs
from fluxobs.deployment.forms.build import zig

MACHINE, SAMPLE_TIME = "servo-400w", 1e-4
KINDS = {"plain": "drift", "adaptive": "drift,resistance,inverter"}
COMMON = ["-std=c99", "-Os", "-ffp-contract=off", "-fno-math-errno", "-ffunction-sections"]
COMMON += ["-fdata-sections", "-Wall", "-Wextra", "-Werror"]


@dataclass(frozen=True)
class Target:
    """A processor: prefix of its tools, compiler options, and a note."""

    name: str
    tools: str
    flags: tuple[str, ...]
    note: str = ""


def _arm(core: str, *more: str) -> tuple[str, ...]:
    return ("-mthumb", f"-mcpu={core}", *more)


_RISC = ("--specs=picolibc.specs",)
TARGETS = (
    Target("Cortex-M0", "arm-none-eabi-", _arm("cortex-m0"), "emulated by `make pil`"),
    Target("Cortex-M3", "arm-none-eabi-", _arm("cortex-m3")),
    Target(
        "Cortex-M4F",
        "arm-none-eabi-",
        _arm("cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
        "emulated by `make pil`",
    ),
    Target(
        "Cortex-M7",
        "arm-none-eabi-",
        _arm("cortex-m7", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard"),
    ),
    Target(
        "Cortex-M33",
        "arm-none-eabi-",
        _arm("cortex-m33", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard"),
    ),
    Target("RISC-V rv32imac", "riscv64-unknown-elf-", ("-march=rv32imac", "-mabi=ilp32", *_RISC)),
    Target(
        "RISC-V rv32imafc", "riscv64-unknown-elf-", ("-march=rv32imafc", "-mabi=ilp32f", *_RISC)
    ),
    Target("AVR ATmega2560", "avr-", ("-mmcu=atmega2560",), "the code fits but is far too slow"),
    Target("x86-64", "", ()),
)


def _run(*command: object) -> str:
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise SystemExit(f"{command[0]}: {done.stderr.strip()}")
    return done.stdout


def measure(target: Target, folder: Path, kind: str) -> dict[str, int | None]:
    """Return (code, state, parameters, stack) in bytes."""
    made = folder / "made"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir()
    compiler = f"{target.tools}gcc"
    adaptive = kind == "adaptive"
    fo = "fo_adaptive" if adaptive else "fo"
    sizes = made / "sizes.c"
    observer = "fo_adaptive" if adaptive else "fo_observer"
    sizes.write_text(
        f'#include "motor_observer.h"\n'
        f"char size_of_state[sizeof({fo}_state)];\nchar size_of_parameters[sizeof({observer})];\n"
    )
    flags = [*COMMON, *target.flags, f"-I{folder}"]
    # The AVR compiler is too old for the option.
    graph = ["-fcallgraph-info=su"] if target.tools != "avr-" else []
    parts = []
    for source in [*sorted(folder.glob("fluxobs*.c")), sizes]:
        parts.append(made / f"{source.stem}.o")
        _run(compiler, *flags, *graph, "-c", source, "-o", parts[-1])
    kept = made / "kept.o"
    entries = [word for name in ("step", "reset") for word in ("-u", f"{fo}_{name}_single")]
    arch = re.findall(r"-march=(rv32\w+)", " ".join(target.flags))
    emulation = ["-m", "elf32lriscv"] if arch else []
    emulation += ["-m", "avr6"] if target.tools == "avr-" else []
    _run(f"{target.tools}ld", *emulation, "-r", "--gc-sections", *entries, *parts[:-1], "-o", kept)
    sections = _run(f"{target.tools}size", "-A", "-d", kept)
    text = sum(map(int, re.findall(r"^\.(?:text|rodata)\S*\s+(\d+)", sections, re.MULTILINE)))
    symbols = _run(f"{target.tools}nm", "-S", parts[-1])
    named = re.findall(r"^[0-9a-f]+ ([0-9a-f]+) \w (size_of_\w+)$", symbols, re.MULTILINE)
    said = {name: int(size, 16) for size, name in named}
    stack = deepest(made, f"{fo}_step_single") if graph else None
    return {
        "code": text,
        "state": said["size_of_state"],
        "parameters": said["size_of_parameters"],
        "stack": stack,
    }


def measure_module(folder: Path, kind: str) -> int:
    """Return the bytes of a WebAssembly module with fo_reset and fo_step."""
    fo = "fo_adaptive" if kind == "adaptive" else "fo"
    module = folder / "module.wasm"
    flags = ["-std=c99", "-Os", "-ffp-contract=off", f"-I{folder}", "-mexec-model=reactor"]
    flags += [f"-Wl,--export={fo}_{name}_single" for name in ("step", "reset")]
    sources = sorted(folder.glob("fluxobs*.c"))
    _run(*zig("wasm32-wasi"), *flags, *sources, "-o", module)
    return module.stat().st_size


def deepest(made: Path, start: str) -> int:
    """Return the stack of the deepest path of calls, by the compiler's graphs (.ci files)."""
    own: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for graph in made.glob("*.ci"):
        text = graph.read_text()
        for title, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', text):
            if size := re.search(r"(\d+) bytes", label):
                own[title] = int(size[1])
        for source, target in re.findall(
            r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text
        ):
            calls.setdefault(source, set()).add(target)

    def depth(name: str) -> int:
        return own.get(name, 0) + max((depth(one) for one in calls.get(name, ())), default=0)

    return depth(next(name for name in own if name.split(":")[-1] == start))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/numbers/targets.json")
    parser.parse_args()
    rows, missing = [], []
    with tempfile.TemporaryDirectory() as scratch:
        for kind, unknowns in KINDS.items():
            fluxobs.export(MACHINE, SAMPLE_TIME, Path(scratch) / kind, unknowns=unknowns)
        for target in TARGETS:
            if shutil.which(f"{target.tools}gcc") is None:
                missing.append(target.name)
                continue
            both = [measure(target, Path(scratch) / kind, kind) for kind in KINDS]
            cells = [
                " / ".join("" if one[what] is None else str(one[what]) for one in both).strip(" /")
                for what in ("code", "state", "parameters", "stack")
            ]
            rows.append(f"| {target.name} | {' | '.join(cells)} | {target.note} |")
        modules = [str(measure_module(Path(scratch) / kind, kind)) for kind in KINDS]
        rows.append(f"| wasm32 | {' / '.join(modules)} | | | | |")
    head = "| plain / adaptive | code [bytes] | state | parameters | stack | |"
    table = "\n".join([head, "|---|---|---|---|---|---|", *rows])
    print(table)
    if missing:
        print(f"Compilers are missing for {', '.join(missing)}")
        return 0
    with Numbers("targets", SOURCES) as numbers:
        add_table(numbers, "sizes", table)
    if read("targets")["tables"] != numbers.tables:
        print("These sizes differ from those in docs/firmware.md; run with --write")
    return 0


if __name__ == "__main__":
    sys.exit(main())
