"""Names of constant or slow unknowns, and the choice of the observer that estimates them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..core.validation import nearest, number
from ..errors import FluxobsError
from ..machines import Machine, RotatingMachine
from ..machines.model.immersion import UNKNOWNS as IMMERSED

#: Errors of the machine's parameters and its inverter, which the adaptive observer estimates.
ADAPTED = ("resistance", "inverter", "asymmetry")
UNKNOWNS: tuple[str, ...] = (*IMMERSED, *ADAPTED)
#: The word that lets the log choose the unknowns, and the unknowns that may be chosen.
AUTO = "auto"
ALL = ("drift", *ADAPTED)
#: Quantities whose prior standard deviation can be given.
PRIORS = ("resistance", "inverter", "asymmetry", "psi_f")


def read_unknowns(unknowns: str | Sequence[str]) -> tuple[str, ...]:
    """Return the unknowns named in ``"drift,resistance"`` or a sequence; for "auto", ("auto",).

    Raises
    ------
    FluxobsError
        A name is unknown (the message names the nearest one), or no name is given.
    """
    raw_words = unknowns.split(",") if isinstance(unknowns, str) else unknowns
    words = [word.strip() for word in raw_words if word.strip()]
    if words == [AUTO]:
        return (AUTO,)
    if AUTO in words:
        raise FluxobsError(
            f"unknowns {','.join(words)}: give {AUTO} alone, since it chooses the others"
        )
    for word in words:
        if word not in UNKNOWNS:
            allowed = (*UNKNOWNS, AUTO) if len(words) == 1 else UNKNOWNS
            raise FluxobsError(f"unknowns: unknown {word!r}{nearest(word, allowed)}")
    if not words:
        raise FluxobsError(f"unknowns: give one or more of {', '.join(UNKNOWNS)}; drift suffices")
    return tuple(name for name in UNKNOWNS if name in words)


def adapts(unknowns: Sequence[str]) -> bool:
    """Whether these unknowns need the adaptive observer."""
    return any(name in ADAPTED for name in unknowns)


def check_adapted(machine: Machine, unknowns: Sequence[str], priors: Mapping[str, float]) -> None:
    """Raise FluxobsError if the adaptive observer cannot estimate these unknowns of the machine."""
    adapted = [name for name in unknowns if name in ADAPTED]
    if adapted and not isinstance(machine, RotatingMachine):
        raise FluxobsError(
            f"kind {machine.kind}: {' and '.join(adapted)} can be estimated only for machines that "
            f"turn"
        )
    if adapted and "current-bias" in unknowns:
        raise FluxobsError(
            f"{' and '.join(adapted)} cannot be estimated together with a current bias. Use "
            f"the drift, which includes the bias's effect: unknowns drift,{','.join(adapted)}"
        )
    if adapted and "drift" not in unknowns:
        raise FluxobsError(
            f"{' and '.join(adapted)} cannot be estimated without the drift, because every sensor "
            f"has an offset; give unknowns drift,{','.join(adapted)}"
        )
    for name, std in priors.items():
        if name not in PRIORS:
            raise FluxobsError(f"prior: unknown {name!r}{nearest(name, PRIORS)}")
        if not 0 <= number(f"prior {name}", std, "SI") < float("inf"):
            raise FluxobsError(f"prior {name}={std:g}: must be finite and not negative")
        if name in ADAPTED and name not in unknowns:
            raise FluxobsError(f"prior {name}: {name} is not among the unknowns")
    if priors and not adapted:
        raise FluxobsError("prior: requires resistance or inverter among the unknowns")
