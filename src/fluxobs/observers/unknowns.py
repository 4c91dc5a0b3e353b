"""The words for constant or slow unknowns, and which observer finds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..core.validation import nearest, number
from ..errors import FluxobsError
from ..machines import Machine, RotatingMachine
from ..machines.model.immersion import UNKNOWNS as IN_THE_IMMERSION

#: Errors of the machine's parameters and of its inverter, found by the adaptive observer.
ADAPTED = ("resistance", "inverter", "asymmetry")
UNKNOWNS: tuple[str, ...] = (*IN_THE_IMMERSION, *ADAPTED)
#: The word for what the log supports, and all that it may take.
AUTO = "auto"
ALL = ("drift", *ADAPTED)
#: Quantities for which a standard deviation can be given.
PRIORS = ("resistance", "inverter", "asymmetry", "psi_f")


def read_unknowns(unknowns: str | Sequence[str]) -> tuple[str, ...]:
    """Unknowns from ``"drift,resistance"``, or a sequence of such words; ("auto",) from "auto".

    Raises
    ------
    FluxobsError
        A word is not known (the message names the nearest known one), or there is none.
    """
    given = unknowns.split(",") if isinstance(unknowns, str) else unknowns
    words = [word.strip() for word in given if word.strip()]
    if words == [AUTO]:
        return (AUTO,)
    if AUTO in words:
        raise FluxobsError(f"unknowns {','.join(words)}: {AUTO} stands alone, it chooses the rest")
    for word in words:
        if word not in UNKNOWNS:
            known = (*UNKNOWNS, AUTO) if len(words) == 1 else UNKNOWNS
            raise FluxobsError(f"unknowns: unknown {word!r}{nearest(word, known)}")
    if not words:
        raise FluxobsError(f"unknowns: give some of {', '.join(UNKNOWNS)}; drift serves")
    return tuple(name for name in UNKNOWNS if name in words)


def adapts(unknowns: Sequence[str]) -> bool:
    """Whether these unknowns need the adaptive observer."""
    return any(name in ADAPTED for name in unknowns)


def check_adapted(machine: Machine, unknowns: Sequence[str], priors: Mapping[str, float]) -> None:
    """Raise FluxobsError if the adaptive observer cannot find these unknowns on this machine."""
    found = [name for name in unknowns if name in ADAPTED]
    if found and not isinstance(machine, RotatingMachine):
        raise FluxobsError(
            f"kind {machine.kind}: {' and '.join(found)} can be found only for machines that turn"
        )
    if found and "current-bias" in unknowns:
        raise FluxobsError(
            f"{' and '.join(found)} cannot be found together with a current bias, only with the "
            f"drift, which includes the effect of a current bias (unknowns drift,{','.join(found)})"
        )
    if found and "drift" not in unknowns:
        raise FluxobsError(
            f"{' and '.join(found)} without the drift: every sensor has an offset, so the drift is "
            f"always found too; give unknowns drift,{','.join(found)}"
        )
    for name, std in priors.items():
        if name not in PRIORS:
            raise FluxobsError(f"prior: unknown {name!r}{nearest(name, PRIORS)}")
        if not 0 <= number(f"prior {name}", std, "SI") < float("inf"):
            raise FluxobsError(f"prior {name}={std:g}: must be finite and not negative")
        if name in ADAPTED and name not in unknowns:
            raise FluxobsError(f"prior {name}: {name} is not among the unknowns")
    if priors and not found:
        raise FluxobsError("prior: needs resistance or inverter among the unknowns")
