"""The result of an estimation: estimates, summary, warnings, picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..core.output import TABLES, check_out, write_rows
from ..core.validation import nearest
from ..errors import FluxobsError
from ..estimation.columns import column_units
from ..machines import rotating
from ..machines.saving import write_machine
from .explanation import ExplainedRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: Other names of columns.
ALIASES = {"omega_e": "speed_e"}


def _optional(package: str) -> Any:
    """Return an optional package."""
    try:
        return import_module(package)
    except ImportError:
        raise FluxobsError(f"this needs {package}: pip install {package}") from None


@dataclass(frozen=True, eq=False)
class Result(ExplainedRun):
    """Result of :func:`fluxobs.estimate`.

    A table: ``result["theta_e"]`` is a column as an array; iterating, `in` and `keys` go over the
    columns, `len` is the number of rows; ``pandas.DataFrame(result)`` and other readers of Arrow
    take it as it is. ``print(result)`` shows summary and warnings.

    Attributes
    ----------
    table : polars.DataFrame, optional
        The estimates, if they stayed in memory.
    path : Path, optional
        The file with the estimates, if there is one.
    log, machine, observer, scales, unknowns, memory, priors, counts, learnt, automatic, causal
        See :class:`fluxobs.estimation.run.LogRun`.
    """

    table: pl.DataFrame | None
    path: Path | None

    @property
    def estimates(self) -> pl.DataFrame:
        """Table in SI units with one row per sample and one column per output.

        The table is read from `path` if the estimates were written there.
        """
        if self.table is not None:
            return self.table
        if self.path is None:
            raise FluxobsError(
                "the estimates were discarded: call estimate with out=… or keep=True"
            )
        read = pl.read_parquet if self.path.suffix == ".parquet" else pl.read_csv
        try:
            with self.path.open("rb") as file:  # Polars reads a name as a pattern
                return read(file)
        except (OSError, pl.exceptions.PolarsError) as error:
            raise FluxobsError(f"{self.path}: the estimates cannot be read: {error}") from None

    def keys(self) -> list[str]:
        """Return the names of the columns."""
        return self.estimates.columns

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def __contains__(self, column: object) -> bool:
        return column in self.keys()

    def __len__(self) -> int:
        return self.estimates.height

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        return self.estimates.__arrow_c_stream__(requested_schema)

    def to_polars(self) -> pl.DataFrame:
        """Return the estimates as a Polars table."""
        return self.estimates

    def to_pandas(self) -> Any:
        """Return the estimates as a pandas table, indexed by the time [s]. Needs pandas."""
        pandas = _optional("pandas")
        table = pandas.DataFrame({name: self[name] for name in self})
        return table.set_index("t")

    def to_xarray(self) -> Any:
        """Return the estimates as an xarray dataset over the time [s]. Needs xarray.

        The variables carry their units.
        """
        xarray = _optional("xarray")
        units = column_units(self.machine)
        columns = {
            name: ("t", self[name], {"units": units[name]} if name in units else {})
            for name in self
            if name != "t"
        }
        return xarray.Dataset(columns, coords={"t": ("t", self["t"], {"units": "s"})})

    def __getitem__(self, column: str) -> NDArray[Any]:
        column = ALIASES.get(column, column)
        table = self.estimates
        if column not in table.columns:
            raise FluxobsError(f"no column {column!r}{nearest(column, table.columns)}")
        return np.asarray(table[column].to_numpy())

    def plot(self, style: str = "screen", panels: Sequence[str] | None = None) -> Figure:
        """Draw the run as a matplotlib figure.

        Parameters
        ----------
        style : {"screen", "one column", "two columns"}
            The styles for a paper are 3.5 or 7.16 inches wide, in 7 point, without a title.
        panels : sequence of str, optional
            A selection of "locus" (flux and position vector), "position" (around the first valid
            row), "error" (with ±2σ), "speed", "drift"; "budget" unless causal; also "resistance",
            "inverter_voltage", "psi_f". Default: all panels on the screen, the first five in a
            paper.

        Raises
        ------
        UsageError
            The style or panel does not exist, or the immersed observer ran: its panels are fixed.
        """
        from .picture import figure  # matplotlib is loaded only where it is needed

        return figure(self, self.truth_fit, style, panels)

    def write(
        self,
        path: str | Path,
        *,
        force: bool = False,
        data: bool = True,
        command: str | None = None,
    ) -> None:
        """Write results to `path`; its ending selects what is written.

        .parquet or .csv: the estimates; .png, .pdf or .svg: the picture; .html: a report that can
        recompute; .toml: the machine with the identified parameters.

        Parameters
        ----------
        path : path
        force : bool
            Overwrite an existing .toml file.
        data : bool
            Whether a report includes the record, unless the record is too large.
        command : str, optional
            The command that a report shows.

        Raises
        ------
        FluxobsError
            The path has another ending, no parameter was identified, or the file cannot be written.
        """
        from ..core.plots import FORMATS, HTML, write

        path = Path(path)
        if path.suffix.lower() == ".toml":
            if not self.found:
                raise FluxobsError(
                    f"{path}: not written, since no parameter is identifiable from this log"
                )
            heading = [f"Learnt from {self.log.path.name} by `fluxobs estimate`."]
            machine = rotating(self.machine_learnt)
            write_machine(path, machine, heading, self.found, force)
            return
        if path.suffix.lower() == HTML:
            from .report import write_report

            write_report(self, path, command=command, data=data)
            return
        if path.suffix.lower() in FORMATS:
            write(self.plot(), path)
            return
        if path.suffix.lower() not in TABLES:
            endings = ", ".join((*TABLES, *FORMATS, HTML))
            raise FluxobsError(f"{path}: a result is written to {endings} or .toml")
        table = self.estimates
        write_rows(check_out(path, self.log.path, force=True), dict(table.schema), iter([table]))

    def _repr_html_(self) -> str:
        """Return summary, warnings and picture as HTML, for a notebook."""
        from ..core.html import bullets, picture, table

        notes = [*(f"Warning: {text}" for text in self.warnings), *self.log.notes]
        shown = picture(self.plot(), self.summary)
        return table(("", ""), self.summary_rows) + bullets(notes) + shown

    def __repr__(self) -> str:
        return (
            f"<Result: {self.log.path.name}, {self.machine.kind}, "
            f"{self.statistics.valid} of {self.statistics.rows} rows valid>"
        )
