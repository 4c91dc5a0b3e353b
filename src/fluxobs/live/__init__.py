"""Live estimates of a stream from a serial port, UDP, a pipe, or a growing file.

lines.py and frames.py turn bytes into rows, reorder.py sorts the rows by time, even_rows.py spaces
them evenly, and :class:`.watch.Watch` estimates. The page runs the same modules on the bytes of a
serial port or of ``fluxobs live``.
"""

from .watch import Watch

__all__ = ["Watch"]
