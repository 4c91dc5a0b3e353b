"""The one list of what observers return: name, unit, shape, file column, and which observer.

An estimate is a dataclass whose fields carry :func:`output`. Its attributes, its docstring, the
columns of a file, the summary's series, the test vectors of firmware and the table in the docs all
come from these fields. The compiled core uses the same names.
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
        In SI; "" if it has none.
    about : str
        What it is.
    vector : bool
        Two components (..., 2), one per port; else (...).
    boolean : bool
    in_files : bool
        Is a column of the files that an estimation writes.
    """

    name: str
    unit: str
    about: str
    vector: bool
    boolean: bool
    in_files: bool

    def columns(self, ports: Sequence[str]) -> tuple[str, ...]:
        """Names of its columns: ``flux`` gives ``flux_alpha``, ``flux_std`` ``flux_alpha_std``."""
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
    """The ``metadata`` of an estimate's field; arguments as for :class:`Output`."""
    return {"output": (unit, about, vector, boolean, in_files)}


def outputs(estimate: type) -> tuple[Output, ...]:
    """Outputs of a class of estimates, in the order of the files; ``valid`` comes last."""
    found = [Output(f.name, *f.metadata["output"]) for f in fields(estimate)]
    return tuple(sorted(found, key=lambda one: one.name == "valid"))


def in_files(estimate: type) -> tuple[Output, ...]:
    """Outputs that are columns of a file."""
    return tuple(one for one in outputs(estimate) if one.in_files)


def documented(estimate: Class) -> Class:
    """Class decorator: append the list of outputs to the docstring."""
    lines = []
    for one in outputs(estimate):
        kind = "ndarray of bool" if one.boolean else "ndarray"
        unit = f" [{one.unit}]" if one.unit else ""
        lines += [f"    {one.name} : {'(..., 2)' if one.vector else '(...)'} {kind}"]
        lines += [f"        {one.about.rstrip('.')}{unit}."]
    heading = "\n\n    Attributes\n    ----------\n"
    estimate.__doc__ = (estimate.__doc__ or "").rstrip() + heading + "\n".join(lines) + "\n    "
    return estimate


def markdown(*estimates: tuple[str, type]) -> str:
    """A table of the outputs of several observers, for the docs."""
    rows: dict[str, tuple[Output, list[str]]] = {}
    for title, estimate in estimates:
        for one in outputs(estimate):
            rows.setdefault(one.name, (one, []))[1].append(title)
    lines = ["| output | unit | observer | meaning |", "|---|---|---|---|"]
    for one, titles in rows.values():
        shape = ", one component per port" if one.vector else ""
        lines.append(
            f"| `{one.name}` | {one.unit or '–'} | {', '.join(titles)} "
            f"| {one.about.rstrip('.')}{shape} |"
        )
    return "\n".join(lines)
