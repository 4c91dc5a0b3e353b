"""Pictures of a campaign's report."""

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

#: Colours of the observers, in the order of the specification; repeated for further observers.
COLOURS = (GREY, BLUE, ORANGE, "#3a923a", "#8e5ea2", "#b3446c")
#: Largest number of machines side by side.
ABREAST = 4
#: Widths of an observer's name in the legend and of a bar [in].
NAME, BAR = 2.2, 0.07


def _new_axes(count: int, height: float) -> tuple[Figure, list]:  # type: ignore[type-arg]
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        columns = min(count, ABREAST)
        rows = -(-count // columns)
        figure = new_figure(figsize=(3.0 * columns + 1.5, height * rows))
        axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    for spare in axes[count:]:
        spare.set_visible(False)
    return figure, axes[:count]


def _add_legend(figure: Figure, axis: Axes) -> None:
    """Put the names of the observers above the axes, in as many columns as fit."""
    columns = max(1, int(figure.get_figwidth() / NAME))
    figure.legend(
        *axis.get_legend_handles_labels(),
        loc="outside upper left",
        ncols=columns,
        frameon=False,
        fontsize=8,
    )


def distribution(specification: Specification, rows: pl.DataFrame) -> Figure:
    """Plot the share of scenarios with an rms error below the abscissa, by machine."""
    figure, axes = _new_axes(len(specification.machines), 2.6)
    for axis, machine in zip(axes, specification.machines, strict=True):
        for k, table in enumerate(specification.observers):
            group_rows = group(rows, machine, table.name)["rms"]
            errors = np.sort(np.degrees(group_rows.drop_nulls().to_numpy()))
            share = np.arange(1, len(errors) + 1) / max(len(group_rows), 1)
            colour = COLOURS[k % len(COLOURS)]
            axis.plot(
                errors, 100 * share, color=colour, label=plain(table.name), drawstyle="steps-post"
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
    _add_legend(figure, axes[0])
    return figure


def importance(
    specification: Specification,
    indices: dict[tuple[str, str], list[Index]],
    max_quantities: int = 8,
) -> Figure:
    """Plot the Sobol' indices as bars with intervals, by machine and observer."""
    height = max(3.0, 1.0 + BAR * max_quantities * len(specification.observers))
    figure, axes = _new_axes(len(specification.machines), height)
    for axis, machine in zip(axes, specification.machines, strict=True):
        by_observer = {
            observer: observer_indices
            for (name, observer), observer_indices in indices.items()
            if name == machine
        }
        shares: dict[str, list[float]] = {}
        for index in itertools.chain.from_iterable(by_observer.values()):
            shares.setdefault(index.quantity, []).append(index.share)
        names = sorted(shares, key=lambda name: -max(shares[name]))[:max_quantities]
        width = 0.8 / max(len(by_observer), 1)
        for k, (_, observer_indices) in enumerate(by_observer.items()):
            by_quantity = {index.quantity: index for index in observer_indices}
            bars = [(j, by_quantity[name]) for j, name in enumerate(names) if name in by_quantity]
            sizes = np.array([index.share for _, index in bars])
            lower = np.array([index.low for _, index in bars])
            upper = np.array([index.high for _, index in bars])
            axis.barh(
                [j + k * width for j, _ in bars],
                100 * sizes,
                width,
                xerr=100 * np.abs(np.array([sizes - lower, upper - sizes])).reshape(2, -1),
                color=COLOURS[k % len(COLOURS)],
                error_kw={"lw": 0.7},
                label=plain(list(by_observer)[k]),
            )
        axis.set_yticks([j + 0.4 - width / 2 for j in range(len(names))], names)
        axis.invert_yaxis()
        axis.set(
            xlabel="share of the variance [%]",
            xlim=(0, None),
            title=plain(specification.called(machine)),
        )
    _add_legend(figure, axes[0])
    return figure


def pairs(pair_list: list[Pair], title: str) -> Figure:
    """Plot the yield [%] over cells of two quantities, one axis for each pair."""
    figure, axes = _new_axes(len(pair_list), 2.9)
    figure.suptitle(plain(title), fontsize=9)
    for axis, pair in zip(axes, pair_list, strict=True):
        share = np.full(pair.of.shape, np.nan)
        np.divide(100 * pair.good, pair.of, out=share, where=pair.of > 0)
        mesh = axis.pcolormesh(pair.x_edges, pair.y_edges, share.T, vmin=0, vmax=100, cmap="RdYlGn")
        for i, j in np.ndindex(share.shape):
            if pair.of[i, j]:
                axis.text(
                    (pair.x_edges[i] + pair.x_edges[i + 1]) / 2,
                    (pair.y_edges[j] + pair.y_edges[j + 1]) / 2,
                    f"{share[i, j]:.0f}",
                    ha="center",
                    va="center",
                    fontsize=6,
                )
        axis.set(xlabel=pair.x, ylabel=pair.y)
    figure.colorbar(mesh, ax=axes, label="good [%]")
    return figure
