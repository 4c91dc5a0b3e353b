"""One machine from many logs, and which of the logs disagrees with the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.engine import LOCAL, compute
from ..core.hashing import hash_file
from ..errors import FluxobsError
from ..logs.for_machine import open_for
from ..logs.read import Source
from ..machines import Machine, as_machine, rotating
from ..machines.heat import COPPER, NEODYMIUM
from .identify import Identification, identify, identify_logs, read_free

#: A log disagrees if a parameter is this many standard deviations from that of the others, and by
#: this share of it: what is surely different but by less matters to nobody.
DISAGREES, MATTERS = 4.0, 0.01


@dataclass(frozen=True)
class Alone:
    """What one of the logs tells by itself.

    Attributes
    ----------
    log : str
    told : dict
        Name → value and standard deviation.
    failed : str
        Why it tells nothing; empty if it does.
    apart : dict
        Name → by how much it is off the others, and by how many standard deviations; of those that
        disagree.
    """

    log: str
    told: dict[str, tuple[float, float]]
    failed: str
    apart: dict[str, tuple[float, float]]

    @property
    def words(self) -> str:
        """What is unlike the others, and what it may be."""
        if self.failed:
            return f"{self.log}: alone it tells nothing: {self.failed}"
        off = []
        for name, (by, sigmas) in self.apart.items():
            value = self.told[name][0]
            base = value - by
            share = f" ({100 * by / base:+.1f} %)" if base else ""
            off.append(f"{name} = {value:.4g}, {sigmas:.0f} standard deviations off{share}")
        return f"{self.log}: {'; '.join(off)}{_cause(self)}"


def _cause(one: Alone) -> str:
    """What the differences may come from."""
    share = {
        name: by / (one.told[name][0] - by)
        for name, (by, _) in one.apart.items()
        if one.told[name][0] != by
    }
    R, psi = share.get("R_s"), share.get("psi_f")
    moved = [name for name in share if name.startswith("L_")]
    if moved:
        return ": another motor, or another saturation"
    if R is not None and psi is None and "psi_f" in one.told:
        return f": as copper {R / COPPER:+.0f} K would, the magnets as they were; or a contact"
    if R is not None and psi is None:
        return f": as copper {R / COPPER:+.0f} K would"
    if R is not None and psi is not None and R * psi < 0:
        return f": as heat would, copper {R / COPPER:+.0f} K and magnets {psi / NEODYMIUM:+.0f} K"
    if psi is not None:
        return ": another motor, or magnets that changed"
    return ""


@dataclass(frozen=True, eq=False)
class Pooled:
    """One machine from many logs.

    Attributes
    ----------
    together : Identification
        From pieces of all logs that have usable ones.
    alone : tuple of Alone
        Every log by itself, in the order given.
    twice : dict
        Logs that are not taken, as they have the content of another → that one.
    """

    together: Identification
    alone: tuple[Alone, ...]
    twice: dict[str, str]

    @property
    def failed(self) -> tuple[Alone, ...]:
        """Logs that tell nothing."""
        return tuple(one for one in self.alone if one.failed)

    @property
    def machine(self) -> Machine:
        return self.together.machine

    @property
    def disagreeing(self) -> tuple[Alone, ...]:
        """Logs that are unlike the others."""
        return tuple(one for one in self.alone if one.apart)

    @property
    def facts(self) -> dict[str, Any]:
        """What was found, as JSON can hold it."""
        return self.together.facts | {
            "logs": [
                {
                    "log": one.log,
                    "told": {name: list(pair) for name, pair in one.told.items()},
                    "failed": one.failed or None,
                    "apart": {name: list(pair) for name, pair in one.apart.items()},
                }
                for one in self.alone
            ],
            "twice": self.twice,
        }

    def lines(self) -> list[str]:
        """The machine, then the logs that disagree or tell nothing."""
        out = self.together.lines()
        failed = self.failed
        out += [f"{one} is {first} again: it counts once" for one, first in self.twice.items()]
        out += [f"Unlike the others: {one.words}" for one in self.disagreeing]
        out += [f"Of no use: {one.words}" for one in failed]
        useful = len(self.alone) - len(failed)
        if useful == 1:
            out.append("Only one log is left: there is nothing to compare it with")
        elif not self.disagreeing:
            out.append(f"{useful} logs agree")
        return out


def identify_many(
    logs: Sequence[str | Path],
    machine: Machine | str | Path,
    *,
    free: str | Sequence[str] | None = None,
    workers: int | None = None,
    scheduler: str = LOCAL,
    progress: Callable[[int, int], Any] = lambda done, total: None,
    **layout: Any,
) -> Pooled:
    """Fit one machine to pieces of many logs, and say which log disagrees.

    Parameters
    ----------
    logs : sequence of paths
        At least two of different content; one that stands there twice counts once.
    machine, free, layout
        See :func:`fluxobs.identify`.
    workers, scheduler
        For the fits of each log alone; see :func:`fluxobs.core.engine.compute`.
    progress : callable
        Called with the number of fits done, and of all.

    Raises
    ------
    FluxobsError
        There is one log only, none is of any use, or together they do not tell the parameters.
    """
    given = rotating(as_machine(machine), "identification")
    names = read_free(free, given)
    twice = copies(logs)
    paths = [path for path in map(str, logs) if path not in twice]
    if len(paths) < 2:
        raise FluxobsError(f"{paths[0]}: one log, and copies of it; give others of this machine")
    total = len(paths) + 1
    progress(0, total)
    work = _Each(given, names, dict(layout))
    found: dict[str, tuple[dict[str, tuple[float, float]], str]] = {}
    for path, told in compute(paths, work, workers, scheduler, _lost):
        found[path] = told
        progress(len(found), total)
    useful: list[Source] = [path for path in paths if found[path][0]]
    if not useful:
        reasons = "; ".join(f"{Path(path).name}: {why}" for path, (_, why) in found.items())
        raise FluxobsError(f"none of {len(paths)} logs tells anything ({reasons})")
    together = identify_logs([open_for(one, given, **layout) for one in useful], given, names)
    progress(total, total)
    told_by = {path: told for path, (told, _) in found.items()}
    alone = tuple(
        Alone(Path(path).name, told_by[path], found[path][1], _apart(path, told_by))
        for path in paths
    )
    return Pooled(together, alone, twice)


def copies(logs: Sequence[str | Path]) -> dict[str, str]:
    """Logs that have the content of an earlier one → that one."""
    first: dict[str, str] = {}
    out = {}
    for path in map(str, logs):
        try:
            content = hash_file(Path(path))
        except FluxobsError:  # its fit says so
            continue
        if content in first:
            out[path] = first[content]
        else:
            first[content] = path
    return out


@dataclass(frozen=True)
class _Each:
    """The fit of one log alone; as a function it is sent to the workers."""

    machine: Machine
    free: tuple[str, ...]
    layout: dict[str, Any]

    def __call__(self, path: str) -> tuple[dict[str, tuple[float, float]], str]:
        try:
            found = identify(path, self.machine, free=self.free, **self.layout)
        except FluxobsError as error:
            return {}, str(error)
        told = {one.name: (one.value, one.std) for one in found.parameters if one.std is not None}
        return told, ""


def _lost(path: str) -> tuple[dict[str, tuple[float, float]], str]:
    return {}, f"{path}: its worker died five times; take fewer workers"


def _apart(
    path: str, told: Mapping[str, Mapping[str, tuple[float, float]]]
) -> dict[str, tuple[float, float]]:
    """Parameters of a log that are off those of the others: their median, which one more log that
    disagrees does not move, and what they scatter by."""
    out = {}
    for name, (value, std) in told[path].items():
        others = [one[name] for other, one in told.items() if other != path and name in one]
        if not others:
            continue
        values = np.array([v for v, _ in others])
        middle = float(np.median(values))
        spread = 1.4826 * float(np.median(np.abs(values - middle)))
        usual = float(np.median([s for _, s in others])) / np.sqrt(len(others))
        by = value - middle
        sigmas = abs(by) / float(np.sqrt(std**2 + spread**2 + usual**2))
        if sigmas > DISAGREES and abs(by) > MATTERS * abs(middle):
            out[name] = (by, sigmas)
    return out
