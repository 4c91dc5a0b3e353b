"""Output on a terminal: wrapped text, tables, progress."""

from __future__ import annotations

import shutil
import sys
import textwrap
import time
from collections.abc import Iterable, Sequence
from typing import Any, Self

import typer

from ..core.printable import visible


def say(text: str, err: bool = False) -> None:
    """Print paths and commands, which must not be wrapped."""
    typer.echo(visible(text), err=err)


def echo(text: str, err: bool = False) -> None:
    """Print text: wrapped on a terminal, as one line in a pipe."""
    text = visible(text)
    if not err and sys.stdout.isatty():
        text = textwrap.fill(text, min(shutil.get_terminal_size().columns, 100))
    typer.echo(text, err=err)


def cell(text: str, style: str = "") -> Any:
    """Return a table cell that shows its text literally: [mA] in a name is not markup."""
    from rich.text import Text

    return Text(visible(text), style)


def summary(rows: Sequence[tuple[str, str]], warnings: Iterable[str]) -> None:
    """Print rows of label and value, then warnings."""
    width = max(len(label) for label, _ in rows)
    columns = min(shutil.get_terminal_size().columns, 100)
    for label, value in rows:
        line = visible(f"{label.ljust(width)}  {value}")
        if sys.stdout.isatty():
            line = textwrap.fill(line, columns, subsequent_indent=" " * (width + 2))
        typer.echo(line)
    for warning in warnings:
        echo(f"Warning: {warning}")


def table(rich_table: Any) -> None:
    """Print a table made with rich."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else 110
    Console(width=width).print(rich_table)


def examination(items: Iterable[Any]) -> None:
    """Print the items of an examination of a drive as a table."""
    from rich.table import Table

    rich_table = Table(box=None, pad_edge=False)
    for title in ("what", "value", "verdict", ""):
        rich_table.add_column(title, overflow="fold")
    colours = {"fine": "green", "look at it": "bold red", "cannot be told": "dim"}
    for item in items:
        verdict = cell(item.verdict, colours[item.verdict])
        rich_table.add_row(cell(item.name), cell(item.told), verdict, cell(item.words))
    typer.echo()
    table(rich_table)


def interactive() -> bool:
    """Return whether a user at a terminal can answer a question."""
    return sys.stdin.isatty() and sys.stdout.isatty()


class Stopped(SystemExit):
    """Ctrl-C was pressed; the exit code is 128 plus the number of the signal, as in shells."""

    def __init__(
        self, progress: str = "", consequence: str = "no file was written or changed"
    ) -> None:
        super().__init__(130)
        self.progress, self.consequence = progress, consequence


class Progress:
    """A progress bar on standard error, shown after one second.

    Parameters
    ----------
    consequence : str, optional
        Text that tells the user what remains after Ctrl-C.
    """

    def __init__(self, consequence: str | None = None) -> None:
        self.started = time.monotonic()
        self.consequence = consequence
        self.bar: Any = None
        self.done = self.total = 0

    def __enter__(self) -> Self:
        return self

    def __call__(self, done: int, total: int) -> None:
        self.done, self.total = done, total
        is_due = sys.stderr.isatty() and time.monotonic() - self.started > 1
        if self.bar is None and is_due and done < total:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TimeRemainingColumn

            self.bar = Progress(
                BarColumn(),
                TaskProgressColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self.bar.start()
            self.task = self.bar.add_task("", total=total)
        if self.bar is not None:
            self.bar.update(self.task, completed=done)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()
        if kind is not None and issubclass(kind, Stopped):
            progress = f" at {self.done / self.total:.0%}" if self.total else ""
            raise (
                Stopped(progress, self.consequence) if self.consequence else Stopped(progress)
            ) from None
