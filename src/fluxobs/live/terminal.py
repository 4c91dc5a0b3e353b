"""A stream in the terminal: the last values, and a strip of each."""

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

#: Seconds between two pictures on a terminal, and between two lines in a pipe; and without rows,
#: after which that is said.
PICTURE, LINE, SILENT = 0.1, 1.0, 2.0
#: What helps if the position stays unknown.
UNKNOWN = "not valid yet: if it stays so, record it (--save) and run `fluxobs check`"
_BLOCKS = "▁▂▃▄▅▆▇█"
_STRIP = 40


class Terminal:
    """Shows a stream; on a pipe it prints a line a second.

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
        self._came = 0.0  # when the last rows came
        self._rows = self._valid = 0  # since the last picture
        self._line = ""
        self._live: Any = None
        self._noted = False
        self._units = {name: unit for name, unit, _ in shown(watch.machine)}

    def __enter__(self) -> Terminal:
        if sys.stdout.isatty():
            from rich.live import Live

            self._live = Live(self._table(), refresh_per_second=1 / PICTURE)
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.update(self._table())
            self._live.stop()

    def add(self, rows: EstimateRows) -> None:
        """Take estimates; values of a row that is not valid are not shown."""
        if not len(rows.valid):
            return
        self._came = time.monotonic()
        for name, _, factor in shown(self.watch.machine):
            if name in rows.columns:
                values = factor * np.asarray(rows.columns[name], dtype=float)
                known = rows.valid[-1] or name == "t"
                self._last[name] = float(values[-1]) if known else math.nan
        self._rows += len(rows.valid)
        self._valid += int(rows.valid.sum())

    def draw(self, force: bool = False) -> None:
        """Show them, if it is time to."""
        now = time.monotonic()
        if now - self._drawn < (PICTURE if self._live is not None else LINE) and not force:
            return
        log = self.watch.log
        if log is not None and not self._noted:
            self._noted = True
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
        line = ", ".join([f"{name} {self._written(name)}" for name in self._last] + self._said())
        if line != self._line:
            self._line = line
            print(line, flush=True)

    def _said(self) -> list[str]:
        """What is to be said of the stream itself."""
        status = self.watch.status
        counted = (
            (status.lost, "lost"),
            (status.damaged, "damaged"),
            (status.restarts, "restarts"),
            (self.source.ignored, "of other senders"),
        )
        said = [f"{count} {what}" for count, what in counted if count]
        if status.rows and not status.valid:
            said.append(UNKNOWN)
        if status.waiting:
            said.append(f"waiting: {status.waiting}")
        if self._last and time.monotonic() - self._came > SILENT:
            said.append(f"no rows for more than {SILENT:g} s")
        return said

    def _print(self, text: str) -> None:
        if self._live is not None:
            self._live.console.print(text, markup=False)
        else:
            print(text, flush=True)

    def _table(self) -> Any:
        from rich.table import Table
        from rich.text import Text

        words = ", ".join([f"{self.watch.status.rows} rows", *self._said()])
        drawn = Table(
            title=Text(visible(f"{self.source.name}: {words}")),
            box=None,
            pad_edge=False,
            title_justify="left",
        )
        for title, justify in (("", "left"), ("now", "right"), ("", "left")):
            drawn.add_column(title, justify=justify)  # type: ignore[arg-type]
        for name, strip in self._strips.items():
            drawn.add_row(name, self._written(name), sparkline(list(strip)))
        return drawn

    def _written(self, name: str) -> str:
        if math.isnan(self._last[name]):
            return "–"
        unit = self._units.get(name, "%")
        return f"{self._last[name]:.4g}{'' if unit in '°%' else ' '}{unit}"


def shown(machine: Machine) -> list[tuple[str, str, float]]:
    """Columns that a person wants to see, each with a unit and what turns it into that."""
    where = machine.position_output
    a, b = machine.ports
    out = [
        ("t", "s", 1.0),
        (where.name, where.unit, where.factor),
        (f"{where.name}_std", where.unit, where.factor),
        (f"{where.name}_error", where.unit, where.factor),
        ("speed_e", "rad/s", 1.0),
    ]
    out += [(f"drift_{a}", "V", 1.0), (f"drift_{b}", "V", 1.0)]
    out += [("resistance", "Ω", 1.0), ("inverter_voltage", "V", 1.0), ("psi_f", "Wb", 1.0)]
    return out


def sparkline(values: list[float]) -> str:
    """Values as a strip of blocks, from the least to the most of them."""
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return ""
    low, high = min(known), max(known)
    size = (high - low) or 1.0
    steps = len(_BLOCKS) - 1
    return "".join(
        _BLOCKS[round((v - low) / size * steps)] if np.isfinite(v) else " " for v in values
    )
