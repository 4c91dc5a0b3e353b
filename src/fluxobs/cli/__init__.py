"""The command line: read options, call the library, print the result."""

from .app import main

__all__ = ["main"]
