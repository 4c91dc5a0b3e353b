"""Machines from TOML files, and shipped examples by name."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from ..core.input_files import read_toml
from ..core.references import beside
from ..core.validation import nearest
from ..errors import FluxobsError, MachineError
from .contract import Machine
from .registry import KINDS


def machine_from(
    fields: Mapping[str, Any], source: str = "machine", folder: Path | None = None
) -> Machine:
    """Return a machine from a mapping with ``kind`` and its parameters.

    The path of a flux map is relative to `folder`.

    Raises
    ------
    MachineError
        A field is missing, unknown (the message suggests the nearest name) or impossible; the
        message names `source`.
    """
    parameters = dict(fields)
    flux_map = parameters.get("flux_map")
    if isinstance(flux_map, str) and folder is not None:
        parameters["flux_map"] = folder / flux_map
    kind = parameters.pop("kind", None)
    if kind is None:
        raise MachineError(f"{source}: kind is missing: give one of {', '.join(KINDS)}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise MachineError(f"{source}: unknown kind {kind!r}{nearest(str(kind), KINDS)}")
    try:
        return KINDS[kind](**parameters)
    except MachineError as error:
        raise MachineError(f"{source}: {error}") from None


def read_machine(path: str | Path) -> Machine:
    """Read a machine from a TOML file, or return a shipped example by its name.

    The table of a flux map must be in the file's folder or below it.

    Raises
    ------
    MachineError
        The file or example does not exist, is not TOML, has wrong parameters, or names a table in
        another folder.
    """
    path = Path(path)
    if not path.exists() and not path.suffix and path.name in example_names():
        return example(path.name)
    if not path.exists():
        raise MachineError(
            f"{path}: no such machine file or shipped machine{nearest(path.name, example_names())}"
        )
    fields = read_toml(path, MachineError)
    flux_map = fields.get("flux_map")
    if isinstance(flux_map, str):
        try:
            beside(path.parent, flux_map, "flux_map")
        except FluxobsError as error:
            raise MachineError(f"{path}: {error}") from None
    return machine_from(fields, source=str(path), folder=path.parent)


def _examples_folder() -> Any:
    return resources.files(__package__) / "examples"


def example_names() -> list[str]:
    """Return the names of the shipped machines."""
    return sorted(
        entry.name[:-5] for entry in _examples_folder().iterdir() if entry.name.endswith(".toml")
    )


def example(name: str) -> Machine:
    """Return a shipped machine by its name.

    >>> example("servo-400w").kind
    'surface-pmsm'
    """
    if name not in example_names():
        raise MachineError(f"no shipped machine {name!r}{nearest(name, example_names())}")
    return machine_from(
        tomllib.loads(example_text(name)), source=name, folder=Path(str(_examples_folder()))
    )


def example_text(name: str) -> str:
    """Return the TOML of a shipped machine, comments included."""
    return str((_examples_folder() / f"{name}.toml").read_text(encoding="utf-8"))


def copy_example(name: str, folder: Path) -> Path:
    """Write a shipped machine file and its flux map into a folder; return the machine file."""
    text = example_text(name)
    path = folder / f"{name}.toml"
    path.write_text(text, "utf-8")
    table = tomllib.loads(text).get("flux_map")
    if isinstance(table, str):
        (folder / table).write_bytes((_examples_folder() / table).read_bytes())
    return path


#: What a function accepts as a machine: an object, a file, the name of a shipped example, or the
#: fields of a machine file.
MachineSource = Machine | str | Path | Mapping[str, Any]


def as_machine(machine: MachineSource) -> Machine:
    """Return `machine` unchanged, read from a file or by the name of an example, or from fields.

    >>> as_machine({"kind": "surface-pmsm", "R_s": 0.5, "L_s": 1e-3, "psi_f": 0.01, "n_p": 4}).kind
    'surface-pmsm'

    Raises
    ------
    MachineError
        `machine` is neither a machine, nor a path, nor a name, or its fields are wrong.
    """
    if isinstance(machine, Machine):
        return machine
    if isinstance(machine, str | Path):
        return read_machine(machine)
    if isinstance(machine, Mapping):
        return machine_from(machine, source="machine")
    raise MachineError(
        f"expected a machine, a TOML file, the fields of one, or one of "
        f"{', '.join(example_names())}, got {type(machine).__name__}"
    )
