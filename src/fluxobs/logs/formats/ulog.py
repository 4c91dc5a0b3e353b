"""ULog files (PX4), read into memory with pyulog: one table per topic."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import RecordError
from .arrays import ArrayTable
from .extras import library
from .table import Said, Table

#: Largest number of fields of all topics; the log of a flight has about ten thousand.
FIELDS = 1 << 18
#: Deepest nesting of types; a type that contains itself is nested without end.
DEPTH = 32


def open_ulog(path: Path) -> list[Table]:
    """Open the tables of the topics. Columns are "topic/field", or "topic[1]/field" for a second
    instance of a topic.
    """
    pyulog = library("pyulog", "ulog", path)
    try:
        with path.open("rb") as file:
            data = _limited_reader(pyulog)(file).data_list
    except Exception as error:  # pyulog raises many kinds of errors for a broken file
        raise RecordError(f"{path}: not a readable ULog file: {error}") from None
    tables: list[Table] = []
    for topic in data:
        name = topic.name if topic.multi_id == 0 else f"{topic.name}[{topic.multi_id}]"
        table = ArrayTable(
            {f"{name}/{field}": values for field, values in topic.data.items()}, path
        )
        time = f"{name}/timestamp"
        table.said = Said({time: "us"}, time)
        tables.append(table)
    return tables


def _limited_reader(pyulog: Any) -> Any:
    """Return pyulog's reader, but with a limit on the number of fields, checked before listing.

    Nested types could have very many fields: a field may be an array of sixty thousand elements,
    and the type of an element may have such an array again.
    """
    fields, topic_class = 0, pyulog.ULog._MessageAddLogged

    def list_fields(topic: Any, types: Any) -> None:
        nonlocal fields
        fields += _count_fields(types, topic.message_name, pyulog.ULog._UNPACK_TYPES, {}, DEPTH)
        if fields > FIELDS:  # pyulog ignores a ValueError
            raise MemoryError(f"its topics have more than {FIELDS} fields")
        topic_class._parse_format(topic, types)

    limited_class = type("Topic", (topic_class,), {"_parse_format": list_fields})
    return type("Reader", (pyulog.ULog,), {"_MessageAddLogged": limited_class})


def _count_fields(types: Any, name: str, basic: Any, counts: dict[str, int], depth: int) -> int:
    """Count the fields of a type, including those of nested types up to `depth` levels."""
    if depth == 0:
        raise MemoryError(f"its types are nested more than {DEPTH} levels deep")
    if name not in counts:
        counts[name] = sum(
            max(count, 1)
            * (1 if kind in basic else _count_fields(types, kind, basic, counts, depth - 1))
            for kind, count, _ in types[name].fields
        )
    return counts[name]
