"""Open logs from files, records or arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import RecordError, UsageError
from ..machines.model.frames import CURRENTS, VOLTAGES, Frame
from .assemble import assemble
from .formats import Table, open_tables
from .formats.arrays import ArrayTable
from .log import Log
from .meaning.guess import ROTATING
from .meaning.layout import CONVERTING, Layout, read_fields
from .meaning.presets import preset_fields
from .record import Record, alphabeta_rows

if TYPE_CHECKING:
    from typing import Unpack

    from .meaning.options import LayoutOptions

#: Source of :func:`read_log`: a file; a log or a record; a mapping of channels (or columns) to
#: arrays, such as a data frame; or a pair (voltage, current) of arrays.
Source = str | Path | Log | Record | Mapping[str, Any] | tuple[Any, Any]

#: Fields of a layout that are mappings: options add entries to the mappings of a record file.
_MAPPINGS = ("columns", "scale", "offset", "truth", "unit", "adc", "priors")

Files = list[tuple[Path, list[Table]]]


def read_log(
    source: Any,
    *,
    record: str | Path | None = None,
    preset: str | None = None,
    frame: Frame | None = None,
    frames: Sequence[Frame] = ROTATING,
    **layout: Unpack[LayoutOptions],
) -> Log:
    """Open a log. At this point, only the head and the times of the log are read.

    Missing fields of the layout are guessed from names, units and values of the columns;
    ``log.notes`` lists the guesses.

    Parameters
    ----------
    source : path, Log, Record, mapping of str to array, or (voltage, current)
        A file in one of the formats of :mod:`fluxobs.logs.formats`, or data in memory. A pair of
        arrays has shapes as in :class:`Record`: (rows, 2) in αβ, (rows, 3) for three phases, or
        (rows,) for complex numbers.
    record : path, optional
        TOML with the fields of :class:`Layout`; other arguments override it.
    preset : str, optional
        Name of a shipped record for the logs of a known tool; `record` overrides it.
    frame : str, optional
        Default: the first of `frames` for which all columns exist.
    frames : sequence of str
        Frames to choose from.
    layout : optional
        Fields of :class:`Layout`: sample_time, lag, held, udc, columns, unit, adc, scale, offset,
        truth, fit_truth, start, stop, header, join, align. A number as the column of udc is a
        constant DC-link voltage.

    Returns
    -------
    Log

    Raises
    ------
    RecordError
        The source cannot be read, or lacks a column of the layout; the message says where.
    UsageError
        A layout is given for a log or a record, which already has a layout.

    Examples
    --------
    >>> import numpy as np
    >>> t = 1e-4 * np.arange(100)
    >>> log = read_log({"t": t, "u_a": t, "u_b": t, "u_c": t, "i_a": t, "i_b": t}, frame="abc")
    >>> len(log), log.sample_time
    (100, 0.0001)
    """
    given: dict[str, Any] = {n: value for n, value in layout.items() if value is not None}
    if isinstance(source, Log):
        if given or record is not None or frame is not None or preset is not None:
            raise UsageError(
                f"{', '.join(given) or 'record, preset or frame'}: the log is already open; give "
                f"its layout to read_log"
            )
        return source
    fields = preset_fields(preset) if preset is not None else {}
    for overrides in (read_fields(record) if record is not None else {}, given):
        for name, value in overrides.items():
            if name in _MAPPINGS and not isinstance(value, Mapping):
                raise UsageError(f"{name} must be a mapping of channels, got {value!r}")
            fields[name] = fields.get(name, {}) | dict(value) if name in _MAPPINGS else value
        _override(fields, overrides)
        if overrides.get("truth"):
            fields["truth"] = dict(overrides["truth"])  # only one truth: replace, do not merge
    if frame is not None:
        fields["frame"] = frame
    files, fields = _open_source(source, fields, frames[0])
    _take_constant_udc(fields, files)
    Layout(**fields)  # validate the user's fields before guessing
    return assemble(files, fields, frames)


def _override(fields: dict[str, Any], later: Mapping[str, Any]) -> None:
    """Remove earlier units, converters and scales of channels that `later` converts."""
    converted = {channel: name for name in CONVERTING for channel in later.get(name, {})}
    for name in CONVERTING:
        if name in fields:
            fields[name] = {
                channel: value
                for channel, value in fields[name].items()
                if channel in later.get(name, {}) or channel not in converted
            }


def _open_source(
    source: Any, fields: dict[str, Any], default_frame: Frame
) -> tuple[Files, dict[str, Any]]:
    """Open the tables of a source, and complete the fields that the source fixes."""
    fields = dict(fields)
    if isinstance(source, str | Path):
        header = _header(fields.get("header"))
        paths = [Path(source), *(Path(name) for name in fields.get("join", []))]
        return [(path, open_tables(path, header)) for path in paths], fields
    if fields.get("join") or fields.get("header"):
        raise UsageError("join and header are for files, not for data in memory")
    if isinstance(source, Record):
        table, fields = _record_table(source, fields, default_frame)
    elif isinstance(source, tuple | list) and len(source) == 2:
        table, fields = _pair_table(source[0], source[1], fields, default_frame)
    elif hasattr(source, "columns") and hasattr(source, "__getitem__"):  # a data frame
        table = ArrayTable({str(name): source[name] for name in source.columns})
    elif isinstance(source, Mapping):
        table = ArrayTable(source)
    else:
        raise RecordError(
            f"a log is a file, a Record, a mapping of channels to arrays, or (voltage, current); "
            f"got {type(source).__name__}"
        )
    return [(table.path, [table])], fields


def _header(given: Any) -> list[str] | None:
    if given is None:
        return None
    names = [name.strip() for name in str(given).split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise RecordError(f"header {given!r}: expected different names, separated by commas")
    return names


def _channels(voltage: Any, current: Any, frame: Frame) -> dict[str, Any]:
    names = VOLTAGES[frame] + CURRENTS[frame]
    return dict(zip(names, (*voltage.T, *current.T), strict=True))


def _record_table(
    source: Record, fields: dict[str, Any], default_frame: Frame
) -> tuple[Table, dict[str, Any]]:
    frame: Frame = fields.setdefault("frame", default_frame)
    surplus = set(fields) - {"frame", "held", "start", "stop", "fit_truth"}
    if surplus or frame not in ("alphabeta", "ports"):
        raise UsageError(
            f"{', '.join(sorted(surplus)) or 'frame'}: cannot be given for a Record, which is in "
            f"αβ and fixes its layout"
        )
    fields = fields | {
        "sample_time": source.sample_time,
        "lag": "auto" if source.lag is None else source.lag,
    }
    channels = _channels(source.voltage, source.current, frame)
    if source.theta_e is not None:
        channels["theta_e"] = source.theta_e
        fields["truth"] = {"theta_e": "theta_e"}
    return ArrayTable(channels, Path("record")), fields


def _pair_table(
    voltage: Any, current: Any, fields: dict[str, Any], default_frame: Frame
) -> tuple[Table, dict[str, Any]]:
    frame: Frame = fields.setdefault("frame", default_frame)
    if frame not in ("alphabeta", "ports"):
        raise UsageError(
            f"frame {frame!r}: a pair (voltage, current) is in αβ, of three phases, or complex; "
            f"for other frames give a mapping of channels to arrays"
        )
    if "sample_time" not in fields:
        raise UsageError(
            "sample_time is missing: arrays without a time column need a sample time [s]"
        )
    u, i = alphabeta_rows("voltage", voltage), alphabeta_rows("current", current)
    if len(u) != len(i):
        raise RecordError(
            f"voltage and current must have the same number of rows, got {len(u)} and {len(i)}"
        )
    return ArrayTable(_channels(u, i, frame)), fields


def _take_constant_udc(fields: dict[str, Any], files: Files) -> None:
    """Use udc as a constant voltage if a number, not a column name, is given as its column."""
    columns = dict(fields.get("columns", {}))
    constant = columns.get("udc")
    if constant is None:
        return
    if any(str(constant) in table.columns for _, tables in files for table in tables):
        fields.pop("udc", None)
        return
    try:
        value = float(constant)
    except ValueError:
        return
    if math.isfinite(value):
        del columns["udc"]
        fields["columns"], fields["udc"] = columns, float(np.float64(value))
