"""The adaptive observer in two tasks: late, preempted at any instruction, on two cores."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest

import fluxobs
from support.compiling import build_program
from support.firmware import HARNESS, firmware_objects
from support.records import COURSE_TIME, PMSM, course, wrapped_degrees

#: The machine file's resistance is 40 % too large.
MACHINE = PMSM.with_values(R_s=1.4 * PMSM.R_s)


@pytest.fixture(scope="module")
def samples():
    return course()


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    """Return a function that compiles the harness with the exported folder."""
    folder = tmp_path_factory.mktemp("two tasks") / "motor"
    unknowns = ("drift", "resistance", "inverter")
    fluxobs.export(MACHINE, COURSE_TIME, folder, unknowns=unknowns)

    def made(name, *flags):
        program = folder.parent / name
        objects = firmware_objects(folder.glob("*obs*.c"), *flags)
        options = ["-std=c99", "-O2", "-ffp-contract=off", *flags, f"-I{folder}", "-pthread"]
        return build_program(["gcc"], options, [HARNESS / "tasks.c", *objects], program)

    return made


def run(program, mode, samples):
    given = np.hstack([samples.voltage, samples.current]).astype(float).tobytes()
    done = subprocess.run([program, mode], input=given, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    angle, std, valid = np.frombuffer(done.stdout).reshape(-1, 3).T
    return wrapped_degrees(angle - samples.theta), np.degrees(std), valid > 0


def check(result, samples, share, rms):
    error, std, valid = result
    assert valid.mean() > share
    assert (np.abs(error[valid]) < 5 * std[valid] + 0.1).all()
    settled = valid & (np.arange(len(error)) > 0.7 / COURSE_TIME)
    assert np.sqrt(np.mean(error[settled] ** 2)) < rms


@pytest.mark.parametrize(
    ("every", "share", "rms"), [(1, 0.9, 0.1), (10, 0.9, 0.1), (50, 0.85, 0.2)]
)
def test_late_learner(build, samples, every, share, rms):
    """At 8 kHz, calls at 800 Hz and at 160 Hz: blocks wait, and are merged, without loss."""
    check(run(build("late"), str(every), samples), samples, share, rms)


def test_preempted_learner(build, samples):
    check(run(build("signals"), "signals", samples), samples, 0.85, 0.2)


def test_two_threads_without_data_races(build, samples):
    """The thread sanitizer reports every access that the flag of the mail does not order."""
    program = build("threads", "-fsanitize=thread", "-g")
    check(run(program, "threads", samples), samples, 0.85, 0.2)
