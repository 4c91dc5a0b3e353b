"""Mean and spread of the score at the true parameters, over noise, controller, delay and machine.

    python tests/engine/score_table.py [--drives 400] [--write]

Each cell has the mean score in standard errors, and its standard deviation over that which the
information states. Two deliberate errors follow.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from ctypes import CDLL
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

from numbers_data import Numbers  # noqa: E402

from engine.likelihood import ENGINE, library  # noqa: E402
from engine.loop import INTERIOR, SURFACE, Conditions  # noqa: E402
from engine.scores import TESTED, scores_at_the_truth  # noqa: E402

#: Machine, noise as a share of the rated current of 12 A, gain kp h / L, and lag. In the last case
#: the sensor gives the mean of two samples.
AVERAGED = replace(SURFACE, moving_mean=2)
CASES = [
    *((SURFACE, noise, 0.35, 0) for noise in (0.0008, 0.0025, 0.008)),
    *((SURFACE, 0.0025, gain, 0) for gain in (0.05, 0.5)),
    (SURFACE, 0.0025, 0.2, 1),
    *((INTERIOR, noise, 0.35, 0) for noise in (0.0008, 0.0025, 0.008)),
    (INTERIOR, 0.0025, 0.2, 1),
    (AVERAGED, 0.0025, 0.35, 0),
]
RATED = 12.0
#: Lines of a source with a deliberate error.
ERRORS = {
    "regressor from the measured current": (
        "innovations.c",
        ("static void move_flux(", "static const double *measured;\nstatic void move_flux("),
        ("    advance(q, &t", "    measured = i;\n    advance(q, &t"),
        ("a ? e->mean.b : e->mean.a;", "fo_constant(measured[a]);"),
    ),
    "∂ ln det S left out": (
        "backward.c",
        ("row->V[r][c] - z->w[r] * z->w[c]", "-z->w[r] * z->w[c]"),
    ),
}


def with_error(file: str, changes: Sequence[tuple[str, str]], folder: Path) -> CDLL:
    """Compile the engine with some lines of a source changed."""
    text = (ENGINE / file).read_text("utf-8")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / file).write_text(text, "utf-8")
    return library(folder / file)


def row(name: str, conditions: Conditions, drives: int, own: CDLL | None = None) -> list[str]:
    got = scores_at_the_truth(conditions, drives, own)
    cells = zip(got.deviation(), got.spread(), strict=True)
    return [name, *(f"{mean:+.1f}, {spread:.2f}" for mean, spread in cells)]


def rows(drives: int) -> Iterator[list[str]]:
    for machine, noise, gain, lag in CASES:
        kind = "interior" if machine is INTERIOR else "surface"
        coloured = ", mean of two samples" if machine is AVERAGED else ""
        name = f"{kind}, noise {100 * noise:.2g} %{coloured}, gain {gain}, lag {-lag}"
        conditions = replace(machine, noise=noise * RATED, bandwidth=gain, lag=lag)
        yield row(name, conditions, drives)
    loud = replace(SURFACE, noise=0.008 * RATED)
    for name, (file, *changes) in ERRORS.items():
        with tempfile.TemporaryDirectory() as folder:
            yield row(name, loud, drives, with_error(file, changes, Path(folder)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=400)
    parser.add_argument("--write", action="store_true", help="write docs/numbers/score_table.json")
    drives = parser.parse_args().drives
    with Numbers("score_table", ["engine/*.[ch]", "tests/engine/*.py"]) as numbers:
        made = []
        for cells in rows(drives):
            print("\t".join(cells), flush=True)
            made.append(cells)
        header = ["", *TESTED]
        numbers.table("scores", header, made)
        numbers.value("drives", drives)


if __name__ == "__main__":
    main()
