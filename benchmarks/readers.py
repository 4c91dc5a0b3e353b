"""Memory and time of all formats that are read in batches, relative to Parquet.

    python benchmarks/readers.py [--rows 20000000] [--format .mf4 …]

Each format is written, then read by `fluxobs.read_log` in a separate process, batch by batch as in
`estimate`.
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
# peak of this process only, unlike ru_maxrss
status = open("/proc/self/status").read()
peak = int(re.search(r"VmHWM:\\s*(\\d+)", status)[1]) / 1024
print(json.dumps([rows, spent, peak]))
"""


def record_batches(rows: int):
    """Yield batches of a record: time, then the signals of NAMES."""
    for start in range(0, rows, PART):
        t = np.arange(start, min(start + PART, rows)) / RATE
        yield [t, *(np.round(np.cos(600 * t + n), 3) for n in range(len(NAMES)))]


def frames(rows: int):
    for columns in record_batches(rows):
        yield pl.DataFrame(dict(zip(("t", *NAMES), columns, strict=True)))


def polars_file(sink: str) -> Callable[[Path, int], None]:
    def write(path: Path, rows: int) -> None:
        from polars.io.plugins import register_io_source

        batches = frames(rows)
        schema = dict.fromkeys(("t", *NAMES), pl.Float64)
        lazy = register_io_source(lambda columns, predicate, n, size: batches, schema=schema)
        getattr(lazy, sink)(path)

    return write


def csv_gz(path: Path, rows: int) -> None:
    with gzip.open(path, "wb", compresslevel=1) as file:
        for n, frame in enumerate(frames(rows)):
            file.write(frame.write_csv(include_header=n == 0).encode())


def mdf(path: Path, rows: int) -> None:
    from asammdf import MDF, Signal

    file = MDF(version="4.10")
    for index, (t, *values) in enumerate(record_batches(rows)):
        if index == 0:
            signals = [
                Signal(samples, t, name=name) for name, samples in zip(NAMES, values, strict=True)
            ]
            file.append(signals, acq_name="drive")
        else:
            file.extend(0, [(t, None), *((samples, None) for samples in values)])
    file.save(path, overwrite=True)
    file.close()


def tdms(path: Path, rows: int) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as writer:
        for _, *values in record_batches(rows):
            properties = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0}
            pairs = zip(NAMES, values, strict=True)
            writer.write_segment(
                [ChannelObject("drive", name, samples, properties) for name, samples in pairs]
            )


def hdf5(path: Path, rows: int) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        datasets = [
            file.create_dataset(name, (rows,), "f8", chunks=(65536,)) for name in ("t", *NAMES)
        ]
        for index, columns in enumerate(record_batches(rows)):
            for dataset, values in zip(datasets, columns, strict=True):
                dataset[index * PART : index * PART + len(values)] = values


def npy(path: Path, rows: int) -> None:
    dtype = [(name, "f8") for name in ("t", *NAMES)]
    array = np.lib.format.open_memmap(path, "w+", dtype, (rows,))
    for index, columns in enumerate(record_batches(rows)):
        for name, values in zip(("t", *NAMES), columns, strict=True):
            array[name][index * PART : index * PART + len(values)] = values
    array.flush()


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
    options = parser.parse_args()
    heading(f"reading {options.rows} rows of six columns (target: 1.5 times Parquet's memory)")
    parquet_peak = None
    with tempfile.TemporaryDirectory() as name:
        for suffix in dict.fromkeys((".parquet", *options.format)):
            path = Path(name) / f"log{suffix}"
            FORMATS[suffix](path, options.rows)
            command = [sys.executable, "-c", READ, str(path)]
            process = subprocess.run(command, capture_output=True, text=True, check=True)
            rows, seconds, peak = json.loads(process.stdout)
            assert rows == options.rows
            parquet_peak = peak if parquet_peak is None else parquet_peak
            print(
                f"    {suffix:9s} {peak:6.0f} MB, {peak / parquet_peak:4.2f} times Parquet's "
                f"memory; {rows / seconds / 1e6:5.2f} million rows per second of processor time"
            )
            path.unlink()


if __name__ == "__main__":
    main()
