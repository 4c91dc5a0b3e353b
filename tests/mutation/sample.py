"""Share of one-line errors that the tests catch, on a random sample of them.

    pip install cosmic-ray libclang ninja cmake nanobind
    python tests/mutation/sample.py --count 150 --seed 1

Work on a clean clone: every mutant is written into the source file and taken back. An expression is
drawn first, then one of its mutants, so that expressions with many mutants do not prevail. A mutant
meets the tests of its room only, and these stop at the first that fails. `--part 1/2` and `--part
2/2`, in two clones, share the work. Mutants that change nothing computable are listed with their
reason in equivalent.txt and left out.
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
#: Room, or file, under src/fluxobs → tests that guard it, the quickest first.
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
#: Longest that the tests of a mutant may take [s]; a mutant that hangs is caught.
LIMIT = 900.0
EQUIVALENT = Path(__file__).with_name("equivalent.txt")


def drawn(rooms: list[str], count: int, seed: int) -> list[tuple[str, PythonMutant | CMutant]]:
    """A random sample of expressions, and of each one of its mutants."""
    sites: dict[object, list[tuple[str, PythonMutant | CMutant]]] = {}
    for room in rooms:
        for mutant in c_mutants() if room == FIRMWARE else python_mutants(room):
            sites.setdefault(mutant.site, []).append((room, mutant))
    print(f"{sum(map(len, sites.values()))} mutants of {len(sites)} expressions", flush=True)
    draw = random.Random(seed)
    reasons = equivalent()
    sample = [draw.choice(sites[site]) for site in draw.sample(list(sites), len(sites))]
    return [(room, one) for room, one in sample if described(one) not in reasons][:count]


def described(mutant: PythonMutant | CMutant) -> str:
    """File, changed line without its indentation, and change; line numbers do not last."""
    path = mutant.path.resolve()
    line = path.read_text("utf-8").splitlines()[mutant.line - 1].strip()
    return f"{path.relative_to(ROOT).as_posix()} | {line} | {mutant.name}"


def equivalent() -> set[str]:
    """Mutants that change nothing computable: lines of the file that begin without a space."""
    lines = EQUIVALENT.read_text("utf-8").splitlines() if EQUIVALENT.exists() else []
    return {line for line in lines if line and not line.startswith((" ", "#"))}


def passes(room: str) -> bool:
    """Do the tests of a room pass?

    Raises
    ------
    subprocess.TimeoutExpired
        They hang.
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
        with suppress(ProcessLookupError):  # a program that hangs outlives the test that started it
            os.killpg(tests.pid, signal.SIGKILL)
        tests.wait()


def verdict(room: str, mutant: PythonMutant | CMutant) -> str:
    """ "caught" or "SURVIVED"; "invalid" if it does not compile."""
    try:
        with mutant.applied():
            return "SURVIVED" if passes(room) else "caught"
    except subprocess.TimeoutExpired:
        return "caught"
    except (subprocess.CalledProcessError, AttributeError):  # Cosmic Ray fails on `except (A, B)`
        return "invalid"


def demand_sound(rooms: list[str]) -> None:
    """Tests that fail anyway would catch every error."""
    if FIRMWARE in rooms:
        install()
    for room in rooms:
        if not passes(room):
            sys.exit(f"{room}: its tests fail without an error in it; run pytest {TESTS[room]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=150)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", default="1/1", help="k/n: every n-th of them, from the k-th")
    parser.add_argument("--rooms", nargs="*", default=list(PRODUCT), choices=list(TESTS))
    options = parser.parse_args()
    if subprocess.run(["git", "diff", "--quiet", "HEAD"], cwd=ROOT, check=False).returncode:
        sys.exit("the clone has changes: commit or stash them first")
    # As an interrupt from the keyboard: the source is taken back.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    first, step = map(int, options.part.split("/"))
    sample = drawn(options.rooms, options.count, options.seed)[first - 1 :: step]
    demand_sound(sorted({room for room, _ in sample}))
    verdicts = []
    for number, (room, mutant) in enumerate(sample, 1):
        begin = time.monotonic()
        text = described(mutant)
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
