"""`fluxobs live` in the terminal and its error messages; tests/page tests its page."""

import re
import signal
import subprocess
import sys
import time

import pytest

from fluxobs.simulation.closed_form.demo import LOG
from support.cli import fluxobs

LIVE = [sys.executable, "-m", "fluxobs", "live"]


def test_a_pipe_in_the_terminal_and_its_recording(tmp_path):
    saved = tmp_path / "run.csv"
    done = subprocess.run(
        [*LIVE, "-", "--machine", "servo-400w", "--text", "--save", saved],
        input=LOG.read_bytes(),
        capture_output=True,
        timeout=120,
    )
    out = done.stdout.decode()
    assert done.returncode == 0, done.stderr.decode()
    assert "5000 rows a second" in out
    last = next(line for line in reversed(out.splitlines()) if line.startswith("t "))
    assert re.search(r"resistance 0\.3[56]\d* Ω", last)
    assert saved.read_bytes() == LOG.read_bytes()
    assert f"fluxobs estimate {saved} --machine servo-400w" in out


def test_ctrl_c_ends_the_demo(tmp_path):
    saved = tmp_path / "demo.csv"
    running = subprocess.Popen(
        [*LIVE, "--demo", "--text", "--save", saved], stdout=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while not saved.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.5)
    running.send_signal(signal.SIGINT)
    out, _ = running.communicate(timeout=30)
    assert running.returncode == 0
    assert "Written" in out
    assert saved.read_text().endswith("\n")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--demo or a SOURCE"),
        (["x.csv", "--demo"], "--demo or a SOURCE"),
        (["x.csv"], "--machine is missing"),
        (["x.csv", "--machine", "servo-400w"], "no such file or port"),
        (["--demo", "--save", "log.txt"], ".csv"),
        (["--demo", "--save", "there.csv"], "exists"),
        (["--demo", "--text", "--unknowns", "sped"], "sped"),
    ],
)
def test_errors_name_a_remedy(tmp_path, arguments, message):
    (tmp_path / "there.csv").write_text("mine")
    done = fluxobs("live", *arguments, folder=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert (tmp_path / "there.csv").read_text() == "mine"


def test_the_log_cannot_be_its_own_recording(tmp_path):
    log = tmp_path / "log.csv"
    log.write_bytes(LOG.read_bytes())
    arguments = ["log.csv", "--machine", "servo-400w", "--save", "log.csv", "--force"]
    done = fluxobs("live", *arguments, folder=tmp_path)
    assert done.returncode == 2
    assert "one of the inputs" in done.stderr
    assert log.read_bytes() == LOG.read_bytes()


def test_a_second_run_does_not_overwrite_a_recording(tmp_path):
    command = [*LIVE, "-", "--machine", "servo-400w", "--text", "--save", tmp_path / "run.csv"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    lines = LOG.read_bytes().splitlines(keepends=True)
    with subprocess.Popen(command, **pipes) as first:
        first.stdin.write(b"".join(lines[:3000]))
        first.stdin.flush()
        deadline = time.monotonic() + 60
        while not (tmp_path / "run.csv").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        for options in ([], ["--force"]):
            done = fluxobs(*command[3:], *options, folder=tmp_path)
            assert done.returncode == 2
            assert "Written" not in done.stdout
        out, err = first.communicate(b"".join(lines[3000:]), timeout=120)
    assert first.returncode == 0, err
    assert b"Written" in out
    assert (tmp_path / "run.csv").read_bytes() == LOG.read_bytes()


@pytest.mark.parametrize("signal_number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_loses_no_received_data(tmp_path, signal_number):
    rows = LOG.read_bytes().split(b"\n", 1)[1][
        :4000
    ]  # small enough that live reads them as one chunk
    command = [*LIVE, "-", "--machine", "servo-400w", "--text", "--save", tmp_path / "run.csv"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as running:
        running.stdin.write(rows)
        running.stdin.flush()
        while b"waiting" not in running.stdout.readline():
            pass
        running.send_signal(signal_number)
        running.stdin.close()
        running.wait(timeout=60)
    assert [path.name for path in tmp_path.iterdir()] == ["run.raw"]
    assert (tmp_path / "run.raw").read_bytes() == rows


def test_without_column_names_the_option_is_named(tmp_path):
    rows = LOG.read_bytes().split(b"\n", 1)[1]
    done = subprocess.run(
        [*LIVE, "-", "--machine", "servo-400w", "--text"], input=rows, capture_output=True
    )
    assert done.returncode == 2
    assert b"--header" in done.stderr


def test_data_without_rows_are_saved_unchanged(tmp_path):
    rows = LOG.read_bytes().split(b"\n", 1)[1]
    done = subprocess.run(
        [*LIVE, "-", "--machine", "servo-400w", "--text", "--save", tmp_path / "run.csv"],
        input=rows,
        capture_output=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert "run.raw, unchanged" in done.stdout.decode()
    assert (tmp_path / "run.raw").read_bytes() == rows
    assert not (tmp_path / "run.csv").exists()
