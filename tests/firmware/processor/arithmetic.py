"""Compare fixed and floating point on a processor without a floating-point unit.

Prints the instructions of a multiplication with an addition on an emulated Cortex-M0.

    python tests/firmware/processor/arithmetic.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from replay import BUILDS, COMMON, HERE, INSTRUCTION, link, said_by

from fluxobs.deployment.costs import read_costs

#: Each pass of a loop in arithmetic.c has two multiplications and one addition.
OPERATIONS = {"emulated": "single precision, emulated", "divided": "a division, emulated"}
OPERATIONS |= {"whole_product": "fixed point, 64-bit products"}
OPERATIONS |= {"upper_half": "fixed point, upper halves from 16-bit parts"}


def main() -> int:
    build = BUILDS[-1]
    with tempfile.TemporaryDirectory() as scratch:
        program = Path(scratch) / "arithmetic.elf"
        link(build, [*COMMON, *build.flags, f"-I{HERE}"], [HERE / "arithmetic.c"], program)
        found = dict(said_by(build, program)[0])
    per = build.clock * INSTRUCTION * 1e-9
    counts = {
        name: (found[name] - found["reading"]) / per / found["parameters"] for name in OPERATIONS
    }
    print(f"{build.name}: instructions of two multiplications with an addition, or of a division")
    for name, about in OPERATIONS.items():
        print(f"  {about}: {counts[name]:.0f}")
    mean = next(one["mean"] for one in read_costs()["plain"]["builds"] if one["name"] == build.name)
    best = counts["upper_half"] / counts["emulated"] * mean
    print(f"  a step of {mean} would take at least {best:.0f} in fixed point without scaling")
    return 0


if __name__ == "__main__":
    sys.exit(main())
