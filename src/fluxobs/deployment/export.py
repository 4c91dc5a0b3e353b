"""A folder of C that compiles into a drive's firmware and does what the log replay did."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path
from typing import Any

from ..errors import FluxobsError
from ..immersion import UNKNOWNS
from ..machines import Machine, RotatingMachine
from ..observers import LeastSquaresObserver
from ..observers.least_squares import MEMORY
from .c_source import PRECISIONS, Precision, identifier, is_identifier
from .course import course
from .header import bases, parameter_header, settings
from .vectors import COLUMNS, vectors_header

SOURCES = ("fluxobs.h", "fluxobs.c")
#: A current control is never slower than this [s]; larger numbers are frequencies or ms.
SLOWEST = 0.1


@dataclass(frozen=True)
class Export:
    """What was exported.

    Attributes
    ----------
    folder : Path
    prefix : str
        Of the parameters' names.
    observer : LeastSquaresObserver
        The same in Python, in single precision as the firmware.
    content : str
        Changes with the parameters and with the C sources.
    """

    folder: Path
    prefix: str
    observer: LeastSquaresObserver
    content: str


def export(
    machine: Machine,
    sample_time: float,
    out: str | Path,
    *,
    memory: float | None = None,
    unknowns: tuple[str, ...] = ("drift",),
    current_noise: float | None = None,
    drift_prior: float | None = None,
    update_every: int = 1,
    prefix: str | None = None,
    force: bool = False,
) -> Export:
    """Write the observer of a machine as a folder of C99.

    The same call writes the same bytes. The folder appears complete or not at all.

    Parameters
    ----------
    machine : Machine
        One that turns, with psi_f (if it has a magnet) and rated_current.
    sample_time : float
        Period of the current-control interrupt [s].
    out : path
        Folder to be made.
    memory : float, optional
        Exponential memory of the least squares [s], ten to a million samples; default 0.03 s.
    unknowns : tuple of str
        What is constant and unknown; the firmware knows ("drift",).
    current_noise, drift_prior : float, optional
        As of :meth:`LeastSquaresObserver.for_machine` [A], [V]; `fluxobs estimate` prints what it
        took for a log.
    update_every : int
        Interrupts from one step of the observer to the next; in between volt-seconds are gathered.
        Costs less, and noise is averaged over fewer samples.
    prefix : str, optional
        Of the generated names, so that two machines fit one firmware; default ``motor``.
    force : bool
        Overwrite an earlier export.

    Raises
    ------
    FluxobsError
        A setting cannot work (with the nearest good value), or `out` exists.

    Examples
    --------
    >>> import fluxobs, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = fluxobs.export(fluxobs.read_machine("servo-400w"), 1e-4, f"{folder}/servo")
    ...     sorted(path.name for path in done.folder.iterdir())
    ['Makefile', 'README.md', 'example_isr.c', 'fluxobs.c', 'fluxobs.h', 'motor.h', 'test']
    """
    prefix = "motor" if prefix is None else prefix
    if not is_identifier(prefix) or prefix == "fluxobs":
        near = identifier(prefix) if prefix != "fluxobs" else "motor"
        raise FluxobsError(f"prefix {prefix!r} cannot begin names in C; {near!r} can")
    rotating = _check_machine(machine, unknowns)
    memory = _check_times(sample_time, update_every, memory)
    for name, value in (("current_noise", current_noise), ("drift_prior", drift_prior)):
        if value is not None and not 0 < value < float("inf"):
            raise FluxobsError(f"{name} must be positive and finite, got {value:g}")
    folder = Path(out)
    _check_folder(folder, force)
    try:
        observers = {
            precision: LeastSquaresObserver.for_machine(
                rotating,
                sample_time=update_every * sample_time,
                memory=memory,
                current_noise=current_noise,
                drift_prior=drift_prior,
                precision=precision,
            )
            for precision in PRECISIONS
        }
    except ValueError as error:
        raise FluxobsError(str(error)) from None
    files = _files(prefix, rotating, observers, update_every)
    content = files["README.md"].split("content `")[1].split("`")[0]
    _write(folder, files)
    return Export(folder, prefix, observers["single"], content)


def _check_machine(machine: Machine, unknowns: tuple[str, ...]) -> RotatingMachine:
    from ..reference_estimate import check_unknowns  # loads what reads logs

    for name in unknowns:
        if name not in UNKNOWNS:
            raise FluxobsError(f"unknowns: {name!r} is none of {', '.join(UNKNOWNS)}")
    if not unknowns:
        raise FluxobsError(f"unknowns: give some of {', '.join(UNKNOWNS)}; drift serves")
    if not isinstance(machine, RotatingMachine):
        raise FluxobsError(
            f"kind {machine.kind}: the firmware's observer is for machines that turn; logs of "
            f"this one can be read with `fluxobs estimate`"
        )
    check_unknowns(machine, unknowns)  # type: ignore[arg-type]
    if set(unknowns) != {"drift"}:
        raise FluxobsError(
            f"unknowns {','.join(unknowns)}: the firmware's observer finds the drift only, which "
            f"takes a current bias in; use drift"
        )
    if rotating_lacks := [
        name
        for name in ("psi_f", "rated_current")
        if name in type(machine).model_fields and getattr(machine, name) is None
    ]:
        raise FluxobsError(
            f"{' and '.join(rotating_lacks)} missing: give it in the machine file; within a factor "
            f"of two serves"
        )
    return machine


def _check_times(sample_time: float, update_every: int, memory: float | None) -> float:
    if not 0 < sample_time < float("inf"):
        near = f"{-sample_time:g} s" if -1 < sample_time < 0 else "1e-4 s, 10 kHz,"
        raise FluxobsError(
            f"sample time {sample_time:g} s: it is the period of the current-control interrupt, "
            f"above 0; {near} would do"
        )
    if sample_time > SLOWEST:
        raise FluxobsError(
            f"sample time {sample_time:g} s is no period of a current control; for "
            f"{sample_time:g} Hz it is {1 / sample_time:g} s"
        )
    if update_every < 1:
        raise FluxobsError(f"update_every {update_every}: at least 1, a step every interrupt")
    memory = MEMORY if memory is None else memory
    step = update_every * sample_time
    least, most = 10 * step, 1e6 * step
    if not least <= memory <= most:
        nearest = most if memory > most else least
        raise FluxobsError(
            f"memory {memory:g} s: with a step every {step:g} s it is ten steps at least and a "
            f"million at most; {nearest:g} s would do"
        )
    return memory


def _check_folder(folder: Path, force: bool) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FluxobsError(f"{folder}: exists and is no folder; give another name")
    if not any(folder.iterdir()):
        return
    if not force:
        raise FluxobsError(f"{folder}: exists; give another name, or --force to overwrite it")
    if not (folder / "fluxobs.h").exists():
        raise FluxobsError(f"{folder}: no earlier export, so nothing in it is overwritten")


def _files(
    prefix: str,
    machine: RotatingMachine,
    observers: Mapping[Precision, LeastSquaresObserver],
    update_every: int,
) -> dict[str, str]:
    """Relative path → text."""
    version = metadata.version("fluxobs")
    installed = resources.files("fluxobs") / "firmware"
    sources = {name: (installed / name).read_text(encoding="utf-8") for name in SOURCES}
    texts = tuple(sources.values())
    header = parameter_header(prefix, observers, machine, version, texts, update_every)
    single = observers["single"]
    record = course(machine, single)
    words = {
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "sample_time": f"{single.sample_time / update_every:.9g}",
        "step_time": f"{single.sample_time:.9g}",
        "steps": "" if update_every == 1 else f" (a step in every {update_every}th)",
        "n_p": str(machine.n_p),
        "half_turn": "; up to half a turn" if machine.half_turn_ambiguous else "",
        "content": header.split("Content ")[1].split(",")[0],
        "columns": ", ".join(f'"{name}"' for name in COLUMNS),
        "costs": cost_table(read_costs()),
        "parameters": str(read_costs()["parameters"]),
        "facts": _facts(machine, single),
    }
    folder = resources.files(__package__) / "templates"

    def filled(name: str) -> str:
        text = (folder / name).read_text(encoding="utf-8")
        for word, value in words.items():
            text = text.replace(f"@{word}@", value)
        return text

    return sources | {
        f"{prefix}.h": header,
        "README.md": filled("README.md"),
        "Makefile": filled("Makefile"),
        "example_isr.c": filled("example_isr.c" if update_every == 1 else "example_slow_isr.c"),
        "test/check.h": filled("check.h"),
        "test/check.c": filled("check.c"),
        "test/host_test.c": filled("host_test.c"),
        "test/vectors.h": vectors_header(record, observers),
    }


def _facts(machine: RotatingMachine, observer: LeastSquaresObserver) -> str:
    given = machine.model_dump(by_alias=True, exclude_none=True)
    rows = {
        "kind": machine.kind,
        **{name: f"{value:.9g}" for name, value in given.items()},
        **settings(observer),
        **{f"per-unit {name}": value for name, value in bases(observer).items()},
    }
    lines = [f"| {name} | {value} |" for name, value in rows.items()]
    return "\n".join(["| | |", "|---|---|", *lines])


def read_costs() -> dict[str, Any]:
    """What `make pil` counted on emulated processors."""
    text = (resources.files(__package__) / "costs.json").read_text(encoding="utf-8")
    costs: dict[str, Any] = json.loads(text)
    return costs


def cost_table(costs: Mapping[str, Any]) -> str:
    """The costs as Markdown."""
    head = "| | instructions, mean | most | code [bytes] | state [bytes] | stack [bytes] |"
    rows = [
        f"| {build['name']} | {build['mean']} | {build['most']} | {build['code']} "
        f"| {build['state']} | {build['stack']} |"
        for build in costs["builds"]
    ]
    return "\n".join([head, "|---|---|---|---|---|---|", *rows, "", f"{costs['compiler']}."])


def _write(folder: Path, files: Mapping[str, str]) -> None:
    """All files or none: they are made beside the folder and moved there when complete."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".fluxobs-", dir=folder.parent) as scratch:
            made = Path(scratch) / "export"
            for name, text in files.items():
                path = made / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8", newline="\n")
            if folder.exists() and not any(folder.iterdir()):
                folder.rmdir()
            if not folder.exists():
                os.replace(made, folder)
                return
            for name in files:
                (folder / name).parent.mkdir(exist_ok=True)
                os.replace(made / name, folder / name)
            shutil.rmtree(folder / "build", ignore_errors=True)  # of the earlier sources
    except OSError as error:
        raise FluxobsError(f"{folder}: cannot be written: {error.strerror}") from None
