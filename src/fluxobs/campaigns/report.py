"""The report of a campaign: text for the terminal, HTML with pictures."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ..core import html
from ..core.html import escape
from ..core.output import write_text
from ..core.printable import visible
from . import pictures, statistics
from .dataset import WORST, Dataset
from .draws import total
from .specification import REPORTED, ObserverTable, Specification
from .statistics import Index, group, in_words
from .worst import KEPT, stem, worst

#: File of the HTML report.
REPORT = "report.html"
#: A number in a message.
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
#: Largest number of tolerances that the report names and pairs for an observer.
MATTER = 3


def degrees(value: float | None) -> str:
    """Return an angle in degrees as text."""
    return "–" if value is None else f"{np.degrees(value):.2f}°"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f}\N{NO-BREAK SPACE}%"


def headline(dataset: Dataset) -> str:
    """Describe the campaign: scenarios, machines, loop, criterion of good scenarios."""
    specification, course = dataset.specification, dataset.specification.course
    loop = (
        "on the record of a drive with an encoder"
        if specification.loop == "open"
        else "in the loop"
    )
    return (
        f"{total(specification)} scenarios of {course.duration:g} s, "
        f"{_count(len(specification.machines), 'machine')}; every observer {loop}. Good: "
        f"{in_words(specification.good)}, from {course.score_from:g} s on. Intervals of "
        f"{100 * statistics.CONFIDENCE:g} %."
    )


HEAD = (
    *("machine", "observer", "good", "median rms", "99 % below", "worst valid", "valid"),
    "sure and wrong",
)
LOOP_HEAD = ("in the loop", "losses", "never in the loop")


def summary_rows(dataset: Dataset, rows: pl.DataFrame) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return (heading, lines) of the table; one line per machine and observer."""
    specification = dataset.specification
    closed_loop = specification.loop == "closed"
    lines = []
    for machine in specification.machines:
        for table in specification.observers:
            selected = group(rows, machine, table.name)
            rms = selected["rms"]
            cells = [
                specification.called(machine),
                table.name,
                str(statistics.yield_of(selected, specification.good)),
                degrees(rms.median()),  # type: ignore[arg-type]
                degrees(rms.quantile(0.99, "higher")),
                degrees(selected["worst"].max()),  # type: ignore[arg-type]
                _percent(selected["valid"].mean()),  # type: ignore[arg-type]
                _wrong(selected),
            ]
            if closed_loop:
                never = int(selected["handed_over"].is_null().sum())
                cells += [
                    _percent(selected["in_loop"].mean()),  # type: ignore[arg-type]
                    str(selected["losses"].sum()),
                    str(never),
                ]
            lines.append(cells)
    return HEAD + (LOOP_HEAD if closed_loop else ()), lines


def _wrong(selected: pl.DataFrame) -> str:
    """Return the number of scenarios with a sure and wrong row; "–" if no std is stated."""
    wrong = selected["wrong"].drop_nulls()
    return str(int((wrong > 0).sum())) if len(wrong) else "–"


def comparisons(specification: Specification, rows: pl.DataFrame) -> list[str]:
    """Compare the best observer with each other observer on the same scenarios."""
    names = [table.name for table in specification.observers]
    is_good = {
        name: group(rows, None, name)
        .sort("number")
        .select(statistics.is_good(specification.good))
        .to_series()
        .to_numpy()
        for name in names
    }
    best = max(names, key=lambda name: int(is_good[name].sum()))
    sentences = []
    for name in names:
        if name != best:
            best_only, other_only = (
                int((is_good[best] & ~is_good[name]).sum()),
                int((is_good[name] & ~is_good[best]).sum()),
            )
            sentences.append(
                f"In {best_only} scenarios, {best} is good and {name} is not; the reverse holds in "
                f"{other_only}."
            )
    return sentences


def failures(rows: pl.DataFrame) -> list[str]:
    """List the failed simulations, grouped by messages that differ only in their numbers."""
    failed = rows.filter(pl.col("failed").is_not_null()).unique("number").sort("number")
    by_message: dict[str, list[tuple[int, str]]] = {}
    for number, message in failed.select("number", "failed").iter_rows():
        by_message.setdefault(NUMBER.sub("#", message), []).append((number, message))
    return [
        f"{_count(len(scenarios), 'scenario')} could not be simulated and {_verb(scenarios)} as "
        f"not good; for example scenario {scenarios[0][0]}: {scenarios[0][1]}"
        for scenarios in sorted(by_message.values(), key=len, reverse=True)
    ]


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _verb(scenarios: list[Any]) -> str:
    return "counts" if len(scenarios) == 1 else "count"


def never_valid(dataset: Dataset, rows: pl.DataFrame) -> list[str]:
    """List the scenarios that medians and percentiles exclude, by observer and machine."""
    specification = dataset.specification
    many_machines = len(specification.machines) > 1
    sentences = []
    for machine in specification.machines:
        for table in specification.observers:
            selected = group(rows, machine, table.name).filter(pl.col("failed").is_null())
            count = selected["rms"].null_count()
            if count:
                where = f" on {specification.called(machine)}" if many_machines else ""
                sentences.append(
                    f"{table.name}{where} is never valid in {_count(count, 'scenario')}; median, "
                    f"99 % and worst errors exclude "
                    f"{'this scenario' if count == 1 else 'these scenarios'}."
                )
    return sentences


def sensitivities(dataset: Dataset, rows: pl.DataFrame) -> dict[tuple[str, str], list[Index]]:
    """Return the Sobol' indices of the quantities, by machine and observer."""
    specification = dataset.specification
    quantities = tuple(
        name
        for name in specification.vary
        if name in specification.varied or name in specification.grids
    )
    return {
        (machine, table.name): statistics.indices(group(rows, machine, table.name), quantities)
        for machine in specification.machines
        for table in specification.observers
    }


def describe_indices(indices: list[Index], scenarios: int) -> str:
    """Describe the largest indices."""
    if scenarios < statistics.FEWEST:
        return f"at least {statistics.FEWEST} scenarios are needed"
    if not indices:
        return "none: the error is equal in all scenarios, or no quantity varies"
    significant = [index for index in indices if index.low > 0][:MATTER]
    if not significant:
        return "no single tolerance, but the combination of tolerances, the course and noise"
    causes = [
        f"{index.quantity} {100 * index.share:.0f} % "
        f"({100 * index.low:.0f} to {100 * index.high:.0f} %)"
        for index in significant
    ]
    return ", ".join(causes)


def text(dataset: Dataset, rows: pl.DataFrame) -> tuple[Any, list[str]]:
    """Return the report for the terminal: a rich table, and sentences."""
    from rich.markup import escape as plain
    from rich.table import Table

    head, lines = summary_rows(dataset, rows)
    table = Table(box=None, pad_edge=False)
    for k, name in enumerate(head):
        table.add_column(name, justify="left" if k < 2 else "right", overflow="fold")
    for line in lines:
        table.add_row(*(plain(visible(cell)) for cell in line))
    specification = dataset.specification
    many_machines = len(specification.machines) > 1
    sentences = [*failures(rows), *never_valid(dataset, rows), *comparisons(specification, rows)]
    for (machine, observer), indices in sensitivities(dataset, rows).items():
        where = f" on {specification.called(machine)}" if many_machines else ""
        sentences.append(
            f"Causes of the error of {observer}{where}: "
            f"{describe_indices(indices, specification.scenarios)}."
        )
    for observer_table in specification.observers:
        worst_rows = worst(rows.lazy(), observer_table.name).head(1)
        if len(worst_rows):
            row = worst_rows.row(0, named=True)
            sentences.append(
                f"Worst valid row of {observer_table.name}: {degrees(row['worst'])} in scenario "
                f"{row['number']}; to repeat the scenario: "
                f"`{_rerun_command(dataset, row['number'], observer_table)}`."
            )
    return table, sentences


def _rerun_command(dataset: Dataset, number: int | str, table: ObserverTable) -> str:
    """Return the command that repeats a scenario and writes the observer's report or record."""
    has_report = table.kind in REPORTED
    output = ("--report", "again.html") if has_report else ("--record", "again.parquet")
    return shlex.join(
        [
            *("fluxobs", "campaign", str(dataset.folder), "--rerun", str(number)),
            *("--observer", table.name, *output),
        ]
    )


def write_html(dataset: Dataset, rows: pl.DataFrame) -> Path:
    """Write report.html into the campaign's folder and return its path."""
    specification = dataset.specification
    head, lines = summary_rows(dataset, rows)
    indices = sensitivities(dataset, rows)
    verdicts = statistics.verdicts(specification, rows)
    blocks = [
        html.paragraph(headline(dataset)),
        *([_verdicts(verdicts)] if verdicts else []),
        html.bullets([*failures(rows), *never_valid(dataset, rows)]),
        html.table(head, lines),
        html.bullets(comparisons(specification, rows)),
        "<h2>Distribution of the position error</h2>",
        html.picture(
            pictures.distribution(specification, rows), "Share of scenarios below each rms error"
        ),
        "<h2>Which tolerance matters</h2>",
        html.paragraph(
            "Share of the variance of log(rms position error) that each quantity explains alone "
            "(first-order Sobol' index), with its interval. The rest comes from combinations of "
            "quantities, the course and noise."
        ),
        html.picture(pictures.importance(specification, indices), "Sobol' indices with intervals")
        if any(indices.values())
        else html.paragraph(f"No index: {describe_indices([], specification.scenarios)}."),
        *_pairs(dataset, rows, indices),
        f"<h2>Worst {KEPT}</h2>",
        *(_worst(dataset, rows, table) for table in specification.observers),
    ]
    path = dataset.folder / REPORT
    write_text(path, html.document(f"Campaign: {specification.name}", *blocks))
    return path


def _verdicts(verdicts: list[statistics.Verdict]) -> str:
    outcome = "passed" if all(verdict.met for verdict in verdicts) else "not passed"
    return f"<p><b>{escape(outcome.capitalize())}</b></p>" + html.bullets(map(str, verdicts))


def _pairs(
    dataset: Dataset, rows: pl.DataFrame, indices: dict[tuple[str, str], list[Index]]
) -> list[str]:
    blocks = ["<h2>Yield over pairs of tolerances</h2>"]
    for (machine, observer), quantity_indices in indices.items():
        names = [index.quantity for index in quantity_indices[:MATTER]]
        selected = group(rows, machine, observer)
        good_share = statistics.yield_of(selected, dataset.specification.good)
        if len(names) < 2 or good_share.good in (0, good_share.of):
            continue  # the yield is 0 or 100 % everywhere
        pairs = [
            statistics.pair(selected, dataset.specification.good, x, y)
            for k, x in enumerate(names)
            for y in names[k + 1 :]
        ]
        title = f"{observer} on {dataset.specification.called(machine)}"
        blocks.append(html.picture(pictures.pairs(pairs, title), f"Yield over pairs, {title}"))
    return blocks if blocks[1:] else []


def _worst(dataset: Dataset, rows: pl.DataFrame, table: ObserverTable) -> str:
    specification = dataset.specification
    lines = []
    varied = [name for name in specification.vary if specification.vary[name].varies]
    for row in worst(rows.lazy(), table.name).iter_rows(named=True):
        number = row["number"]
        path = f"{WORST}/{stem(specification, number, table.name)}"
        report_path = dataset.folder / f"{path}.html"
        link = (
            f'<a href="{escape(path)}.html">{number}</a>' if report_path.exists() else str(number)
        )
        cells = [
            link,
            escape(specification.called(row["machine"])),
            degrees(row["worst"]),
            degrees(row["rms"]),
            _percent(row["valid"]),
            *(f"{row[name]:.4g}" for name in varied),
        ]
        lines.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = ("scenario", "machine", "worst", "rms", "valid", *varied)
    names = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    return (
        f'<table style="white-space:nowrap"><caption>'
        f"{escape(table.name)}: <code>{escape(_rerun_command(dataset, 'NUMBER', table))}"
        f"</code></caption><thead><tr>{names}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table>"
    )
