"""Output files appear complete or not at all, even if runs are killed or collide."""

import os
import subprocess
import sys

import polars as pl
import pytest

from fluxobs import FluxobsError
from fluxobs.core.output import check_new, replacing, write_rows, write_text

FRAME = pl.DataFrame({"x": [1]})
SCHEMA = {"x": pl.Int64}

#: Program that writes forty frames, then dies before the last.
KILLED = """
import os, sys
from pathlib import Path
import polars as pl
from fluxobs.core.output import write_rows

def frames():
    for k in range(40):
        yield pl.DataFrame({"x": [1.0] * 10_000})
    os._exit(9)  # no cleanup, as after a kill
    yield pl.DataFrame({"x": [1.0]})

write_rows(Path(sys.argv[1]), {"x": pl.Float64}, frames())
"""


@pytest.mark.parametrize("name", ["out.parquet", "out [1].csv"])
def test_the_next_run_removes_the_temporary_file_of_a_killed_one(tmp_path, name):
    out = tmp_path / name
    process = subprocess.run([sys.executable, "-c", KILLED, out], check=False)
    assert process.returncode == 9
    assert len(list(tmp_path.iterdir())) == 1
    assert not out.exists()
    write_rows(out, SCHEMA, iter([FRAME]))
    assert list(tmp_path.iterdir()) == [out]


def test_a_second_run_cannot_write_the_temporary_file_of_a_running_one(tmp_path):
    out = tmp_path / "out.csv"
    with replacing(out) as file:
        file.write(b"first\n")
        for write in (
            lambda: write_text(out, "second\n"),
            lambda: write_rows(out, SCHEMA, iter([FRAME])),
        ):
            with pytest.raises(FluxobsError, match=r"out\.csv: another run is writing this file"):
                write()
        assert not out.exists()
    assert out.read_bytes() == b"first\n"
    write_text(out, "second\n")
    assert list(tmp_path.iterdir()) == [out]


def test_a_replaced_temporary_file_is_not_moved(tmp_path, monkeypatch):
    """Without locks, another run may replace the temporary file as a stale file."""
    out = tmp_path / "out.csv"
    monkeypatch.setattr("fluxobs.core.output.lock", lambda descriptor: True)

    def frames():
        write_text(out, "second")
        yield FRAME

    with pytest.raises(FluxobsError, match="another run"):
        write_rows(out, SCHEMA, frames())
    assert out.read_text() == "second"
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_in_place_of_the_temporary_file_does_not_block(tmp_path):
    os.mkfifo(tmp_path / ".out.csv.part")
    write_text(tmp_path / "out.csv", "x")
    assert (tmp_path / "out.csv").read_text() == "x"


def test_a_hard_link_to_another_file_is_not_written(tmp_path):
    (tmp_path / "victim").write_text("mine")
    os.link(tmp_path / "victim", tmp_path / ".out.csv.part")
    write_text(tmp_path / "out.csv", "x")
    assert (tmp_path / "victim").read_text() == "mine"


def test_a_file_that_appears_during_the_run_is_kept(tmp_path):
    out = tmp_path / "out.csv"
    check_new(out, (".csv",), force=False)

    def frames():
        out.write_text("mine")
        yield FRAME

    with pytest.raises(FluxobsError, match=r"out\.csv: exists, created during this run"):
        write_rows(out, SCHEMA, frames(), force=False)
    assert out.read_text() == "mine"
    write_rows(out, SCHEMA, frames())
    assert out.read_text() == "x\n1\n"
    assert list(tmp_path.iterdir()) == [out]


def test_a_dangling_link_counts_as_an_existing_file(tmp_path):
    (tmp_path / "out.csv").symlink_to("nowhere")
    with pytest.raises(FluxobsError, match="exists"):
        check_new(tmp_path / "out.csv", (".csv",), force=False)


def test_files_have_the_usual_permissions(tmp_path):
    before = os.umask(0o027)
    try:
        write_text(tmp_path / "a.csv", "x")
        write_rows(tmp_path / "b.csv", SCHEMA, iter([FRAME]))
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in tmp_path.iterdir()} == {0o640}
