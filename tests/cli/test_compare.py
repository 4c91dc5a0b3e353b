"""`fluxobs compare` by exit code, output and files."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from fluxobs.comparison.catalogue import CATALOGUE
from fluxobs.machines import example
from support.cli import fluxobs
from support.records import steady


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("compare")
    rows = 12000  # like the scenario below: JAX compiles once
    data = steady(example("pmsm-2kw2"), 1.25e-4, 300.0, rows, 4j, 0.2, 2.0, noise=0.02, theta0=0.0)
    columns = {
        "t": np.arange(rows) * 1.25e-4,
        # Each row holds the voltage that acts from this row to the next row.
        "u_alpha": np.append(data.voltage[1:, 0], 0.0),
        "u_beta": np.append(data.voltage[1:, 1], 0.0),
        "i_alpha": data.current[:, 0],
        "i_beta": data.current[:, 1],
        "theta": data.theta,
    }
    pl.DataFrame(columns).write_csv(path / "log.csv")
    (path / "record.toml").write_text("frame = 'alphabeta'\n")
    return path


def test_list_needs_no_other_argument(folder):
    done = fluxobs("compare", "list", folder=folder)
    assert done.returncode == 0
    assert "low-speed-1 " in done.stdout
    assert "dead time" in done.stdout


@pytest.mark.slow
def test_a_log_and_a_scenario(folder):
    done = fluxobs(
        "compare",
        "log.csv",
        "unknown-start",
        "--machine",
        "pmsm-2kw2",
        "--truth",
        "theta_e=theta",
        "--lag",
        "0",
        "--out",
        "out",
        folder=folder,
    )
    assert done.returncode == 0, done.stderr
    assert "The least squares, which learns no parameter, has" in " ".join(done.stdout.split())
    assert "of the scored rows are valid" in done.stdout
    own = pl.read_csv(folder / "out" / "scores.csv").filter(
        (pl.col("record") == "log.csv") & pl.col("observer").is_in(["whole log", "adaptive"])
    )
    assert own["valid_share"].min() > 0.9
    assert own["valid_rms_deg"].max() < 0.5
    for entry in CATALOGUE:
        assert entry.name in done.stdout
    scores = pl.read_csv(folder / "out" / "scores.csv")
    assert set(scores["record"]) == {"log.csv", "unknown-start"}
    least_squares = scores.filter(
        (pl.col("record") == "log.csv")
        & (pl.col("observer") == "least squares")
        & (pl.col("gains") == "recommended")
    )
    assert 0.05 < least_squares["rms_deg"][0] < 0.15
    for name in ("log.png", "unknown-start.png", "summary.png"):
        assert (folder / "out" / name).stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["calm"], "'calm' is neither a file nor a scenario"),
        (["log.csv"], "a log (log.csv) needs a machine: give --machine"),
        (
            ["log.csv", "--machine", "pmsm-2kw2", "--truth", "none"],
            "the log has no true angle to score observers",
        ),
        (
            ["log.csv", "--machine", "pmsm-2kw2", "--record", "record.toml", "--truth", "none"],
            "the log has no true angle to score observers",
        ),
        (["ideal", "--machine", "maglev-knospe"], "no drive is defined for 'maglev-knospe'"),
        (
            ["log.csv", "--machine", "pmsm-2kw2", "--truth", "theta_e=theta", "--settle", "9"],
            "--settle 9 s must be shorter",
        ),
        (["ideal", "--out", "log.csv"], "cannot be created"),
    ],
)
def test_unusable_input_ends_with_2(folder, arguments, message):
    done = fluxobs("compare", *arguments, folder=folder)
    assert done.returncode == 2, done.stdout
    assert message in " ".join(done.stderr.split())
