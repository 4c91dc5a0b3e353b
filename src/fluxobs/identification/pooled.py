"""Identification of one machine from many logs, and the logs that disagree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.engine import LOCAL, compute
from ..core.hashing import hash_file
from ..errors import FluxobsError
from ..logs.for_machine import open_for
from ..logs.read import Source
from ..machines import Machine, MachineSource, as_machine, rotating
from ..machines.heat import COPPER, NEODYMIUM
from .identify import Identification, combine, identify, read_free

if TYPE_CHECKING:
    from typing import Unpack

    from ..logs.meaning.options import ReadOptions

#: A log disagrees if a parameter differs from that of the other logs by this many standard
#: deviations and by this share: smaller differences do not matter in practice.
DISAGREES, MATTERS = 4.0, 0.01
#: Share of a standard deviation that differs from log to log. Most of it comes from the sensors,
#: the inverter and the machine file, which the logs share. With the whole deviation, a winding that
#: is 50 K hotter than in five other logs is not found (tests/identification/test_pooled.py).
INDEPENDENT = 1 / 3


@dataclass(frozen=True)
class LogFit:
    """Parameters identified from one log alone.

    Attributes
    ----------
    log : str
    told : dict
        Name → value and standard deviation.
    failed : str
        Why no parameter could be identified; empty if at least one parameter was.
    apart : dict
        Name → (difference from the other logs, difference in standard deviations), of parameters
        that disagree.
    """

    log: str
    told: dict[str, tuple[float, float]]
    failed: str
    apart: dict[str, tuple[float, float]]

    @property
    def words(self) -> str:
        """How the log differs from the other logs, and the likely cause; or why its fit failed."""
        if self.failed:
            return f"{self.log}: no parameter can be identified: {self.failed}"
        differences = []
        for name, (difference, sigmas) in self.apart.items():
            value = self.told[name][0]
            base = value - difference
            share = f" ({100 * difference / base:+.1f} %)" if base else ""
            differences.append(
                f"{name} = {value:.4g}, {sigmas:.0f} standard deviations from the others{share}"
            )
        return f"{self.log}: {'; '.join(differences)}{_likely_cause(self)}"


def _likely_cause(log_fit: LogFit) -> str:
    """Return the likely cause of the differences, as the end of a sentence."""
    share = {
        name: difference / (log_fit.told[name][0] - difference)
        for name, (difference, _) in log_fit.apart.items()
        if log_fit.told[name][0] != difference
    }
    R, psi = share.get("R_s"), share.get("psi_f")
    inductances = [name for name in share if name.startswith("L_")]
    if inductances:
        return "; likely cause: another motor, or other saturation"
    if R is not None and psi is None and "psi_f" in log_fit.told:
        return (
            f"; likely cause: copper {R / COPPER:+.0f} K with unchanged magnets, or a bad contact"
        )
    if R is not None and psi is None:
        return f"; likely cause: copper {R / COPPER:+.0f} K"
    if R is not None and psi is not None and R * psi < 0:
        return f"; likely cause: heat, copper {R / COPPER:+.0f} K, magnets {psi / NEODYMIUM:+.0f} K"
    if psi is not None:
        return "; likely cause: another motor, or changed magnets"
    return ""


@dataclass(frozen=True, eq=False)
class Pooled:
    """One machine identified from many logs.

    Attributes
    ----------
    together : Identification
        The parameters of the machine from all usable logs.
    alone : tuple of LogFit
        Identification from each log alone, in the given order.
    twice : dict
        Ignored log → log with the same content.
    """

    together: Identification
    alone: tuple[LogFit, ...]
    twice: dict[str, str]

    @property
    def failed(self) -> tuple[LogFit, ...]:
        """Logs from which no parameter can be identified."""
        return tuple(log for log in self.alone if log.failed)

    @property
    def machine(self) -> Machine:
        return self.together.machine

    @property
    def disagreeing(self) -> tuple[LogFit, ...]:
        """Logs that disagree with the others."""
        return tuple(log for log in self.alone if log.apart)

    @property
    def facts(self) -> dict[str, Any]:
        """The results as JSON can hold them."""
        return self.together.facts | {
            "logs": [
                {
                    "log": log.log,
                    "told": {name: list(pair) for name, pair in log.told.items()},
                    "failed": log.failed or None,
                    "apart": {name: list(pair) for name, pair in log.apart.items()},
                }
                for log in self.alone
            ],
            "twice": self.twice,
        }

    def lines(self) -> list[str]:
        """Return lines on the machine, then lines on the logs that disagree or failed."""
        lines = self.together.lines()
        failed = self.failed
        lines += [
            f"{copy} is a copy of {first}: it counts once" for copy, first in self.twice.items()
        ]
        lines += [f"Disagrees with the others: {log.words}" for log in self.disagreeing]
        lines += [f"Not usable: {log.words}" for log in failed]
        useful = len(self.alone) - len(failed)
        if useful == 1:
            lines.append("Only one log is usable: there is no other to compare it with")
        elif not self.disagreeing:
            lines.append(f"{useful} logs agree")
        return lines


def identify_many(
    logs: Sequence[str | Path],
    machine: MachineSource,
    *,
    free: str | Sequence[str] | None = None,
    workers: int | None = None,
    scheduler: str = LOCAL,
    progress: Callable[[int, int], Any] = lambda done, total: None,
    **layout: Unpack[ReadOptions],
) -> Pooled:
    """Identify one machine from many logs, and find the logs that disagree.

    Parameters
    ----------
    logs : sequence of paths
        At least two logs with different content; copies count once.
    machine, free, layout
        See :func:`fluxobs.identify`.
    workers, scheduler
        How to compute the fits of single logs; see :func:`fluxobs.core.engine.compute`.
    progress : callable
        Called with the number of finished fits and the number of all fits.

    Raises
    ------
    FluxobsError
        There is only one log, no log is usable, or the logs together identify no parameter.
    """
    rotating_machine = rotating(as_machine(machine), "identification")
    names = read_free(free, rotating_machine)
    twice = find_copies(logs)
    paths = [path for path in map(str, logs) if path not in twice]
    if len(paths) < 2:
        raise FluxobsError(
            f"{paths[0]}: all other logs are copies of this one; give other logs of this machine"
        )
    total = len(paths) + 1
    progress(0, total)
    fit_log = _FitLog(rotating_machine, names, dict(layout))
    fits: dict[str, tuple[dict[str, tuple[float, float]], str]] = {}
    for path, fit in compute(paths, fit_log, workers, scheduler, _report_lost_worker):
        fits[path] = fit
        progress(len(fits), total)
    useful: list[Source] = [path for path in paths if fits[path][0]]
    if not useful:
        reasons = "; ".join(f"{Path(path).name}: {why}" for path, (_, why) in fits.items())
        raise FluxobsError(f"none of {len(paths)} logs identifies a parameter ({reasons})")
    together = combine(
        [open_for(path, rotating_machine, **layout) for path in useful],
        rotating_machine,
        names,
        [fits[path][0] for path in paths if fits[path][0]],
    )
    progress(total, total)
    told_by = {path: fit for path, (fit, _) in fits.items()}
    alone = tuple(
        LogFit(Path(path).name, told_by[path], fits[path][1], _find_differences(path, told_by))
        for path in paths
    )
    return Pooled(together, alone, twice)


def find_copies(logs: Sequence[str | Path]) -> dict[str, str]:
    """Return copies: log → earlier log with the same content."""
    path_by_content: dict[str, str] = {}
    copies = {}
    for path in map(str, logs):
        try:
            content = hash_file(Path(path))
        except FluxobsError:  # the fit of an unreadable log reports the error
            continue
        if content in path_by_content:
            copies[path] = path_by_content[content]
        else:
            path_by_content[content] = path
    return copies


@dataclass(frozen=True)
class _FitLog:
    """Function that fits one log, as an object that can be sent to workers."""

    machine: Machine
    free: tuple[str, ...]
    layout: dict[str, Any]

    def __call__(self, path: str) -> tuple[dict[str, tuple[float, float]], str]:
        try:
            identification = identify(path, self.machine, free=self.free, **self.layout)
        except FluxobsError as error:
            return {}, str(error)
        told = {p.name: (p.value, p.std) for p in identification.parameters if p.std is not None}
        return told, ""


def _report_lost_worker(path: str) -> tuple[dict[str, tuple[float, float]], str]:
    return {}, f"{path}: the worker died five times on this log; use fewer workers"


def _find_differences(
    path: str, told: Mapping[str, Mapping[str, tuple[float, float]]]
) -> dict[str, tuple[float, float]]:
    """Return the parameters of a log that differ from the median of the other logs.

    The limit includes the scatter of the other logs; median and scatter are robust, so a second log
    that disagrees does not shift them.
    """
    differences = {}
    for name, (value, std) in told[path].items():
        others = [
            parameters[name]
            for other, parameters in told.items()
            if other != path and name in parameters
        ]
        if not others:
            continue
        values = np.array([v for v, _ in others])
        median = float(np.median(values))
        spread = 1.4826 * float(np.median(np.abs(values - median)))
        median_std = INDEPENDENT * float(np.median([s for _, s in others])) / np.sqrt(len(others))
        difference = value - median
        sigmas = abs(difference) / float(
            np.sqrt((INDEPENDENT * std) ** 2 + spread**2 + median_std**2)
        )
        if sigmas > DISAGREES and abs(difference) > MATTERS * abs(median):
            differences[name] = (difference, sigmas)
    return differences
