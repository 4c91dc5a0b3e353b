"""MATLAB files: up to version 7 by SciPy, in memory; of version 7.3 by h5py."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordError
from .extras import library
from .hdf5 import open_hdf5
from .mat_size import check_size
from .nested import Contents, tables
from .table import Table

#: Fields of a signal that carries its own name: of dSPACE ControlDesk, and of Simulink's
#: "structure with time".
_NAMED = (("Name", "Data", "Unit"), ("label", "values", "unit"))


def open_mat(path: Path) -> list[Table]:
    """Tables of the arrays of a file; a field of a struct has the path "struct/field"."""
    matlab = library("scipy.io", "mat", path)
    try:
        check_size(path)
        content = matlab.loadmat(path, simplify_cells=True)
    except NotImplementedError:
        return open_hdf5(path, "mat")
    except Exception as error:  # SciPy raises many kinds for a broken file
        raise RecordError(f"{path}: not a readable MATLAB file: {error}") from None
    found = Contents()
    _walk(found, "", {k: v for k, v in content.items() if not k.startswith("__")})
    if not found.columns and "None" in content:  # an object of a class
        raise RecordError(
            f"{path}: it holds objects of a MATLAB class, as timeseries or a Simulink Dataset, "
            f"which only MATLAB can read. Save arrays: s = struct; s.t = x.Time; s.i_a = x.Data; "
            f"save('log.mat', '-struct', 's')"
        )
    return tables(path, found)


def _walk(found: Contents, path: str, node: Any) -> None:
    if isinstance(node, Mapping):
        for name, data, unit in _NAMED:
            if data in node and isinstance(node.get(name), str) and node[name]:
                values = np.asarray(node[data])
                found.add(f"{path}/{node[name]}".lstrip("/"), values, str(node.get(unit, "")))
                return
        for name, child in node.items():
            _walk(found, f"{path}/{name}" if path else str(name), child)
    elif isinstance(node, list) or (isinstance(node, np.ndarray) and node.dtype == object):
        for n, child in enumerate(np.ravel(node) if isinstance(node, np.ndarray) else node):
            named = isinstance(child, Mapping) and any(
                isinstance(child.get(name), str) and child[name] for name, _, _ in _NAMED
            )
            _walk(found, path if named else f"{path}[{n}]", child)
    else:
        found.add(path, np.asarray(node))
