"""The tables of docs/observers.md: yields of the shipped machines with a product's tolerances.

fluxobs campaign examples/campaigns/product.toml --out product
fluxobs campaign examples/campaigns/product-cage.toml --out product-cage
python benchmarks/product.py product product-cage [--pictures docs/images]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from fluxobs.campaigns import open_dataset, pictures
from fluxobs.campaigns.report import headline, sensitivities, describe_indices
from fluxobs.campaigns.statistics import group, yield_of
from fluxobs.core.plots import write


def table(folder: Path) -> None:
    """A table in Markdown: machines down, observers across; yield, and what is sure and wrong."""
    found = open_dataset(folder)
    s, rows = found.specification, found.rows()
    names = [one.name for one in s.observers]
    print(f"\n{headline(found)}\n")
    print(f"| machine | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for machine in s.machines:
        cells = []
        for name in names:
            mine = group(rows, machine, name)
            one = yield_of(mine, s.good)
            low, high = (100 * x for x in one.interval)
            wrong = mine["wrong"].drop_nulls()
            more = f"; {int((wrong > 0).sum())}" if len(wrong) else ""
            rms = np.degrees(mine["rms"].median() or np.nan)
            cells.append(f"{100 * one.share:.0f} ({low:.0f}–{high:.0f}), {rms:.2g}°{more}")
        print(f"| {machine} | {' | '.join(cells)} |")
    print()
    for (machine, name), indices in sensitivities(found, rows).items():
        if name in ("plain", "adaptive"):
            print(
                f"{name} on {machine}: {describe_indices(indices, found.specification.scenarios)}"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    for folder in options.folders:
        table(folder)
    if options.pictures:
        found = open_dataset(options.folders[0])
        drawn = pictures.distribution(found.specification, found.rows())
        write(drawn, options.pictures / "campaign.png")
