"""Read files in a separate process with limited memory.

A library in Rust or C aborts its process if it gets no memory or has a fault. The process that
calls this module survives.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...errors import RecordError
from .arrays import ArrayTable
from .table import Said

#: Function that reads the tables of a file in the separate process.
Reader = Callable[[Path, list[str] | None], list[ArrayTable]]

_CHILD = f"from {__name__} import answer; answer()"
#: Threads use address space, and a library needs seconds for a backtrace.
_ENVIRONMENT = {"POLARS_MAX_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RUST_BACKTRACE": "0"}


def read_apart(
    reader: Reader, path: Path, header: list[str] | None, memory: int, seconds: float
) -> list[ArrayTable]:
    """Read the tables of a file in a separate process.

    Parameters
    ----------
    reader : function
        A function of a module, so that the process can import the function.
    path : path
    header : list of str, optional
    memory : int
        Limit of the allocations [bytes], on systems that support it.
    seconds : float
        Time limit [s].

    Raises
    ------
    RecordError
        The reader raises a RecordError, or the process ends without an answer or exceeds its
        limits.
    """
    request = [reader.__module__, reader.__qualname__, str(path), header, memory]
    try:
        process = subprocess.run(  # with -P, nothing is imported from the folder of the log
            [sys.executable, "-P", "-c", _CHILD],
            input=json.dumps(request).encode(),
            capture_output=True,
            env=os.environ | _ENVIRONMENT,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        raise RecordError(
            f"{path}: reading the file took more than {seconds:.3g} s. Save only the table, as CSV"
        ) from None
    position = process.stdout.find(b"\n") + 1
    if process.returncode or not position:
        raise RecordError(
            f"{path}: reading the file ended with "
            f"{_last_line(process.stderr) or process.returncode}. The file is damaged, or needs "
            f"more than {memory >> 20} MB of memory. Save only the table, as CSV"
        )
    reply = json.loads(process.stdout[:position])
    if isinstance(reply, str):
        raise RecordError(reply)
    tables = []
    for names, rows, metadata in reply:
        values = np.frombuffer(process.stdout, float, len(names) * rows, position).reshape(
            len(names), rows
        )
        position += values.nbytes
        table = ArrayTable(dict(zip(names, values, strict=True)), path)
        table.said = Said(**metadata | {"notes": tuple(metadata["notes"])})
        tables.append(table)
    return tables


def _last_line(stderr: bytes) -> str:
    """Return the last line of the error output, without advice on debugging."""
    lines = [line for line in stderr.decode(errors="replace").splitlines() if line.strip()]
    return next((line[:200] for line in reversed(lines) if not line.startswith("note:")), "")


def answer() -> None:
    """Read a request from standard input; write a line of JSON and the columns as the answer."""
    module, name, path, header, memory = json.load(sys.stdin)
    reader: Reader = getattr(importlib.import_module(module), name)
    _limit_memory(memory)
    tables: list[ArrayTable] = []
    try:
        tables = reader(Path(path), header)
        reply: object = [(t.columns, t.rows, asdict(t.said)) for t in tables]
    except RecordError as error:
        reply = str(error)
    stdout = sys.stdout.buffer
    stdout.write(json.dumps(reply).encode() + b"\n")
    for table in tables:
        for batch in table.batches(table.columns, 0, table.rows, max(table.rows, 1)):
            for values in batch.values():
                stdout.write(np.ascontiguousarray(values).data)
    stdout.flush()


def _limit_memory(memory: int) -> None:
    """Limit further allocations of this process to `memory` [bytes], on Linux only."""
    if sys.platform == "linux":
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + memory
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
