"""The report of a campaign: text for a terminal, HTML with pictures."""

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
from .specification import ADAPTIVE, PLAIN, ObserverTable, Specification
from .statistics import Index, group, in_words
from .worst import KEPT, stem, worst

#: File of the HTML report.
REPORT = "report.html"
#: A number in a message.
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
#: Pairs of tolerances that are shown for an observer.
MATTER = 3


def degrees(value: float | None) -> str:
    """An angle in degrees."""
    return "–" if value is None else f"{np.degrees(value):.2f}°"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f}\N{NO-BREAK SPACE}%"


def headline(found: Dataset) -> str:
    """What the campaign is, in a sentence."""
    s = found.specification
    loop = "on the record of a drive with an encoder" if s.loop == "open" else "in the loop"
    return (
        f"{total(s)} scenarios of {s.course.duration:g} s, {len(s.machines)} "
        f"machine{'s' if s.machines[1:] else ''}; every observer {loop}. Good: "
        f"{in_words(s.good)}, from {s.course.score_from:g} s on. Intervals of "
        f"{100 * statistics.CONFIDENCE:g} %."
    )


HEAD = (
    *("machine", "observer", "good", "median rms", "99 % below", "worst valid", "valid"),
    "sure and wrong",
)
LOOP_HEAD = ("in the loop", "losses", "never in it")


def summary_rows(found: Dataset, rows: pl.DataFrame) -> tuple[tuple[str, ...], list[list[str]]]:
    """The table of observers on machines."""
    s = found.specification
    closed = s.loop == "closed"
    out = []
    for machine in s.machines:
        for table in s.observers:
            mine = group(rows, machine, table.name)
            rms = mine["rms"]
            line = [
                s.called(machine),
                table.name,
                str(statistics.yield_of(mine, s.good)),
                degrees(rms.median()),  # type: ignore[arg-type]
                degrees(rms.quantile(0.99, "higher")),
                degrees(mine["worst"].max()),  # type: ignore[arg-type]
                _percent(mine["valid"].mean()),  # type: ignore[arg-type]
                _wrong(mine),
            ]
            if closed:
                never = int(mine["handed_over"].is_null().sum())
                line += [_percent(mine["in_loop"].mean()), str(mine["losses"].sum()), str(never)]  # type: ignore[arg-type]
            out.append(line)
    return HEAD + (LOOP_HEAD if closed else ()), out


def _wrong(rows: pl.DataFrame) -> str:
    """How many scenarios have a row that is sure and wrong; nothing of who tells no std."""
    wrong = rows["wrong"].drop_nulls()
    return str(int((wrong > 0).sum())) if len(wrong) else "–"


def against(specification: Specification, rows: pl.DataFrame) -> list[str]:
    """Observers against each other on the same scenarios, in sentences."""
    names = [table.name for table in specification.observers]
    good = {
        name: group(rows, None, name)
        .sort("number")
        .select(statistics.is_good(specification.good))
        .to_series()
        .to_numpy()
        for name in names
    }
    best = max(names, key=lambda name: int(good[name].sum()))
    out = []
    for name in names:
        if name != best:
            only, lost = (
                int((good[best] & ~good[name]).sum()),
                int((good[name] & ~good[best]).sum()),
            )
            out.append(
                f"{best} is good where {name} is not in {only} scenarios, the other way round in "
                f"{lost}."
            )
    return out


def failures(rows: pl.DataFrame) -> list[str]:
    """Scenarios that could not be simulated, by what was wrong but its numbers."""
    failed = rows.filter(pl.col("failed").is_not_null()).unique("number").sort("number")
    alike: dict[str, list[tuple[int, str]]] = {}
    for number, what in failed.select("number", "failed").iter_rows():
        alike.setdefault(NUMBER.sub("#", what), []).append((number, what))
    return [
        f"{_count(len(some), 'scenario')} could not be simulated, and {_verb(some)} as not good; "
        f"{some[0][0]} for example: {some[0][1]}"
        for some in sorted(alike.values(), key=len, reverse=True)
    ]


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _verb(some: list[Any]) -> str:
    return "counts" if len(some) == 1 else "count"


def never_valid(found: Dataset, rows: pl.DataFrame) -> list[str]:
    """What medians and percentiles leave out, in a sentence for each observer on each machine."""
    s = found.specification
    several = len(s.machines) > 1
    out = []
    for machine in s.machines:
        for table in s.observers:
            mine = group(rows, machine, table.name).filter(pl.col("failed").is_null())
            never = mine["rms"].null_count()
            if never:
                where = f" on {s.called(machine)}" if several else ""
                out.append(
                    f"{table.name}{where} is never valid in {_count(never, 'scenario')}: median, "
                    f"99 % and worst leave {'it' if never == 1 else 'them'} out."
                )
    return out


def matters(found: Dataset, rows: pl.DataFrame) -> dict[tuple[str, str], list[Index]]:
    """Indices of the quantities, by machine and observer."""
    s = found.specification
    quantities = tuple(name for name in s.vary if name in s.varied or name in s.grids)
    return {
        (machine, table.name): statistics.indices(group(rows, machine, table.name), quantities)
        for machine in s.machines
        for table in s.observers
    }


def told_indices(found: list[Index], scenarios: int) -> str:
    """The largest indices in words."""
    if scenarios < statistics.FEWEST:
        return f"not told by fewer than {statistics.FEWEST} scenarios"
    if not found:
        return "nothing: it is the same in all scenarios, or no quantity varies"
    clear = [one for one in found if one.low > 0][:MATTER]
    if not clear:
        return "no single tolerance: it is their combination, the course, and noise"
    words = [
        f"{one.quantity} {100 * one.share:.0f} % ({100 * one.low:.0f} to {100 * one.high:.0f} %)"
        for one in clear
    ]
    return ", ".join(words)


def text(found: Dataset, rows: pl.DataFrame) -> tuple[Any, list[str]]:
    """For a terminal: a rich table, and sentences."""
    from rich.markup import escape as plain
    from rich.table import Table

    head, lines = summary_rows(found, rows)
    table = Table(box=None, pad_edge=False)
    for k, name in enumerate(head):
        table.add_column(name, justify="left" if k < 2 else "right", overflow="fold")
    for line in lines:
        table.add_row(*(plain(visible(cell)) for cell in line))
    s = found.specification
    several = len(s.machines) > 1
    sentences = [*failures(rows), *never_valid(found, rows), *against(s, rows)]
    for (machine, observer), indices in matters(found, rows).items():
        where = f" on {s.called(machine)}" if several else ""
        sentences.append(
            f"What the error of {observer}{where} varies with: "
            f"{told_indices(indices, s.scenarios)}."
        )
    for table_ in s.observers:
        first = worst(rows.lazy(), table_.name).head(1)
        if len(first):
            row = first.row(0, named=True)
            sentences.append(
                f"Worst valid row of {table_.name}: {degrees(row['worst'])} in scenario "
                f"{row['number']}; `{_again(found, row['number'], table_)}` shows it."
            )
    return table, sentences


def _again(found: Dataset, number: int | str, table: ObserverTable) -> str:
    """The command that simulates a scenario again, with what it writes of this observer."""
    estimated = table.kind in (PLAIN, ADAPTIVE)
    wanted = ("--report", "again.html") if estimated else ("--record", "again.parquet")
    return shlex.join(
        [
            *("fluxobs", "campaign", str(found.folder), "--rerun", str(number)),
            *("--observer", table.name, *wanted),
        ]
    )


def write_html(found: Dataset, rows: pl.DataFrame) -> Path:
    """Write report.html into the campaign's folder."""
    s = found.specification
    head, lines = summary_rows(found, rows)
    indices = matters(found, rows)
    verdicts = statistics.verdicts(s, rows)
    parts = [
        html.paragraph(headline(found)),
        *([_verdicts(verdicts)] if verdicts else []),
        html.bullets([*failures(rows), *never_valid(found, rows)]),
        html.table(head, lines),
        html.bullets(against(s, rows)),
        "<h2>Distribution of the position error</h2>",
        html.picture(pictures.distribution(s, rows), "Share of scenarios below an rms error"),
        "<h2>Which tolerance matters</h2>",
        html.paragraph(
            "Share of the variance of log(rms position error) that each quantity explains alone "
            "(first-order Sobol' index), with its interval. The rest is due to quantities "
            "together, to the course and to noise."
        ),
        html.picture(pictures.importance(s, indices), "Sobol' indices with intervals")
        if any(indices.values())
        else html.paragraph(f"Not told: {told_indices([], s.scenarios)}."),
        *_pairs(found, rows, indices),
        f"<h2>Worst {KEPT}</h2>",
        *(_worst(found, rows, table) for table in s.observers),
    ]
    path = found.folder / REPORT
    write_text(path, html.document(f"Campaign: {s.name}", *parts))
    return path


def _verdicts(verdicts: list[statistics.Verdict]) -> str:
    word = "passed" if all(one.met for one in verdicts) else "not passed"
    return f"<p><b>{escape(word.capitalize())}</b></p>" + html.bullets(map(str, verdicts))


def _pairs(
    found: Dataset, rows: pl.DataFrame, indices: dict[tuple[str, str], list[Index]]
) -> list[str]:
    out = ["<h2>Yield over pairs of tolerances</h2>"]
    for (machine, observer), some in indices.items():
        names = [one.quantity for one in some[:MATTER]]
        mine = group(rows, machine, observer)
        share = statistics.yield_of(mine, found.specification.good)
        if len(names) < 2 or share.good in (0, share.of):
            continue  # nothing to see: all are good, or none
        pairs = [
            statistics.pair(mine, found.specification.good, x, y)
            for k, x in enumerate(names)
            for y in names[k + 1 :]
        ]
        title = f"{observer} on {found.specification.called(machine)}"
        out.append(html.picture(pictures.pairs(pairs, title), f"Yield over pairs, {title}"))
    return out if out[1:] else []


def _worst(found: Dataset, rows: pl.DataFrame, table: ObserverTable) -> str:
    s = found.specification
    lines = []
    varied = [name for name in s.vary if s.vary[name].varies]
    for row in worst(rows.lazy(), table.name).iter_rows(named=True):
        number = row["number"]
        name = f"{WORST}/{stem(s, number, table.name)}"
        shown = found.folder / f"{name}.html"
        link = f'<a href="{escape(name)}.html">{number}</a>' if shown.exists() else str(number)
        cells = [
            link,
            escape(s.called(row["machine"])),
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
        f"{escape(table.name)}: <code>{escape(_again(found, 'NUMBER', table))}"
        f"</code></caption><thead><tr>{names}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table>"
    )
