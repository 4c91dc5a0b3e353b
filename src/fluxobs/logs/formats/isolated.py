"""Files that are read in a process of its own, with a limit on its memory.

A library in Rust or C ends its process where it gets no memory, or fails in itself. That process is
not this one.
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

#: What reads the tables of a file in that process.
Reader = Callable[[Path, list[str] | None], list[ArrayTable]]

_CHILD = f"from {__name__} import answer; answer()"
#: Threads take address space, and a trace of a library's stack takes seconds.
_ENVIRONMENT = {"POLARS_MAX_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "RUST_BACKTRACE": "0"}


def read_apart(
    reader: Reader, path: Path, header: list[str] | None, memory: int, seconds: float
) -> list[ArrayTable]:
    """Tables of a file, read by a function of a module.

    Parameters
    ----------
    reader : function
    path : path
    header : list of str, optional
    memory : int
        Most bytes that the process may allocate, where the system can limit it.
    seconds : float
        After which the process is stopped.

    Raises
    ------
    RecordError
        The reader raises one, or its process ends before it answers, or is stopped.
    """
    asked = [reader.__module__, reader.__qualname__, str(path), header, memory]
    try:
        done = subprocess.run(  # -P: nothing is imported from the folder of the log
            [sys.executable, "-P", "-c", _CHILD],
            input=json.dumps(asked).encode(),
            capture_output=True,
            env=os.environ | _ENVIRONMENT,
            timeout=seconds,
        )
    except subprocess.TimeoutExpired:
        raise RecordError(
            f"{path}: reading it took more than {seconds:.3g} s. Save its table alone, as CSV"
        ) from None
    end = done.stdout.find(b"\n") + 1
    if done.returncode or not end:
        raise RecordError(
            f"{path}: reading it ended with {_last_words(done.stderr) or done.returncode}. The "
            f"file is damaged, or takes more than {memory >> 20} MB of memory. Save its table "
            f"alone, as CSV"
        )
    answered = json.loads(done.stdout[:end])
    if isinstance(answered, str):
        raise RecordError(answered)
    tables = []
    for names, rows, said in answered:
        values = np.frombuffer(done.stdout, float, len(names) * rows, end).reshape(len(names), rows)
        end += values.nbytes
        table = ArrayTable(dict(zip(names, values, strict=True)), path)
        table.said = Said(**said | {"notes": tuple(said["notes"])})
        tables.append(table)
    return tables


def _last_words(said: bytes) -> str:
    """The last line that a process has written, without advice on how to debug it."""
    lines = [line for line in said.decode(errors="replace").splitlines() if line.strip()]
    return next((line[:200] for line in reversed(lines) if not line.startswith("note:")), "")


def answer() -> None:
    """Read what is asked for on the standard input; write a line of JSON, and the columns."""
    module, name, path, header, memory = json.load(sys.stdin)
    reader: Reader = getattr(importlib.import_module(module), name)
    _limit(memory)
    tables: list[ArrayTable] = []
    try:
        tables = reader(Path(path), header)
        answered: object = [(t.columns, t.rows, asdict(t.said)) for t in tables]
    except RecordError as error:
        answered = str(error)
    out = sys.stdout.buffer
    out.write(json.dumps(answered).encode() + b"\n")
    for table in tables:
        for part in table.batches(table.columns, 0, table.rows, max(table.rows, 1)):
            for values in part.values():
                out.write(np.ascontiguousarray(values).data)
    out.flush()


def _limit(memory: int) -> None:
    """Let this process allocate no more than so many bytes from now on; only Linux can."""
    if sys.platform == "linux":
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + memory
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
