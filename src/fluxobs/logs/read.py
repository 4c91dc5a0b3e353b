"""Open a log from a file, a record, or arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RecordError, UsageError
from ..model.frames import CURRENTS, VOLTAGES, Frame
from .formats import open_table
from .formats.arrays import ArrayTable
from .formats.table import Table
from .layout import Layout, read_fields
from .log import Log, open_log
from .record import Record, alphabeta_rows

#: What :func:`read_log` takes: a file; a log or a record; a mapping of channels (or columns) to
#: arrays, such as a data frame; or a pair (voltage, current) of arrays.
Source = str | Path | Log | Record | Mapping[str, Any] | tuple[Any, Any]

#: Fields of a layout that are mappings: options add to those of a record file.
_MAPPINGS = ("columns", "scale", "offset", "truth")


def read_log(
    source: Any,
    *,
    record: str | Path | None = None,
    frame: Frame | None = None,
    default_frame: Frame = "alphabeta",
    **layout: Any,
) -> Log:
    """Open a log. Only its head is read at this point.

    Parameters
    ----------
    source : path, Log, Record, mapping of str to array, or (voltage, current)
        A CSV (any delimiter), Parquet or npz file, or data in memory. A pair of arrays is as for
        :class:`Record`: (rows, 2) in αβ, (rows, 3) of three phases, or (rows,) complex.
    record : path, optional
        TOML with the fields of :class:`Layout`; arguments given here override it.
    frame : str, optional
    default_frame : str
        Used if neither `record` nor `frame` gives a frame.
    sample_time, lag, held, udc, columns, scale, offset, truth, start, stop : optional
        Fields of :class:`Layout`. A number as the column of udc is a constant DC-link voltage.

    Returns
    -------
    Log

    Raises
    ------
    RecordError
        The source cannot be read, or lacks what the layout names; the message says what and where.
    UsageError
        A layout is given for a log or a record, which already has one.

    Examples
    --------
    >>> import numpy as np
    >>> t = 1e-4 * np.arange(100)
    >>> log = read_log({"t": t, "u_a": t, "u_b": t, "u_c": t, "i_a": t, "i_b": t}, frame="abc")
    >>> len(log), log.sample_time
    (100, 0.0001)
    """
    given = {name: value for name, value in layout.items() if value is not None}
    if isinstance(source, Log):
        if given or record is not None or frame is not None:
            raise UsageError(
                f"{', '.join(given) or 'record or frame'}: the log is open already; give its "
                f"layout to read_log"
            )
        return source
    fields = read_fields(record) if record is not None else {}
    for name, value in given.items():
        fields[name] = fields.get(name, {}) | dict(value) if name in _MAPPINGS else value
    if layout.get("truth"):
        fields["truth"] = dict(layout["truth"])  # there is only one truth: replace it
    if frame is not None:
        fields["frame"] = frame
    fields.setdefault("frame", default_frame)
    table, fields = _table(source, fields)
    _take_constant_udc(fields, table)
    return open_log(table, Layout(**fields))


def _table(source: Any, fields: dict[str, Any]) -> tuple[Table, dict[str, Any]]:
    """The table, and the fields, completed by what the source itself says."""
    if isinstance(source, str | Path):
        return open_table(source), fields
    if isinstance(source, Record):
        return _record_table(source, fields)
    if isinstance(source, tuple | list) and len(source) == 2:
        return _pair_table(source[0], source[1], fields)
    if hasattr(source, "columns") and hasattr(source, "__getitem__"):  # a data frame
        return ArrayTable({str(name): source[name] for name in source.columns}), fields
    if isinstance(source, Mapping):
        return ArrayTable(source), fields
    raise RecordError(
        f"a log is a file, a Record, a mapping of channels to arrays, or (voltage, current); got "
        f"{type(source).__name__}"
    )


def _channels(voltage: Any, current: Any, frame: Frame) -> dict[str, Any]:
    names = VOLTAGES[frame] + CURRENTS[frame]
    return dict(zip(names, (*voltage.T, *current.T), strict=True))


def _record_table(source: Record, fields: dict[str, Any]) -> tuple[Table, dict[str, Any]]:
    surplus = set(fields) - {"frame", "held", "start", "stop"}
    if surplus or fields["frame"] not in ("alphabeta", "ports"):
        raise UsageError(
            f"{', '.join(sorted(surplus)) or 'frame'}: already fixed in a Record, which is in αβ"
        )
    fields = fields | {"sample_time": source.sample_time, "lag": source.lag}
    channels = _channels(source.voltage, source.current, fields["frame"])
    if source.theta_e is not None:
        channels["theta_e"] = source.theta_e
        fields["truth"] = {"theta_e": "theta_e"}
    return ArrayTable(channels, Path("record")), fields


def _pair_table(voltage: Any, current: Any, fields: dict[str, Any]) -> tuple[Table, dict[str, Any]]:
    if fields.get("frame") not in ("alphabeta", "ports"):
        raise UsageError(
            f"frame {fields['frame']!r}: a pair (voltage, current) is in αβ, of three phases, or "
            f"complex; for other frames give a mapping of channels to arrays"
        )
    if "sample_time" not in fields:
        raise UsageError("sample_time is missing: arrays without a time column need it [s]")
    u, i = alphabeta_rows("voltage", voltage), alphabeta_rows("current", current)
    if len(u) != len(i):
        raise RecordError(f"voltage and current must have as many rows, got {len(u)} and {len(i)}")
    return ArrayTable(_channels(u, i, fields["frame"])), fields


def _take_constant_udc(fields: dict[str, Any], table: Table) -> None:
    """Take a udc column that is a number, and not a column's name, as a constant voltage."""
    columns = dict(fields.get("columns", {}))
    constant = columns.get("udc")
    if constant is None:
        return
    if str(constant) in table.columns:
        fields.pop("udc", None)
        return
    try:
        value = float(constant)
    except ValueError:
        return
    if math.isfinite(value):
        del columns["udc"]
        fields["columns"], fields["udc"] = columns, float(np.float64(value))
