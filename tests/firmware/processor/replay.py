"""Processor in the loop: the exported folder on emulated microcontrollers.

Exports a machine, cross-compiles the folder for Cortex-M4F and Cortex-M0, and replays its test
vectors under QEMU. Compares the outputs with the library's numbers, and prints the costs of a
sample.

    python tests/firmware/processor/replay.py           # prints which tools are missing
    python tests/firmware/processor/replay.py --write   # writes the costs into package and docs

Instructions are counted, not timed: with ``-icount shift=10`` every instruction lasts 1024 ns of
virtual time. The processor's SysTick timer runs on virtual time and is read before and after each
call. The period of the timer is so short that ticks give the exact number of instructions.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from in_docs import SOURCES, Numbers, add_table
from longest import bound

import fluxobs
from fluxobs.deployment.costs import cost_table, read_costs, task_table
from fluxobs.machines import AlgebraicSaturation, SynchronousReluctance
from fluxobs.simulation.closed_form.firmware_record import firmware_record

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
#: The memory is short so that the vectors include open-loop integration of the flux through a stop.
MACHINE, SAMPLE_TIME, MEMORY = "servo-400w", 1e-4, 0.006
#: Virtual time of an instruction [ns].
INSTRUCTION = 1024
TOOLS = {
    "arm-none-eabi-gcc": "gcc-arm-none-eabi libnewlib-arm-none-eabi",
    "qemu-system-arm": "qemu-system-arm",
}
COMMON = ["-std=c99", "-ffp-contract=off", "-fno-math-errno", "-mthumb"]
COMMON += ["-ffunction-sections", "-fdata-sections", "-Wall", "-Wextra", "-Werror"]
SIZE = ["-Os", "-fno-tree-loop-distribute-patterns"]


@dataclass(frozen=True)
class Build:
    """Compiler options, and the board that QEMU emulates for them."""

    name: str
    flags: list[str]
    board: str
    clock: float  # frequency of the SysTick timer [Hz]
    linker: str
    hard: bool  # Has a floating-point unit.
    fused: bool = (
        False  # The compiler may fuse multiplications with additions, which changes last digits.
    )


ADAPTIVE = ("drift", "resistance", "inverter")
#: "tasks" is the adaptive observer in an interrupt and a slower task.
KINDS = {"plain": ("drift",), "adaptive": ADAPTIVE, "tasks": ADAPTIVE}
STEPS = {
    "plain": "fo_step_single",
    "adaptive": "fo_adaptive_step_single",
    "tasks": "fo_adaptive_fast_step_single",
}
LEARN = "fo_adaptive_learn_single"
#: Instructions of a call of the slower task that has no work, at most.
IDLE = 50
#: Limits of the first build: instructions of a sample, bytes.
BUDGETS = {
    "plain": {"mean": 1320, "most": 1600, "state": 400, "stack": 256},
    "adaptive": {"mean": 4700, "state": 1720, "stack": 1400},
    "tasks": {"mean": 2350, "most": 3400, "stack": 640, "learn_most": 18000, "learn_bound": 26000},
}
#: Largest difference of a fused build: share of the flux, angle [rad].
FUSED = (1e-4, math.radians(0.05))
#: Instructions that a look-up in a table may add to those of a linear map.
LOOK_UP = 300
#: Instructions of the injector while the observer runs, at most.
INJECTING = 400
#: Processor → its clock [Hz], and cycles of an instruction, estimated.
PROCESSORS = {
    "Cortex-M4F, 168 MHz": (168e6, 1.6),
    "Cortex-M33, 250 MHz": (250e6, 1.5),
    "Cortex-M7, 480 MHz": (480e6, 1.0),
}
#: Calls of the slower task that have work, in the table of loads [1/s].
TASK_RATE = 1000
M4F = ["-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]
M0 = ["-mcpu=cortex-m0", "-O2"]
BUILDS = (
    Build("Cortex-M4F, -O2", [*M4F, "-O2"], "mps2-an386", 25e6, "m4f.ld", True),
    Build(
        "Cortex-M4F, -O2, fused",
        [*M4F, "-O2", "-ffp-contract=fast"],
        "mps2-an386",
        25e6,
        "m4f.ld",
        True,
        fused=True,
    ),
    Build("Cortex-M4F, -Os", [*M4F, *SIZE], "mps2-an386", 25e6, "m4f.ld", True),
    Build("Cortex-M0, soft float, -O2", M0, "microbit", 16e6, "m0.ld", False),
)


def compile_for(
    build: Build, folder: Path, kind: str, more: Sequence[str] = ()
) -> tuple[Path, int]:
    """Return (program, bytes of the observer in it: code and constants of its sources)."""
    flags = [*COMMON, *build.flags, *more, "-I", folder, "-I", folder / "test", "-I", HERE]
    flags += ["-DADAPTIVE"] if kind != "plain" else []
    flags += ["-DTASKS"] if kind == "tasks" else []
    observer, program = folder / "observer.o", folder / "program.elf"
    parts = []
    for source in sorted(folder.glob("fluxobs*.c")):
        parts.append(source.with_suffix(".o"))
        subprocess.run(["arm-none-eabi-gcc", *flags, "-c", source, "-o", parts[-1]], check=True)
    subprocess.run(["arm-none-eabi-ld", "-r", *parts, "-o", observer], check=True)
    sources = [HERE / "main.c", folder / "test" / "check.c", *parts, folder / "motor_observer.c"]
    link(build, flags, sources, program)
    linked = sizes(program)
    # Leave out what is only needed to step every few interrupts.
    few = {
        "fo_gather_single",
        "fo_step_volt_seconds_single",
        "fo_adaptive_step_volt_seconds_single",
        "fo_adaptive_fast_step_volt_seconds_single",
    }
    counted = linked.keys() - few
    return program, sum(size for name, size in sizes(observer).items() if name in counted)


def link(build: Build, flags: Sequence[object], sources: Sequence[Path], program: Path) -> None:
    """Link a program for the board."""
    command = ["arm-none-eabi-gcc", "-Wl,--gc-sections", *flags, HERE / "startup.c", *sources]
    command += ["-nostartfiles", "--specs=nano.specs", "-L", HERE, "-T", HERE / build.linker]
    command += ["-Wl,--no-warn-rwx-segments", "-lm", "-o", program]
    subprocess.run(command, check=True)


def sizes(path: Path) -> dict[str, int]:
    """Return the bytes of each function and constant."""
    out = subprocess.run(
        ["arm-none-eabi-nm", "-S", "-t", "d", path], check=True, capture_output=True, text=True
    ).stdout
    found = re.findall(r"^\d+ (\d+) [tTrRdD] (\S+)$", out, re.MULTILINE)
    return {name: int(size) for size, name in found}


def said_by(build: Build, program: Path) -> tuple[list[tuple[str, int]], int]:
    """Return (names and numbers that the program prints, exit code)."""
    command = ["qemu-system-arm", "-M", build.board, "-nographic", "-monitor", "none"]
    command += ["-serial", "none", "-semihosting-config", "enable=on,target=native"]
    command += ["-icount", "shift=10", "-kernel", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    lines = (done.stdout + done.stderr).split("\n")
    pairs = [line.split() for line in lines if re.fullmatch(r"\w+ -?\d+", line)]
    if not any(name == "parameters" for name, _ in pairs):
        raise SystemExit(f"{build.name}: the program did not end: {lines[-3:]}")
    return [(name, int(value)) for name, value in pairs], done.returncode


@dataclass(frozen=True)
class Run:
    """What a program printed: numbers by name; instructions of every step, of every call of the
    slower task, of gathering."""

    said: dict[str, int]
    steps: np.ndarray
    learning: np.ndarray
    gathering: float


def run(build: Build, program: Path) -> Run:
    """Run a program."""
    pairs, rc = said_by(build, program)
    said = {name: value for name, value in pairs if name not in ("ticks", "learning")}
    per_instruction = build.clock * INSTRUCTION * 1e-9

    def instructions(wanted: str) -> np.ndarray:
        ticks = np.array([value for name, value in pairs if name == wanted], float)
        exact = (ticks - said["ticks_of_reading"]) / per_instruction
        assert np.abs(exact - np.round(exact)).max(initial=0) < 0.1, "no whole instructions"
        return np.round(exact)

    gathering = instructions("ticks_of_gathering")[0]
    return Run(said | {"rc": rc}, instructions("ticks"), instructions("learning"), gathering)


def as_expected(build: Build, said: dict[str, int]) -> bool:
    """Whether every output equals the library's, bit for bit or, if fused, within tolerances."""
    if build.fused:
        flux, angle = said["flux_error_e9"] / 1e9, said["angle_error_e9"] / 1e9
        return not said["damaged"] and said["valid"] > 0 and flux < FUSED[0] and angle < FUSED[1]
    return said["rc"] == 0 and not (said["wrong"] or said["damaged"] or said["between"])


def measure(kind: str, unknowns: tuple[str, ...], compiler: str) -> tuple[dict[str, Any], bool]:
    """Return (costs of one kind of observer, whether any check failed)."""
    costs: dict[str, Any] = {"compiler": compiler, "builds": []}
    failed = False
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "motor"
        machine = fluxobs.read_machine(MACHINE)
        fluxobs.export(machine, SAMPLE_TIME, folder, memory=MEMORY, unknowns=unknowns)
        for build in BUILDS:
            program, code = compile_for(build, folder, kind)
            done = run(build, program)
            said, instructions = done.said, done.steps
            ok = as_expected(build, said)
            failed = failed or not ok
            print(
                f"{kind}, {build.name}: {said['rows'] - said['wrong']} of {said['rows']} rows as "
                f"expected, {said['valid']} valid; flux equal within "
                f"{said['flux_error_e9'] / 1e9:.0e}, angles within "
                f"{said['angle_error_e9'] / 1e9:.0e} rad"
                + ("" if ok else f"  FAILED, first at sample {said['first_row']}")
            )
            if kind != "plain" and build is BUILDS[0]:
                print_shares(kind, machine, build, instructions)
            costs["parameters"] = said["parameters"]
            costs["builds"].append(
                {
                    "name": build.name,
                    "mean": round(float(instructions.mean())),
                    "most": int(instructions.max()),
                    "bound": bound(program, build.board, STEPS[kind]) if build.hard else None,
                    "gather": int(done.gathering),
                    "code": code,
                    "state": said["state"],
                    "stack": said["stack"],
                }
            )
            if kind == "tasks":
                worked = done.learning[done.learning > IDLE]
                costs["builds"][-1] |= {
                    "learn_mean": round(float(worked.mean())),
                    "learn_most": int(worked.max()),
                    "learn_bound": bound(program, build.board, LEARN) if build.hard else None,
                    "learn_stack": said["learning_stack"],
                }
    for what, most in BUDGETS.get(kind, {}).items():
        if costs["builds"][0][what] > most:
            name = costs["builds"][0]["name"]
            print(f"FAILED: {kind}, {name}: {what} is {costs['builds'][0][what]}, limit {most}")
            failed = True
    print()
    print(cost_table(costs))
    print(f"Parameters in flash: {costs['parameters']} bytes")
    return costs, failed


def print_shares(
    kind: str, machine: fluxobs.Machine, build: Build, instructions: np.ndarray
) -> None:
    """Print the costs of a sample before and while the adaptive observer's filter runs, and while
    the position is valid."""
    observer = fluxobs.AdaptiveObserver.for_machine(
        machine,
        sample_time=SAMPLE_TIME,
        memory=MEMORY,
        unknowns=KINDS["adaptive"],
        precision="single",
    )
    record = firmware_record(machine, observer.plain)
    estimate = observer.run(record.voltage, record.current)
    running = estimate.adapting
    print(
        f"{kind}, {build.name}: starting on {1 - running.mean():.0%} of the rows, "
        f"mean {instructions[~running].mean():.0f} instructions; then "
        f"{instructions[running].mean():.0f}; on valid rows "
        f"{instructions[estimate.valid].mean():.0f}"
    )


def measure_maps(numbers: Numbers) -> bool:
    """Print the instructions that maps add to a sample; return whether a look-up has too many."""
    model = AlgebraicSaturation(a_d0=17.4, a_dd=373, a_q0=52.1, a_qq=658, a_dq=1120)
    machines = {
        "without": fluxobs.read_machine(MACHINE),
        "linear": fluxobs.read_machine("ipm-2kw2"),
        "table": SynchronousReluctance(R_s=0.63, n_p=2, rated_current=22.0, flux_map=model),
    }
    means = {}
    for name, machine in machines.items():
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch) / "motor"
            fluxobs.export(machine, SAMPLE_TIME, folder, unknowns="drift")
            program, _ = compile_for(BUILDS[0], folder, "plain")
            means[name] = run(BUILDS[0], program).steps.mean()
    table, linear = means["table"] - means["linear"], means["linear"] - means["without"]
    print(
        f"plain, {BUILDS[0].name}: a linear map adds {linear:.0f} instructions, a table "
        f"{table:.0f} more"
    )
    numbers.value("linear_map", linear, "{:.0f}")
    numbers.value("look_up", table, "{:.0f}")
    if table > LOOK_UP:
        print(f"FAILED: a look-up in a table may add at most {LOOK_UP} instructions")
    return bool(table > LOOK_UP)


def measure_configuring() -> bool:
    """Print the costs of a motor chosen in the field before its first step; return failure."""
    failed = False
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "motor"
        fluxobs.export(fluxobs.read_machine(MACHINE), SAMPLE_TIME, folder, unknowns="drift")
        sources = [folder / "fluxobs.c", folder / "runtime" / "fluxobs_config.c"]
        for build in (one for one in BUILDS if not one.fused):
            program, own = folder / "configure.elf", set[str]()
            flags = [*COMMON, *build.flags, f"-I{folder}", f"-I{folder / 'runtime'}", f"-I{HERE}"]
            for source in sources:
                made = source.with_suffix(".o")
                subprocess.run(["arm-none-eabi-gcc", *flags, "-c", source, "-o", made], check=True)
                own |= sizes(made).keys()
            link(build, flags, [HERE / "configure.c", *sources], program)
            pairs, rc = said_by(build, program)
            ticks = dict(pairs)
            count = (ticks["configuring"] - ticks["reading"]) / (build.clock * INSTRUCTION * 1e-9)
            code = sum(size for name, size in sizes(program).items() if name in own)
            print(f"fo_configure and fo_init, {build.name}: {count:.0f} instructions, {code} bytes")
            if rc != 0:
                print(f"FAILED: {build.name} refuses the configuration")
                failed = True
    return failed


def measure_injecting(numbers: Numbers) -> bool:
    """Print the costs of the injector; return whether it costs too many instructions."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, build = Path(scratch) / "motor", BUILDS[0]
        machine = fluxobs.read_machine("ipm-2kw2")
        fluxobs.export(machine, SAMPLE_TIME, folder, unknowns=ADAPTIVE)
        program = folder / "inject.elf"
        flags = [*COMMON, *build.flags, f"-I{folder}", f"-I{folder / 'runtime'}", f"-I{HERE}"]
        sources = [folder / "runtime" / f"fluxobs_{name}.c" for name in ("inject", "seed")]
        link(build, flags, [HERE / "inject.c", *sources, *folder.glob("fluxobs*.c")], program)
        pairs, rc = said_by(build, program)
        ticks, per_instruction = dict(pairs), build.clock * INSTRUCTION * 1e-9
        searching, running = (
            round((ticks[name] - ticks["reading"]) / per_instruction)
            for name in ("searching", "running")
        )
        inject = folder / "inject.o"
        source = folder / "runtime" / "fluxobs_inject.c"
        subprocess.run(["arm-none-eabi-gcc", *flags, "-c", source, "-o", inject], check=True)
        code = sum(sizes(inject).values())
    print(
        f"fo_inject, {build.name}: at most {searching} instructions while it searches, "
        f"{running} while the observer runs; {code} bytes"
    )
    numbers.value("injector_searching", searching)
    numbers.value("injector_running", running)
    numbers.value("injector_code", code / 1e3, "{:.1f} KB")
    if rc != 0 or running > INJECTING:
        print(f"FAILED: the injector may cost at most {INJECTING} instructions")
        return True
    return False


def load_rows(build: dict[str, Any]) -> list[list[str]]:
    """Return the load of each processor [%], interrupt + task, by the rate of the interrupt."""
    rows = []
    for rate in (10_000, 20_000, 40_000):
        cells = []
        for clock, cycles in PROCESSORS.values():
            calls = (rate * build["mean"], TASK_RATE * build["learn_mean"])
            interrupt, task = (100 * count * cycles / clock for count in calls)
            too_much = ": too much" if interrupt + task > 90 else ""
            cells.append(f"{interrupt:.0f} + {task:.0f}{too_much}")
        rows.append([f"{rate // 1000} kHz", *cells])
    return rows


def record(costs: dict[str, Any], numbers: Numbers) -> None:
    """Keep the numbers of the docs."""
    for kind, cost in costs.items():
        add_table(numbers, kind, (task_table if kind == "tasks" else cost_table)(cost))
        numbers.value(f"{kind}_parameters", cost["parameters"], "{} bytes")
        build = cost["builds"][0]
        for name in ("mean", "most"):
            numbers.value(f"{kind}_{name}", build[name])
        for name in ("state", "stack"):
            numbers.value(f"{kind}_{name}", build[name] / 1e3, "{:.1f} KB")
    loads = load_rows(costs["tasks"]["builds"][0])
    numbers.table("loads", ("interrupt at", *PROCESSORS), loads)
    numbers.value("compiler", costs["plain"]["compiler"])
    means = [costs[kind]["builds"][0]["mean"] for kind in ("adaptive", "plain")]
    reached = "{} (plain {})".format(*means)
    row = ("instructions on a Cortex-M4F, for the record of `make pil`", "3000", reached)
    numbers.table("adaptive_reached", ("quantity", "required", "reached"), [row])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write costs.json, docs/numbers")
    options = parser.parse_args()
    missing = [package for tool, package in TOOLS.items() if shutil.which(tool) is None]
    if missing:
        print(f"Processor in the loop: skipped; it needs apt-get install {' '.join(missing)}")
        return 0
    version = subprocess.run(
        ["arm-none-eabi-gcc", "--version"], check=True, capture_output=True, text=True
    ).stdout.split("\n")[0]
    compiler = f"Compiled by {version}"
    costs: dict[str, Any] = {}
    failed = False
    for kind, unknowns in KINDS.items():
        costs[kind], bad = measure(kind, unknowns, compiler)
        failed = failed or bad
    with Numbers("processor", SOURCES) as numbers:
        failed = measure_maps(numbers) or failed
        failed = measure_configuring() or failed
        failed = measure_injecting(numbers) or failed
        record(costs, numbers)
    if options.write:
        target = ROOT / "src" / "fluxobs" / "deployment" / "costs.json"
        target.write_text(json.dumps(costs, indent=1) + "\n", encoding="utf-8")
        print(f"Written: {target}")
    elif not failed and read_costs() != costs:
        print("These costs differ from those in the package; run with --write, for the docs too")
        failed = read_costs()["plain"]["compiler"] == compiler  # other compilers give other numbers
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
