"""Check of a log, and examination of the drive."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..checking.findings import Check
from ..checking.search import check_log
from ..core.output import check_new, write_text
from ..errors import FluxobsError
from ..logs.for_machine import open_for
from ..logs.log import Log
from ..logs.read import Source
from ..machines import MachineSource, RotatingMachine, as_machine, rotating
from ..observers.unknowns import ALL
from ..presentation import Result, estimate
from ..presentation.agreement import agreed
from .drive import lag_item, learnt_items, truth_items
from .item import Item
from .rest import rest_items
from .signals import (
    ROWS,
    check_converters,
    check_offsets,
    check_sampling,
    rated_current,
    read_channels,
)

if TYPE_CHECKING:
    from typing import Unpack

    from matplotlib.figure import Figure

    from ..logs.meaning.options import ReadOptions


@dataclass(frozen=True)
class Examination(Check):
    """Result of :func:`fluxobs.check`: the mistakes; on request, an examination of the drive.

    Attributes
    ----------
    findings, residual_given, residual, notes, fits
        See :class:`fluxobs.checking.findings.Check`.
    log : Log
    machine : RotatingMachine
    cold_resistance : float, optional
        Phase resistance at 20 °C [Ω].
    run : Result, optional
        Estimate of the log, of at most ROWS rows; None if it is not possible.
    """

    log: Log | None = None
    machine: RotatingMachine | None = None
    cold_resistance: float | None = None
    run: Result | None = None

    @cached_property
    def items(self) -> tuple[Item, ...]:
        """Items of the examination with value, standard deviation and verdict."""
        assert self.log is not None
        assert self.machine is not None
        log = replace(self.log, last=min(self.log.last, self.log.first + ROWS))
        channels = read_channels(log)
        rated = rated_current(self.machine, channels)
        items = [*check_converters(channels, log, rated), *check_offsets(channels, log, rated)]
        if any(finding.kind in ("columns", "angle", "machine") for finding in self.mistakes):
            words = "the log is not read correctly; correct the findings above first"
            items.append(Item("parameters of the drive", "cannot be told", words))
            return (*check_sampling(log, channels, 0.0), *items)
        result = self.run
        if result is None:
            words = "no estimate of this log is possible"
            items.append(Item("parameters of the drive", "cannot be told", words))
            return (*check_sampling(log, channels, 0.0), *items)
        series = result.statistics.thin.columns()
        valid = series["valid"] > 0
        speed = float(abs(series["speed_e"][valid]).max()) if valid.any() else 0.0
        return (
            *check_sampling(log, channels, speed),
            *items,
            *learnt_items(result, self.cold_resistance),
            lag_item(result),
            *rest_items(log, self.machine, result.scales, series),
            *truth_items(result),
        )

    @property
    def facts(self) -> dict[str, Any]:
        """Findings and items as JSON can hold them."""
        return {
            "sound": self.sound,
            "findings": [finding.facts for finding in self.findings],
            "residual_given": _finite(self.residual_given),
            "residual": _finite(self.residual),
            "notes": [*self.notes, *(self.log.notes if self.log is not None else ())],
            "items": [item.facts for item in self.items],
        }

    def _repr_html_(self) -> str:
        """Return findings and items as HTML, for a notebook."""
        from ..core.html import bullets, table

        rows = [(item.name, item.told, item.verdict, item.words) for item in self.items]
        return bullets(self.lines()) + table(("what", "value", "verdict", ""), rows)

    def plot(self) -> Figure:
        """Draw the examination."""
        from .picture import figure

        return figure(self)

    def write(self, path: str | Path, *, force: bool = False) -> None:
        """Write the examination as a picture or .html.

        Raises
        ------
        FluxobsError
            The file exists and `force` is false, or the file cannot be written.
        """
        from ..core.html import document
        from ..core.plots import HTML, REPORTS, write

        path = Path(path)
        check_new(path, REPORTS, force, "--report")
        if path.suffix.lower() != HTML:
            write(self.plot(), path)
            return
        name = "" if self.log is None else self.log.path.name
        title = f"{name}: check of the log and examination of the drive"
        write_text(path, document(title, self._repr_html_()))


def _finite(value: float | None) -> float | None:
    return value if value is not None and abs(value) < float("inf") else None


def check(
    log: Source,
    machine: MachineSource,
    *,
    cold_resistance: float | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **layout: Unpack[ReadOptions],
) -> Examination:
    """Test segments of a log for the usual mistakes.

    The columns are checked first: duplicates, raw counts, an angle in degrees, spikes. Then the
    sign of the current, the phase order, the lag, the frame, and scales of the log or of the
    machine file are checked; with a true angle, also the angle's zero and direction, and n_p.

    ``.items`` of the result are the examination of the drive: sensors, resistance and winding
    temperature, magnets, inverter, lag, encoder, sampling, each with a verdict.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, path, name of a shipped machine, or mapping of a machine file
        The machine must be a rotating one.
    cold_resistance : float, optional
        Phase resistance at 20 °C [Ω], for the winding temperature. Default: R_s of the machine.
    progress : callable, optional
        Called with the number of finished rows, or fits, and of those that are planned so far.
    layout : optional
        As for :func:`fluxobs.read_log`.

    Raises
    ------
    FluxobsError
        The machine does not rotate, or the log has too few rows without a gap.
    """
    rotating_machine = rotating(as_machine(machine), "the check of a log")
    opened_log = open_for(log, rotating_machine, **layout)
    part = replace(opened_log, last=min(opened_log.last, opened_log.first + ROWS))
    run = None
    with suppress(FluxobsError):  # nothing turns, or the log is too short
        run = estimate(part, rotating_machine, unknowns=ALL, keep=False, progress=progress)
    if run is not None and run.examined is not None and len(part) == len(opened_log):
        result = run.examined
    else:
        result = check_log(opened_log, rotating_machine, progress)
    if run is not None:
        result = agreed(result, run)
    attributes = {field.name: getattr(result, field.name) for field in fields(result)}
    return Examination(
        **attributes,
        log=opened_log,
        machine=rotating_machine,
        cold_resistance=cold_resistance,
        run=run,
    )
