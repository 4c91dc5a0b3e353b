"""Recorded data: files and arrays, what their columns mean, and what the signals are like."""

from .layout import Layout
from .log import Log
from .read import Source, read_log
from .record import Record

__all__ = ["Layout", "Log", "Record", "Source", "read_log"]
