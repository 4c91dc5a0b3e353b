"""Memory and time of every format that is read in chunks, against Parquet.

    python benchmarks/readers.py [--rows 20000000] [--format .mf4 …]

Each format is written, then read by `fluxobs.read_log` in a process of its own, batch by batch as
`estimate` does.
"""

from __future__ import annotations

import argparse
import gzip
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
from common import heading

NAMES = ("i_a", "i_b", "u_a", "u_b", "u_c")
RATE, PART = 20_000.0, 1_000_000

READ = """
import json, re, sys, time
from fluxobs import read_log
start = time.process_time()
log = read_log(sys.argv[1])
rows = sum(len(part.t) for part in log.aligned())
spent = time.process_time() - start
# of this program alone, unlike ru_maxrss
status = open("/proc/self/status").read()
peak = int(re.search(r"VmHWM:\\s*(\\d+)", status)[1]) / 1024
print(json.dumps([rows, spent, peak]))
"""


def parts(rows: int):
    """Pieces of a record: time, then the signals of NAMES."""
    for first in range(0, rows, PART):
        t = np.arange(first, min(first + PART, rows)) / RATE
        yield [t, *(np.round(np.cos(600 * t + n), 3) for n in range(len(NAMES)))]


def frames(rows: int):
    for one in parts(rows):
        yield pl.DataFrame(dict(zip(("t", *NAMES), one, strict=True)))


def polars_file(sink: str) -> Callable[[Path, int], None]:
    def write(path: Path, rows: int) -> None:
        from polars.io.plugins import register_io_source

        made = frames(rows)
        schema = dict.fromkeys(("t", *NAMES), pl.Float64)
        lazy = register_io_source(lambda columns, predicate, n, size: made, schema=schema)
        getattr(lazy, sink)(path)

    return write


def csv_gz(path: Path, rows: int) -> None:
    with gzip.open(path, "wb", compresslevel=1) as file:
        for n, frame in enumerate(frames(rows)):
            file.write(frame.write_csv(include_header=n == 0).encode())


def mdf(path: Path, rows: int) -> None:
    from asammdf import MDF, Signal

    made = MDF(version="4.10")
    for n, (t, *values) in enumerate(parts(rows)):
        if n == 0:
            signals = [Signal(v, t, name=k) for k, v in zip(NAMES, values, strict=True)]
            made.append(signals, acq_name="drive")
        else:
            made.extend(0, [(t, None), *((v, None) for v in values)])
    made.save(path, overwrite=True)
    made.close()


def tdms(path: Path, rows: int) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as writer:
        for _, *values in parts(rows):
            about = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0}
            pairs = zip(NAMES, values, strict=True)
            writer.write_segment([ChannelObject("drive", k, v, about) for k, v in pairs])


def hdf5(path: Path, rows: int) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        sets = [file.create_dataset(k, (rows,), "f8", chunks=(65536,)) for k in ("t", *NAMES)]
        for n, one in enumerate(parts(rows)):
            for data, values in zip(sets, one, strict=True):
                data[n * PART : n * PART + len(values)] = values


def npy(path: Path, rows: int) -> None:
    kind = [(name, "f8") for name in ("t", *NAMES)]
    out = np.lib.format.open_memmap(path, "w+", kind, (rows,))
    for n, one in enumerate(parts(rows)):
        for name, values in zip(("t", *NAMES), one, strict=True):
            out[name][n * PART : n * PART + len(values)] = values
    out.flush()


FORMATS = {
    ".parquet": polars_file("sink_parquet"),
    ".csv": polars_file("sink_csv"),
    ".csv.gz": csv_gz,
    ".feather": polars_file("sink_ipc"),
    ".mf4": mdf,
    ".tdms": tdms,
    ".h5": hdf5,
    ".npy": npy,
}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=20_000_000)
    parser.add_argument("--format", nargs="*", choices=list(FORMATS), default=list(FORMATS))
    given = parser.parse_args()
    heading(f"reading {given.rows} rows of six columns (target: 1.5 times Parquet's memory)")
    first = None
    with tempfile.TemporaryDirectory() as name:
        for ending in dict.fromkeys((".parquet", *given.format)):
            path = Path(name) / f"log{ending}"
            FORMATS[ending](path, given.rows)
            command = [sys.executable, "-c", READ, str(path)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            rows, spent, peak = json.loads(done.stdout)
            assert rows == given.rows
            first = peak if first is None else first
            print(
                f"    {ending:9s} {peak:6.0f} MB, {peak / first:4.2f} times Parquet's; "
                f"{rows / spent / 1e6:5.2f} million rows a second of processor"
            )
            path.unlink()


if __name__ == "__main__":
    main()
