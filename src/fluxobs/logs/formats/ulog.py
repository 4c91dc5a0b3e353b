"""ULog (PX4), by pyulog: a table for each topic, all in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import RecordError
from .arrays import ArrayTable
from .extras import library
from .table import Said, Table

#: Most fields of all topics; a flight has some ten thousand.
FIELDS = 1 << 18
#: Most types one within the other; a type that holds itself has no end.
DEPTH = 32


def open_ulog(path: Path) -> list[Table]:
    """Tables of the topics: "topic/field", or "topic[1]/field" of a further instance."""
    pyulog = library("pyulog", "ulog", path)
    try:
        with path.open("rb") as file:
            data = _bounded(pyulog)(file).data_list
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


def _bounded(pyulog: Any) -> Any:
    """pyulog's reader, which counts the fields of topics before it lists them.

    A field may be an array of sixty thousand of a type that has such a field itself.
    """
    fields, usual = 0, pyulog.ULog._MessageAddLogged

    def list_fields(topic: Any, types: Any) -> None:
        nonlocal fields
        fields += _fields(types, topic.message_name, pyulog.ULog._UNPACK_TYPES, {}, DEPTH)
        if fields > FIELDS:  # pyulog goes on after a ValueError
            raise MemoryError(f"its topics have more than {FIELDS} fields")
        usual._parse_format(topic, types)

    made = type("Topic", (usual,), {"_parse_format": list_fields})
    return type("Reader", (pyulog.ULog,), {"_MessageAddLogged": made})


def _fields(types: Any, name: str, plain: Any, known: dict[str, int], depth: int) -> int:
    """How many fields a type has, with those of the types in it, at most `depth` levels."""
    if depth == 0:
        raise MemoryError(f"more than {DEPTH} of its types lie one within the other")
    if name not in known:
        known[name] = sum(
            max(count, 1) * (1 if kind in plain else _fields(types, kind, plain, known, depth - 1))
            for kind, count, _ in types[name].fields
        )
    return known[name]
