"""Open logs for a machine, with the machine's frame and a truth channel that fits the machine."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..errors import RecordError
from ..machines import Machine, RotatingMachine
from ..machines.model.frames import Frame
from .log import Log
from .meaning.guess import ROTATING
from .read import read_log

if TYPE_CHECKING:
    from typing import Unpack

    from .meaning.options import ReadOptions

#: Truth channels of a rotor that are not its angle.
INDIRECT = ("speed_mech", "speed_e", "hall")


def open_for(source: Any, machine: Machine, **layout: Unpack[ReadOptions]) -> Log:
    """Open a log for a machine; by default, use the machine's frame and a suitable truth channel.

    Parameters
    ----------
    source, layout
        See :func:`fluxobs.read_log`.

    Raises
    ------
    RecordError
        The frame or the truth channel does not fit the kind of machine.
    """
    frame = layout.get("frame")
    if frame is not None:  # checked before the columns are searched
        _check_frame(frame, machine)
    frames: tuple[Frame, ...] = ROTATING if machine.frame == "alphabeta" else (machine.frame,)
    log = read_log(source, frames=frames, **layout)
    _check_frame(log.frame, machine)
    truths = machine.position_output.truths
    if isinstance(machine, RotatingMachine):
        truths = (*truths, *INDIRECT)
    if log.truth is not None and log.truth[0] not in truths:
        if log.true is not None and log.true.guessed:
            return replace(log, true=None)
        raise RecordError(
            f"truth {log.truth[0]} does not fit kind {machine.kind}; use "
            f"{' or '.join(reversed(truths))}"
        )
    return log


def _check_frame(frame: str, machine: Machine) -> None:
    if (frame == "ports") != (machine.frame == "ports"):
        raise RecordError(
            f"frame {frame!r} does not fit kind {machine.kind}; use {machine.frame!r}"
        )
