"""Processes that fork after a file was read.

The threads of Polars do not survive, and its next task would wait for them for ever.
"""

from __future__ import annotations

import os

from ..errors import UsageError

#: Whether this process has used Polars, and whether it was forked from one that had.
_state = {"used": False, "forked": False}


def use_polars() -> None:
    """Note that this process reads or writes a file with Polars.

    Raises
    ------
    UsageError
        The process was forked from one that had done so before.
    """
    if _state["forked"]:
        raise UsageError(
            "this process was forked from one that had read or written a file, and the threads "
            'for that are lost. Start processes with multiprocessing.get_context("spawn"), or '
            "fork before the first file"
        )
    _state["used"] = True


def _in_child() -> None:
    _state["forked"] = _state["used"]


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_in_child)
