"""Recorded data: files and arrays, the meaning of their columns, and the sizes of their signals."""

from .layout import Layout
from .log import Log
from .read import Source, read_log
from .record import Record

__all__ = ["Layout", "Log", "Record", "Source", "read_log"]
