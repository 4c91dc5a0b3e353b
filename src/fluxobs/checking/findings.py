"""Findings of a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

#: Note on a log without a true angle.
UNSEEN = (
    "Only a true angle (--truth) can reveal two phases exchanged in both currents and voltages, a "
    "wrong n_p, or a reversed sign of the speed."
)


def capitalise(text: str) -> str:
    """Return the text with a capital first letter."""
    return text[:1].upper() + text[1:]


@dataclass(frozen=True)
class Finding:
    """The finding for one kind of mistake.

    Attributes
    ----------
    kind, words : str
        The kind of mistake, and the finding as text.
    as_given : bool
        Whether the given value fits best, or as well as another value.
    others : tuple of str
        Alternatives that fit this log equally well.
    sure : str
        How certain the finding is, if known.
    """

    kind: str
    words: str
    as_given: bool
    others: tuple[str, ...] = ()
    sure: str = ""

    @property
    def facts(self) -> dict[str, Any]:
        """The fields, in types that JSON can hold."""
        return {
            "kind": self.kind,
            "words": self.words,
            "as_given": self.as_given,
            "others": list(self.others),
            "sure": self.sure,
        }

    def __str__(self) -> str:
        others = [f"Fits equally well: {'; '.join(self.others)}"] if self.others else []
        sentences = [self.words, *([self.sure] if self.sure else []), *others]
        mark = "" if self.as_given else "NOT as given: "
        return f"{self.kind}: {mark}" + ". ".join([sentences[0], *map(capitalise, sentences[1:])])


@dataclass(frozen=True)
class Check:
    """Result of :func:`fluxobs.check`.

    Attributes
    ----------
    findings : tuple of Finding
    residual_given, residual : float or None
        Rms residual of the machine's relation as a share of the flux, with the log as given and
        with the best explanation. Infinite if the position is never known, None if not computed.
    notes : tuple of str
        What this log cannot show.
    fits : str
        The parameter values that fit best, as text.
    factors : tuple of float, optional
        R_s, the inductances and the magnet flux that fit best, over those of the machine file.
    rearranged : bool
        Whether the best explanation exchanges, turns or reverses the vectors, and reduces the
        residual to a small part: then no estimate of the log as given is right.
    """

    findings: tuple[Finding, ...]
    residual_given: float | None
    residual: float | None
    notes: tuple[str, ...] = ()
    fits: str = ""
    factors: tuple[float, float, float] | None = None
    rearranged: bool = False

    @property
    def sound(self) -> bool:
        """Whether no correction of the log or the machine fits better."""
        return all(finding.as_given for finding in self.findings)

    @property
    def mistakes(self) -> tuple[Finding, ...]:
        """The findings that contradict the log or machine as given."""
        return tuple(finding for finding in self.findings if not finding.as_given)

    def lines(self) -> list[str]:
        """Return one finding per line, then the residual and the notes."""
        return [*(str(finding) for finding in self.findings), *self._residual_line(), *self.notes]

    def _residual_line(self) -> list[str]:
        given, best = self.residual_given, self.residual
        if best is None or given is None or not np.isfinite(best):
            return []
        suffix = (
            ""
            if f"{best:.1%}" == f"{given:.1%}"
            else f"; as given, it is {given:.1%}"
            if np.isfinite(given)
            else "; as given, the position is never known"
        )
        return [f"Residual of the machine's relation: {best:.1%} of the flux{suffix}."]

    def __str__(self) -> str:
        return "\n".join(self.lines())
