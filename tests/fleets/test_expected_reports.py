"""Remarks, page and pictures of a fleet's report equal the expected ones."""

from datetime import UTC, datetime, timedelta

import numpy as np
import polars as pl

from fluxobs.fleets.batch import Fleet
from fluxobs.fleets.follow import follow, read_limit, untold
from fluxobs.fleets.log_task import COLUMNS
from fluxobs.fleets.report import headline, remarks, write_html
from support.expected import check, pictures_of_reports

START = datetime(2025, 3, 1, tzinfo=UTC)


def table():
    """Return six drives: one warms up, one magnet jumps, one ages, one differs from the rest."""
    rng, rows = np.random.default_rng(5), []
    for d, drive in enumerate("abcdef"):
        for k in range(12):
            R = 1.0 + 0.003 * rng.standard_normal()
            psi = 0.1 + 1e-4 * rng.standard_normal()
            R += 0.01 * k if drive == "b" else 0.25 if drive == "e" else 0.0
            psi -= 0.004 if drive == "c" and k > 6 else 4e-4 * k if drive == "d" else 0.0
            rows.append(
                {
                    "log": f"{drive}/day{k:02d}.csv",
                    "drive": drive,
                    "time": START + timedelta(days=3 * k + d / 8),
                    "resistance": R,
                    "resistance_std": 0.003,
                    "psi_f": psi,
                    "psi_f_std": 1e-4,
                    "valid": 0.95,
                }
            )
    rows.append({"log": "g/x.csv", "drive": "g", "failed": "g/x.csv: no columns of currents"})
    return pl.DataFrame(rows, schema=COLUMNS)


def test_the_report(tmp_path, monkeypatch):
    pictures = pictures_of_reports(monkeypatch)
    fleet = Fleet(tmp_path, table())
    limits = [read_limit("resistance=20%"), read_limit("psi_f=0.09..0.11")]
    followed = follow(fleet.table, limits)
    write_html(fleet, followed, tmp_path / "fleet.html")
    page = (tmp_path / "fleet.html").read_text("utf-8").partition("<h1")[2]
    contents = {
        "headline": headline(fleet, followed),
        "remarks": remarks(followed),
        "untold": untold(followed, limits),
        "page": page.splitlines(),
        "pictures": pictures,
    }
    check("fleets/report", contents)
