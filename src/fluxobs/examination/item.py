"""One line of an examination."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

Verdict = Literal["fine", "look at it", "cannot be told"]


@dataclass(frozen=True)
class Item:
    """What a log says of one thing.

    Attributes
    ----------
    name : str
    verdict : str
        "fine", "look at it", or "cannot be told" from this log.
    words : str
        What it means; where it cannot be told, which test would tell.
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
        """Value and standard deviation, in words."""
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
        """The same, for JSON."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "value": self.value,
            "std": self.std,
            "unit": self.unit,
            "words": self.words,
        }


def judged(value: float, std: float, limit: float, expected: float = 0.0) -> Verdict:
    """Whether a value lies within a limit of what is expected, as far as it is known.

    It cannot be told if its standard deviation alone exceeds the limit; it is worth a look if it is
    beyond the limit by more than two standard deviations.
    """
    off = abs(value - expected)
    if off - 2 * std > limit:
        return "look at it"
    return "fine" if 2 * std <= limit or off + 2 * std <= limit else "cannot be told"


def look_if(bad: bool) -> Verdict:
    """ "look at it" if something is bad, else "fine"."""
    return "look at it" if bad else "fine"
