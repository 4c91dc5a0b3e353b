"""The environment of workers: one thread each, compiled simulations shared between them."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: Where compiled simulations are kept, if the user does not say.
CACHE = "JAX_COMPILATION_CACHE_DIR"


def _processor() -> str:
    """Stands for the kind of processor: code compiled for one may not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        told = next(line for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        told = platform.processor()
    return hashlib.sha256((platform.machine() + told).encode()).hexdigest()[:12]


def variables() -> dict[str, str]:
    """Environment variables of a worker; those that the user has set stay as they are."""
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    wanted = {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "POLARS_MAX_THREADS": "1",
        CACHE: str(Path(home) / "fluxobs" / f"jax-{_processor()}"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }
    return {name: value for name, value in wanted.items() if name not in os.environ}


@contextmanager
def for_workers() -> Iterator[None]:
    """While it lasts, new processes get the environment of workers."""
    added = variables()
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
