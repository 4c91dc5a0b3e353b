"""What the columns of a log mean: frame, channels, units, timing."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from ..core.input_files import parse_toml, read_toml
from ..core.references import beside
from ..core.validation import Number, Positive, complaints, nearest
from ..errors import FluxobsError, RecordError
from ..machines.model.frames import CURRENTS, FRAMES, VOLTAGES, Frame
from . import units

#: Every channel a log may have.
CHANNELS = tuple(
    dict.fromkeys(
        ["t"]
        + [name for frame in FRAMES for name in VOLTAGES[frame] + CURRENTS[frame]]
        + ["theta_e", "theta_mech", "position", "speed_mech", "speed_e"]
    )
)
#: Channels of truth; hall and sincos are read from several columns, parted by commas.
TRUTHS = ("theta_e", "theta_mech", "position", "speed_mech", "speed_e", "hall", "sincos")
#: A truth that says: use none, even if there is a column like one.
NO_TRUTH = "none"
#: Column name that means: ignore the existing column (for t).
NO_COLUMN = "-"
#: Words for several channels, in `unit` and `adc`: their first letters.
GROUPS = {"i": "i_", "u": "u_", "duty": "d_", "theta": "theta", "speed": "speed"}
#: What turns a column into its channel; one of them for each.
CONVERTING = ("unit", "adc", "scale")

Align = Literal["time", "index", "auto"]


class Layout(BaseModel):
    """How to read a log: the fields of a record TOML, and the options of the same names.

    A channel's value is ``scale · column + offset``, in SI. A channel that is not named in
    `columns` is read from the column of the same name, or from the one whose name means it.
    `columns` t = "-" ignores a column t.

    Parameters
    ----------
    frame : str, optional
        "alphabeta", "abc" (amplitude-invariant Clarke; two phase currents suffice), "line"
        (two line-to-line voltages of u_ab, u_bc, u_ca), "duty" (duty cycles 0…1 and udc), "dq"
        (with theta_e, the angle used for the rotation), "ports" (u_1 u_2 i_1 i_2, coils as they
        are). Default: the first of these that the columns fill.
    currents : str, optional
        Frame of the currents, if it is not that of the voltages: "alphabeta", "abc" or "dq".
    sample_time : float, optional
        [s]; needed if there is no column t, and the file does not say it.
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
    unit : dict
        Channel, or i, u, duty, theta, speed for all of these → unit: mA, ms, deg, rpm, % …;
        counts:4096 (of a turn, or of a duty of one); ticks:170e6 (t, of a clock in Hz); q8 (fixed
        point with eight fractional bits). Default: the file's unit, or that in the column's name.
    adc : dict
        Channel, or i or u for all of them → "bits,range,zero" of its converter: the range [SI] that
        all counts span, and the count at zero (default: half of them).
    scale, offset : dict
        Channel → number; a scale stands in place of a unit.
    truth : dict
        One of: {"theta_e": column} (electrical), {"theta_mech": column} (mechanical), {"sincos":
        "column,column"} (sine and cosine of the mechanical angle), {"hall": "column,column,column"}
        or {"hall": column} (its code, 1…6), {"speed_mech": column}, {"speed_e": column} [rad/s],
        {"position": column} [m] of a levitated body; for scoring. {"none": "-"}: no truth, even if
        a column looks like one.
    fit_truth : bool
        Whether zero, direction, pole pairs, lag and eccentricity of the truth are fitted to the
        estimate, and reported apart.
    start, stop : float, optional
        Only rows with start <= t <= stop [s].
    header : str, optional
        Names of the columns, parted by commas, for a file without names.
    note : str, optional
        What a reader of the result should know; it is printed.
    join : list of str
        Further files with channels of the same run; in a record TOML beside it, or below.
    align : str
        How their times belong together: "time" (their stamps; default), "index" (row by row),
        "auto" (by what the files have in common).
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    frame: Frame | None = None
    currents: Frame | None = None
    sample_time: Positive | None = None
    lag: Number = 0.0
    held: bool | None = None
    udc: Positive | None = None
    columns: dict[str, str] = {}
    unit: dict[str, str] = {}
    adc: dict[str, str] = {}
    scale: dict[str, Number] = {}
    offset: dict[str, Number] = {}
    truth: dict[str, str] = {}
    fit_truth: bool = True
    start: Number | None = None
    stop: Number | None = None
    header: str | None = None
    note: str | None = None
    join: list[str] = []
    align: Align = "time"

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise RecordError(complaints(error, type(self).model_fields, "a record")) from None

    @model_validator(mode="after")
    def _known_channels(self) -> Self:
        for field in ("columns", "scale", "offset", "unit", "adc"):
            several = GROUPS if field in ("unit", "adc") else {}
            known = [*CHANNELS, *several]
            for channel in getattr(self, field):
                if channel not in known:
                    raise ValueError(
                        f"{field}: unknown channel {channel!r}{nearest(channel, known)}"
                    )
        for channel in self.truth:
            if channel not in (*TRUTHS, NO_TRUTH):
                raise ValueError(f"truth must be one of {', '.join(TRUTHS)}, got {channel!r}")
        if self.udc is not None and self.frame not in ("duty", None):
            raise ValueError(f'udc belongs to frame "duty", not to "{self.frame}"')
        if len(self.truth) > 1:
            raise ValueError("truth: give one channel only")
        for channel, unit in self.unit.items():
            example = {"i": "i_a", "u": "u_a", "duty": "d_a", "theta": "theta_e"}.get(channel)
            units.factor(example or {"speed": "speed_mech"}.get(channel, channel), unit)
        for channel, given in self.adc.items():
            units.adc(channel, given)
        for one, other in combinations(CONVERTING, 2):
            for channel in getattr(self, one):
                if channel in getattr(self, other):
                    raise ValueError(f"{channel} has both {one} and {other}; give one of them")
        return self

    def conversion(self, channel: str) -> tuple[float, float]:
        """Scale and offset that turn a column into its channel, in SI."""
        scale, offset = 1.0, 0.0
        for word in words_for(channel):
            if word in self.scale:
                scale = self.scale[word]
            elif word in self.adc:
                scale, offset = units.adc(channel, self.adc[word])
            elif word in self.unit:
                scale = units.factor(channel, self.unit[word])
            else:
                continue
            break
        return scale, offset + self.offset.get(channel, 0.0)


def words_for(channel: str) -> list[str]:
    """Words under which a unit or a converter of a channel may be given: its name goes first."""
    return [channel, *(word for word, start in GROUPS.items() if channel.startswith(start))]


def read_fields(path: str | Path) -> dict[str, Any]:
    """Fields of a record TOML; a mapping, so that options can override them.

    Raises
    ------
    RecordError
        The file cannot be read, or holds something that is not a field of :class:`Layout`.
    """
    path = Path(path)
    fields = _checked(read_toml(path, RecordError), str(path))
    if "join" in fields:
        try:
            fields["join"] = [str(beside(path.parent, one, "join")) for one in fields["join"]]
        except FluxobsError as error:
            raise RecordError(f"{path}: {error}") from None
    return fields


def fields_from(text: str, where: str) -> dict[str, Any]:
    """Fields of a record from the text of its TOML; RecordError if they are none."""
    return _checked(parse_toml(text, where, RecordError), where)


def _checked(fields: dict[str, Any], where: str) -> dict[str, Any]:
    try:
        Layout(**fields)
    except RecordError as error:
        raise RecordError(f"{where}: {error}") from None
    return fields
