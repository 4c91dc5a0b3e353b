"""MATLAB files: SciPy reads files up to version 7 into memory; h5py reads files of version 7.3."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordError
from .extras import library
from .hdf5 import objects_of_matlab, open_hdf5
from .mat_size import check_size
from .nested import Contents, tables
from .table import Table

#: Fields (name, values, unit) of a named signal: those of dSPACE ControlDesk, and those of
#: Simulink's "structure with time".
_SIGNAL_FIELDS = (("Name", "Data", "Unit"), ("label", "values", "unit"))


def open_mat(path: Path) -> list[Table]:
    """Open the tables of the arrays of a file; a struct field has the path "struct/field"."""
    matlab = library("scipy.io", "mat", path)
    try:
        check_size(path)
        content = matlab.loadmat(path, simplify_cells=True)
    except NotImplementedError:
        return open_hdf5(path, "mat")
    except Exception as error:  # SciPy raises many kinds of errors for a broken file
        raise RecordError(f"{path}: not a readable MATLAB file: {error}") from None
    contents = Contents()
    _collect(
        contents, "", {name: value for name, value in content.items() if not name.startswith("__")}
    )
    if not contents.columns and "None" in content:  # the file holds an object of a MATLAB class
        raise RecordError(objects_of_matlab(path, {}))
    return tables(path, contents)


def _collect(contents: Contents, path: str, node: Any) -> None:
    if isinstance(node, Mapping):
        for name, data, unit in _SIGNAL_FIELDS:
            if data in node and isinstance(node.get(name), str) and node[name]:
                values = np.asarray(node[data])
                contents.add(f"{path}/{node[name]}".lstrip("/"), values, str(node.get(unit, "")))
                return
        for name, child in node.items():
            _collect(contents, f"{path}/{name}" if path else str(name), child)
    elif isinstance(node, list) or (isinstance(node, np.ndarray) and node.dtype == object):
        for n, child in enumerate(np.ravel(node) if isinstance(node, np.ndarray) else node):
            is_signal = isinstance(child, Mapping) and any(
                isinstance(child.get(name), str) and child[name] for name, _, _ in _SIGNAL_FIELDS
            )
            _collect(contents, path if is_signal else f"{path}[{n}]", child)
    else:
        contents.add(path, np.asarray(node))
