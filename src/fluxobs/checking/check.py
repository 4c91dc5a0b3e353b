"""Is a log what its user thinks?"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..logs.for_machine import open_for
from ..logs.read import Source
from ..machines import Machine, as_machine, rotating
from .findings import Check
from .search import check_log


def check(
    log: Source,
    machine: Machine | str | Path,
    *,
    progress: Callable[[int, int], Any] | None = None,
    **layout: Any,
) -> Check:
    """Is a log what its user thinks? Try the usual mistakes on stretches of it.

    They are the sign of the current, the phase order, the lag, the frame, and scales of the log or
    of the machine file; with a true angle, also its zero, its direction, and n_p. Columns are
    looked at first: repeated, raw counts, an angle in degrees, spikes.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, or a path, or the name of a shipped machine
        A rotating one.
    progress : callable, optional
        Called with the number of attempts made and the number of all attempts so far known.
    layout : optional
        As for :func:`fluxobs.read_log`.

    Raises
    ------
    FluxobsError
        The machine does not rotate, or the log has too few rows without a gap.
    """
    given = rotating(as_machine(machine), "the check of a log")
    return check_log(open_for(log, given, **layout), given, progress)
