"""Remarks on a fleet, and the command `fluxobs fleet`."""

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
    """Eight drives, one log per week; `changes` maps a drive to (resistance, flux) of week k."""
    rng, rows = np.random.default_rng(3), []
    for d in range(8):
        drive = f"unit{d}"
        for k in range(30):
            R, psi = changes.get(drive, lambda k: (1.0, 1.0))(k)
            time = START + timedelta(days=7 * k)
            row = dict.fromkeys(COLUMNS) | {
                "log": f"{drive}/{time:%Y-%m-%d}.csv",
                "drive": drive,
                "time": time,
                "resistance": 0.36 * R * (1 + 0.01 * rng.standard_normal()),
                "resistance_std": 0.0025,
                "psi_f": 0.0125 * psi + 5e-6 * rng.standard_normal(),
                "psi_f_std": 5e-6,
            }
            rows.append(row)
    rows.append(dict.fromkeys(COLUMNS) | {"log": "bad", "drive": "unit0", "failed": "no columns"})
    return pl.DataFrame(rows, schema=COLUMNS)


def test_a_quiet_fleet_has_no_remarks():
    followed = follow(table())
    assert len(followed) == 16
    assert [item.remarks for item in followed] == [()] * 16


def test_limits_are_relative_to_the_first_level_of_a_drift():
    followed = follow(table(unit1=lambda k: (1.0, 1 - 4e-3 * k)), [read_limit("psi_f=5%")])
    flux = next(item for item in followed if (item.drive, item.name) == ("unit1", "psi_f"))
    assert flux.first == pytest.approx(0.0125, rel=0.01)
    assert flux.limits == pytest.approx((0.95 * flux.first, 1.05 * flux.first))
    assert flux.crossed
    assert "is outside" in flux.remarks[0]
    assert not any("reach the limit" in text for text in flux.remarks)


def test_two_limits_of_one_parameter_are_refused():
    with pytest.raises(UsageError, match="a parameter has two"):
        follow(table(), [read_limit("psi_f=5%"), read_limit("psi_f=90%")])


def test_logs_without_value_or_time_are_ignored():
    rows = table().with_columns(
        psi_f=pl.when(pl.col("drive") == "unit3").then(float("nan")).otherwise(pl.col("psi_f")),
        time=pl.when(pl.col("drive") == "unit5").then(None).otherwise(pl.col("time")),
    )
    followed = follow(rows)
    assert len(followed) == 16 - 1 - 2
    assert all(np.isfinite(item.values).all() for item in followed)
    fleet = Fleet(Path(), rows)
    assert "30 logs have no time and are ignored" in headline(fleet, followed)


def test_logs_within_seconds_are_drawn():
    rows = table().filter(pl.col("drive") == "unit0")
    close = rows.with_columns(
        time=pl.lit(START) + pl.duration(milliseconds=pl.int_range(len(rows)))
    )
    picture(follow(close), "unit0").savefig(io.BytesIO())


def test_heat_ageing_and_another_motor():
    followed = {
        (item.drive, item.name): item
        for item in follow(
            table(
                unit2=lambda k: (1.12 if k >= 18 else 1.0, 1.0),
                unit4=lambda k: (1.0, 1 - 1e-3 * k),
                unit7=lambda k: (1.4, 1.0),
            ),
            [read_limit("psi_f=5%"), read_limit("resistance=0.3..0.45")],
        )
    }
    jump = followed["unit2", "resistance"].remarks[0]
    assert "(+12." in jump or "(+11." in jump
    assert re.search(r"like \+(2[5-9]|3[0-5]) K of copper", jump)
    assert "2024-05-06" in jump
    trend = followed["unit4", "psi_f"].remarks[0]
    assert re.match(r"magnet flux drifts by -65\d µWb ± \d", trend)
    assert "will reach the limit in " in trend
    other = followed["unit7", "resistance"]
    assert other.crossed
    assert "is outside 300 mΩ to 450 mΩ" in other.remarks[0]
    assert "differs from the other drives" in other.remarks[-1]
    assert not followed["unit3", "resistance"].remarks


@pytest.mark.parametrize(
    ("text", "lower", "upper", "relative"),
    [
        ("resistance=0.3..0.5", 0.3, 0.5, False),
        ("psi_f=10%", -0.1, 0.1, True),
        ("psi_f=±10%", -0.1, 0.1, True),
        ("psi_f=-5..2%", -0.05, 0.02, True),
        ("offset_alpha=-1e-2..1e-2", -0.01, 0.01, False),
    ],
)
def test_limits(text, lower, upper, relative):
    limit = read_limit(text)
    assert (limit.low, limit.high, limit.relative) == (lower, upper, relative)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("R_s=1..2", "'R_s' is not followed"),
        ("psi_f=0.1", "give psi_f=LOW..HIGH"),
        ("psi_f=2..1", "LOW must be below HIGH"),
        ("psi_f", "give psi_f=LOW..HIGH"),
    ],
)
def test_malformed_limits(text, message):
    with pytest.raises(UsageError, match=message):
        read_limit(text)


def test_the_command(tmp_path: Path):
    table(unit7=lambda k: (1.4, 1.0)).write_parquet(tmp_path / "summary.parquet")
    run = fluxobs("fleet", tmp_path, "--limit", "resistance=0.3..0.45", folder=tmp_path)
    assert run.returncode == 1
    assert "241 logs of 8 drives, 2024-01-01 to 2024-07-22; 1 could not be" in run.stdout
    assert "unit7: resistance" in run.stdout
    page = (tmp_path / "fleet.html").read_text()
    assert page.count("data:image/png") == 8
    assert "no columns" in page
    run = fluxobs("fleet", tmp_path, "--limit", "inverter_voltage=0..2", folder=tmp_path)
    assert run.returncode == 1
    assert "Limit on inverter's voltage loss: no log identifies this parameter." in run.stdout
    run = fluxobs("fleet", tmp_path, "--json", folder=tmp_path)
    assert run.returncode == 0
    assert len(json.loads(run.stdout)["followed"]) == 16
    assert fluxobs("fleet", tmp_path / "none", folder=tmp_path).returncode == 2
