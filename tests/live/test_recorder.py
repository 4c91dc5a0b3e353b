"""A recording locks its file from the start, and keeps the contents of an existing file."""

import os
import subprocess
import sys

import pytest

from fluxobs.errors import FluxobsError
from fluxobs.live.recorder import Recorder, save_raw


def record(path, lines=b"a\n1\n", **options):
    with Recorder(path, **options) as recorder:
        recorder.add(lines)


def test_lines_are_in_the_file_before_it_is_closed(tmp_path):
    path = tmp_path / "run.csv"
    with Recorder(path) as recorder:
        recorder.add(b"a\n1\n")
        assert path.read_bytes() == b"a\n1\n"
        recorder.add(b"2\n")
        assert path.read_bytes() == b"a\n1\n2\n"


@pytest.mark.parametrize("force", [False, True])
def test_two_recordings_do_not_share_a_file(tmp_path, force):
    path = tmp_path / "run.csv"
    with Recorder(path, force=force) as first:
        first.add(b"first\n")
        message = (
            "another run records into this file" if force else "exists; give another name, or force"
        )
        with pytest.raises(FluxobsError, match=f"run.csv: {message}"):
            record(path, force=force)
        first.add(b"more\n")
    assert path.read_bytes() == b"first\nmore\n"


def test_the_file_exists_from_the_start(tmp_path):
    path = tmp_path / "run.csv"
    with Recorder(path) as recorder:
        with pytest.raises(FileExistsError):
            path.open("x")
        recorder.add(b"a\n")
    with pytest.raises(FluxobsError, match="exists"):
        record(path)
    record(path, b"b\n", force=True)
    assert path.read_bytes() == b"b\n"


def test_without_lines_no_file_is_created_or_changed(tmp_path):
    with Recorder(tmp_path / "new.csv"):
        pass
    (tmp_path / "old.csv").write_bytes(b"mine")
    with Recorder(tmp_path / "old.csv", force=True):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["old.csv"]
    assert (tmp_path / "old.csv").read_bytes() == b"mine"


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("target_exists", [False, True])
def test_links_are_not_followed(tmp_path, force, target_exists):
    victim, path = tmp_path / "victim", tmp_path / "run.csv"
    if target_exists:
        victim.write_text("mine")
    path.symlink_to(victim)
    with pytest.raises(FluxobsError, match="is a link" if force else "exists"):
        record(path, force=force)
    assert victim.exists() == target_exists
    assert not target_exists or victim.read_text() == "mine"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_refused(tmp_path):
    """Opening the pipe would wait for a reader."""
    os.mkfifo(tmp_path / "run.csv")
    with pytest.raises(FluxobsError, match="is not a regular file"):
        record(tmp_path / "run.csv", force=True)


def test_raw_bytes_go_to_the_next_free_name(tmp_path):
    (tmp_path / "run.raw").symlink_to("nowhere")
    (tmp_path / "run-2.raw").write_bytes(b"mine")
    assert save_raw(tmp_path / "run.csv", b"x") == tmp_path / "run-3.raw"
    assert (tmp_path / "run-3.raw").read_bytes() == b"x"
    assert (tmp_path / "run-2.raw").read_bytes() == b"mine"
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on file sizes")
def test_a_full_disk_keeps_what_fits(tmp_path):
    program = (
        "import resource, signal, sys\n"
        "from pathlib import Path\n"
        "from fluxobs.live.recorder import Recorder\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (25, 25))\n"
        "with Recorder(Path(sys.argv[1])) as recorder:\n"
        "    recorder.add(b'0123456789' * 2)\n"
        "    recorder.add(b'0123456789')\n"
    )
    path = tmp_path / "run.csv"
    command = [sys.executable, "-c", program, path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "run.csv: cannot be written: File too large" in done.stderr
    assert path.read_bytes() == b"0123456789012345678901234"
