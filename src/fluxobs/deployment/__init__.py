"""From the desk to the drive: a folder of C that does what the log replay did."""

from .export import Export, export

__all__ = ["Export", "export"]
