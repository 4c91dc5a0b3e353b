"""The environment of workers: one thread each, and a shared cache of compiled simulations."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: Variable with the folder of compiled simulations; a value that the user has set is kept.
CACHE = "JAX_COMPILATION_CACHE_DIR"


def _processor() -> str:
    """Return a hash of the processor type; compiled code may not run on another type."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        features = next(line for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        features = platform.processor()
    return hashlib.sha256((platform.machine() + features).encode()).hexdigest()[:12]


def variables() -> dict[str, str]:
    """Return environment variables to add for a worker; the user's variables stay unchanged."""
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    settings = {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "POLARS_MAX_THREADS": "1",
        CACHE: str(Path(home) / "fluxobs" / f"jax-{_processor()}"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.2",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }
    return {name: value for name, value in settings.items() if name not in os.environ}


@contextmanager
def for_workers() -> Iterator[None]:
    """Give new processes the environment of workers while the context is open."""
    added = variables()
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
