"""Delimited text, written by people or instruments."""

from .table import TextTable

__all__ = ["TextTable"]
