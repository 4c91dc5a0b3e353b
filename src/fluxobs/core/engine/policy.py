"""How tasks are handed out and given up; the same for pool and Dask."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

#: Tasks handed out per worker: one in work, one waiting.
TASKS_PER_WORKER = 2
#: Attempts at a task whose worker dies.
MAX_ATTEMPTS = 5
#: Returns the result of a task that is given up.
GivenUp = Callable[[Any], Any]
