"""Export of an observer to a drive: C code that returns the same numbers as a replayed log."""

from .export import Export, export

__all__ = ["Export", "export"]
