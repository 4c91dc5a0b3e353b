"""Persistency of excitation of a regressor along a record: (pe1) and (pe2) of the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...core.arrays import Array
from ...errors import ModelError


@dataclass(frozen=True, eq=False)
class Excitation:
    """Excitation by a regressor over sliding windows of one length.

    Attributes
    ----------
    window : float
        Length T [s].
    smallest, largest : (windows,) ndarray
        Extreme eigenvalues of ``∫ Φ Φᵀ`` over each window.
    """

    window: float
    smallest: Array
    largest: Array

    @property
    def alpha(self) -> float:
        """α of (pe1) or (pe2): the smallest eigenvalue over all windows."""
        return float(self.smallest.min())

    @property
    def ratio(self) -> float:
        """Smallest over largest eigenvalue in the worst window; 1 is perfect, 1e-5 is ill-posed."""
        return float((self.smallest / np.maximum(self.largest, 1e-300)).min())


def gram(signal: ArrayLike, h: float, window: float) -> Array:
    """Return the sliding ``∫_t^{t+T} Φ Φᵀ ds`` (windows, k, k), computed by the trapezoid rule."""
    phi = np.asarray(signal, float)
    length = round(window / h)
    if length < 1 or length >= len(phi):
        raise ModelError(
            f"a window of {window:g} s does not fit: the record has {len(phi)} rows of {h:g} s"
        )
    if not np.isfinite(phi).all():
        raise ModelError(
            f"the regressor is not finite at row {int(np.argwhere(~np.isfinite(phi))[0][0])}"
        )
    product = np.einsum("ki,kj->kij", phi, phi)
    area = (product[:-1] + product[1:]) / 2 * h
    # Cumulative sums restart in each block of one window, which avoids differences of large sums.
    count = len(area) - length + 1
    blocks = -(-len(area) // length)
    padded = np.zeros((blocks * length, *area.shape[1:]))
    padded[: len(area)] = area
    padded = padded.reshape(blocks, length, *area.shape[1:])
    head = np.cumsum(padded, axis=1).reshape(-1, *area.shape[1:])
    tail = np.cumsum(padded[:, ::-1], axis=1)[:, ::-1].reshape(-1, *area.shape[1:])
    start = np.arange(count)
    whole = start % length == 0
    return np.asarray(np.where(whole[:, None, None], 0.0, head[start + length - 1]) + tail[start])


def excitation(
    signal: ArrayLike, h: float, window: float, scale: ArrayLike | None = None
) -> Excitation:
    """Return the extreme eigenvalues of the sliding Gram matrix.

    Parameters
    ----------
    signal : (rows, k) array_like
        Regressor.
    h, window : float
        Sample time and window length [s].
    scale : (k,) array_like, optional
        Size of each unknown; default 1. The regressor is multiplied by these sizes, which makes the
        eigenvalues per-unit and comparable.
    """
    phi = np.asarray(signal, float)
    values = np.linalg.eigvalsh(gram(phi if scale is None else phi * scale, h, window))
    # Rounding may make an eigenvalue slightly negative.
    smallest, largest = np.asarray(values[:, 0], float), np.asarray(values[:, -1], float)
    # The integrated window is a whole number of steps.
    return Excitation(round(window / h) * h, np.maximum(smallest, 0.0), largest)


def persistency(
    signal: ArrayLike, h: float, windows: Sequence[float], scale: ArrayLike | None = None
) -> list[tuple[float, float, float]]:
    """Return (T, α, eigenvalue ratio) for each window length; α > 0 means excitation within T."""
    rows = []
    for window in windows:
        excited = excitation(signal, h, window, scale)
        rows.append((window, excited.alpha, excited.ratio))
    return rows
