"""The list of observer outputs, each with name, unit, shape, file columns and observers.

An estimate is a dataclass, and :func:`output` describes each of its fields. The fields determine
the estimate's attributes and docstring, the columns of a file, the summary's series, the test
vectors of firmware and the table in the docs. The compiled core uses the same names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

Class = TypeVar("Class", bound=type)


@dataclass(frozen=True)
class Output:
    """One output.

    Attributes
    ----------
    name : str
        Name of the attribute and of the column.
    unit : str
        SI unit; "" if dimensionless.
    about : str
        Description.
    vector : bool
        Whether the output has two components, one per port: shape (..., 2), else (...).
    boolean : bool
    in_files : bool
        Whether an estimation writes it to files.
    """

    name: str
    unit: str
    about: str
    vector: bool
    boolean: bool
    in_files: bool

    def columns(self, ports: Sequence[str]) -> tuple[str, ...]:
        """Return the column names: ``flux_std`` has ``flux_alpha_std`` and ``flux_beta_std``."""
        if not self.vector:
            return (self.name,)
        stem, std = (self.name[:-4], "_std") if self.name.endswith("_std") else (self.name, "")
        return tuple(f"{stem}_{port}{std}" for port in ports)


def output(
    unit: str,
    about: str,
    *,
    vector: bool = False,
    boolean: bool = False,
    in_files: bool = True,
) -> dict[str, Any]:
    """Return the ``metadata`` of an estimate's field; :class:`Output` explains the arguments."""
    return {"output": (unit, about, vector, boolean, in_files)}


def outputs(estimate: type) -> tuple[Output, ...]:
    """Return the outputs of a class of estimates in file order, with ``valid`` last."""
    unsorted = [Output(item.name, *item.metadata["output"]) for item in fields(estimate)]
    return tuple(sorted(unsorted, key=lambda output: output.name == "valid"))


def in_files(estimate: type) -> tuple[Output, ...]:
    """Return the outputs that are columns of a file."""
    return tuple(output for output in outputs(estimate) if output.in_files)


def documented(estimate: Class) -> Class:
    """Class decorator: append the list of outputs to the docstring."""
    lines = []
    for output in outputs(estimate):
        kind = "ndarray of bool" if output.boolean else "ndarray"
        unit = f" [{output.unit}]" if output.unit else ""
        lines += [f"    {output.name} : {'(..., 2)' if output.vector else '(...)'} {kind}"]
        lines += [f"        {output.about.rstrip('.')}{unit}."]
    heading = "\n\n    Attributes\n    ----------\n"
    estimate.__doc__ = (estimate.__doc__ or "").rstrip() + heading + "\n".join(lines) + "\n    "
    return estimate


def markdown(*estimates: tuple[str, type]) -> str:
    """Return a Markdown table of the outputs of several observers, for the docs."""
    rows: dict[str, tuple[Output, list[str]]] = {}
    for title, estimate in estimates:
        for output in outputs(estimate):
            rows.setdefault(output.name, (output, []))[1].append(title)
    lines = ["| output | unit | observer | meaning |", "|---|---|---|---|"]
    for output, titles in rows.values():
        shape = ", one component per port" if output.vector else ""
        lines.append(
            f"| `{output.name}` | {output.unit or '–'} | {', '.join(titles)} "
            f"| {output.about.rstrip('.')}{shape} |"
        )
    return "\n".join(lines)
