"""What a check finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

#: What a log without a true angle cannot show.
UNSEEN = (
    "Only a true angle (--truth) would show two phases exchanged in currents and voltages alike, "
    "a wrong n_p, or a mirrored sign of the speed."
)


def capital(text: str) -> str:
    """A sentence with its first letter large."""
    return text[:1].upper() + text[1:]


@dataclass(frozen=True)
class Finding:
    """The finding for one kind of mistake.

    Attributes
    ----------
    kind, words : str
    as_given : bool
        Whether what was given fits best, or as well as the best.
    others : tuple of str
        Alternatives that this log cannot tell from it.
    sure : str
        How sure the finding is, if that is known.
    """

    kind: str
    words: str
    as_given: bool
    others: tuple[str, ...] = ()
    sure: str = ""

    @property
    def facts(self) -> dict[str, Any]:
        """The same, for JSON."""
        return {
            "kind": self.kind,
            "words": self.words,
            "as_given": self.as_given,
            "others": list(self.others),
            "sure": self.sure,
        }

    def __str__(self) -> str:
        told = [f"Would fit as well: {'; '.join(self.others)}"] if self.others else []
        said = [self.words, *([self.sure] if self.sure else []), *told]
        mark = "" if self.as_given else "NOT as given: "
        return f"{self.kind}: {mark}" + ". ".join([said[0], *map(capital, said[1:])])


@dataclass(frozen=True)
class Check:
    """Result of :func:`fluxobs.check`.

    Attributes
    ----------
    findings : tuple of Finding
    residual_given, residual : float or None
        Rms residual of the machine's relation over the flux, as given and at best; infinite where
        the position is never known, None if it was not tried.
    notes : tuple of str
        What this log cannot show.
    fits : str
        The parameters that fit, in words.
    """

    findings: tuple[Finding, ...]
    residual_given: float | None
    residual: float | None
    notes: tuple[str, ...] = ()
    fits: str = ""

    @property
    def sound(self) -> bool:
        """Whether nothing fits better than what was given."""
        return all(finding.as_given for finding in self.findings)

    @property
    def untold(self) -> str:
        """A sentence on what this log cannot show, empty if there is nothing."""
        lag = [", ".join(one.others) for one in self.findings if one.kind == "lag" and one.others]
        parts = [f"the lag ({others} would fit as well)" for others in lag]
        parts += (
            ["the sense of rotation and n_p, without a true angle"] if UNSEEN in self.notes else []
        )
        return f"Not told by the log: {'; '.join(parts)}." if parts else ""

    @property
    def mistakes(self) -> tuple[Finding, ...]:
        """The findings that are not as given."""
        return tuple(finding for finding in self.findings if not finding.as_given)

    def lines(self) -> list[str]:
        """One finding per line, then the residual and what this log cannot show."""
        return [*(str(finding) for finding in self.findings), *self._residual(), *self.notes]

    def _residual(self) -> list[str]:
        given, best = self.residual_given, self.residual
        if best is None or given is None or not np.isfinite(best):
            return []
        tail = (
            ""
            if best == given
            else f"; as given it is {given:.1%}"
            if np.isfinite(given)
            else "; as given the position is never known"
        )
        return [f"Residual of the machine's relation: {best:.1%} of the flux{tail}."]

    def __str__(self) -> str:
        return "\n".join(self.lines())
