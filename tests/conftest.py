import os

# Tests run side by side: threads within each would only wait for one another.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

# Deterministic, and no deadline: a slow machine is no failure.
settings.register_profile("fluxobs", deadline=None, derandomize=True)
settings.load_profile("fluxobs")
