"""Requirements on the numbers of an observer; the messages name the field and its value."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..core.arrays import Array
from ..errors import ObserverError


def require_positive(name: str, value: Any) -> None:
    """Raise ObserverError unless a number, or each element of an array, is positive and finite."""
    if not np.all(np.isfinite(value) & (np.asarray(value) > 0)):
        raise ObserverError(f"{name} must be positive and finite, got {value}")


def require_not_negative(name: str, value: float) -> None:
    """Raise ObserverError unless a number is finite and not negative."""
    if not (np.isfinite(value) and value >= 0):
        raise ObserverError(f"{name} must be finite and not negative, got {value}")


def require_memory(memory: float, sample_time: float) -> None:
    """Raise ObserverError unless a memory spans at least ten samples."""
    if not memory >= 10 * sample_time:
        raise ObserverError(
            f"memory must be at least ten samples, {10 * sample_time:g} s here, got {memory:g} s"
        )


def positive_vector(name: str, value: Any, length: int) -> Array:
    """Return a read-only vector of positive numbers; a single number fills it."""
    vector = np.array(np.broadcast_to(value, (length,)), dtype=float)
    require_positive(name, vector)
    vector.setflags(write=False)
    return vector


def finite_matrix(name: str, value: Any, shape: tuple[int, int | None]) -> Array:
    """Return a read-only matrix of finite numbers; a shape of None allows any number of columns."""
    matrix = np.array(value, dtype=float)
    rows, columns = shape
    if matrix.ndim != 2 or len(matrix) != rows or columns not in (None, matrix.shape[1]):
        wanted = f"{rows} rows" if columns is None else f"shape ({rows}, {columns})"
        raise ObserverError(f"{name} must have {wanted}, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ObserverError(f"{name} must be finite, got {matrix.tolist()}")
    matrix.setflags(write=False)
    return matrix
