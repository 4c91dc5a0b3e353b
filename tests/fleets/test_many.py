"""Each of many logs gets a file and a row, once; a bad log does not stop the other logs."""

from __future__ import annotations

import functools
import http.server
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime
from pathlib import Path

import polars as pl
import pytest

import fluxobs
from fluxobs.errors import FluxobsError, UsageError
from fluxobs.fleets import estimate_many, log_task, open_fleet
from fluxobs.fleets.log_task import COLUMNS, LogTask, Settings
from fluxobs.fleets.sources import Source, sources
from fluxobs.machines.files import example_text
from fluxobs.simulation.closed_form.demo import LOG
from support.cli import fluxobs as command

HALF = 2000


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """Create two drives with one log each, and files that are not logs."""
    folder = tmp_path / "logs"
    lines = LOG.read_text().splitlines(keepends=True)
    for name in ("a/run_2024-05-01.csv", "b/run_2024-06-02_1330.csv"):
        path = folder / name
        path.parent.mkdir(parents=True)
        path.write_text("".join(lines[: HALF + 1]))
    (folder / "b" / "bad.csv").write_text("x,y\n1,2\n3,4\n")
    (folder / "b" / "notes.md").write_text("no log")
    return folder


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Estimate in this process: a pool imports the library again for each run."""

    def compute(tasks, work, *arguments):
        return ((task, work(task)) for task in tasks)

    monkeypatch.setattr("fluxobs.fleets.batch.compute", compute)


def run(logs: Path, out: Path, machine: str = "servo-400w", **options) -> pl.DataFrame:
    return estimate_many([logs], machine, out, workers=1, scheduler="pool", **options).table


def stamps(out: Path) -> dict[str, int]:
    return {
        path.relative_to(out).as_posix(): path.stat().st_mtime_ns
        for path in (out / "estimates").rglob("*.parquet")
    }


def test_each_log_gets_the_same_results_as_alone(logs, tmp_path):
    table = run(logs, tmp_path / "out")
    assert table["log"].to_list() == ["a/run_2024-05-01.csv", "b/bad.csv", table["log"][2]]
    assert table["drive"].to_list() == ["a", "b", "b"]
    assert table["time"][0] == datetime(2024, 5, 1, tzinfo=UTC)
    assert table["time"][2] == datetime(2024, 6, 2, 13, 30, tzinfo=UTC)
    alone = fluxobs.estimate(logs / "a" / "run_2024-05-01.csv", "servo-400w")
    estimates = tmp_path / "out" / "estimates" / "a" / "run_2024-05-01.csv.parquet"
    assert pl.read_parquet(estimates).equals(alone.estimates)
    row = table.row(0, named=True)
    assert row["rows"] == HALF
    assert row["error_rms"] == alone.facts["error"]["rms"]
    assert row["resistance"] == alone.facts["parameters"]["resistance"]["value"]
    assert row["failed"] is None
    assert "currents and voltages are not found" in table["failed"][1]
    saved = pl.read_parquet(tmp_path / "out" / "summary.parquet")
    assert saved.equals(table)
    assert open_fleet(tmp_path / "out").table.equals(table)
    assert (tmp_path / "out" / "summary.csv").read_text().count("\n") >= 4


@pytest.mark.usefixtures("in_process")
def test_logs_are_estimated_again_only_after_changes(logs, tmp_path):
    out, machine = tmp_path / "out", tmp_path / "motor.toml"
    machine.write_text(example_text("servo-400w"))
    options = {"machine": str(machine)}
    table = run(logs, out, **options)
    first = stamps(out)
    assert run(logs, out, **options).equals(table)
    assert stamps(out) == first
    (logs / "a" / "run_2024-05-01.csv").touch()  # new time, same content
    assert run(logs, out, **options).equals(table)
    assert stamps(out) == first
    log = logs / "a" / "run_2024-05-01.csv"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:1501]))
    assert run(logs, out, **options)["rows"].to_list() == [1500, None, HALF]
    second = stamps(out)
    assert [name for name in first if first[name] != second[name]] == [
        "estimates/a/run_2024-05-01.csv.parquet"
    ]
    run(logs, out, **options, memory=0.05)  # other settings
    third = stamps(out)
    assert not set(third.values()) & set(second.values())
    machine.write_text(example_text("servo-400w").replace("R_s = 0.3", "R_s = 0.31"))
    run(logs, out, **options, memory=0.05)
    assert not set(stamps(out).values()) & set(third.values())


@pytest.mark.slow
@pytest.mark.usefixtures("in_process")
def test_failed_logs_are_retried_on_request(logs, tmp_path, monkeypatch):
    out = tmp_path / "out"
    run(logs, out)
    note = out / "logs" / "b" / "bad.csv.json"
    before = note.stat().st_mtime_ns
    run(logs, out)
    assert note.stat().st_mtime_ns == before
    run(logs, out, retry="failed")
    assert note.stat().st_mtime_ns > before
    before = note.stat().st_mtime_ns
    run(logs, out, memory=0.05)  # other settings may succeed
    assert note.stat().st_mtime_ns > before
    shutil.copy(logs / "a" / "run_2024-05-01.csv", logs / "b" / "bad.csv")  # repaired
    assert run(logs, out)["failed"].null_count() == 3
    estimates = out / "estimates" / "b" / "bad.csv.parquet"
    assert estimates.exists()
    (logs / "b" / "bad.csv").write_text("x,y\n1,2\n")  # broken again
    assert run(logs, out)["failed"].null_count() == 2
    assert not estimates.exists()


@pytest.mark.slow
@pytest.mark.usefixtures("in_process")
def test_a_corrected_machine_file_is_tried_again(logs, tmp_path):
    out = tmp_path / "out"
    for drive in ("a", "b"):
        (tmp_path / f"{drive}.toml").write_text(example_text("servo-400w"))
    (tmp_path / "b.toml").write_text("kind = 3")
    good = [logs / "a" / "run_2024-05-01.csv", logs / "b" / "run_2024-06-02_1330.csv"]
    options = {"workers": 1, "scheduler": "pool"}
    machine = tmp_path / "{drive}.toml"
    assert estimate_many(good, machine, out, **options).failed["drive"].to_list() == ["b"]
    (tmp_path / "b.toml").write_text(example_text("servo-400w"))
    assert not len(estimate_many(good, machine, out, **options).failed)


@pytest.mark.usefixtures("in_process")
def test_logs_of_earlier_runs_stay_in_the_table(logs, tmp_path):
    out = tmp_path / "out"
    run(logs, out)
    table = estimate_many(
        [logs / "a" / "*.csv"], "servo-400w", out, workers=1, scheduler="pool"
    ).table
    assert len(table) == 3
    assert table["drive"].to_list() == ["a", "b", "b"]


def log_task_for(tmp_path: Path) -> LogTask:
    return LogTask(str(tmp_path / "out"), Settings("servo-400w", "{}"))


def test_a_log_that_changes_while_it_is_read_is_a_failed_row(logs, tmp_path, monkeypatch):
    log = logs / "a" / "run_2024-05-01.csv"
    estimate = log_task.estimate

    def slow(path: Path, *arguments, **options):
        result = estimate(path, *arguments, **options)
        with log.open("a") as file:
            file.write("0,0,0,0,0,0\n")
        return result

    monkeypatch.setattr(log_task, "estimate", slow)
    row = log_task_for(tmp_path)(Source(str(log), "a/run.csv", "a"))
    assert "changed while it was read" in row["failed"]
    assert not (tmp_path / "out" / "estimates" / "a" / "run.csv.parquet").exists()


def test_an_unexpected_error_is_a_failed_row(logs, tmp_path, monkeypatch):
    def broken(*arguments, **options):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(log_task, "estimate", broken)
    row = log_task_for(tmp_path)(Source(str(logs / "a" / "run_2024-05-01.csv"), "a/run.csv", "a"))
    assert row["failed"].endswith("ZeroDivisionError: division by zero")


def test_a_missing_log_is_a_failed_row(tmp_path):
    (tmp_path / "out").mkdir()
    row = log_task_for(tmp_path)(Source(str(tmp_path / "gone.csv"), "gone.csv", ""))
    assert row["failed"].endswith("gone.csv: no such file")
    assert set(row) == set(COLUMNS)


def test_a_name_that_is_too_long_is_a_failed_row(logs, tmp_path, in_process):
    good, long = logs / "a" / "run_2024-05-01.csv", 300 * "a" + ".csv"
    table = estimate_many([good, long], "servo-400w", tmp_path / "out").table
    failed = dict(zip(table["log"].str.tail(8), table["failed"], strict=True))
    assert failed.pop("aaaa.csv").endswith("aaaa.csv: file name too long")
    assert list(failed.values()) == [None]


def test_a_full_disk_is_a_failed_row(logs, tmp_path):
    program = (
        "import resource, signal, sys, json\n"
        "from fluxobs.fleets.log_task import LogTask, Settings\n"
        "from fluxobs.fleets.sources import Source\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (30000, 30000))\n"
        "task = LogTask(sys.argv[1], Settings('servo-400w', '{}'))\n"
        "row = task(Source(sys.argv[2], 'a.csv', ''))\n"
        "print(json.dumps(row['failed']))\n"
    )
    (tmp_path / "out").mkdir()
    process = subprocess.run(
        [sys.executable, "-c", program, tmp_path / "out", logs / "a" / "run_2024-05-01.csv"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "cannot be written" in json.loads(process.stdout)
    assert not list((tmp_path / "out" / "estimates").rglob("*.parquet"))


def test_drive_and_time_from_the_name(logs):
    log_sources = sources([logs], r"logs/(\w)/")
    assert [log.drive for log in log_sources] == ["a", "b", "b"]
    for name, expected in (
        ("20240517_143005.csv", datetime(2024, 5, 17, 14, 30, 5, tzinfo=UTC)),
        ("unit7/2023/x-2024-12-31.mf4", datetime(2024, 12, 31, tzinfo=UTC)),
        ("2024-01-02T03-04-05.csv", datetime(2024, 1, 2, 3, 4, 5, tzinfo=UTC)),
    ):
        assert Source("x", name, "").time() == expected
    assert Source("gone", "serial-123456789.csv", "").time() is None


def test_a_name_stays_in_the_folder_of_the_results(logs, tmp_path, monkeypatch):
    below = tmp_path / "x" / "y"
    below.mkdir(parents=True)
    (below / "c.csv").write_bytes(LOG.read_bytes())
    monkeypatch.chdir(below)
    direct = sources([logs])
    assert sources(["../../logs"]) == direct
    logs_of_both = sources(["../../logs", below])
    assert not any(".." in log.name for log in logs_of_both)
    later = sources([below], root=f"{logs.as_posix()}/")  # not in the first run's folder
    assert later[0].name == f"@{below.as_posix()}/c.csv"
    assert later[0].drive == "y"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="file names are text there")
def test_names_with_invalid_text_or_control_characters(logs, tmp_path):
    out = tmp_path / "out"
    good, bad = logs / "a" / "run_2024-05-01.csv", logs / "b" / "bad.csv"
    drive = logs / os.fsdecode(b"dr\xe9\x1b[31m")
    drive.mkdir()
    shutil.copy(good, drive / os.fsdecode(b"caf\xe9.csv"))
    shutil.copy(bad, drive / os.fsdecode(b"\x9b\xff.csv"))
    shutil.copy(good, drive / "e\x1b]0;title\x07.csv")
    for _ in range(2):  # estimated, then read from the notes
        table = run(logs, out)
        rows = {row["log"]: row for row in table.iter_rows(named=True)}
        printed = r"dr\xe9\x1b[31m"
        assert len(rows) == 6
        assert rows["a/run_2024-05-01.csv"]["rows"] == HALF
        assert rows[rf"{printed}/caf\xe9.csv"]["rows"] == HALF
        assert rows[rf"{printed}/e\x1b]0;title\x07.csv"]["rows"] == HALF
        failed = rows[rf"{printed}/\x9b\xff.csv"]["failed"]
        assert rf"{printed}/\x9b\xff.csv: currents and voltages are not found" in failed
        assert rows[rf"{printed}/caf\xe9.csv"]["drive"] == printed
    assert b"\x1b" not in (out / "summary.csv").read_bytes()
    out = out.rename(tmp_path / "o\udce9 [1]")
    process = command("fleet", out, folder=tmp_path)
    assert process.returncode == 0
    page = (out / "fleet.html").read_text()
    assert printed in page
    assert "\x1b" not in page


def test_other_files_beside_logs_are_ignored(logs):
    for name in ("README.txt", "license.txt", "a/notes.json", ".hidden.csv"):
        (logs / name).write_text("words")
    (logs / "a" / "link.csv").symlink_to(logs / "gone.csv")
    os.mkfifo(logs / "a" / "pipe.csv")
    names = [log.name for log in sources([logs])]
    assert names == ["a/link.csv", "a/run_2024-05-01.csv", "b/bad.csv", "b/run_2024-06-02_1330.csv"]


def test_wrong_arguments(logs, tmp_path):
    with pytest.raises(FluxobsError, match="no file matches this pattern"):
        sources([logs / "c*.csv"])
    (logs / "empty").mkdir()
    with pytest.raises(FluxobsError, match="no logs there"):
        sources([logs / "empty"])
    with pytest.raises(UsageError, match="not a regular expression"):
        sources([logs], "(")
    with pytest.raises(UsageError, match="does not match this path"):
        sources([logs], "unit")
    with pytest.raises(FluxobsError, match="is not empty and holds no such results"):
        run(logs, logs)
    with pytest.raises(FluxobsError, match="holds no summary"):
        open_fleet(tmp_path)
    with pytest.raises(FluxobsError, match="no such machine file"):
        run(logs, tmp_path / "out", machine="servo-401w")
    with pytest.raises(FluxobsError, match="nosuch"):
        sources(["nosuch://bucket/x.csv"])


@pytest.mark.usefixtures("in_process")
def test_machines_by_drive(logs, tmp_path):
    for drive in ("a", "b"):
        shutil.copy(logs / "a" / "run_2024-05-01.csv", logs / "b" / "bad.csv")
        (tmp_path / f"motor-{drive}.toml").write_text(example_text("servo-400w"))
    (tmp_path / "motor-b.toml").unlink()
    table = run(logs, tmp_path / "out", machine=str(tmp_path / "motor-{drive}.toml"))
    assert table["failed"][0] is None
    assert "motor-b.toml: no such machine file" in table["failed"][1]


@pytest.mark.usefixtures("in_process")
def test_logs_of_a_web_server(logs, tmp_path):
    pytest.importorskip("aiohttp")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(logs))
    handler.log_message = lambda *arguments: None  # type: ignore[attr-defined]
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_address[1]}"
        table = estimate_many(
            [f"{address}/a/run_2024-05-01.csv", f"{address}/a/gone.csv"],
            *("servo-400w", tmp_path / "out"),
            workers=1,
            scheduler="pool",
        ).table
        server.shutdown()
    by_name = {row["log"]: row for row in table.iter_rows(named=True)}
    assert by_name["run_2024-05-01.csv"]["rows"] == HALF
    assert "cannot be fetched" in by_name["gone.csv"]["failed"]


def test_the_command(logs, tmp_path):
    pool = ("--scheduler", "pool", "--workers", "1")
    process = command(
        *("estimate", "logs", "--machine", "servo-400w", "--out", "o", *pool), folder=tmp_path
    )
    assert process.returncode == 1
    assert "2 of 3 logs estimated" in process.stdout
    assert "Failed: " in process.stderr
    process = command(
        *("estimate", "logs/a/*.csv", "--machine", "servo-400w", "--out", "o", *pool, "--json"),
        folder=tmp_path,
    )
    assert json.loads(process.stdout)["logs"] == 3
    for arguments, message in (
        (["logs"], "--out is missing"),
        (["logs", "--out", "x.parquet"], "for many logs, give a folder"),
        (["logs", "--out", "p", "--report", "r.html"], "--report works only with one log"),
        (["logs/a/run_2024-05-01.csv", "--retry", "failed"], "--retry works only with many logs"),
        (["logs", "--out", "p", "--retry", "some"], "none, failed or all"),
        (["logs/a/run [1].csv"], "run [1].csv: no such file, and "),
        (["logs/a/run [1].csv", "--out", "p"], "run [1].csv: no such file"),
        (["logs/a/gone.csv", "logs/a/run [1].csv", "--out", "p"], "run [1].csv: no such file"),
    ):
        process = command("estimate", *arguments, "--machine", "servo-400w", folder=tmp_path)
        assert process.returncode == 2
        assert message in process.stderr


def test_finished_logs_take_no_time(logs, tmp_path):
    run(logs, tmp_path / "out")
    started = time.perf_counter()
    run(logs, tmp_path / "out")
    assert time.perf_counter() - started < 1.0  # no process is started
