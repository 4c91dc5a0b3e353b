"""Recorded data: files and arrays, the meaning of the columns, and the sizes of the signals."""

from .log import Log
from .meaning.layout import Layout
from .read import Source, read_log
from .record import Record

__all__ = ["Layout", "Log", "Record", "Source", "read_log"]
