"""ULog (PX4), by pyulog: a table for each topic, all in memory."""

from __future__ import annotations

from pathlib import Path

from ...errors import RecordError
from .arrays import ArrayTable
from .extras import library
from .table import Said, Table


def open_ulog(path: Path) -> list[Table]:
    """Tables of the topics: "topic/field", or "topic[1]/field" of a further instance."""
    pyulog = library("pyulog", "ulog", path)
    try:
        with path.open("rb") as file:
            data = pyulog.ULog(file).data_list
    except Exception as error:  # pyulog raises many kinds for a broken file
        raise RecordError(f"{path}: not a readable ULog file: {error}") from None
    out: list[Table] = []
    for topic in data:
        name = topic.name if topic.multi_id == 0 else f"{topic.name}[{topic.multi_id}]"
        table = ArrayTable({f"{name}/{key}": values for key, values in topic.data.items()}, path)
        time = f"{name}/timestamp"
        table.said = Said({time: "us"}, time)
        out.append(table)
    return out
