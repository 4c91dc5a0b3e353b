"""Share of one-line errors that the tests catch, on a random sample of errors.

    pip install cosmic-ray libclang ninja cmake nanobind
    python tests/mutation/sample.py --count 150 --seed 1

Run this in a clean clone: every mutant is written into its source file and then reverted. The
program first draws an expression, then one of its mutants, so expressions with many mutants do not
dominate. Only the tests of the mutant's room run; they stop at the first failure. `--part 1/2` and
`--part 2/2`, in two clones, share the work. Mutants that change no result are skipped;
equivalent.txt lists them with the reason.

To compare two states of the tests: write the output of one state to a file, and run
`--again FILE` in the other state. It repeats the mutants that survived there.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from c_mutants import CMutant, c_mutants, install
from python_mutants import PythonMutant, python_mutants
from scipy.stats import binomtest

ROOT = Path(__file__).parents[2]
#: Room or file under src/fluxobs → its tests, the quickest tests first.
TESTS = {
    "estimation": "tests/estimation",
    "observers": "tests/observers tests/contract/test_observers.py",
    "logs": "tests/logs",
    "identification": "tests/identification",
    "checking": "tests/checking",
    "machines": "tests/machines tests/contract/test_machines.py",
    "live": "tests/live",
    "campaigns": "tests/campaigns",
    "fleets": "tests/fleets",
    "firmware": "tests/observers tests/firmware tests/contract/test_observers.py",
    "research/analysis": "tests/research/analysis tests/research/regression tests/research/paper",
    "research/regression": "tests/research/regression tests/research/analysis tests/research/paper",
    "research/energies": "tests/research/energies tests/research/paper",
    "research/relation_observer.py": "tests/research/test_relation_observer.py",
    "simulation/precision.py": "tests/research/energies tests/research/regression",
    "comparison/baselines": "tests/comparison/baselines",
    "simulation/drive": "tests/simulation/drive",
    "research/paper": "tests/research/paper tests/research/energies/test_levitation.py "
    "tests/research/analysis",
}
#: The C sources are not under src/fluxobs.
FIRMWARE = "firmware"
PRODUCT = tuple(TESTS)[: tuple(TESTS).index(FIRMWARE) + 1]
#: Longest time for the tests of a mutant [s]. A mutant that needs longer counts as caught.
LIMIT = 900.0
EQUIVALENT = Path(__file__).with_name("equivalent.txt")


def draw_mutants(
    rooms: list[str], count: int, seed: int
) -> list[tuple[str, PythonMutant | CMutant]]:
    """Draw expressions at random, and one mutant of each expression."""
    sites: dict[object, list[tuple[str, PythonMutant | CMutant]]] = {}
    for room in rooms:
        for mutant in c_mutants() if room == FIRMWARE else python_mutants(room):
            sites.setdefault(mutant.site, []).append((room, mutant))
    print(f"{sum(map(len, sites.values()))} mutants of {len(sites)} expressions", flush=True)
    draw = random.Random(seed)
    reasons = equivalent()
    sample = [draw.choice(sites[site]) for site in draw.sample(list(sites), len(sites))]
    return [(room, mutant) for room, mutant in sample if describe(mutant) not in reasons][:count]


def repeated(log: Path) -> set[str]:
    """Return the descriptions of the mutants that survived in an earlier run, from its output."""
    lines = log.read_text("utf-8").splitlines()
    return {line.split(": ", 1)[1] for line in lines if line[4:12] == "SURVIVED"}


def describe(mutant: PythonMutant | CMutant) -> str:
    """Return (file, line without indentation, change); line numbers would soon be wrong."""
    path = mutant.path.resolve()
    line = path.read_text("utf-8").splitlines()[mutant.line - 1].strip()
    return f"{path.relative_to(ROOT).as_posix()} | {line} | {mutant.name}"


def equivalent() -> set[str]:
    """Return the mutants that change no result, one from each line of the file."""
    lines = EQUIVALENT.read_text("utf-8").splitlines() if EQUIVALENT.exists() else []
    return {line for line in lines if line and not line.startswith((" ", "#"))}


def passes(room: str) -> bool:
    """Whether the tests of a room pass.

    Raises
    ------
    subprocess.TimeoutExpired
        The tests hang.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    tests = subprocess.Popen(
        [*command, *TESTS[room].split()],
        cwd=ROOT,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        return tests.wait(LIMIT) == 0
    finally:
        with suppress(ProcessLookupError):  # a program that hangs continues after its test
            os.killpg(tests.pid, signal.SIGKILL)
        tests.wait()


def verdict(room: str, mutant: PythonMutant | CMutant) -> str:
    """ "caught" or "SURVIVED"; "invalid" if the mutant does not compile."""
    try:
        with mutant.applied():
            return "SURVIVED" if passes(room) else "caught"
    except subprocess.TimeoutExpired:
        return "caught"
    except (subprocess.CalledProcessError, AttributeError):  # Cosmic Ray fails on `except (A, B)`
        return "invalid"


def require_passing_tests(rooms: list[str]) -> None:
    """Exit if the tests fail without a mutant: such tests would seem to catch every error."""
    if FIRMWARE in rooms:
        install()
    for room in rooms:
        if not passes(room):
            sys.exit(f"{room}: its tests fail without a mutant; run pytest {TESTS[room]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", default="1/1", help="k/n: every n-th mutant, from the k-th")
    parser.add_argument("--rooms", nargs="*", default=list(PRODUCT), choices=list(TESTS))
    parser.add_argument("--again", type=Path, help="repeat the survivors of this run's output")
    options = parser.parse_args()
    if subprocess.run(["git", "diff", "--quiet", "HEAD"], cwd=ROOT, check=False).returncode:
        sys.exit("the clone has changes: commit or stash them first")
    # As after a keyboard interrupt, the source is restored.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    part, step = map(int, options.part.split("/"))
    count = sys.maxsize if options.again else options.count
    sample = draw_mutants(options.rooms, count, options.seed)
    if options.again:
        survivors = repeated(options.again)
        sample = [drawn for drawn in sample if describe(drawn[1]) in survivors]
    sample = sample[part - 1 :: step]
    require_passing_tests(sorted({room for room, _ in sample}))
    verdicts = []
    for number, (room, mutant) in enumerate(sample, 1):
        begin = time.monotonic()
        text = describe(mutant)
        verdicts.append(verdict(room, mutant))
        seconds = time.monotonic() - begin
        print(f"{number:3d} {verdicts[-1]:8s} {seconds:4.0f} s  {mutant.line}: {text}", flush=True)
    caught = verdicts.count("caught")
    count = len(verdicts) - verdicts.count("invalid")
    interval = binomtest(caught, count).proportion_ci()
    print(f"caught {caught} of {count}: {caught / count:.0%}, with 95 % between", end=" ")
    print(f"{interval.low:.0%} and {interval.high:.0%}")


if __name__ == "__main__":
    main()
