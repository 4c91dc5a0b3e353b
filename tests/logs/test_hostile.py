"""Hostile text logs must not block the program or fill the memory."""

import contextlib
import gzip
import time
import tracemalloc

import pytest

from fluxobs import FluxobsError
from fluxobs.logs import read_log
from fluxobs.logs.formats import open_tables
from support.hostile import refused

HEAD = "t,u_alpha,u_beta,i_alpha,i_beta\n"
ROWS = "".join(f"{n * 1e-3:.3f},1,2,3,4\n" for n in range(300))


@pytest.mark.parametrize(
    "above",
    [
        HEAD.replace("u_beta", "(" * 100_000),
        HEAD.replace("u_beta", "[" * 100_000),
        "Sample Interval,1" + " " * 100_000 + "!\n" + HEAD,
        "Sample Interval" + "(" * 100_000 + ",1 ms\n" + HEAD,
        "a" + " " * 100_000 + "b\n" + HEAD,
        HEAD + "1" * 100_000 + "x,1,2,3,4\n",
    ],
)
def test_time_grows_linearly_with_the_length_of_a_text(tmp_path, above):
    (tmp_path / "log.csv").write_text(above + ROWS)
    before = time.process_time()
    with contextlib.suppress(FluxobsError):
        read_log(tmp_path / "log.csv")
    assert time.process_time() - before < 3  # it was a minute


def test_a_log_of_too_many_columns(tmp_path):
    names = ",".join(f"c{n}" for n in range(50_000))
    (tmp_path / "log.csv").write_text(names + ("\n" + ",".join(["1"] * 50_000)) * 3)
    refused(tmp_path / "log.csv", "a row has 50000 cells, more than 10000")


def test_many_columns_of_one_name_are_numbered(tmp_path):
    names = ",".join(["x"] * 9_000)
    (tmp_path / "log.csv").write_text(names + ("\n" + ",".join(["1"] * 9_000)) * 3)
    (table,) = open_tables(tmp_path / "log.csv")
    assert table.columns[-1] == "x (column 9000)"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("at", [0, 100, len(ROWS)])
def test_a_line_without_end(tmp_path, encoding, packed, at):
    text = (HEAD + ROWS[:at] + "1" * (9 << 20) + "\n" + ROWS[at:]).encode(encoding)
    path = tmp_path / ("log.csv.gz" if packed else "log.csv")
    path.write_bytes(gzip.compress(text, 1) if packed else text)
    refused(path, "more than 1048576 characters|no header|is not a number")


def packed_rows(path, row, megabytes):
    """Write a compressed log that repeats one row; unpacked, the log has `megabytes` MB."""
    block = gzip.compress(row * ((1 << 20) // len(row)))
    path.write_bytes(gzip.compress((HEAD + ROWS).encode()) + block * megabytes)
    return path


def test_a_small_file_that_unpacks_to_a_gigabyte(tmp_path):
    path = packed_rows(tmp_path / "log.csv.gz", b"0,1,2,3,4\n", 1024)
    refused(path, "unpacks to more than 4........ bytes, and to more than 200 times its size")


def test_short_rows_are_read_in_little_memory(tmp_path):
    (table,) = open_tables(packed_rows(tmp_path / "log.csv.gz", b"0,1,2,3,4\n", 70))
    tracemalloc.start()
    rows = sum(len(batch["t"]) for batch in table.batches(table.columns, 0, table.rows))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert rows == table.rows > 7_000_000
    assert peak < 100 << 20  # all rows as numbers would need 290 MB


def test_lines_without_rows_are_not_kept_in_memory(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(HEAD + ROWS + "\n" * 500_000 + ROWS)
    tracemalloc.start()
    (table,) = open_tables(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 << 20  # one number per empty line would need 20 MB
    assert table.place(299) == "line 301"
    assert table.place(300) == "line 500302"
