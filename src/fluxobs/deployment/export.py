"""`fluxobs export`: the observer of one machine for firmware, simulation or browser."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..core.validation import number
from ..errors import FluxobsError
from ..machines import MachineSource, as_machine
from ..observers import AdaptiveObserver, LeastSquaresObserver, Priors
from ..observers.unknowns import ALL, AUTO, adapts, read_unknowns
from .c_source import PRECISIONS
from .core import make_core
from .folder import check_folder, write_folder
from .forms import files_of
from .settings import check_machine, check_prefix, check_times


@dataclass(frozen=True)
class Export:
    """Result of :func:`export`.

    Attributes
    ----------
    folder : Path
    form : str
    prefix : str
        Prefix of the generated names.
    observer : LeastSquaresObserver or AdaptiveObserver
        The same observer in Python, in single precision as in firmware.
    content : str
        Hash of the parameters and the C sources.
    """

    folder: Path
    form: str
    prefix: str
    observer: LeastSquaresObserver | AdaptiveObserver
    content: str


def export(
    machine: MachineSource,
    sample_time: float,
    out: str | Path,
    *,
    memory: float | None = None,
    unknowns: str | Sequence[str] = "auto",
    current_noise: float | None = None,
    drift_prior: float | None = None,
    priors: Mapping[str, float] | None = None,
    update_every: int = 1,
    prefix: str = "motor",
    form: str = "c",
    force: bool = False,
) -> Export:
    """Write the observer of a machine as a folder: C99, or the form that a host needs.

    The same call writes the same bytes. The folder appears complete or not at all.

    Parameters
    ----------
    machine : Machine, path, name of a shipped machine, or mapping of a machine file
        A rotating machine with rated_current, and psi_f if it has a magnet.
    sample_time : float
        Period of the current-control interrupt [s].
    out : path
        Folder to create.
    memory : float, optional
        Exponential memory of the least squares [s], 10 to 4000 steps; default 0.03 s, or less where
        L/R is short (see :meth:`RotatingMachine.memory_for`).
    unknowns : str or sequence of str
        Constant or slow unknowns, as for :func:`fluxobs.estimate`. "drift" with some of
        "resistance", "inverter" and "asymmetry" ("auto": all) exports the adaptive observer;
        "drift" alone exports the plain observer, which needs a third of the time.
    current_noise, drift_prior : float, optional
        Arguments of :meth:`LeastSquaresObserver.for_machine` [A], [V]; `fluxobs estimate` prints
        the values that it used for a log.
    priors : mapping of {"resistance", "inverter", "asymmetry", "psi_f"} to float, optional
        Standard deviations of the machine's values, for the adaptive observer [Ω], [V], [Wb].
    update_every : int
        Interrupts per step of the observer; volt-seconds are summed between steps. More interrupts
        per step cost less computing time but average the noise over fewer samples.
    prefix : str
        Prefix of the generated names, for several machines in one firmware.
    form : {"c", "arduino", "fmu", "wasm", "rust"}
        Form of the export: C99 for any firmware, an Arduino library, simulation units, a
        WebAssembly module or a Rust crate. All forms contain the same sources, parameters and
        record.
    force : bool
        Replace an earlier export if none of its files has been changed.

    Raises
    ------
    FluxobsError
        A setting cannot work (the message gives the nearest valid value), or `out` exists.

    Examples
    --------
    >>> import fluxobs, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = fluxobs.export("servo-400w", 1e-4, f"{folder}/servo")
    ...     sorted(path.name for path in done.folder.glob("motor*.[ch]"))
    ['motor_observer.c', 'motor_observer.h']
    """
    files = files_of(form)
    check_prefix(prefix)
    sample_time = number("sample_time", sample_time, "s")
    memory = None if memory is None else number("memory", memory, "s")
    chosen = read_unknowns(unknowns)
    if chosen == (AUTO,):
        chosen = ALL
    rotating = check_machine(as_machine(machine), chosen, priors or {})
    check_times(rotating, sample_time, update_every, memory)
    for name, value, unit in (
        ("current_noise", current_noise, "A"),
        ("drift_prior", drift_prior, "V"),
    ):
        if value is not None and not 0 < number(name, value, unit) < float("inf"):
            raise FluxobsError(f"{name} must be positive and finite, got {value:g}")
    folder = Path(out).resolve()
    check_folder(folder, force)
    if adapts(chosen):
        given = Priors(**(priors or {}))
        build: Any = partial(AdaptiveObserver.for_machine, unknowns=chosen, priors=given)
    else:
        build = LeastSquaresObserver.for_machine
    observers = {
        precision: build(
            rotating,
            sample_time=update_every * sample_time,
            memory=memory,
            current_noise=current_noise,
            drift_prior=drift_prior,
            precision=precision,
        )
        for precision in PRECISIONS
    }
    core = make_core(prefix, rotating, observers, update_every)
    write_folder(folder, files(core))
    return Export(folder, form, prefix, observers["single"], core.content)
