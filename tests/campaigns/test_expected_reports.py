"""The report of a campaign with drawn rows equals the expected report."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from matplotlib.container import BarContainer

from fluxobs.campaigns import pictures, report
from fluxobs.campaigns.columns import schema
from fluxobs.campaigns.dataset import Dataset
from fluxobs.campaigns.specification import Specification
from fluxobs.campaigns.statistics import Index
from support.expected import check, pictures_of_reports

MACHINES = ("servo-400w", "pmsm-2kw2", "ipm-2kw2", "synrm-6kw7", "induction-2kw2")
OBSERVERS = ("plain", "adaptive", "gradient (Ortega, Lee)")


def drawn(specification):
    """Return rows with errors from R and gain; some rows of the last observer are never valid."""
    rng, rows = np.random.default_rng(3), []
    for k, machine in enumerate(specification.machines):
        for number in range(k * specification.scenarios, (k + 1) * specification.scenarios):
            R, gain, noise = rng.uniform(-1, 1, 3)
            for j, table in enumerate(specification.observers):
                rms = np.radians(1 + j + k) * np.exp(
                    R + 0.5 * gain * (j + 1) + 0.2 * noise + R * gain
                )
                row = {"number": number, "machine": machine, "observer": table.name}
                row |= dict.fromkeys(specification.vary, 0.5) | {
                    "R": 1 + 0.2 * R,
                    "gain_a": 1 + 0.01 * gain,
                }
                row |= {"rms": rms, "worst": 3 * rms, "valid": 0.9 + 0.1 * noise}
                row |= {"first_valid": 0.1, "wrong": 0.02 * (rms > 0.3)}
                if j == 2:
                    row["wrong"] = None
                    if number % 7 == 0:
                        row |= dict.fromkeys(("rms", "worst", "first_valid")) | {"valid": 0.0}
                if specification.loop == "closed":
                    row |= {"handed_over": 0.2 if number % 5 else None, "in_loop": 0.5 + 0.4 * R}
                    row |= {"losses": int(number % 11 == 0), "tripped": number % 13 == 0}
                rows.append(row)
    rows[0] |= dict.fromkeys(("rms", "worst", "valid"), None)
    rows[0]["failed"] = "a torque of 12.5 Nm cannot be held"
    return pl.DataFrame(rows, schema=schema(specification))


def campaign(machines, scenarios, **fields):
    specification = Specification(
        name="product",
        machines=list(machines),
        scenarios=scenarios,
        observers=list(OBSERVERS),
        course={"duration": 2.0, "score_from": 0.25},
        vary={"R": {"uniform": [0.8, 1.2]}, "gain_a": {"uniform": [0.99, 1.01]}, "noise": 0.003},
        good={"rms": 4.0, "valid": 0.8},
        limits=[{"good": 0.6, "observer": "adaptive"}, {"good": 0.99, "observer": "plain"}],
        **fields,
    )
    return Dataset(Path("out"), specification, 16)


def test_quantities_are_shown_by_their_largest_share():
    """Pairs show the quantities with the largest share of any observer, the largest first."""
    specification = campaign(MACHINES[:1], 400).specification
    shares = {
        "plain": {"R": -0.02, "L_s": 0.1, "noise": -0.01},
        "adaptive": {"R": 0.7, "psi_f": 0.3},
    }
    indices = {
        (MACHINES[0], name): [
            Index(quantity, x, x - 0.01, x + 0.01) for quantity, x in by_quantity.items()
        ]
        for name, by_quantity in shares.items()
    }
    for max_quantities in (5, 3):
        (axis,) = pictures.importance(specification, indices, max_quantities).axes
        labels = [label.get_text() for label in axis.get_yticklabels()]
        assert labels == ["R", "psi_f", "L_s", "noise"][:max_quantities]
        bars = [bar for bar in axis.containers if isinstance(bar, BarContainer)]
        assert sorted(round(width) for bar in bars for width in bar.datavalues)[-2:] == [30, 70]


@pytest.mark.parametrize(
    ("name", "dataset"),
    [
        ("pairs", campaign(MACHINES[:1], 400)),
        ("one_machine", campaign(MACHINES[:1], 120)),
        ("in_the_loop", campaign(MACHINES[:2], 90, loop="closed")),
        ("five_machines", campaign(MACHINES, 20)),
    ],
)
def test_the_report(name, dataset, monkeypatch, tmp_path):
    drawings = pictures_of_reports(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    rows = drawn(dataset.specification)
    table, sentences = report.text(dataset, rows)
    columns = [(str(column.header), column.justify, list(column.cells)) for column in table.columns]
    page = report.write_html(dataset, rows).read_text("utf-8").partition("<h1")[2]
    contents = {
        "headline": report.headline(dataset),
        "terminal": columns,
        "sentences": sentences,
        "page": page.splitlines(),
        "pictures": drawings,
    }
    check(f"campaigns/{name}", contents)
