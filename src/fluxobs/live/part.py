"""Rows of a stream, as they arrived."""

from __future__ import annotations

from typing import NamedTuple

from ..logs.formats.table import Columns


class Part(NamedTuple):
    """Some rows: their columns as they were sent, and their lines if the stream is text."""

    columns: Columns
    lines: bytes
