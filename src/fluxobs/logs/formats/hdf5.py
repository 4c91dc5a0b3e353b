"""HDF5, and MATLAB files of version 7.3, which are HDF5 as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import RecordError
from .extras import library
from .nested import Found, tables
from .table import Table

#: MATLAB's own group, which holds what others refer to.
_REFERENCES = "#refs#"


def open_hdf5(path: Path, extra: str = "hdf5") -> list[Table]:
    """Tables of the datasets of a file; a dataset in a group has the path "group/dataset"."""
    h5py = library("h5py", extra, path)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise RecordError(f"{path}: not a readable HDF5 file: {error}") from None
    found = Found()

    def visit(name: str | bytes, node: Any) -> None:
        if isinstance(name, bytes):  # no UTF-8
            name = name.decode("utf-8", errors="replace")
        if isinstance(node, h5py.Dataset) and not name.startswith(_REFERENCES) and node.shape:
            if node.is_virtual or node.external:
                raise RecordError(
                    f"{path}: the values of {name} are kept in other files, which are "
                    f"not read for a log; copy them into this one"
                )
            unit = next((node.attrs[k] for k in ("unit", "units", "Unit") if k in node.attrs), None)
            if isinstance(unit, bytes):
                unit = unit.decode("utf-8", errors="replace")
            found.add(name, node, None if unit is None else str(unit))

    try:
        file.visititems(visit)
    except RecordError:
        raise
    except Exception as error:  # h5py raises many kinds for a broken file
        raise RecordError(f"{path}: damaged: {error}") from None
    return tables(path, found)
