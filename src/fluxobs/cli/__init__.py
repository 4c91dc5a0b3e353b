"""The command line: it reads options, calls the library, and prints what that returns."""

from .app import main

__all__ = ["main"]
