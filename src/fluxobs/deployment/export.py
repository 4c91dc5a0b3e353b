"""A folder of C that compiles into a drive's firmware and does what the log replay did."""

from __future__ import annotations

import hashlib
import json
import math
import os
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
from .header import bases, parameter_header, parameters, settings
from .vectors import COLUMNS, EXACT_COLUMNS, vectors_header

SOURCES = ("fluxobs.h", "fluxobs.c")
#: Periods of current controls [s]; other numbers are in another unit.
PERIODS = (1e-6, 1e-2)
#: What a voltage error as large as the drift's prior may turn the flux by while the position is
#: called valid [rad]; as in firmware/fluxobs.c.
VOLTAGE_LIMIT = math.pi / 22.5
#: For the README of a folder whose observer is stepped every few interrupts.
#: Steps in a memory up to which single precision keeps to 1e-4 of the flux and 0.01°
#: (benchmarks/accuracy.py).
MOST_STEPS = 4000
#: Lists what an export wrote, so that another may overwrite that and nothing else.
MANIFEST = "MANIFEST"
GATHER = (
    "\nIn every interrupt `fo_gather` adds the volt-seconds of the interval that ends, and "
    "`fo_step_volt_seconds` takes their sum instead of the voltage. A voltage that is not known "
    "spoils the step it belongs to, a current that is missing the steps on either side of it.\n"
)


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
        Exponential memory of the least squares [s], 10 to 4000 steps; default 0.03 s.
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
        Replace an earlier export, of which nothing has been changed since.

    Raises
    ------
    FluxobsError
        A setting cannot work (with the nearest good value), or `out` exists.

    Examples
    --------
    >>> import fluxobs, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = fluxobs.export(fluxobs.read_machine("servo-400w"), 1e-4, f"{folder}/servo")
    ...     sorted(path.name for path in done.folder.glob("*.[ch]"))
    ['example_isr.c', 'fluxobs.c', 'fluxobs.h', 'motor_observer.h']
    """
    prefix = "motor" if prefix is None else prefix
    if not is_identifier(prefix) or prefix == "fo":  # fo_observer is a type
        near = identifier(prefix) if prefix != "fo" else "motor"
        raise FluxobsError(f"prefix {prefix!r} cannot begin names in C; {near!r} can")
    rotating = _check_machine(machine, unknowns)
    memory = _check_times(sample_time, update_every, memory)
    for name, value in (("current_noise", current_noise), ("drift_prior", drift_prior)):
        if value is not None and not 0 < value < float("inf"):
            raise FluxobsError(f"{name} must be positive and finite, got {value:g}")
    folder = Path(out).resolve()
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
    try:
        _write(folder, files)
    except OSError as error:
        raise FluxobsError(f"{folder}: cannot be written: {error.strerror}") from None
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
            f"the machine file lacks {' and '.join(rotating_lacks)}: give a value that is right "
            f"within a factor of two"
        )
    return machine


def _check_times(sample_time: float, update_every: int, memory: float | None) -> float:
    if not 0 < sample_time < float("inf"):
        near = f"{-sample_time:g} s" if -1 < sample_time < 0 else "1e-4 s, 10 kHz,"
        raise FluxobsError(
            f"sample time {sample_time:g} s: it is the period of the current-control interrupt, "
            f"above 0; {near} would do"
        )
    if not PERIODS[0] <= sample_time <= PERIODS[1]:
        meant = {
            "µs": 1e-6 * sample_time,
            "ms": 1e-3 * sample_time,
            "Hz": 1 / sample_time,
            "kHz": 1e-3 / sample_time,
        }
        likely = [
            f"{sample_time:g} {unit} is {period:g} s"
            for unit, period in meant.items()
            if PERIODS[0] <= period <= 0.2 * PERIODS[1]
        ]
        raise FluxobsError(
            f"sample time {sample_time:g} s is no period of a current control"
            + (f"; {', '.join(likely)}" if likely else "; it is in seconds, such as 1e-4")
        )
    if update_every < 1:
        raise FluxobsError(f"update_every {update_every}: at least 1, a step every interrupt")
    memory = MEMORY if memory is None else memory
    step = update_every * sample_time
    least, most = 10 * step, MOST_STEPS * step
    if memory > most * (1 + 1e-9):
        every = math.ceil(memory / (MOST_STEPS * sample_time))
        raise FluxobsError(
            f"memory {memory:g} s: single precision is good for {MOST_STEPS} steps in a memory, "
            f"{most:g} s with a step every {step:g} s; with update_every {every} it would do"
        )
    if not memory >= least * (1 - 1e-9):
        raise FluxobsError(
            f"memory {memory:g} s: with a step every {step:g} s it is ten steps at least, "
            f"{least:g} s"
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
        raise FluxobsError(f"{folder}: exists; give another name, or --force to replace an export")
    for name, digest in _manifest(folder).items():
        path = folder / name
        if path.exists() and _digest(path.read_bytes()) != digest:
            raise FluxobsError(
                f"{path}: changed since it was exported; move it away, and it will be written anew"
            )


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _manifest(folder: Path) -> dict[str, str]:
    """What an earlier export wrote: name → SHA-256."""
    path = folder / MANIFEST
    if not path.exists():
        raise FluxobsError(f"{folder}: no earlier export, so nothing in it is overwritten")
    lines = path.read_text(encoding="utf-8").split("\n")
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines) if name}


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
    if not single.run(record.voltage, record.current).valid.any():
        raise FluxobsError(
            f"with these settings the position is never known, not even at full speed: memory "
            f"{single.memory:g} s, current noise {single.current_noise:g} A, drift prior "
            f"{single.drift_prior:g} V; check the units of R_s, inductance and rated_current"
        )
    slowest = single.drift_prior / (VOLTAGE_LIMIT * single.flux_base)
    words = {
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "sample_time": f"{single.sample_time / update_every:.9g}",
        "step_time": f"{single.sample_time:.9g}",
        "steps": "" if update_every == 1 else f" (a step in every {update_every}th)",
        "n_p": str(machine.n_p),
        "half_turn": "; the one 180 degrees away fits as well"
        if machine.half_turn_ambiguous
        else "",
        "gather": GATHER if update_every > 1 else "",
        "drift_prior": f"{single.drift_prior:.3g}",
        "slowest": f"{slowest:.3g}",
        "slowest_rpm": f"{slowest / machine.n_p * 30 / math.pi:.3g}",
        "content": header.split("Content ")[1].split(",")[0],
        "exact_columns": str(EXACT_COLUMNS),
        "columns": ", ".join(f'"{name}"' for name in COLUMNS),
        "costs": cost_table(read_costs()),
        "parameters": str(read_costs()["parameters"]),
        "facts": _facts(machine, single, update_every),
    }
    folder = resources.files(__package__) / "templates"

    def filled(name: str) -> str:
        text = (folder / name).read_text(encoding="utf-8")
        for word, value in words.items():
            text = text.replace(f"@{word}@", value)
        return text

    return sources | {
        "LICENSE": (installed / "LICENSE").read_text(encoding="utf-8"),
        f"{prefix}_observer.h": header,
        "README.md": filled("README.md"),
        "Makefile": filled("Makefile"),
        "example_isr.c": filled("example_isr.c" if update_every == 1 else "example_slow_isr.c"),
        "test/check.h": filled("check.h"),
        "test/check.c": filled("check.c"),
        "test/host_test.c": filled("host_test.c"),
        "test/vectors.h": vectors_header(record, observers, update_every),
    }


def _facts(machine: RotatingMachine, observer: LeastSquaresObserver, update_every: int) -> str:
    rows = {
        **parameters(machine),
        **settings(observer, update_every),
        **{f"per-unit base of {name}": value for name, value in bases(observer).items()},
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
    contents = {name: text.encode() for name, text in files.items()}
    listing = "".join(f"{_digest(content)}  {name}\n" for name, content in contents.items())
    contents[MANIFEST] = listing.encode()
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".fluxobs-", dir=folder.parent) as scratch:
        made = Path(scratch) / "export"
        for name, content in contents.items():
            path = made / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        if folder.exists() and not any(folder.iterdir()):
            folder.rmdir()
        if not folder.exists():
            os.replace(made, folder)
            return
        old = _manifest(folder)
        for name in contents:
            path = folder / name
            if name not in old and name != MANIFEST and path.exists():
                raise FluxobsError(f"{path}: is no part of the earlier export; move it away")
            if path.parent.exists() and not path.parent.is_dir():
                raise FluxobsError(f"{path.parent}: is no folder; move it away")
        for name in contents:
            (folder / name).parent.mkdir(exist_ok=True)
            os.replace(made / name, folder / name)
        for name in old.keys() - contents.keys():
            (folder / name).unlink(missing_ok=True)
