"""From the desk to the drive: a folder of C that computes what the replay of a log computed."""

from .export import Export, export

__all__ = ["Export", "export"]
