"""Live estimates in the terminal: the latest values, each with a sparkline."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from typing import Any

import numpy as np

from ..core.printable import visible
from ..estimation.columns import EstimateRows
from ..machines import Machine
from .sources import Source
from .watch import Watch

#: Seconds between updates of the table on a terminal, between lines in a pipe, and without rows
#: until a note reports this.
UPDATE, LINE, SILENT = 0.1, 1.0, 2.0
#: Note shown while no row is valid.
UNKNOWN = "not valid yet: if this lasts, record the stream (--save) and run `fluxobs check`"
_BLOCKS = "▁▂▃▄▅▆▇█"
_STRIP = 40


class Terminal:
    """Live display of a stream: a table on a terminal, one line a second in a pipe.

    Parameters
    ----------
    watch : Watch
    source : Source
    """

    def __init__(self, watch: Watch, source: Source) -> None:
        self.watch, self.source = watch, source
        self._last: dict[str, float] = {}
        self._strips: dict[str, deque[float]] = {}
        self._drawn = 0.0
        self._last_arrival = 0.0  # time of the last rows [s]
        self._rows = self._valid = 0  # counts since the last update
        self._line = ""
        self._live: Any = None
        self._notes_printed = False
        self._units = {name: unit for name, unit, _ in shown(watch.machine)}

    def __enter__(self) -> Terminal:
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(self._table(), refresh_per_second=1 / UPDATE)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.update(self._table())
            self._live.stop()

    def add(self, rows: EstimateRows) -> None:
        """Add estimates. The values of an invalid row are not shown."""
        if not len(rows.valid):
            return
        self._last_arrival = time.monotonic()
        for name, _, factor in shown(self.watch.machine):
            if name in rows.columns:
                values = factor * np.asarray(rows.columns[name], dtype=float)
                visible_now = rows.valid[-1] or name == "t"
                self._last[name] = float(values[-1]) if visible_now else math.nan
        self._rows += len(rows.valid)
        self._valid += int(rows.valid.sum())

    def draw(self, force: bool = False) -> None:
        """Update the display if an update is due, or always with `force`."""
        now = time.monotonic()
        if now - self._drawn < (UPDATE if self._live is not None else LINE) and not force:
            return
        log = self.watch.log
        if log is not None and not self._notes_printed:
            self._notes_printed = True
            self._print("; ".join([*log.notes, f"{1 / log.sample_time:.6g} rows a second"]) + ".")
        if self._rows:
            self._last["valid"] = 100 * self._valid / self._rows
            self._rows = self._valid = 0
            for name, value in self._last.items():
                self._strips.setdefault(name, deque(maxlen=_STRIP)).append(value)
        self._drawn = now
        if self._live is not None:
            self._live.update(self._table())
            return
        line = ", ".join(
            [f"{name} {self._format_value(name)}" for name in self._last] + self._remarks()
        )
        if line != self._line:
            self._line = line
            print(line, flush=True)

    def _remarks(self) -> list[str]:
        """Return notes on losses, restarts, waiting and silence of the stream."""
        status = self.watch.status
        counts = (
            (status.lost, "lost"),
            (status.damaged, "damaged"),
            (status.restarts, "restarts"),
            (self.source.ignored, "from other senders"),
        )
        remarks = [f"{count} {label}" for count, label in counts if count]
        if status.rows and not status.valid:
            remarks.append(UNKNOWN)
        if status.waiting:
            remarks.append(f"waiting: {status.waiting}")
        if self._last and time.monotonic() - self._last_arrival > SILENT:
            remarks.append(f"no rows for more than {SILENT:g} s")
        return remarks

    def _print(self, text: str) -> None:
        if self._live is not None:
            self._live.console.print(text, markup=False)
        else:
            print(text, flush=True)

    def _table(self) -> Any:
        from rich.table import Table
        from rich.text import Text

        remarks = ", ".join([f"{self.watch.status.rows} rows", *self._remarks()])
        table = Table(
            title=Text(visible(f"{self.source.name}: {remarks}")),
            box=None,
            pad_edge=False,
            title_justify="left",
        )
        for title, justify in (("", "left"), ("now", "right"), ("", "left")):
            table.add_column(title, justify=justify)  # type: ignore[arg-type]
        for name, strip in self._strips.items():
            table.add_row(name, self._format_value(name), sparkline(list(strip)))
        return table

    def _format_value(self, name: str) -> str:
        if math.isnan(self._last[name]):
            return "–"
        unit = self._units.get(name, "%")
        return f"{self._last[name]:.4g}{'' if unit in '°%' else ' '}{unit}"


def shown(machine: Machine) -> list[tuple[str, str, float]]:
    """Return the displayed columns: name, unit, and factor from SI to that unit."""
    position = machine.position_output
    a, b = machine.ports
    columns = [
        ("t", "s", 1.0),
        (position.name, position.unit, position.factor),
        (f"{position.name}_std", position.unit, position.factor),
        (f"{position.name}_error", position.unit, position.factor),
        ("speed_e", "rad/s", 1.0),
    ]
    columns += [(f"drift_{a}", "V", 1.0), (f"drift_{b}", "V", 1.0)]
    columns += [("resistance", "Ω", 1.0), ("inverter_voltage", "V", 1.0), ("psi_f", "Wb", 1.0)]
    return columns


def sparkline(values: list[float]) -> str:
    """Return values as a strip of blocks, scaled from their minimum to their maximum."""
    finite = [value for value in values if np.isfinite(value)]
    if not finite:
        return ""
    low, high = min(finite), max(finite)
    span = (high - low) or 1.0
    steps = len(_BLOCKS) - 1
    return "".join(
        _BLOCKS[round((v - low) / span * steps)] if np.isfinite(v) else " " for v in values
    )
