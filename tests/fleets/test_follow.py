"""What is said of a fleet."""

from __future__ import annotations

import io
import json
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from fluxobs.errors import UsageError
from fluxobs.fleets.batch import Fleet
from fluxobs.fleets.follow import follow, read_limit
from fluxobs.fleets.log_task import COLUMNS
from fluxobs.fleets.report import headline, picture
from support.cli import fluxobs

START = datetime(2024, 1, 1, tzinfo=UTC)


def table(**changes) -> pl.DataFrame:
    """Eight drives, a log a week; `changes` maps drive to (resistance, flux) over k."""
    rng, rows = np.random.default_rng(3), []
    for d in range(8):
        drive = f"unit{d}"
        for k in range(30):
            R, psi = changes.get(drive, lambda k: (1.0, 1.0))(k)
            when = START + timedelta(days=7 * k)
            row = dict.fromkeys(COLUMNS) | {
                "log": f"{drive}/{when:%Y-%m-%d}.csv",
                "drive": drive,
                "time": when,
                "resistance": 0.36 * R * (1 + 0.01 * rng.standard_normal()),
                "resistance_std": 0.0025,
                "psi_f": 0.0125 * psi + 5e-6 * rng.standard_normal(),
                "psi_f_std": 5e-6,
            }
            rows.append(row)
    rows.append(dict.fromkeys(COLUMNS) | {"log": "bad", "drive": "unit0", "failed": "no columns"})
    return pl.DataFrame(rows, schema=COLUMNS)


def test_a_quiet_fleet_has_no_remarks():
    found = follow(table())
    assert len(found) == 16
    assert [one.remarks for one in found] == [()] * 16


def test_a_steady_drift_crosses_the_limit_about_its_beginning():
    found = follow(table(unit1=lambda k: (1.0, 1 - 4e-3 * k)), [read_limit("psi_f=5%")])
    one = next(one for one in found if (one.drive, one.name) == ("unit1", "psi_f"))
    assert one.first == pytest.approx(0.0125, rel=0.01)
    assert one.limits == pytest.approx((0.95 * one.first, 1.05 * one.first))
    assert one.crossed
    assert "is beyond" in one.remarks[0]
    assert not any("meets its limit" in text for text in one.remarks)


def test_two_limits_of_one_parameter_are_refused():
    with pytest.raises(UsageError, match="a parameter has two"):
        follow(table(), [read_limit("psi_f=5%"), read_limit("psi_f=90%")])


def test_what_cannot_be_followed_is_left_out():
    rows = table().with_columns(
        psi_f=pl.when(pl.col("drive") == "unit3").then(float("nan")).otherwise(pl.col("psi_f")),
        time=pl.when(pl.col("drive") == "unit5").then(None).otherwise(pl.col("time")),
    )
    found = follow(rows)
    assert len(found) == 16 - 1 - 2
    assert all(np.isfinite(one.values).all() for one in found)
    fleet = Fleet(Path(), rows)
    assert "30 logs have no time and are left out" in headline(fleet, found)


def test_logs_within_seconds_are_drawn():
    rows = table().filter(pl.col("drive") == "unit0")
    close = rows.with_columns(
        time=pl.lit(START) + pl.duration(milliseconds=pl.int_range(len(rows)))
    )
    picture(follow(close), "unit0").savefig(io.BytesIO())


def test_heat_ageing_and_another_motor():
    found = {
        (one.drive, one.name): one
        for one in follow(
            table(
                unit2=lambda k: (1.12 if k >= 18 else 1.0, 1.0),
                unit4=lambda k: (1.0, 1 - 1e-3 * k),
                unit7=lambda k: (1.4, 1.0),
            ),
            [read_limit("psi_f=5%"), read_limit("resistance=0.3..0.45")],
        )
    }
    jump = found["unit2", "resistance"].remarks[0]
    assert "(+12." in jump or "(+11." in jump
    assert re.search(r"as copper \+(2[5-9]|3[0-5]) K would", jump)
    assert "2024-05-06" in jump
    trend = found["unit4", "psi_f"].remarks[0]
    assert re.match(r"magnet flux drifts by -65\d µWb ± \d", trend)
    assert "meets its limit in " in trend
    other = found["unit7", "resistance"]
    assert other.crossed
    assert "is beyond 300 mΩ to 450 mΩ" in other.remarks[0]
    assert "is unlike that of the others" in other.remarks[-1]
    assert not found["unit3", "resistance"].remarks


@pytest.mark.parametrize(
    ("text", "low", "high", "relative"),
    [
        ("resistance=0.3..0.5", 0.3, 0.5, False),
        ("psi_f=10%", -0.1, 0.1, True),
        ("psi_f=±10%", -0.1, 0.1, True),
        ("psi_f=-5..2%", -0.05, 0.02, True),
        ("offset_alpha=-1e-2..1e-2", -0.01, 0.01, False),
    ],
)
def test_limits(text, low, high, relative):
    limit = read_limit(text)
    assert (limit.low, limit.high, limit.relative) == (low, high, relative)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("R_s=1..2", "'R_s' is not followed"),
        ("psi_f=0.1", "give psi_f=LOW..HIGH"),
        ("psi_f=2..1", "must rise"),
        ("psi_f", "give psi_f=LOW..HIGH"),
    ],
)
def test_limits_that_are_none(text, words):
    with pytest.raises(UsageError, match=words):
        read_limit(text)


def test_the_command(tmp_path: Path):
    table(unit7=lambda k: (1.4, 1.0)).write_parquet(tmp_path / "summary.parquet")
    done = fluxobs("fleet", tmp_path, "--limit", "resistance=0.3..0.45", folder=tmp_path)
    assert done.returncode == 1
    assert "241 logs of 8 drives, 2024-01-01 to 2024-07-22; 1 could not be" in done.stdout
    assert "unit7: resistance" in done.stdout
    page = (tmp_path / "fleet.html").read_text()
    assert page.count("data:image/png") == 8
    assert "no columns" in page
    done = fluxobs("fleet", tmp_path, "--limit", "inverter_voltage=0..2", folder=tmp_path)
    assert done.returncode == 1
    assert "Limit on inverter's voltage loss: no log tells it." in done.stdout
    done = fluxobs("fleet", tmp_path, "--json", folder=tmp_path)
    assert done.returncode == 0
    assert len(json.loads(done.stdout)["followed"]) == 16
    assert fluxobs("fleet", tmp_path / "none", folder=tmp_path).returncode == 2
