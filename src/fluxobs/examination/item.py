"""Items of an examination, and their verdicts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

Verdict = Literal["fine", "look at it", "cannot be told"]


@dataclass(frozen=True)
class Item:
    """One item of an examination.

    Attributes
    ----------
    name : str
    verdict : str
        "fine", "look at it", or "cannot be told" if this log does not determine the item.
    words : str
        Remarks; for "cannot be told", the test that would determine the item.
    value, std : float, optional
        Value and standard deviation, in `unit`.
    unit : str
    """

    name: str
    verdict: Verdict
    words: str = ""
    value: float | None = None
    std: float | None = None
    unit: str = ""

    @property
    def told(self) -> str:
        """Value and standard deviation as text."""
        if self.value is None:
            return ""
        if self.std is None or not self.std > 0:
            return f"{self.value:.4g} {self.unit}".strip()
        digits = max(0, 1 - math.floor(math.log10(self.std)))
        if abs(self.value) < 1e-6 * self.std:
            return f"0 ± {self.std:.2g} {self.unit}".strip()
        if digits > 6:
            return f"{self.value:.4g} ± {self.std:.2g} {self.unit}".strip()
        return f"{self.value:.{digits}f} ± {self.std:.{digits}f} {self.unit}".strip()

    @property
    def facts(self) -> dict[str, Any]:
        """The fields as JSON can hold them."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "value": self.value,
            "std": self.std,
            "unit": self.unit,
            "words": self.words,
        }


def judge(value: float, std: float, limit: float, expected: float = 0.0) -> Verdict:
    """Return whether a value lies within `limit` of the expected value.

    "look at it" means that the deviation exceeds the limit by more than two standard deviations,
    "cannot be told" that it may exceed the limit, or that the standard deviation is too large.
    """
    deviation = abs(value - expected)
    if deviation - 2 * std > limit:
        return "look at it"
    return "fine" if deviation <= limit and 2 * std <= limit else "cannot be told"


def flag_if(bad: bool) -> Verdict:
    """Return "look at it" if `bad`, else "fine"."""
    return "look at it" if bad else "fine"
