"""Print the tables of docs/observers.md: yields of shipped machines with a product's tolerances.

fluxobs campaign examples/campaigns/product.toml --out product
fluxobs campaign examples/campaigns/product-cage.toml --out product-cage
python benchmarks/product.py product product-cage [--pictures docs/images]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from fluxobs.campaigns import open_dataset, pictures
from fluxobs.campaigns.report import describe_indices, headline, sensitivities
from fluxobs.campaigns.statistics import group, yield_of
from fluxobs.core.plots import write


def table(folder: Path) -> None:
    """Print a Markdown table with a row per machine and a column per observer.

    Each cell holds the yield with its interval, the median rms error and the number of scenarios
    that are sure and wrong.
    """
    dataset = open_dataset(folder)
    specification, rows = dataset.specification, dataset.rows()
    names = [observer.name for observer in specification.observers]
    print(f"\n{headline(dataset)}\n")
    print(f"| machine | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
    for machine in specification.machines:
        cells = []
        for name in names:
            selected = group(rows, machine, name)
            good_yield = yield_of(selected, specification.good)
            lower, upper = (100 * x for x in good_yield.interval)
            wrong = selected["wrong"].drop_nulls()
            wrong_text = f"; {int((wrong > 0).sum())}" if len(wrong) else ""
            rms = np.degrees(selected["rms"].median() or np.nan)
            cells.append(
                f"{100 * good_yield.share:.0f} ({lower:.0f}–{upper:.0f}), {rms:.2g}°{wrong_text}"
            )
        print(f"| {machine} | {' | '.join(cells)} |")
    print()
    for (machine, name), indices in sensitivities(dataset, rows).items():
        if name in ("plain", "adaptive"):
            print(f"{name} on {machine}: {describe_indices(indices, specification.scenarios)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    for folder in options.folders:
        table(folder)
    if options.pictures:
        dataset = open_dataset(options.folders[0])
        figure = pictures.distribution(dataset.specification, dataset.rows())
        write(figure, options.pictures / "campaign.png")
