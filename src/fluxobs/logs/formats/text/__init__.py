"""Delimited text of people and instruments."""

from .table import TextTable

__all__ = ["TextTable"]
