"""What an estimation returns: the estimates, and everything found on the way."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..checking.findings import Check
from ..checking.search import check_log
from ..errors import FluxobsError
from ..machines import Machine, RotatingMachine, rotating
from ..machines.written import machine_text, with_found, write_machine
from ..output import check_out, write_rows
from ..validation import nearest
from .facts import facts
from .learning import parameters
from .run import LogRun
from .summary import paragraph
from .truth import TruthFit, fit_truth
from .warnings import warnings

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Result(LogRun):
    """Result of :func:`fluxobs.estimate`.

    ``result["theta_e"]`` is a column as an array; ``print(result)`` shows summary and warnings.

    Attributes
    ----------
    table : polars.DataFrame, optional
        The estimates, if they stayed in memory.
    path : Path, optional
        The file with the estimates, if there is one.
    log, machine, observer, scales, unknowns, priors, statistics, counts, learnt, automatic, causal
        See :class:`LogRun`.
    """

    table: pl.DataFrame | None
    path: Path | None

    @property
    def estimates(self) -> pl.DataFrame:
        """One row per sample, one column per output, in SI; read from `path` if written there."""
        if self.table is not None:
            return self.table
        if self.path is None:
            raise FluxobsError("the estimates were not kept: estimate with out=… or keep=True")
        read = pl.read_parquet if self.path.suffix == ".parquet" else pl.read_csv
        try:
            return read(self.path)
        except (OSError, pl.exceptions.PolarsError) as error:
            raise FluxobsError(f"{self.path}: the estimates cannot be read: {error}") from None

    def __getitem__(self, column: str) -> NDArray[Any]:
        table = self.estimates
        if column not in table.columns:
            raise FluxobsError(f"no column {column!r}{nearest(column, table.columns)}")
        return np.asarray(table[column].to_numpy())

    @cached_property
    def summary(self) -> str:
        """What the run found, in one paragraph."""
        return paragraph(self, self.checked, self.truth_fit)

    @cached_property
    def warnings(self) -> list[str]:
        """What should make a reader wary, one or two sentences each."""
        return warnings(self, self.checked, self.truth_fit)

    @property
    def facts(self) -> dict[str, Any]:
        """Summary and warnings as numbers and words that JSON can hold."""
        return facts(self, self.warnings, self.truth_fit)

    @cached_property
    def truth_fit(self) -> TruthFit | None:
        """What the truth channel is off by, fitted to the estimate; None without one."""
        samples = self.statistics.truth
        if samples is None or not isinstance(self.machine, RotatingMachine):
            return None
        return fit_truth(samples, self.machine)

    @cached_property
    def checked(self) -> Check | None:
        """What :func:`fluxobs.check` says of the log; None if it cannot be checked."""
        if not isinstance(self.machine, RotatingMachine):
            return None
        try:
            return check_log(self.log, self.machine, scales=self.scales)
        except FluxobsError:  # too many gaps
            return None

    @property
    def firmware(self) -> str | None:
        """What keeps the same observer out of firmware; None if nothing does, or it has no C."""
        plain = self.plain
        if plain is None:
            return None
        machine = self.rotor
        lacking = []
        if machine.flux_base(1.0) is None:
            lacking.append(f"psi_f ({plain.flux_base:.3g} here)")
        if not machine.rated_current:
            lacking.append(f"rated_current ({self.scales.current:.3g} here)")
        if lacking:
            return f"For an export as firmware, the machine file needs {' and '.join(lacking)}."
        if machine.inverter is not None and self.adaptive is None:
            return (
                "In firmware, the observer for the drift alone leaves the inverter to the drive: "
                "compensate it there, or export with --unknowns drift,inverter."
            )
        return None

    def export_command(self, machine: str) -> str | None:
        """The command that exports the same observer for a machine of that name."""
        plain = self.plain
        if plain is None or self.firmware is not None:
            return None
        chosen = "" if self.adaptive is None else f" --unknowns {','.join(self.unknowns)}"
        priors = dict(self.priors)
        if self.adaptive is not None and self.adaptive.inverter_std > 0:
            priors["inverter"] = self.adaptive.inverter_std  # its default depends on the log
        chosen += "".join(f" --prior {name}={std!r}" for name, std in priors.items())
        return (
            f"fluxobs export --machine {shlex.quote(machine)}{chosen} "
            f"--sample-time {plain.sample_time!r} --memory {plain.memory!r} "
            f"--current-noise {plain.current_noise!r} --drift-prior {plain.drift_prior!r} "
            f"--out FOLDER"
        )

    @property
    def found(self) -> dict[str, tuple[float, float]]:
        """Name in the machine file → value and standard deviation, of what the log told."""
        if self.adaptive is None or self.learnt is None:
            return {}
        names = {"magnet flux": "psi_f", "resistance": "R_s", "inverter": "inverter_voltage"}
        return {
            names[one.name]: (one.value, one.std)
            for one in parameters(self.adaptive, self.learnt)
            if one.told
        }

    @property
    def machine_learnt(self) -> Machine:
        """The machine with what the log told, and standard deviations for the next log."""
        if self.adaptive is None or not self.found:
            return self.machine
        machine = with_found(self.rotor, self.found)
        if "inverter_voltage" not in self.found:
            return machine
        return machine.with_values(inverter_current=float(f"{self.adaptive.inverter_current:.6g}"))

    def plot(self, style: str = "screen", panels: Sequence[str] | None = None) -> Figure:
        """The picture of the run, a matplotlib figure.

        Parameters
        ----------
        style : {"screen", "one column", "two columns"}
            For a paper: 3.5 or 7.16 inches wide, in 7 point, without a title.
        panels : sequence of str, optional
            Some of "locus" (flux and position vector), "position" (around the first valid row),
            "error" (with ±2σ), "speed", "drift"; and of what was learnt "resistance",
            "inverter_voltage", "psi_f". Default: all on the screen, the first five in a paper.

        Raises
        ------
        UsageError
            There is no such style or panel, or the observer of a current bias ran, which has its
            own panels.
        """
        from .picture import figure  # matplotlib is loaded only where it is needed

        return figure(self, self.truth_fit, style, panels)

    def write(self, path: str | Path, *, force: bool = False) -> None:
        """Write estimates to .parquet or .csv, the picture to .png, .pdf or .svg, or the machine
        with what was learnt to .toml (over an existing file only with `force`).

        Raises
        ------
        FluxobsError
            The path has another ending, nothing was learnt, or the file cannot be written.
        """
        from ..plots import FORMATS, write

        path = Path(path)
        if path.suffix.lower() == ".toml":
            if not self.found:
                raise FluxobsError(f"{path}: the log told no parameter; there is nothing to write")
            head = [f"Learnt from {self.log.path.name} by `fluxobs estimate`."]
            machine = rotating(self.machine_learnt)
            write_machine(path, machine_text(machine, head, self.found), force)
            return
        if path.suffix.lower() in FORMATS:
            write(self.plot(), path)
            return
        table = self.estimates
        write_rows(check_out(path, self.log.path, force=True), dict(table.schema), iter([table]))

    def _repr_html_(self) -> str:
        """What a notebook shows: summary, warnings and picture."""
        from ..html import bullets, paragraph, picture

        notes = [*(f"Warning: {text}" for text in self.warnings), *self.log.notes]
        shown = picture(self.plot(), self.summary)
        return paragraph(self.summary) + bullets(notes) + shown

    def __str__(self) -> str:
        return "\n".join([self.summary, *(f"Warning: {text}" for text in self.warnings)])

    def __repr__(self) -> str:
        return (
            f"<Result: {self.log.path.name}, {self.machine.kind}, "
            f"{self.statistics.valid} of {self.statistics.rows} rows valid>"
        )
