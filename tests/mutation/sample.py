"""Share of one-line errors in design/ and paper/ that the tests catch, on a random sample.

    pip install cosmic-ray
    python tests/mutation/sample.py --count 60 --seed 1

Work on a clean clone: every mutant is written into the source file and taken back. The operators
are Cosmic Ray's; those on `|` are left out, since here it stands in annotations. Each mutant meets
the tests of its folder, and stops at the first that fails.
"""

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.testing import TestOutcome
from cosmic_ray.work_db import WorkDB, use_db

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "src" / "fluxobs"
#: Folder or file under src/fluxobs → tests that guard it, the quickest first.
TESTS = {
    "design/analysis": "tests/design/analysis tests/design/regression tests/paper",
    "design/regression": "tests/design/regression tests/design/analysis tests/paper",
    "design/energies": "tests/design/energies tests/paper",
    "design/relation_observer.py": "tests/design/test_relation_observer.py",
    "design/precision.py": "tests/design/energies tests/design/regression",
    "design/baselines": "tests/design/baselines",
    "design/drive": "tests/design/drive",
    "paper": "tests/paper tests/design/energies/test_levitation.py tests/design/analysis",
}
LIMIT = 900.0


def mutants() -> list[tuple[str, object]]:
    """Every mutation with the tests that guard its file."""
    out = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (part, tests) in enumerate(TESTS.items()):
            where = SOURCES / part
            files = sorted(where.rglob("*.py")) if where.is_dir() else [where]
            with use_db(Path(folder) / f"{number}.sqlite", WorkDB.Mode.create) as db:
                init([path.relative_to(ROOT) for path in files], db, {})
                out += [
                    (tests, mutation)
                    for item in db.work_items
                    for mutation in item.mutations
                    if "BitOr" not in mutation.operator_name
                ]
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folders", nargs="*", default=list(TESTS), choices=list(TESTS))
    chosen = parser.parse_args()
    dirty = subprocess.run(["git", "diff", "--quiet"], cwd=ROOT, check=False).returncode
    if dirty:
        sys.exit("the clone has changes: commit or stash them first")
    for part in set(TESTS) - set(chosen.folders):
        del TESTS[part]
    every = mutants()
    random.seed(chosen.seed)
    sample = random.sample(every, min(chosen.count, len(every)))
    print(f"{len(sample)} of {len(every)} mutants")
    caught = 0
    for k, (tests, mutation) in enumerate(sample, 1):
        begin = time.monotonic()
        command = f"{sys.executable} -m pytest -x -q -p no:cacheprovider {tests}"
        result = mutate_and_test([mutation], command, LIMIT)
        killed = result.test_outcome != TestOutcome.SURVIVED
        caught += killed
        place = f"{mutation.module_path}:{mutation.start_pos[0]}"
        name = mutation.operator_name.removeprefix("core/")
        verdict = "caught" if killed else "SURVIVED"
        print(f"{k:3d} {verdict:8s} {time.monotonic() - begin:5.0f} s  {place} {name}", flush=True)
    n, p = len(sample), caught / len(sample)
    half = 1.96 * (p * (1 - p) / n) ** 0.5
    print(f"caught {caught} of {n}: {p:.0%} ± {half:.0%}")


if __name__ == "__main__":
    main()
