"""Pictures of a campaign."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..core.plots import BLUE, GREY, ORANGE, STYLE, new_figure, plain
from .specification import Specification
from .statistics import Index, Pair, group

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Colours of the observers, in the order of the specification; more than these repeat.
COLOURS = (GREY, BLUE, ORANGE, "#3a923a", "#8e5ea2", "#b3446c")
#: Machines side by side.
ABREAST = 4
#: Widths of an observer's name in a legend, and of its bar [in].
NAME, BAR = 2.2, 0.07


def _axes(count: int, height: float) -> tuple[Figure, list]:  # type: ignore[type-arg]
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        columns = min(count, ABREAST)
        lines = -(-count // columns)
        figure = new_figure(figsize=(3.0 * columns + 1.5, height * lines))
        axes = figure.subplots(lines, columns, squeeze=False).ravel().tolist()
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, axes[:count]


def _legend(figure: Figure, axis: Axes) -> None:
    """Names of the observers above, as many abreast as there is room for."""
    columns = max(1, int(figure.get_figwidth() / NAME))
    figure.legend(
        *axis.get_legend_handles_labels(),
        loc="outside upper left",
        ncols=columns,
        frameon=False,
        fontsize=8,
    )


def distribution(specification: Specification, rows: pl.DataFrame) -> Figure:
    """Share of the scenarios with an rms error below the abscissa, by machine."""
    figure, axes = _axes(len(specification.machines), 2.6)
    for axis, machine in zip(axes, specification.machines, strict=True):
        for k, table in enumerate(specification.observers):
            mine = group(rows, machine, table.name)["rms"]
            error = np.sort(np.degrees(mine.drop_nulls().to_numpy()))
            share = np.arange(1, len(error) + 1) / max(len(mine), 1)
            colour = COLOURS[k % len(COLOURS)]
            axis.plot(
                error, 100 * share, color=colour, label=plain(table.name), drawstyle="steps-post"
            )
        if specification.good.rms is not None:
            axis.axvline(specification.good.rms, color="black", lw=0.6, ls=":")
        axis.set(
            xscale="log",
            xlabel="rms position error [°]",
            ylim=(0, 100),
            title=plain(specification.called(machine)),
        )
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("scenarios below [%]")
    _legend(figure, axes[0])
    return figure


def importance(
    specification: Specification, indices: dict[tuple[str, str], list[Index]], most: int = 8
) -> Figure:
    """Indices of the quantities as bars with intervals, by machine and observer."""
    height = max(3.0, 1.0 + BAR * most * len(specification.observers))
    figure, axes = _axes(len(specification.machines), height)
    for axis, machine in zip(axes, specification.machines, strict=True):
        mine = {name: found for (where, name), found in indices.items() if where == machine}
        shares: dict[str, list[float]] = {}
        for index in itertools.chain.from_iterable(mine.values()):
            shares.setdefault(index.quantity, []).append(index.share)
        names = sorted(shares, key=lambda name: -max(shares[name]))[:most]
        width = 0.8 / max(len(mine), 1)
        for k, (_, found) in enumerate(mine.items()):
            by = {one.quantity: one for one in found}
            here = [(j, by[name]) for j, name in enumerate(names) if name in by]
            share = np.array([one.share for _, one in here])
            low = np.array([one.low for _, one in here])
            high = np.array([one.high for _, one in here])
            axis.barh(
                [j + k * width for j, _ in here],
                100 * share,
                width,
                xerr=100 * np.abs(np.array([share - low, high - share])).reshape(2, -1),
                color=COLOURS[k % len(COLOURS)],
                error_kw={"lw": 0.7},
                label=plain(list(mine)[k]),
            )
        axis.set_yticks([j + 0.4 - width / 2 for j in range(len(names))], names)
        axis.invert_yaxis()
        axis.set(
            xlabel="share of the variance [%]",
            xlim=(0, None),
            title=plain(specification.called(machine)),
        )
    _legend(figure, axes[0])
    return figure


def pairs(found: list[Pair], title: str) -> Figure:
    """Yield in cells of two quantities, with the number of scenarios."""
    figure, axes = _axes(len(found), 2.9)
    figure.suptitle(plain(title), fontsize=9)
    for axis, one in zip(axes, found, strict=True):
        share = np.full(one.of.shape, np.nan)
        np.divide(100 * one.good, one.of, out=share, where=one.of > 0)
        drawn = axis.pcolormesh(one.x_edges, one.y_edges, share.T, vmin=0, vmax=100, cmap="RdYlGn")
        for i, j in np.ndindex(share.shape):
            if one.of[i, j]:
                axis.text(
                    (one.x_edges[i] + one.x_edges[i + 1]) / 2,
                    (one.y_edges[j] + one.y_edges[j + 1]) / 2,
                    f"{share[i, j]:.0f}",
                    ha="center",
                    va="center",
                    fontsize=6,
                )
        axis.set(xlabel=one.x, ylabel=one.y)
    figure.colorbar(drawn, ax=axes, label="good [%]")
    return figure
