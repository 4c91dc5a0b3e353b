"""The page of the benchmark, docs/scores.md, from the committed numbers in docs/scores/.

python benchmarks/score_page.py              # page and picture from docs/scores/*.csv
python benchmarks/score_page.py logs A B …   # first merge the summaries of `fluxobs score --out`
"""

from __future__ import annotations

import sys
from pathlib import Path

import polars as pl

from fluxobs.benchmark.report import markdown_table
from fluxobs.benchmark.scores import Summary
from fluxobs.core.plots import BLUE, GREY, ORANGE, STYLE, new_figure, write

DOCS = Path(__file__).resolve().parent.parent / "docs"
NUMBERS, PAGE, PICTURE = DOCS / "scores", DOCS / "scores.md", DOCS / "images" / "scores.png"
TITLES = {
    "logs": (
        "Logs",
        "Suite 1, seed 1: 95 records of eight machines. An observer without standard deviations "
        "gets the constant that suits it best in the interval score; an observer without a "
        "validity flag is trusted above 5 % of the rated speed if it is a published one, else "
        "always. Observers that do not exist for a kind of machine are scored on fewer records.",
    ),
    "closed-loop": (
        "Closed loop",
        "96 drives of the same machines start at rest without load, take over, are loaded, "
        "accelerate or reverse. *Valid* is the share of the time in which the drive uses the "
        "observer. *Lost*: the drive trips, or does not follow its speed reference on a fifth of "
        "the rows after 1.5 s; a drive that waits too long in its open-loop start is lost, too. "
        "That is how our observers lose drives: of the 49 of the adaptive observer, 26 never hand "
        "over and 17 in the second half of the time (the open-loop start accelerates by a fifth of "
        "the rated speed per second; at no load the drone motor is known from 36 % of it on, "
        "the 5.6 kW machine from 13 %).",
    ),
    "measured": (
        "Measured logs",
        "Recipe `med2021-spmsm` on the five logs that were used in the development, with the "
        "published machine file. The encoder contributes 0.5°.",
    ),
}
#: Names of the classes of examples/motulator_entrants.py.
NAMES = {
    "FluxObserver": "flux observer (motulator)",
    "AdaptingFluxObserver": "flux observer, adapting (motulator)",
}
TEXTS = ("entrant", "track", "group")
GROUPS = ("right model", "data sheet", "every error")
OURS = ("plain", "adaptive", "whole-log")


def merge(name: str, folders: list[str]) -> None:
    """Write a table of the summaries of runs."""
    tables = [pl.read_csv(Path(folder) / "summary.csv") for folder in folders]
    merged = pl.concat(tables, how="vertical_relaxed")
    counts = ("records", "lost_drives", "sure_and_wrong")
    numbers = [name for name in merged.columns if name not in (*TEXTS, *counts)]
    rounded = merged.with_columns(pl.col(numbers).cast(pl.Float64).round_sig_figs(4))
    rounded.with_columns(pl.col("entrant").replace(NAMES)).write_csv(NUMBERS / f"{name}.csv")


def summaries(name: str) -> list[Summary]:
    table = pl.read_csv(NUMBERS / f"{name}.csv", infer_schema_length=None)
    return [Summary(**row) for row in table.to_dicts()]


def page() -> str:
    """Return the page."""
    parts = [
        "# Scores\n\nThe public part of [the benchmark](tasks/score.md): every baseline of "
        "`fluxobs compare`, our observers, and motulator's. `benchmarks/score_page.py` makes "
        "this page from the numbers in `docs/scores/`, which `fluxobs score --out` wrote. "
        "[What the columns mean](tasks/score.md#scores).\n\n"
        "![Rms error and share of valid rows of each observer](images/scores.png)\n"
    ]
    for name, (title, text) in TITLES.items():
        found = summaries(name)
        parts.append(f"\n## {title}\n\n{text}\n\n")
        parts.append(markdown_table([s for s in found if s.group == "all"]))
        for group in GROUPS if name == "logs" else ():
            parts.append(f"\n**{group.capitalize()}**\n\n")
            parts.append(markdown_table([s for s in found if s.group == group]))
    return "".join(parts)


def picture() -> None:
    """Draw error and validity of the observers on the logs."""
    import matplotlib as mpl

    found = [s for s in summaries("logs") if s.group == "all"]
    found.sort(key=lambda s: -s.interval)
    with mpl.rc_context(STYLE):
        figure = new_figure(figsize=(9, 0.28 * len(found) + 1.2))
        left, middle, right = figure.subplots(1, 3, sharey=True)
        names = [f"{s.entrant} ({s.records})" for s in found]
        colours = [
            BLUE if s.entrant in OURS else ORANGE if "motulator" in s.entrant else GREY
            for s in found
        ]
        for axes, title, values in (
            (left, "rms error of valid rows [°]", [s.rms_valid or 0 for s in found]),
            (middle, "valid rows [%]", [100 * s.valid for s in found]),
            (right, "interval score [°]", [s.interval for s in found]),
        ):
            axes.barh(names, values, color=colours)
            axes.set_title(title)
        left.set_xscale("log")
        left.tick_params(axis="y", labelsize=7)
    write(figure, PICTURE)


def main() -> None:
    if len(sys.argv) > 2:
        merge(sys.argv[1], sys.argv[2:])
        return
    PAGE.write_text(page(), "utf-8")
    picture()


if __name__ == "__main__":
    main()
