"""What the columns of a log mean: frame, channels, scale, offset, timing."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from ..errors import RecordError
from ..model.frames import CURRENTS, FRAMES, PHASE_CURRENTS, VOLTAGES, Frame
from ..validation import Number, Positive, complaints, nearest

#: Every channel a log may have.
CHANNELS = tuple(
    dict.fromkeys(
        ["t"]
        + [name for frame in FRAMES for name in VOLTAGES[frame] + CURRENTS[frame]]
        + ["theta_e", "theta_mech", "position"]
    )
)
TRUTHS = ("theta_e", "theta_mech", "position", "speed_mech")
#: Column name that means: ignore the existing column (for t).
NO_COLUMN = "-"


class Layout(BaseModel):
    """How to read a log: the fields of a record TOML, and the options of the same names.

    A channel's value is ``scale · column + offset``. A channel that is not named in `columns` is
    read from the column of the same name. `columns` t = "-" ignores a column t.

    Parameters
    ----------
    frame : str
        "alphabeta", "abc" (amplitude-invariant Clarke; two phase currents suffice), "line"
        (line-to-line voltages u_ab, u_bc), "duty" (duty cycles 0…1 and udc), "dq" (with theta_e,
        the angle used for the rotation), "ports" (u_1 u_2 i_1 i_2, coils as they are).
    sample_time : float, optional
        [s]; needed if there is no column t.
    lag : float
        Interval over which a row's voltage acts, in samples: 0 from that row to the next, -1 one
        sample later, +1 one earlier; fractions allowed.
    held : bool, optional
        Whether each voltage is held over its sample, as an inverter's mean voltage is; default: if
        that matters for the machine (R h/L above 0.15), and the lag is no fraction.
    udc : float, optional
        DC-link voltage [V] if it has no column (frame "duty").
    columns : dict
        Channel → column name.
    scale, offset : dict
        Channel → number.
    truth : dict
        {"theta_e": column} (electrical), {"theta_mech": column} (mechanical) or {"position":
        column} [m] of a levitated body, for scoring; {"speed_mech": column} [rad/s], from which
        `identify` tells R_R of an induction machine.
    start, stop : float, optional
        Only rows with start <= t <= stop [s].
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    frame: Frame = "alphabeta"
    sample_time: Positive | None = None
    lag: Number = 0.0
    held: bool | None = None
    udc: Positive | None = None
    columns: dict[str, str] = {}
    scale: dict[str, Number] = {}
    offset: dict[str, Number] = {}
    truth: dict[str, str] = {}
    start: Number | None = None
    stop: Number | None = None

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise RecordError(complaints(error, type(self).model_fields, "a record")) from None

    @model_validator(mode="after")
    def _known_channels(self) -> Self:
        for field in ("columns", "scale", "offset"):
            for channel in getattr(self, field):
                if channel not in CHANNELS:
                    raise ValueError(
                        f"{field}: unknown channel {channel!r}{nearest(channel, CHANNELS)}"
                    )
        for channel in self.truth:
            if channel not in TRUTHS:
                raise ValueError(f"truth must be one of {', '.join(TRUTHS)}, got {channel!r}")
        if self.udc is not None and self.frame != "duty":
            raise ValueError(f'udc belongs to frame "duty", not to "{self.frame}"')
        if len(self.truth) > 1:
            raise ValueError("truth: give one channel only")
        return self

    def required(self, available: list[str]) -> dict[str, str]:
        """Channel → column for all channels that the frame needs or can use."""
        channels = list(VOLTAGES[self.frame])
        if self.frame == "duty" and self.udc is not None:
            channels.remove("udc")
        currents = list(CURRENTS[self.frame])
        if tuple(currents) == PHASE_CURRENTS:
            present = [name for name in currents if self.columns.get(name, name) in available]
            currents = present if len(present) >= 2 else currents[:2]
        if self.frame == "dq":
            channels.append("theta_e")
        if self.columns.get("t", "t") != NO_COLUMN and ("t" in self.columns or "t" in available):
            channels.insert(0, "t")
        return {name: self.columns.get(name, name) for name in channels + currents}


def read_fields(path: str | Path) -> dict[str, Any]:
    """Fields of a record TOML; a mapping, so that options can override them.

    Raises
    ------
    RecordError
        The file cannot be read, or holds something that is not a field of :class:`Layout`.
    """
    path = Path(path)
    try:
        fields = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RecordError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise RecordError(f"{path}: not TOML: {error}") from None
    try:
        Layout(**fields)
    except RecordError as error:
        raise RecordError(f"{path}: {error}") from None
    return fields
