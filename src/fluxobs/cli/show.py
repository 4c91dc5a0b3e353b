"""Output on a terminal: wrapped text, tables, progress."""

from __future__ import annotations

import shutil
import sys
import textwrap
import time
from collections.abc import Iterable
from typing import Any, Self

import typer

from ..core.printable import visible


def say(text: str, err: bool = False) -> None:
    """Print text as it is, for paths and commands: it is not wrapped."""
    typer.echo(visible(text), err=err)


def echo(text: str, err: bool = False) -> None:
    """Print text, wrapped for a terminal, in one line for a pipe."""
    text = visible(text)
    if not err and sys.stdout.isatty():
        text = textwrap.fill(text, min(shutil.get_terminal_size().columns, 100))
    typer.echo(text, err=err)


def cell(text: str, style: str = "") -> Any:
    """Text of a table as it is: [mA] in a name is no markup."""
    from rich.text import Text

    return Text(visible(text), style)


def summary(paragraph: str, warnings: Iterable[str]) -> None:
    """Print a paragraph and its warnings."""
    echo(paragraph)
    for warning in warnings:
        echo(f"Warning: {warning}")


def table(rich_table: Any) -> None:
    """Print a table made with rich."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else 110
    Console(width=width).print(rich_table)


def page(items: Iterable[Any]) -> None:
    """Print the lines of an examination."""
    from rich.table import Table

    drawn = Table(box=None, pad_edge=False)
    for title in ("what", "value", "verdict", ""):
        drawn.add_column(title, overflow="fold")
    colours = {"fine": "green", "look at it": "bold red", "cannot be told": "dim"}
    for item in items:
        verdict = cell(item.verdict, colours[item.verdict])
        drawn.add_row(cell(item.name), cell(item.told), verdict, cell(item.words))
    typer.echo()
    table(drawn)


def interactive() -> bool:
    """Whether somebody can answer a question."""
    return sys.stdin.isatty() and sys.stdout.isatty()


class Stopped(SystemExit):
    """Ctrl-C; the exit code is that of shells, 128 and the number of the signal."""

    def __init__(self, where: str = "", left: str = "no file was written or changed") -> None:
        super().__init__(130)
        self.where, self.left = where, left


class Progress:
    """A bar on standard error, once a run has taken a second.

    Parameters
    ----------
    left : str, optional
        What Ctrl-C leaves behind, in words.
    """

    def __init__(self, left: str | None = None) -> None:
        self.started = time.monotonic()
        self.left = left
        self.bar: Any = None
        self.done = self.total = 0

    def __enter__(self) -> Self:
        return self

    def __call__(self, done: int, total: int) -> None:
        self.done, self.total = done, total
        late = sys.stderr.isatty() and time.monotonic() - self.started > 1
        if self.bar is None and late and done < total:
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
            at = f" at {self.done / self.total:.0%}" if self.total else ""
            raise (Stopped(at, self.left) if self.left else Stopped(at)) from None
