"""Tasks for the tests of the engine, importable by worker processes."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from fluxobs.errors import FluxobsError


def square(k: int) -> int:
    return k * k


def refuse_seven(k: int) -> int:
    if k == 7:
        raise FluxobsError("no room for 7")
    return k


def die_once(folder: str, k: int) -> int:
    mark = Path(folder) / "died"
    if k == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return k


def die(k: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return k


def environment(names: tuple[str, ...]) -> list[str]:
    return [os.environ.get(name, "") for name in names]


def die_at_three(k: int) -> int:
    return die(k) if k == 3 else k
