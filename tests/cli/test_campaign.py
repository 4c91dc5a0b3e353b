"""`fluxobs campaign` makes a report from a specification, and repeats a scenario."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

from fluxobs.campaigns.columns import schema
from fluxobs.campaigns.dataset import create
from fluxobs.campaigns.specification import read_specification
from support.cli import fluxobs

SPECIFICATION = """
name = "trial"
machines = ["servo-400w"]
scenarios = 6
observers = ["plain", "adaptive"]

[course]
duration = 0.4
score_from = 0.1
speeds = [0.3, 1.0]
ramp = 0.1
stops = 0.0

[vary]
R = { normal = [1.0, 0.1] }
noise = 0.003

[good]
rms = 2.0

[[limits]]
good = 0.5
observer = "adaptive"
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a finished campaign with written rows instead of simulated ones."""
    folder = tmp_path_factory.mktemp("written")
    (folder / "trial.toml").write_text(SPECIFICATION)
    specification = read_specification(folder / "trial.toml")
    dataset = create(folder / "out", specification, 6)
    numbers = [number for number in range(6) for _ in specification.observers]
    names = ["plain", "adaptive"] * 6
    frame = pl.DataFrame({"number": numbers, "observer": names}).with_columns(
        machine=pl.lit("servo-400w"),
        R=1 + 0.1 * pl.col("number"),
        noise=0.003,
        rms=0.01 * (1 + pl.col("number")),
        worst=0.03,
        valid=0.9,
        first_valid=0.1,
        wrong=0.0,
    )
    columns = schema(specification)
    rest = [name for name in columns if name not in frame.columns]
    missing = [pl.lit(None if name == "failed" else 0.0).alias(name) for name in rest]
    rows = frame.with_columns(missing).select(pl.col(n).cast(k) for n, k in columns.items())
    for chunk in dataset.chunks():
        rows.write_parquet(dataset.folder / "rows" / chunk.file)
    return folder


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a campaign that met its limit."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "trial.toml").write_text(SPECIFICATION)
    run = fluxobs(
        *("campaign", folder / "trial.toml", "--out", folder / "out"),
        *("--workers", "1", "--scheduler", "pool"),
        folder=folder,
    )
    assert run.returncode == 0, run.stderr
    assert "6 scenarios of 0.4 s, 1 machine; every observer on the record" in run.stdout
    assert re.search(r"adaptive .*\d+\.\d % \(\d+\.\d to \d+\.\d %\)", run.stdout)
    assert "Limit met: adaptive on servo-400w" in run.stdout
    return folder


@pytest.mark.slow
def test_files_written(simulated):
    out = simulated / "out"
    rows = pl.read_parquet(out / "rows" / "*.parquet")
    assert len(rows) == 12
    assert rows["failed"].null_count() == 12
    page = (out / "report.html").read_text()
    assert "Campaign: trial" in page
    assert "Passed" in page
    assert page.count("data:image/png") == 1
    assert "at least 80 scenarios" in page
    for link in re.findall(r'href="([^"]+)"', page):
        assert (out / link).exists()
    assert len(list((out / "worst").glob("*.parquet"))) == 12
    times = (out / "times.csv").read_text().splitlines()
    assert sum(int(line.split(",")[1]) - int(line.split(",")[0]) for line in times) == 6


@pytest.mark.slow
def test_finished_scenarios_are_not_repeated(simulated):
    out = simulated / "out"
    before = {path: path.stat().st_mtime_ns for path in (out / "rows").iterdir()}
    run = fluxobs("campaign", out, folder=simulated)
    assert run.returncode == 0, run.stderr
    assert {path: path.stat().st_mtime_ns for path in (out / "rows").iterdir()} == before


def test_a_missed_limit_is_exit_code_1(done):
    from fluxobs.campaigns import open_dataset
    from fluxobs.cli.commands.campaign import MISSED, _show

    dataset = open_dataset(done / "out")
    stricter = [
        dataset.specification.limits[0].model_copy(update={"good": 1.0, "observer": "plain"})
    ]
    dataset.specification.limits[:] = stricter
    rows = dataset.rows().with_columns(rms=pl.lit(1.0))
    for path in (dataset.folder / "rows").iterdir():
        saved = path.read_bytes()
        rows.write_parquet(path)
        assert _show(dataset) == MISSED
        path.write_bytes(saved)


@pytest.mark.slow
def test_a_scenario_is_rerun(simulated, tmp_path):
    out = simulated / "out"
    run = fluxobs(
        *("campaign", out, "--rerun", "5", "--observer", "adaptive"),
        *("--report", tmp_path / "r.html", "--record", tmp_path / "r.parquet"),
        folder=tmp_path,
    )
    assert run.returncode == 0, run.stderr
    rows = pl.read_parquet(out / "rows" / "*.parquet")
    row = rows.filter((pl.col("number") == 5) & (pl.col("observer") == "adaptive"))
    assert re.search(rf"^rms +{row['rms'][0]:.6g}$", run.stdout, re.MULTILINE)
    assert "<html" in (tmp_path / "r.html").read_text()[:1000]
    estimated = fluxobs(
        *("estimate", tmp_path / "r.parquet", "--machine", "servo-400w"),
        *("--truth", "theta_e=theta_e"),
        folder=tmp_path,
    )
    assert estimated.returncode == 0, estimated.stderr
    assert "valid rows with a true value" in estimated.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["campaign", "{folder}/trial.toml"], "--out is missing"),
        (["campaign", "{folder}/trial.toml", "--rerun", "3"], "give the folder of the campaign"),
        (["campaign", "{folder}/out", "--rerun", "6"], "no scenario 6; give 0 to 5"),
        (["campaign", "{folder}/out", "--rerun", "2", "--observer", "ekf"], "plain, adaptive"),
        (
            ["campaign", "{folder}/out", "--rerun", "2", "--out", "x"],
            "--out cannot be combined with",
        ),
        (
            ["campaign", "{folder}/out", "--rerun", "2", "--budget", "99"],
            "--budget cannot be combined",
        ),
        (
            ["campaign", "{folder}/out", "--search", "worst", "--workers", "2"],
            "--workers cannot be",
        ),
        (
            ["campaign", "{folder}/out", "--search", "worst", "--force"],
            "--force cannot be combined",
        ),
        (["campaign", "{folder}/out", "--force"], "--force works only with --rerun"),
        (["campaign", "{folder}/out", "--report", "r.html"], "--report works only with --rerun"),
        (["campaign", "{folder}/out", "--machine", "x"], "--machine works only with --search"),
        (["campaign", "{folder}/out", "--search", "best"], "worst or failures"),
        (["campaign", "{folder}/out", "--search", "worst", "--machine", "x"], "no machine"),
        (["campaign", "{folder}/out", "--out", "x"], "is already the folder of the results"),
        (["campaign", "{folder}"], "holds no campaign"),
        (["campaign", "{folder}/trial.toml", "--out", "o\udce9"], "not UTF-8"),
        (["campaign", "{folder}/other.toml", "--out", "{folder}/out"], "its name, seed differ"),
        (["campaign", "{folder}/other.toml", "--out", "{folder}"], "is not empty"),
        (
            ["campaign", "{folder}/ekf.toml", "--out", "{folder}/n"],
            "ekf.toml: observers: servo-400w has no 'ekf'",
        ),
    ],
)
def test_unusable_options_are_named(done, arguments, message):
    (done / "other.toml").write_text(SPECIFICATION.replace('name = "trial"', "seed = 5"))
    (done / "ekf.toml").write_text(SPECIFICATION.replace('"adaptive"', '"ekf"'))
    run = fluxobs(*(argument.format(folder=done) for argument in arguments), folder=done)
    assert run.returncode == 2
    assert message in run.stderr


@pytest.fixture
def copy(done, tmp_path) -> Path:
    """Return a copy of the finished campaign, which a test may damage."""
    shutil.copytree(done / "out", tmp_path / "out")
    return tmp_path / "out"


@pytest.mark.slow
def test_a_damaged_file_is_named_with_the_remedy(simulated, tmp_path):
    copy = tmp_path / "out"
    shutil.copytree(simulated / "out", copy)
    rows = sorted((copy / "rows").iterdir())[0]
    intact = rows.read_bytes()
    for damaged in (b"", intact[:-7], intact[:100] + bytes(100) + intact[200:]):
        rows.write_bytes(damaged)
        run = fluxobs("campaign", copy, folder=tmp_path)
        assert run.returncode == 2
        assert f"delete it; `fluxobs campaign {copy}`" in run.stderr
    pl.DataFrame({"x": [1]}).write_parquet(rows)
    assert (
        "its columns differ from the campaign's"
        in fluxobs("campaign", copy, folder=tmp_path).stderr
    )
    for damaged in ("{", "[]", "{}", '{"fluxobs": "1", "chunk": 0}'):
        (copy / "campaign.json").write_text(damaged)
        run = fluxobs("campaign", copy, folder=tmp_path)
        assert run.returncode == 2
        assert re.search(r"campaign\.json: (cannot be read|is damaged)", run.stderr)


@pytest.mark.slow
def test_rows_that_were_deleted_are_computed_again(simulated, tmp_path):
    copy = tmp_path / "out"
    shutil.copytree(simulated / "out", copy)
    rows = sorted((copy / "rows").iterdir())[0]
    intact = rows.read_bytes()
    rows.unlink()
    (copy / "rows" / "mine.parquet").write_bytes(b"")
    assert fluxobs("campaign", copy, folder=tmp_path).returncode == 0
    assert rows.read_bytes() == intact


def test_a_campaign_that_cannot_be_repeated_can_be_read(copy, tmp_path):
    path = copy / "campaign.json"
    facts = json.loads(path.read_text())
    facts["machines"] = {"servo-400w": "0123456789abcdef"}  # hash of an older machine file
    path.write_text(json.dumps(facts))
    run = fluxobs("campaign", copy, folder=tmp_path)
    assert run.returncode == 0
    assert "Warning: the campaign's rows cannot be repeated: servo-400w changed." in run.stderr
    run = fluxobs("campaign", copy, "--rerun", "3", folder=tmp_path)
    assert run.returncode == 2
    assert "cannot be repeated: servo-400w changed" in run.stderr
    sorted((copy / "rows").iterdir())[0].unlink()
    run = fluxobs("campaign", copy, folder=tmp_path)
    assert run.returncode == 2
    assert "holds another campaign (servo-400w changed)" in run.stderr


def test_only_observers_of_estimate_have_a_report(copy, tmp_path):
    text = (copy / "campaign.json").read_text()
    (copy / "campaign.json").write_text(text.replace('"kind": "plain"', '"kind": "ekf"'))
    run = fluxobs("campaign", copy, "--rerun", "3", "--report", "r.html", folder=tmp_path)
    assert run.returncode == 2
    assert "plain, adaptive, whole-log, or give --record" in run.stderr


def test_no_scenario_could_be_simulated(tmp_path):
    course = "[course]\nload = [[0.0, 50.0]]"
    (tmp_path / "s.toml").write_text(SPECIFICATION.partition("[[")[0].replace("[course]", course))
    run = fluxobs(
        *("campaign", "s.toml", "--out", "out", "--workers", "1", "--scheduler", "pool"),
        folder=tmp_path,
    )
    assert "No scenario could be simulated." in run.stdout, run.stderr
    assert run.returncode == 1


@pytest.mark.slow
def test_ctrl_c_keeps_finished_scenarios(tmp_path):
    (tmp_path / "s.toml").write_text(SPECIFICATION.replace("scenarios = 6", "scenarios = 24000"))
    command = [sys.executable, "-m", "fluxobs", "campaign", tmp_path / "s.toml"]
    running = subprocess.Popen(
        [*command, "--out", tmp_path / "o", "--scheduler", "pool", "--workers", "1"],
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while not list(tmp_path.glob("o/rows/*.parquet")) and time.monotonic() < deadline:
        time.sleep(0.1)
    running.send_signal(signal.SIGINT)
    interrupted = time.monotonic()
    _, stderr = running.communicate(timeout=30)
    assert running.returncode == 130
    assert "run the same command to resume" in stderr
    assert time.monotonic() - interrupted < 5
    assert list(tmp_path.glob("o/rows/*.parquet"))
