"""Plans as text, pictures, set points and C."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.output import check_new, write_text
from ..core.plots import FORMATS, GREY, STYLE, new_figure
from ..core.plots import write as save
from ..identification.values import UNITS
from ..presentation.summary import RPM, si
from .limits import VALID, Map, Plan
from .sequence import Knot, Sequence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Speeds of the text's table, as shares of the rated speed.
SHOWN = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
#: Colours' range of standard deviations [°].
STDS = (0.4, 5.0)
#: A gain below this is not worth a line.
WORTH = 0.97


def _rpm(plan: Plan, share: float) -> float:
    return share * plan.cell.rated.speed_e / plan.cell.machine.n_p * RPM


def plan_text(plan: Plan) -> str:
    """Return the plan of a drive as text."""
    cell, sensors, known = plan.cell, plan.sensors, plan.known
    rated = cell.rated
    lines = [
        f"{cell.name}: {_rpm(plan, 1.0):.0f} rpm, {rated.torque:.3g} N m, {cell.current:.3g} A, "
        f"{rated.dc_link:.3g} V, {1e-3 / rated.sample_time:.3g} kHz",
        f"Sensors (standard deviations): noise {si(sensors.noise, 'A')}, offset "
        f"{si(sensors.offset, 'A')}, gain {sensors.gain:.1%}; {sensors.bits:.0f} bits over "
        f"±{si(sensors.range, 'A')}. Inverter, uncompensated: dead time "
        f"{si(sensors.dead_time, 's')}, drop {si(sensors.drop, 'V')}",
        "",
        "Standard deviation of the position in steady operation [°]; - not valid, x cannot run",
        "load \\ speed  " + "".join(f"{share:>7.0%}" for share in SHOWN),
    ]
    for m, load in enumerate(known.loads):
        cells = [_cell(known, m, share) for share in SHOWN]
        lines.append(f"{load:>10.0%}    " + "".join(f"{cell:>7}" for cell in cells))
    lines += ["", "Lowest valid speed"]
    for load, lowest in zip(known.loads, known.lowest(), strict=True):
        text = (
            "none" if np.isnan(lowest) else f"{lowest:.2g} of rated, {_rpm(plan, lowest):.3g} rpm"
        )
        lines.append(f"{load:>10.0%}    {text}")
    lines += ["", f"If a quantity is known or measured twice as well, at a load of {plan.load:.0%}"]
    lines.append(f"    {'quantity':24s} {'lowest speed':>12s} {'std':>7s}")
    for gain in plan.gains:
        if min(gain.lowest, gain.std) < WORTH:
            speed = "-" if np.isnan(gain.lowest) else f"x {gain.lowest:.2f}"
            std = "-" if np.isnan(gain.std) else f"x {gain.std:.2f}"
            lines.append(f"    {gain.what:24s} {speed:>12s} {std:>6s}   {gain.remedy}")
    return "\n".join(lines)


def _cell(known: Map, m: int, share: float) -> str:
    n = int(np.argmin(np.abs(np.log(known.speeds / share))))
    if np.isnan(known.valid[m, n]):
        return "x"
    return "-" if known.valid[m, n] < VALID else f"{np.degrees(known.std[m, n]):.1f}"


def plan_data(plan: Plan) -> dict[str, Any]:
    """Return the plan for JSON; what is not known is None."""

    def numbers(values: Any) -> Any:
        return [
            numbers(value) if np.ndim(value) else (float(value) if np.isfinite(value) else None)
            for value in values
        ]

    known = plan.known
    return {
        "machine": plan.cell.name,
        "rated": vars(plan.cell.rated),
        "sensors": vars(plan.sensors),
        "speeds": numbers(known.speeds),
        "loads": numbers(known.loads),
        "lowest_valid_speed": numbers(known.lowest()),
        "valid": numbers(known.valid),
        "theta_e_std": numbers(known.std),
        "gains_at_load": plan.load,
        "gains": [
            {
                "what": gain.what,
                "remedy": gain.remedy,
                **dict(zip(("lowest_speed", "std"), numbers([gain.lowest, gain.std]), strict=True)),
            }
            for gain in plan.gains
        ],
    }


def write_plan(plan: Plan, out: Path, force: bool) -> None:
    """Write the picture of a plan.

    Raises
    ------
    FluxobsError
        The file exists, or cannot be written.
    """
    check_new(out, FORMATS, force)
    save(plan_figure(plan), out)


def plan_figure(plan: Plan) -> Figure:
    """Draw the standard deviation over speed and load, and the lowest valid speed."""
    import matplotlib as mpl
    from matplotlib.colors import LogNorm

    known = plan.known
    with mpl.rc_context(STYLE):
        figure = new_figure(figsize=(8, 4))
        axes = figure.subplots()
        std = np.degrees(np.where(known.valid >= VALID, known.std, np.nan))
        rpm = np.array([_rpm(plan, share) for share in known.speeds])
        drawn = axes.pcolormesh(
            rpm, 100 * known.loads, std, shading="nearest", norm=LogNorm(*STDS), cmap="viridis_r"
        )
        bar = figure.colorbar(drawn, label="standard deviation of the position [°]", extend="both")
        bar.set_ticks([0.5, 1.0, 2.0, 5.0], labels=["0.5", "1", "2", "5"])
        bar.ax.minorticks_off()
        lowest = np.array([_rpm(plan, share) for share in known.lowest()])
        axes.plot(lowest, 100 * known.loads, "o-", color=GREY, label="lowest valid speed")
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:.0f}")
        axes.set_xlabel("speed [rpm]")
        axes.set_ylabel("load [% of the rated torque]")
        axes.set_title(f"{plan.cell.name}: adaptive observer in steady operation; white: not valid")
        axes.legend(loc="upper left")
    return figure


def sequence_text(sequence: Sequence, wanted: dict[str, float]) -> str:
    """Return a test as text."""
    lines = [f"{sequence.points} set points, {sequence.duration:.1f} s. Standard deviations:", ""]
    lines.append(f"    {'':12s} {'promised':>16s} {'wanted':>16s}")
    for name, std in wanted.items():
        promised, asked = (_with_unit(value, UNITS[name]) for value in (sequence.stds[name], std))
        value = abs(sequence.values[name])
        share = (
            f"{sequence.stds[name] / value:.1%} of {_with_unit(value, UNITS[name])}"
            if value
            else ""
        )
        lines.append(
            f"    {name:12s} {'± ' + promised:>16s} {'± ' + asked:>16s}   {share}".rstrip()
        )
    lines += ["", f"    {'from s':>8s} {'to s':>8s} {'rpm':>8s} {'i_d A':>8s} {'i_q A':>8s}"]
    held = [knot for knot in sequence.knots if knot.t <= sequence.ramps_from]
    for begin, end in pairwise(held):
        if (begin.speed, begin.i_d, begin.i_q) == (end.speed, end.i_d, end.i_q) and begin.speed > 0:
            lines.append(
                f"    {begin.t:8.2f} {end.t:8.2f} {begin.speed * RPM:8.1f} {begin.i_d + 0:8.3g} "
                f"{begin.i_q + 0:8.3g}"
            )
    free = [knot for knot in sequence.knots if knot.t > sequence.ramps_from]
    if free:
        top = max(knot.speed for knot in free) * RPM
        low = min(knot.speed for knot in free if knot.speed > 0) * RPM
        lines.append(
            f"    {free[0].t:8.2f} {free[-1].t:8.2f}  free shaft: speed ramps from {low:.0f} to "
            f"{top:.0f} rpm, i_d = {free[0].i_d:.3g} A"
        )
    return "\n".join(lines)


def _with_unit(value: float, unit: str) -> str:
    """Format a number; a unit with a kilogram takes no prefix."""
    return f"{value:.3g} {unit}" if unit.startswith("kg") else si(value, unit)


def write_sequence(sequence: Sequence, out: Path, force: bool) -> None:
    """Write the corners of a test: .csv for a bench, .h for firmware.

    Raises
    ------
    FluxobsError
        The file exists, or cannot be written.
    """
    check_new(out, (".csv", ".h"), force)
    write_text(out, _csv(sequence) if out.suffix.lower() == ".csv" else _header(sequence))


def _csv(sequence: Sequence) -> str:
    lines = ["t,speed_mech,i_d,i_q,free_shaft"]
    lines += [f"{_row(knot)},{int(knot.free)}" for knot in sequence.knots]
    return "\n".join(lines) + "\n"


def _row(knot: Knot) -> str:
    return f"{knot.t:.5f},{knot.speed:.6g},{knot.i_d + 0.0:.6g},{knot.i_q + 0.0:.6g}"


_C = """/* Set points of a test, from `fluxobs plan-test`. Between the corners, speed and
 * currents are linear in time. On corners with a free shaft, a speed controller
 * follows the speed; i_q is what to expect. */
#ifndef TEST_POINTS_H
#define TEST_POINTS_H

#define TEST_CORNERS {count}
#define TEST_DURATION {duration}f /* s */

/* Time [s], mechanical speed [rad/s], i_d and i_q [A], 1 for a free shaft. */
static const float test_corners[TEST_CORNERS][5] = {{
{rows}
}};

typedef struct {{
    float speed; /* mechanical [rad/s] */
    float i_d, i_q; /* [A] */
    int free_shaft;
    int done; /* the test has ended: set points are those of the last corner */
}} test_point;

/* The set point at time t [s] since the start of the test. */
static inline test_point test_point_at(float t)
{{
    int k = 0;
    while (k < TEST_CORNERS - 2 && t >= test_corners[k + 1][0]) {{
        k++;
    }}
    const float *a = test_corners[k], *b = test_corners[k + 1];
    float share = b[0] > a[0] ? (t - a[0]) / (b[0] - a[0]) : 1.0f;
    share = share < 0.0f ? 0.0f : (share > 1.0f ? 1.0f : share);
    test_point at;
    at.speed = a[1] + share * (b[1] - a[1]);
    at.i_d = a[2] + share * (b[2] - a[2]);
    at.i_q = a[3] + share * (b[3] - a[3]);
    at.free_shaft = a[4] > 0.5f && b[4] > 0.5f;
    at.done = t >= TEST_DURATION;
    return at;
}}

#endif
"""


def _header(sequence: Sequence) -> str:
    def number(value: float) -> str:
        text = f"{value + 0.0:.6g}"
        return f"{text}f" if "." in text or "e" in text else f"{text}.0f"

    rows = ",\n".join(
        "    {"
        + ", ".join(
            number(value) for value in (knot.t, knot.speed, knot.i_d, knot.i_q, float(knot.free))
        )
        + "}"
        for knot in sequence.knots
    )
    return _C.format(count=len(sequence.knots), duration=f"{sequence.duration:.5f}", rows=rows)
