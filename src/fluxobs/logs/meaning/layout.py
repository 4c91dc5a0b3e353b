"""Layout: meaning of the columns of a log (frame, channels, units, timing)."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from ...core.input_files import parse_toml, read_toml
from ...core.references import beside
from ...core.validation import NotNegative, Number, Positive, complaints, nearest
from ...errors import FluxobsError, RecordError
from ...machines.model.frames import CURRENTS, FRAMES, VOLTAGES, Frame
from . import units

#: All channels that a log may have.
CHANNELS = tuple(
    dict.fromkeys(
        ["t"]
        + [name for frame in FRAMES for name in VOLTAGES[frame] + CURRENTS[frame]]
        + ["theta_e", "theta_mech", "position", "speed_mech", "speed_e"]
    )
)
#: Truth channels; hall and sincos are read from several columns, whose names commas separate.
TRUTHS = ("theta_e", "theta_mech", "position", "speed_mech", "speed_e", "hall", "sincos")
#: Name of a truth that means: use no truth, even if a column looks like a truth.
NO_TRUTH = "none"
#: Name of a column of t that means: ignore an existing column t.
NO_COLUMN = "-"
#: Groups of channels in `unit` and `adc` → first letters of their names.
GROUPS = {"i": "i_", "u": "u_", "duty": "d_", "theta": "theta", "speed": "speed"}
#: Fields that convert a column into its channel; a channel may be in only one of these fields.
CONVERTING = ("unit", "adc", "scale")

Align = Literal["time", "index", "auto"]


class Layout(BaseModel):
    """How to read a log: the fields of a record TOML, and the options of the same names.

    A channel's value is ``scale · column + offset``, in SI. If a channel is not in `columns`, it is
    read from the column with the channel's name or with a synonymous name. With `columns` t = "-",
    a column t is ignored.

    Parameters
    ----------
    frame : str, optional
        "alphabeta", "abc" (amplitude-invariant Clarke; two phase currents suffice), "line"
        (two line-to-line voltages of u_ab, u_bc, u_ca), "duty" (duty cycles 0…1 and udc), "dq"
        (with theta_e, the angle used for the rotation), "ports" (u_1 u_2 i_1 i_2, the coils
        themselves). Default: the first of these frames for which all columns exist.
    currents : str, optional
        Frame of the currents, if it differs from `frame`: "alphabeta", "abc" or "dq".
    sample_time : float, optional
        Sample time [s]; needed if there is no column t and the file does not state it.
    lag : float or "auto"
        Interval over which a row's voltage acts, in samples. With 0, it acts from its row to the
        next; with -1, one sample later; with +1, one sample earlier. Fractions are allowed.
        "auto" (default): an estimate of every row learns it, from -2 to +1; everything else uses 0.
    held : bool, optional
        Whether each voltage is constant over its sample, like the mean voltage of an inverter.
        Default: yes if this matters for the machine (R h/L above 0.15) and the lag is a whole
        number.
    udc : float, optional
        DC-link voltage [V] if no column holds this voltage (frame "duty").
    columns : dict
        Channel → column name.
    unit : dict
        Channel, or i, u, duty, theta, speed for a group of channels → unit: mA, ms, deg, rpm, % …;
        counts:4096 (of a turn, or of a duty of one); ticks:170e6 (t, of a clock in Hz); q8 (fixed
        point with eight fractional bits). Default: the unit in the file or in the column's name.
    adc : dict
        Channel, or i or u for a group → "bits,range,zero" of the converter. All counts span the
        range [SI]; zero is the count at zero (default: half of all counts).
    scale, offset : dict
        Channel → number; a scale replaces a unit.
    truth : dict
        One of: {"theta_e": column} (electrical), {"theta_mech": column} (mechanical), {"sincos":
        "column,column"} (sine and cosine of the mechanical angle), {"hall": "column,column,column"}
        or {"hall": column} (its code, 1…6), {"speed_mech": column}, {"speed_e": column} [rad/s],
        {"position": column} [m] of a levitated body. The truth serves for scoring only. With
        {"none": "-"}, no truth is used, even if a column looks like a truth.
    fit_truth : bool
        Whether zero, direction, pole pairs, lag and eccentricity of the truth are fitted to the
        estimate and reported separately.
    start, stop : float, optional
        Read only rows with start <= t <= stop [s].
    header : str, optional
        Names of the columns, separated by commas, for a file without names.
    note : str, optional
        Note for readers of the result; the note is printed.
    join : list of str
        Further files with channels of the same run. Files named in a record TOML must be in its
        folder or below.
    align : str
        How to match the rows of the files: "time" (by time stamps; default), "index" (row by row),
        "auto" (by signals that the files have in common).
    priors : dict
        Standard deviations of the log's errors, see :func:`fluxobs.estimate`: lag, offset,
        current_gain, voltage_gain, …
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
    priors: dict[str, NotNegative] = {}

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise RecordError(complaints(error, type(self).model_fields, "a record")) from None

    @model_validator(mode="before")
    @classmethod
    def _unstated_lag(cls, fields: Any) -> Any:
        """Drop the lag "auto"."""
        if isinstance(fields, dict) and fields.get("lag") == "auto":
            return {name: value for name, value in fields.items() if name != "lag"}
        return fields

    @property
    def lag_stated(self) -> bool:
        """Whether somebody states the lag."""
        return "lag" in self.model_fields_set

    @model_validator(mode="after")
    def _known_channels(self) -> Self:
        for field in ("columns", "scale", "offset", "unit", "adc"):
            groups = GROUPS if field in ("unit", "adc") else {}
            allowed = [*CHANNELS, *groups]
            for channel in getattr(self, field):
                if channel not in allowed:
                    raise ValueError(
                        f"{field}: unknown channel {channel!r}{nearest(channel, allowed)}"
                    )
        for channel in self.truth:
            if channel not in (*TRUTHS, NO_TRUTH):
                raise ValueError(f"truth must be one of {', '.join(TRUTHS)}, got {channel!r}")
        if self.udc is not None and self.frame not in ("duty", None):
            raise ValueError(f'udc belongs to frame "duty", not "{self.frame}"')
        if len(self.truth) > 1:
            raise ValueError("truth: give one channel only")
        for channel, unit in self.unit.items():
            example = {"i": "i_a", "u": "u_a", "duty": "d_a", "theta": "theta_e"}.get(channel)
            units.factor(example or {"speed": "speed_mech"}.get(channel, channel), unit)
        for channel, given in self.adc.items():
            units.adc(channel, given)
        for first, second in combinations(CONVERTING, 2):
            for channel in getattr(self, first):
                if channel in getattr(self, second):
                    raise ValueError(f"{channel} has both {first} and {second}; give only one")
        return self

    def conversion(self, channel: str) -> tuple[float, float]:
        """Return the (scale, offset) that convert a column to its channel, in SI."""
        scale, offset = 1.0, 0.0
        for key in keys_for(channel):
            if key in self.scale:
                scale = self.scale[key]
            elif key in self.adc:
                scale, offset = units.adc(channel, self.adc[key])
            elif key in self.unit:
                scale = units.factor(channel, self.unit[key])
            else:
                continue
            break
        return scale, offset + self.offset.get(channel, 0.0)


def keys_for(channel: str) -> list[str]:
    """Return the keys of a channel's unit or converter: the channel's name, then its group."""
    return [channel, *(group for group, prefix in GROUPS.items() if channel.startswith(prefix))]


def read_fields(path: str | Path) -> dict[str, Any]:
    """Read the fields of a record TOML as a mapping; options can override the fields.

    Raises
    ------
    RecordError
        The file cannot be read, or has a key that is not a field of :class:`Layout`.
    """
    path = Path(path)
    fields = _validated(read_toml(path, RecordError), str(path))
    if "join" in fields:
        try:
            fields["join"] = [str(beside(path.parent, name, "join")) for name in fields["join"]]
        except FluxobsError as error:
            raise RecordError(f"{path}: {error}") from None
    return fields


def fields_from(text: str, where: str) -> dict[str, Any]:
    """Parse the fields of a record TOML; raise RecordError if it is malformed."""
    return _validated(parse_toml(text, where, RecordError), where)


def _validated(fields: dict[str, Any], where: str) -> dict[str, Any]:
    try:
        Layout(**fields)
    except RecordError as error:
        raise RecordError(f"{where}: {error}") from None
    return fields
