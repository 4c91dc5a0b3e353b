"""Reproduce the figures, numbers and report of the paper's Section V with one command."""

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


class _Workers:
    """Processes that do work and compile separately; with zero processes, `start` does the work."""

    def __init__(self, processes: int) -> None:
        context = get_context("spawn")
        self.pool = ProcessPoolExecutor(processes, context) if processes else None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self.pool:
            self.pool.shutdown(cancel_futures=True)

    def start(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Callable[[], T]:
        """Start work; the returned function waits for its result."""
        if self.pool:
            return self.pool.submit(work, *args, **kwargs).result
        result = work(*args, **kwargs)
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
    """Run all studies; write ``report.html``, ``report.md``, ``numbers.json`` and the figures.

    Parameters
    ----------
    out : path
        Output folder, created if missing. Files with the names of the outputs are replaced.
    quick : bool
        Run only scenario S5, for 30 s with the jump at 15 s, without stability and noise; PNG only.
    deep : bool
        Also run the long studies (about ten minutes): scenario S2, Proposition 2 with a scalar
        gain, observers published later, the levitation as printed, the closed loop, the smoother,
        the levitation at rest.
    say : callable
        Function that gets a line of text after each step.
    processes : int
        Number of processes; 1 runs everything in the calling process, with the same results.

    Returns
    -------
    dict
        The content of ``numbers.json``.

    Raises
    ------
    FluxobsError
        If the folder cannot be created or written, or `quick` and `deep` are both set.
    """
    if quick and deep:
        raise FluxobsError("quick and deep exclude each other: use only one of them")
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FluxobsError(f"{out}: cannot be created: {error.strerror}") from None
    names: tuple[str, ...] = (MAIN,) if quick else ("S1", "S3", MAIN)
    if deep:
        names = ("S1", "S2", "S3", MAIN)
    formats = (".png",) if quick else (".png", ".svg")
    with _Workers(processes - 1) as workers:
        motors = workers.start(_motors, out, quick, formats)
        elsewhere = {
            name: workers.start(run_levitation, name, quick, deep)
            for name in names[: len(names) // 2]
        }
        results: dict[str, ScenarioResult] = {}
        for name in [name for name in names if name not in elsewhere]:
            results[name] = run_levitation(name, quick, deep)
            say(f"{name}: {results[name].scenario.title}")
        for name, result in elsewhere.items():
            results[name] = result()
            say(f"{name}: {results[name].scenario.title}")
        motor, counter = motors()
        runs = [results[name] for name in names]
        shown = [run for run in runs if run.scenario.name in SHOWN]
        half = workers.start(draw_scenarios, out, shown, formats, SCENARIO_FIGURES[::2])
        draw_scenarios(out, shown, formats, SCENARIO_FIGURES[1::2])
        half()
    content = numbers(runs, motor, counter)
    more: list[str] = []
    if deep:
        from . import deep as long_studies

        content["deep"] = long_studies.study(say)
        more = long_studies.markdown(content["deep"])
        draw_scalar_gain(out, content["deep"]["scalar_gain"], formats)
    write_text(out / "numbers.json", json.dumps(content, indent=1) + "\n")
    title, _, text = markdown(content, more).partition("\n")
    write_text(out / "report.md", f"{title}\n{text}")
    page = html.document(title.removeprefix("# "), html.from_markdown(text, out))
    write_text(out / "report.html", page)
    return content
