"""Estimates of a stream while it comes: from a serial port, UDP, a pipe, or a file that grows.

Bytes become rows (lines.py, frames.py), rows come into order (reorder.py) and get even times
(even_rows.py), and :class:`.watch.Watch` estimates. The page runs the same modules on what a serial
port or ``fluxobs live`` sends it.
"""

from .watch import Watch

__all__ = ["Watch"]
