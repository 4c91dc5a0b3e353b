"""Rules by which the pool and Dask hand out tasks and give them up."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

#: Tasks handed out per worker; one task runs, one task waits.
TASKS_PER_WORKER = 2
#: Attempts at a task whose worker dies.
MAX_ATTEMPTS = 5
#: Function that returns the result of a task that is given up.
GivenUp = Callable[[Any], Any]
