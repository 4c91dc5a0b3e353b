"""Results of an estimate as a person reads them: summary, warnings, picture, report, files."""

from .estimate import estimate
from .result import Result

__all__ = ["Result", "estimate"]
