"""An identification in words, as a machine file, and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.html import bullets, document, picture, table
from ..core.output import check_out, write_text
from ..core.plots import BLUE, FORMATS, GREY, HTML, ORANGE, STYLE, legend, new_figure
from ..core.plots import write as save
from ..errors import FluxobsError
from ..machines.saving import write_machine
from .fit_result import ADVICE, FittedParameters, Parameter
from .map_fit import FoundMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def lines(found: FittedParameters) -> list[str]:
    """One parameter per line, then what the log cannot tell, then the residual."""
    out = []
    for p in found.parameters:
        was = "not given" if p.given is None else f"given {p.given:.4g}"
        if p.std is None:
            out.append(f"{p.name} held at {p.value:.4g} {p.unit}: {found.untold[p.name]}")
        else:
            out.append(f"{p.name} = {p.value:.4g} ± {p.std:.2g} {p.unit} ({was}){_note(p, found)}")
    if found.map is not None:
        out += found.map.lines()
    if found.untold:
        out.append(
            f"This log cannot tell {', '.join(found.untold)}: held as given. The others are right "
            f"only as far as these are. {ADVICE}."
        )
    used = sum(len(piece) for piece in found.pieces)
    if used < 0.99 * found.rows:
        out.append(
            f"{used} of {found.rows} rows were used: those without a gap, in pieces in which the "
            f"position is known"
        )
    size = _flux(found)
    before, after = found.before.rms() / size, found.after.rms() / size
    out.append(
        f"Residual of the relation: {before:.2%} of the flux {_as_given(found)}, {after:.2%} as "
        f"found"
    )
    if not found.after.converged:
        out.append("Warning: the fit did not converge; treat its values with caution")
    return out


def _flux(found: FittedParameters) -> float:
    """The flux to which residuals are related: the magnet's, or the mean of the start [Wb]."""
    lengths = [np.linalg.norm(piece.start) for piece in found.pieces]
    return found.after.values["psi_f"] or float(np.mean(lengths))


def _note(parameter: Parameter, found: FittedParameters) -> str:
    if parameter.name == "inverter":
        return f", its sign smoothed at inverter_current = {found.inverter_current:.3g} A"
    if parameter.name == "lag":
        return f"; not part of a machine file: give --lag {parameter.value:.2g}"
    return ""


def _as_given(found: FittedParameters) -> str:
    name = found.machine.flux_name
    return f"as given but for {name}, which is fitted" if found.before.free else "as given"


def _head(found: FittedParameters) -> list[str]:
    """The first lines of the machine file."""
    head = [f"Identified from {found.source} by `fluxobs identify`."]
    if found.untold:
        head.append(f"The log did not tell {', '.join(found.untold)}: held as given.")
    return head


def write(found: FittedParameters, path: Path, force: bool) -> None:
    """Write the machine file, the map's table, the picture or a report in HTML; FluxobsError if it
    cannot be written."""
    if path.suffix.lower() == HTML:
        title = f"{Path(found.source).name}: the {found.machine.kind} that it shows"
        write_text(path, document(title, html_of(found)))
    elif path.suffix.lower() in FORMATS:
        save(figure(found), path)
    elif path.suffix.lower() == ".csv":
        if found.map is None:
            raise FluxobsError(f"{path}: there is no map to write; identify with free = map")
        write_text(check_out(path, Path(found.source)), found.map.csv())
    else:
        write_machine(path, found.machine, _head(found), found.found, force)


def html_of(found: FittedParameters) -> str:
    """The parameters, what the log cannot tell, and the picture."""
    rows = [
        (
            one.name,
            f"{one.value:.4g}" + ("" if one.std is None else f" ± {one.std:.2g}"),
            one.unit,
            "not given" if one.given is None else f"{one.given:.4g}",
            f"held: {found.untold[one.name]}" if one.name in found.untold else "",
        )
        for one in found.parameters
    ]
    words = lines(found)[len(found.parameters) :]
    shown = table(("parameter", "found", "unit", "given", ""), rows)
    return shown + bullets(words) + picture(figure(found), " ".join(words))


def figure(found: FittedParameters) -> Figure:
    """Draw the residual over time, before and after the fit."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        if found.map is None:
            drawn = new_figure(figsize=(9, 4.5))
            _residuals(drawn.subplots(), found)
        else:
            drawn = new_figure(figsize=(9, 8.5))
            axes = drawn.subplot_mosaic([["d", "q"], ["residual", "residual"]])
            _map(axes["d"], axes["q"], found.map)
            _residuals(axes["residual"], found)
    return drawn


def _map(along_d: Axes, along_q: Axes, told: FoundMap) -> None:
    """Flux over current along each axis, at three currents of the other; ± 2σ, visited marked."""
    d, q = told.visited.real, told.visited.imag
    grid = told.grid()
    ends = (grid.real[0, 0], grid.real[-1, 0]), (grid.imag[0, 0], grid.imag[0, -1])
    for axes, name, span, others in (
        (along_d, "d", ends[0], np.linspace(q.min(), q.max(), 3)),
        (along_q, "q", ends[1], np.linspace(d.min(), d.max(), 3)),
    ):
        at = np.linspace(*span, 121)
        for other, colour in zip(others, (BLUE, ORANGE, GREY), strict=True):
            i = at + 1j * other if name == "d" else other + 1j * at
            flux, std = told.flux(i), told.flux_std(i)
            value, width = (flux.real, std.real) if name == "d" else (flux.imag, std.imag)
            seen = told.inside(i)
            fixed = f"i_{'q' if name == 'd' else 'd'} = {other:.3g} A"
            axes.fill_between(at, value - 2 * width, value + 2 * width, color=colour, alpha=0.25)
            axes.plot(at, value, color=colour, linewidth=0.8, linestyle=":")
            axes.plot(at, np.where(seen, value, np.nan), color=colour, label=fixed)
        axes.set_xlabel(f"i_{name} [A]")
        axes.set_ylabel(f"psi_{name} [Wb]")
        axes.legend(loc="upper left", frameon=False, fontsize=8)
    along_q.text(
        0.98,
        0.03,
        "solid: visited by the log\ndotted: the model\nband: ± 2σ",
        transform=along_q.transAxes,
        ha="right",
        fontsize=8,
    )


def _residuals(axes: Axes, found: FittedParameters) -> None:
    size = _flux(found)
    styles = ((found.before, _as_given(found), ORANGE), (found.after, "as identified", BLUE))
    for fitted, label, colour in styles:
        begin = 0.0
        for k, (piece, residual) in enumerate(zip(found.pieces, fitted.residuals, strict=True)):
            axes.plot(
                begin + piece.t,
                100 * residual / size,
                color=colour,
                linewidth=0.8,
                label=f"{label}: {100 * fitted.rms() / size:.2f} % rms" if k == 0 else None,
            )
            begin += float(piece.t[-1])
    axes.axhline(0, color=GREY, linewidth=0.5)
    axes.set_xlabel("time in the pieces that were used [s]")
    axes.set_ylabel("residual of the relation [% of the flux]")
    axes.set_title("How well the relation holds")
    legend(axes)
