"""Report of an identification: text, machine file, HTML, and picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.html import bullets, document, picture, table
from ..core.output import check_out, write_text
from ..core.plots import BLUE, FORMATS, GREY, HTML, ORANGE, STYLE, legend, new_figure
from ..core.plots import write as save
from ..errors import FluxobsError
from ..logs.record import signed
from ..machines.heat import COLD, COPPER, NEODYMIUM
from ..machines.saving import write_machine
from ..presentation.summary import RPM
from .energy import energy_of
from .fit_result import FittedParameters
from .map_fit import FoundMap
from .mechanics import NOT_RIGID, Mechanics
from .mechanics import UNITS as MECHANICS
from .segment_fit import SegmentFit
from .values import ADVICE, Parameter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..presentation import Result


def lines(fit: FittedParameters) -> list[str]:
    """Return lines: one for each parameter, then unidentified parameters, then how it fits."""
    sentences = []
    for parameter in fit.parameters:
        given_text = "not given" if parameter.given is None else f"given {parameter.given:.4g}"
        if parameter.std is None and parameter.given is None and parameter.name in MECHANICS:
            sentences.append(f"{parameter.name} is open: {fit.untold[parameter.name]}")
        elif parameter.std is None:
            sentences.append(
                f"{parameter.name} held at {parameter.value:.4g} {parameter.unit}: "
                f"{fit.untold[parameter.name]}"
            )
        else:
            sentences.append(
                f"{parameter.name} = {parameter.value:.4g} ± {parameter.std:.2g} "
                f"{parameter.unit} ({given_text}){_note(parameter, fit)}"
            )
    if fit.map is not None:
        sentences += fit.map.lines()
    if fit.run is not None:
        sentences += [*constants(fit.run), *temperatures(fit)]
        energy = energy_of(fit.run)
        sentences += [] if energy is None else [energy.text()]
    if fit.mechanics is not None:
        sentences += _describe_mechanics(fit.mechanics)
    held = [name for name in fit.untold if name not in MECHANICS]
    if held:
        sentences.append(
            f"This log cannot identify {', '.join(held)}: held at the given value; the "
            f"other values depend on it. {ADVICE}."
        )
    if fit.segment_fit is not None:
        sentences += _describe_fit(fit.segment_fit, fit.rows)
    elif fit.run is not None:
        statistics = fit.run.statistics
        sentences.append(
            f"The position is valid on {statistics.valid / statistics.rows:.1%} of the rows; "
            f"lag {signed(fit.lag)}"
        )
    return sentences


def constants(run: Result) -> list[str]:
    """Return the constants of a data sheet that follow from the magnet flux, with definitions.

    The flux ψ of a phase is a peak value. The peak voltage between two terminals is √3 n_p ψ ω, and
    the torque of a current with the peak value î along q is 3/2 n_p ψ î.
    """
    machine, learnt = run.rotor, run.learnt
    if not machine.magnets or learnt is None or not run.statistics.valid:
        return []
    share, emf = learnt.psi_f_std / learnt.psi_f, machine.n_p * learnt.psi_f
    K_e, K_t, K_V = 3**0.5 * emf, 1.5 * emf, RPM / (3**0.5 * emf)
    return [
        f"K_e = {K_e:.4g} ± {share * K_e:.2g} V s/rad (line to line, peak), "
        f"{emf:.4g} V s/rad (phase, peak)",
        f"K_t = {K_t:.4g} ± {share * K_t:.2g} N m/A (phase current, peak), "
        f"{2**0.5 * K_t:.4g} N m/A (rms)",
        f"K_V = {K_V:.4g} ± {share * K_V:.2g} rpm/V (line to line, peak), "
        f"{2**0.5 * K_V:.4g} rpm/V (rms)",
    ]


def temperatures(fit: FittedParameters) -> list[str]:
    """Return temperatures of winding and magnets, if the machine file holds at 20 °C.

    The standard deviation is that of the identified value; an error of the machine file adds to it.
    """
    sentences = []
    for name, what, material, slope in (
        ("R_s", "Winding", "copper", COPPER),
        ("psi_f", "Magnets", "neodymium", NEODYMIUM),
    ):
        for parameter in fit.parameters:
            if parameter.name == name and parameter.std is not None and parameter.given:
                rise = (parameter.value / parameter.given - 1) / slope
                std = parameter.std / parameter.given / abs(slope)
                sentences.append(
                    f"{what}: {COLD + rise:.0f} ± {std:.0f} °C, if {name} = {parameter.given:.4g} "
                    f"{parameter.unit} holds at {COLD:.0f} °C ({material}, {slope:+.2%}/K)"
                )
    return sentences


def _describe_mechanics(mechanics: Mechanics) -> list[str]:
    """Return lines on the load, and a warning if the drive is not rigid."""
    load = mechanics.load
    sentences = [
        f"The load is {load.min():.3g} to {load.max():.3g} N m, "
        f"± {np.median(mechanics.load_std):.2g} N m"
    ]
    if abs(mechanics.elastic) > NOT_RIGID:
        sentences.append(
            f"Warning: short and long segments disagree on J by {abs(mechanics.elastic):.1f} σ: "
            f"the shaft is elastic, a coupling has play, or the load depends on the angle"
        )
    return sentences


def _describe_fit(fit: SegmentFit, rows: int) -> list[str]:
    """Return lines on rows and residual of a fit to segments."""
    sentences = []
    used = sum(len(segment) for segment in fit.segments)
    if used < 0.99 * rows:
        sentences.append(
            f"{used} of {rows} rows were used: segments without a gap in which the position "
            f"is known"
        )
    before, after = fit.before.rms() / fit.flux, fit.after.rms() / fit.flux
    sentences.append(
        f"Residual: {before:.2%} of the flux with the {_describe_given(fit)}, {after:.2%} with the "
        f"identified ones"
    )
    if not fit.after.converged:
        sentences.append("Warning: the fit did not converge; treat its values with caution")
    return sentences


def _note(parameter: Parameter, fit: FittedParameters) -> str:
    if parameter.name == "inverter" and fit.machine.inverter_current is not None:
        return f", its sign smoothed at inverter_current = {fit.machine.inverter_current:.3g} A"
    if parameter.name == "lag":
        return "; the machine file has no lag: state it with the log"
    return ""


def _describe_given(fit: SegmentFit) -> str:
    name = fit.machine.flux_name
    return f"given values ({name} fitted)" if fit.before.free else "given values"


def _head(fit: FittedParameters) -> list[str]:
    """Return the comment lines at the head of the machine file."""
    head = [f"Identified from {fit.source} by `fluxobs identify`."]
    if fit.untold:
        head.append(
            f"Not identifiable from this log, held at the given value: {', '.join(fit.untold)}."
        )
    return head


def write(fit: FittedParameters, path: Path, force: bool) -> None:
    """Write the machine file, the table of the map, the picture or an HTML report.

    Raises
    ------
    FluxobsError
        The file cannot be written, or there is no map to write.
    """
    if path.suffix.lower() == HTML:
        title = f"{Path(fit.source).name}: identified {fit.machine.kind}"
        write_text(path, document(title, html_of(fit)))
    elif path.suffix.lower() in FORMATS:
        save(figure(fit), path)
    elif path.suffix.lower() == ".csv":
        if fit.map is None:
            raise FluxobsError(f"{path}: there is no flux map to write; identify with free = map")
        write_text(check_out(path, Path(fit.source)), fit.map.csv())
    else:
        write_machine(path, fit.machine, _head(fit), fit.found, force)


def html_of(fit: FittedParameters) -> str:
    """Return the parameters, the unidentified parameters, and the picture as HTML."""
    rows = [
        (
            parameter.name,
            f"{parameter.value:.4g}" + ("" if parameter.std is None else f" ± {parameter.std:.2g}"),
            parameter.unit,
            "not given" if parameter.given is None else f"{parameter.given:.4g}",
            f"held: {fit.untold[parameter.name]}" if parameter.name in fit.untold else "",
        )
        for parameter in fit.parameters
    ]
    sentences = lines(fit)[len(fit.parameters) :]
    text = table(("parameter", "value ± σ", "unit", "given", ""), rows) + bullets(sentences)
    if fit.segment_fit is None and fit.run is None:
        return text
    return text + picture(figure(fit), " ".join(sentences))


def figure(fit: FittedParameters) -> Figure:
    """Draw the map and the residual of its fit, or the parameters over time."""
    import matplotlib as mpl

    from ..presentation.picture import figure as picture_of

    if fit.segment_fit is None:
        if fit.run is None:
            raise FluxobsError("there is no picture of values from several logs")
        names = {"R_s": "resistance", "inverter": "inverter_voltage", "psi_f": "psi_f"}
        panels = [names[p.name] for p in fit.parameters if p.name in names]
        return picture_of(fit.run, fit.run.truth_fit, "screen", [*panels, "budget"])
    with mpl.rc_context(STYLE):
        if fit.map is None:
            drawing = new_figure(figsize=(9, 4.5))
            _plot_residuals(drawing.subplots(), fit.segment_fit)
        else:
            drawing = new_figure(figsize=(9, 8.5))
            axes = drawing.subplot_mosaic([["d", "q"], ["residual", "residual"]])
            _plot_map(axes["d"], axes["q"], fit.map)
            _plot_residuals(axes["residual"], fit.segment_fit)
    return drawing


def _plot_map(along_d: Axes, along_q: Axes, flux_map: FoundMap) -> None:
    """Plot each axis's flux over its current, with ± 2σ, for three currents of the other axis."""
    d, q = flux_map.visited.real, flux_map.visited.imag
    grid = flux_map.grid()
    ends = (grid.real[0, 0], grid.real[-1, 0]), (grid.imag[0, 0], grid.imag[0, -1])
    for axes, name, span, others in (
        (along_d, "d", ends[0], np.linspace(q.min(), q.max(), 3)),
        (along_q, "q", ends[1], np.linspace(d.min(), d.max(), 3)),
    ):
        currents = np.linspace(*span, 121)
        for other, colour in zip(others, (BLUE, ORANGE, GREY), strict=True):
            i = currents + 1j * other if name == "d" else other + 1j * currents
            flux, std = flux_map.flux(i), flux_map.flux_std(i)
            value, width = (flux.real, std.real) if name == "d" else (flux.imag, std.imag)
            visited = flux_map.inside(i)
            label = f"i_{'q' if name == 'd' else 'd'} = {other:.3g} A"
            axes.fill_between(
                currents, value - 2 * width, value + 2 * width, color=colour, alpha=0.25
            )
            axes.plot(currents, value, color=colour, linewidth=0.8, linestyle=":")
            axes.plot(currents, np.where(visited, value, np.nan), color=colour, label=label)
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


def _plot_residuals(axes: Axes, fit: SegmentFit) -> None:
    size = fit.flux
    styles = (
        (fit.before, _describe_given(fit), ORANGE),
        (fit.after, "identified values", BLUE),
    )
    for fitted, label, colour in styles:
        start = 0.0
        for k, (piece, residual) in enumerate(zip(fit.segments, fitted.residuals, strict=True)):
            axes.plot(
                start + piece.t,
                100 * residual / size,
                color=colour,
                linewidth=0.8,
                label=f"{label}: {100 * fitted.rms() / size:.2f} % rms" if k == 0 else None,
            )
            start += float(piece.t[-1])
    axes.axhline(0, color=GREY, linewidth=0.5)
    axes.set_xlabel("time in the segments used [s]")
    axes.set_ylabel("residual [% of the flux]")
    axes.set_title("Residual of the machine's relation")
    legend(axes)
