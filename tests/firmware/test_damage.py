"""The observer's memory is overwritten while it runs: few rows are wrong, and the observer
recovers."""

import subprocess

import pytest

import fluxobs
from support.compiling import build_program
from support.firmware import HARNESS, firmware_objects
from support.records import SERVO

#: Largest number of rows that are valid but wrong, and of samples (1e-4 s) until all rows are right
#: again. The worst case is a number of the least squares that becomes zero: the state then still
#: looks correct.
LIMITS = {"MOST_WRONG": 60, "MOST_LATE": 1500, "L_S": SERVO.L_s, "R_S": SERVO.R_s}


@pytest.mark.parametrize("single", [0, 1])
def test_overwritten_memory(tmp_path, single):
    folder = tmp_path / "motor"
    fluxobs.export(SERVO, 1e-4, folder, unknowns="drift")
    values = [f"-D{name}={value}" for name, value in LIMITS.items()]
    options = ["-std=c99", "-O1", f"-DFO_SINGLE={single}", *values]
    options += [f"-I{folder}", f"-I{folder}/test"]
    objects = firmware_objects(folder.glob("*obs*.c"), f"-DFO_SINGLE={single}")
    sources = [HARNESS / "damage.c", *objects]
    build_program(["gcc"], options, sources, tmp_path / "damage")
    done = subprocess.run([tmp_path / "damage"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
