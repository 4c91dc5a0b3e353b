"""Upper bound of the instructions of a step, from a trace of an emulated processor.

The count of an instruction of the observer is its largest count in any call. An instruction that
never ran counts once if other instructions of its function ran. Even a call with the worst of all
branches cannot need more instructions, provided that no loop runs longer than in the record. Loops
of the sources have constant counts; loops of emulated arithmetic (Cortex-M0) have varying counts.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

#: Functions of the harness that call the step: when one of them continues, the call has ended.
CALLERS = (
    "timed_step",
    "timed_learning",
    "main",
    "step",
    "check_replay",
    "fo_adaptive_step_single",
)
NO_INSTRUCTION = (".word", ".short", ".byte")


def calls(program: Path, board: str, step: str) -> Iterator[Counter[int]]:
    """Yield, for every call of the function `step`: address → how often its instruction ran."""
    symbols = ["arm-none-eabi-nm", program]
    named = subprocess.run(symbols, check=True, capture_output=True, text=True).stdout
    entry = int(re.search(rf"^([0-9a-f]+) . {step}$", named, re.MULTILINE)[1], 16) & ~1
    with tempfile.TemporaryDirectory() as scratch:
        trace = Path(scratch) / "trace"
        command = ["qemu-system-arm", "-M", board, "-nographic", "-monitor", "none"]
        command += ["-serial", "none", "-semihosting-config", "enable=on,target=native"]
        command += ["-d", "exec,nochain,in_asm", "-D", trace, "-kernel", program]
        subprocess.run(command, check=False, capture_output=True, timeout=300)
        yield from _read(trace, entry, step)


def _read(trace: Path, entry: int, step: str) -> Iterator[Counter[int]]:
    blocks: dict[int, list[int]] = {}  # address → addresses of the instructions in the block
    functions: dict[int, str] = {}
    function, block = "", list[int]()
    call: Counter[int] | None = None
    with trace.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if line.startswith("IN: "):
                function, block = line[4:].strip(), []
            elif line.startswith("0x"):
                block.append(int(line[:10], 16))
            elif line.startswith("Trace"):
                at = int(line.split("/")[1], 16)
                if block:
                    blocks[block[0]], functions[block[0]], block = block, function, []
                if call is None and at == entry:
                    call = Counter()
                elif call is not None and functions[at] in CALLERS and functions[at] != step:
                    ran: Counter[int] = Counter()
                    for first, times in call.items():
                        for address in blocks[first]:
                            ran[address] += times
                    yield ran
                    call = None
                if call is not None:
                    call[at] += 1


def _instructions(program: Path) -> dict[str, set[int]]:
    """Return function → addresses of its instructions."""
    command = ["arm-none-eabi-objdump", "-d", program]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found: dict[str, set[int]] = {}
    function = ""
    for line in listing.splitlines():
        if start := re.match(r"[0-9a-f]+ <(.*)>:", line):
            function = start[1]
        one = re.match(r"\s+([0-9a-f]+):\t[0-9a-f ]+\t(\S+)", line)
        if one and one[2] not in NO_INSTRUCTION:
            found.setdefault(function, set()).add(int(one[1], 16))
    return found


def bound(program: Path, board: str, step: str) -> int:
    """Return the upper bound of the instructions of a call of the function `step`."""
    most: Counter[int] = Counter()
    for ran in calls(program, board, step):
        most |= ran
    touched = (one for one in _instructions(program).values() if one & most.keys())
    return most.total() + sum(len(one - most.keys()) for one in touched)
