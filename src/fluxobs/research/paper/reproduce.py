"""Reproduces Section V of the paper with one command: figures, numbers, report."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, ParamSpec, Self, TypeVar

from ...core import html
from ...core.output import write_text
from ...errors import FluxobsError
from . import counter_example
from .counter_example import CounterExample
from .figures import SCENARIO_FIGURES, draw_motors, draw_scalar_gain, draw_scenarios
from .pmsm import servo
from .report import markdown, numbers
from .scenario import MAIN, SHOWN, ScenarioResult, run_levitation
from .section_v import ErrorCourse, motor_courses

P = ParamSpec("P")
T = TypeVar("T")


class _Share:
    """Gives work to other processes, which compile for themselves; with none, does it at once."""

    def __init__(self, processes: int) -> None:
        context = get_context("spawn")
        self.pool = ProcessPoolExecutor(processes, context) if processes else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self.pool:
            self.pool.shutdown(cancel_futures=True)

    def start(self, work: Callable[P, T], *given: P.args, **named: P.kwargs) -> Callable[[], T]:
        """Starts work; the returned function waits for its result."""
        if self.pool:
            return self.pool.submit(work, *given, **named).result
        result = work(*given, **named)
        return lambda: result


def _motors(
    out: Path, quick: bool, formats: Sequence[str]
) -> tuple[dict[str, ErrorCourse], CounterExample]:
    motor, counter = motor_courses(servo(quick)), counter_example.study()
    draw_motors(out, motor, counter, formats)
    return motor, counter


def reproduce(
    out: str | Path,
    quick: bool = False,
    deep: bool = False,
    say: Callable[[str], Any] = lambda text: None,
    processes: int = 2,
) -> dict[str, Any]:
    """Runs everything; writes ``report.html``, ``report.md``, ``numbers.json`` and the figures.

    Parameters
    ----------
    out : path
        Created if missing; files of the same names are replaced.
    quick : bool
        Runs scenario S5 alone, 30 s with the jump at 15 s; no stability, no noise, PNG only.
    deep : bool
        Also the long studies (minutes): scenario S2, Proposition 2 with a scalar gain, the line of
        observers that followed, the levitation as printed, the loop closed.
    say : callable
        Called with a line of text after each part.
    processes : int
        Number of processes; 1 runs all in this one. The numbers do not depend on it.

    Returns
    -------
    dict
        The content of ``numbers.json``.

    Raises
    ------
    FluxobsError
        The folder cannot be created or written, or `quick` and `deep` are both set.
    """
    if quick and deep:
        raise FluxobsError("quick and deep exclude each other: leave one out")
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be made: {error.strerror}") from None
    names: tuple[str, ...] = (MAIN,) if quick else ("S1", "S3", MAIN)
    if deep:
        names = ("S1", "S2", "S3", MAIN)
    formats = (".png",) if quick else (".png", ".svg")
    with _Share(processes - 1) as share:
        side = share.start(_motors, out, quick, formats)
        away = {
            name: share.start(run_levitation, name, quick, deep)
            for name in names[: len(names) // 2]
        }
        done: dict[str, ScenarioResult] = {}
        for name in [name for name in names if name not in away]:
            done[name] = run_levitation(name, quick, deep)
            say(f"{name}: {done[name].scenario.title}")
        for name, result in away.items():
            done[name] = result()
            say(f"{name}: {done[name].scenario.title}")
        motor, counter = side()
        runs = [done[name] for name in names]
        shown = [one for one in runs if one.scenario.name in SHOWN]
        half = share.start(draw_scenarios, out, shown, formats, SCENARIO_FIGURES[::2])
        draw_scenarios(out, shown, formats, SCENARIO_FIGURES[1::2])
        half()
    found = numbers(runs, motor, counter)
    more: list[str] = []
    if deep:
        from . import deep as long

        found["deep"] = long.study(say)
        more = long.markdown(found["deep"])
        draw_scalar_gain(out, found["deep"]["scalar_gain"], formats)
    write_text(out / "numbers.json", json.dumps(found, indent=1) + "\n")
    title, _, text = markdown(found, more).partition("\n")
    write_text(out / "report.md", f"{title}\n{text}")
    page = html.document(title.removeprefix("# "), html.from_markdown(text, out))
    write_text(out / "report.html", page)
    return found
