"""Text as people and instruments write it."""

from .table import TextTable

__all__ = ["TextTable"]
