"""The command line: it reads options, calls the library, and prints the result."""

from .app import main

__all__ = ["main"]
