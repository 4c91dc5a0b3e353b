"""Instructions and bytes of each part of the plain observer.

    python tests/firmware/processor/parts.py           # prints the table
    python tests/firmware/processor/parts.py --write   # writes docs/numbers/parts.json

Instructions are the mean of a sample on an emulated Cortex-M4F, -O2. Bytes are those of the code,
-Os. The compiler's debugging information states from which function of the source an instruction
comes, inlined or not. The constants of a part are not counted.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from in_docs import SOURCES, Numbers, add_table
from longest import calls
from replay import BUILDS, KINDS, MACHINE, MEMORY, SAMPLE_TIME, STEPS, compile_for

import fluxobs

#: Part → its functions, and its purpose.
PARTS = {
    "rotations": (
        ("rotate_row", "add_row", "reinject_prior", "prior_information"),
        "measurement update and, every other sample, re-injection of a prior row",
    ),
    "transition": (("predict",), "propagates the information over the interval"),
    "solution": (("solve",), "flux and drift of every sample"),
    "certainty": (
        (
            "flux_variances",
            "update_variances",
            "correlation",
            "widen_drift_prior",
            "discount_information",
        ),
        "`theta_e_std`, share of noise, correction of a too tight prior; needed for `valid`",
    ),
    "measurement": (
        (
            "integrate_interval",
            "mean_current_24",
            "row_of",
            "measurement_row",
            "row_of_newest_current",
            "add_linear",
            "update_measurement",
            "third_difference",
            "difference_of_sums",
            "push_current",
            "dot",
            "set_zero",
            "fo_step_single",
        ),
        "volt-seconds, quadrature, the relation, noise of the current",
    ),
    "bad samples": (
        (
            "process_sample",
            "fo_step_merged_single",
            "classify",
            "is_outlier",
            "position_jumps",
            "position_step_length",
            "extrapolate",
            "reset_information",
            "restart",
            "fo_reset_single",
            "fo_damaged_single",
            "may_be_damaged",
            "zero_if_finite",
        ),
        "missing, absurd and contradicting samples; restarts",
    ),
    "angle and tracker": (
        ("fo_atan2_single", "wrap", "track", "predicted_step", "stop_tracker", "settle_tracker"),
        "`theta_e`, `theta_e_tracked`, `speed_e`",
    ),
    "open-loop integration": (
        ("integrate_open_loop", "drift_variance_across"),
        "the flux through a stop, and its growing standard deviation",
    ),
    "estimate": (
        (
            "finish_estimate",
            "solve_state",
            "take_turn",
            "update_voltage_turn",
            "select_flux",
            "track_solution",
            "write_estimate",
            "judge",
            "set_reason",
            "position_vector",
            "armature_flux",
        ),
        "choice of the reported flux, `valid`, outputs",
    ),
}
#: Without --no-gc-sections, debugging information places functions that the linker drops at address
#: 0.
DEBUG = ("-g", "-Wl,--no-gc-sections")
#: Functions that a step does not use.
OTHERS = ("check", "prepare", "in_range", "fo_init_single", "set_tracker", "reinjected", "within")
OTHERS += ("demand", "demand_size", "is_finite", "is_number", "check_prepared", "fo_wrong_single")
OTHERS += (
    "prepare_checked",
    "fo_rotate_in_single",
    "stretch",
    "fo_uneven_single",
    "fo_gather_single",
)
OTHERS += (
    "fo_scale_to_duration_single",
    "fo_step_volt_seconds_single",
    "fo_step_for_single",
    "memset",
)


def functions(program: Path, addresses: Iterable[int]) -> list[str]:
    """Return the function of the source from which each instruction comes."""
    command = ["arm-none-eabi-addr2line", "-f", "-e", str(program)]
    given = "\n".join(map(hex, addresses))
    done = subprocess.run(command, input=given, check=True, capture_output=True, text=True)
    return done.stdout.splitlines()[::2]


def instructions(folder: Path) -> Counter[str]:
    """Return the mean instructions of a sample, by function."""
    build = BUILDS[0]
    program, _ = compile_for(build, folder, "plain", DEBUG)
    ran: Counter[int] = Counter()
    steps = 0
    for one in calls(program, build.board, STEPS["plain"]):
        ran.update(one)
        steps += 1
    found: Counter[str] = Counter()
    for name, times in zip(functions(program, ran), ran.values(), strict=True):
        found[name] += times
    return Counter({name: round(times / steps) for name, times in found.items()})


def sizes(folder: Path) -> Counter[str]:
    """Return bytes by function."""
    build = next(one for one in BUILDS if one.name.endswith("-Os"))
    program, _ = compile_for(build, folder, "plain", DEBUG)
    listing = subprocess.run(
        ["arm-none-eabi-objdump", "-d", program], check=True, capture_output=True, text=True
    ).stdout
    pattern = r"^\s+([0-9a-f]+):\t([0-9a-f ]+)\t"
    lines = re.findall(pattern, listing, re.MULTILINE)
    bytes_of = {int(at, 16): len(code.replace(" ", "")) // 2 for at, code in lines}
    found: Counter[str] = Counter()
    for name, size in zip(functions(program, bytes_of), bytes_of.values(), strict=True):
        found[name] += size
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write docs/numbers/parts.json")
    parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "motor"
        machine = fluxobs.read_machine(MACHINE)
        fluxobs.export(machine, SAMPLE_TIME, folder, memory=MEMORY, unknowns=KINDS["plain"])
        ran, size = instructions(folder), sizes(folder)
    known = {name for names, _ in PARTS.values() for name in names} | set(OTHERS)
    lost = {name for name, times in ran.items() if times > 0} - known
    if lost:
        print(f"FAILED: these functions belong to no part: {', '.join(sorted(lost))}")
        return 1
    rows = [
        f"| {part} | {sum(ran[name] for name in names)} | {sum(size[name] for name in names)} "
        f"| {buys} |"
        for part, (names, buys) in PARTS.items()
    ]
    table = "\n".join(["| | instructions | bytes | purpose |", "|---|---|---|---|", *rows])
    print(table)
    with Numbers("parts", SOURCES) as numbers:
        add_table(numbers, "tasks", table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
