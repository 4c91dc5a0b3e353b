"""White noise of a signal, and injected signals that look like noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array

#: Rows from which one noise level is computed; transients do not change the median of the levels.
NOISE_ROWS = 256
#: If third differences have this multiple of the noise floor's variance, a signal is injected.
LINES = 4.0
#: Frequencies above this share of the sampling frequency show noise and injected signals: the
#: fundamental is below an eighth.
LEAST_FREQUENCY = 0.15
#: An injected signal has this multiple of the power of white noise with the median of the spectrum,
#: and this share of the usual current as its rms value.
LINE_RATIO, LINE_SIZE = 10.0, 0.005
#: An injected signal has this share of the power within LINE_BINS on each side of one frequency,
#: positive and negative.
LINE_SHARE, LINE_BINS = 0.6, 2
#: A larger share of the power of a block is its fundamental, logged too slowly. A signal whose
#: positive and negative lines differ by less than this factor pulsates, and is no fundamental.
#: Without load it is most of the current; its limit is LINE_MOST of the power of half the usual
#: current.
LINE_MOST, SYMMETRY = 0.1, 3.0


class Blocks(NamedTuple):
    """Blocks of NOISE_ROWS rows; of a shorter signal one block.

    Attributes
    ----------
    rows : int
        Rows of a block.
    level : (blocks,) ndarray
        Variance of a component from third differences, less 20 times as large; NaN if unknown.
    floor : (blocks,) ndarray
        The same from the median of the spectrum; NaN if a value is missing or a block is short.
    lines : (blocks,) ndarray
        Variance of an injected signal; 0 without, NaN if unknown.
    narrow, pulsating : (blocks,) ndarray of bool
        Whether most of the power above LEAST_FREQUENCY is at one frequency; whether it pulsates.
    """

    rows: int
    level: Array
    floor: Array
    lines: Array
    narrow: NDArray[np.bool_]
    pulsating: NDArray[np.bool_]


def _strongest(power: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which blocks have a strong line, and where its positive and negative parts agree."""
    width = 2 * LINE_BINS + 1
    total = np.concatenate([np.zeros((len(power), 1)), np.cumsum(power, axis=1)], axis=1)
    line = total[:, width:] - total[:, :-width]  # of the frequency in the middle
    other = line[:, ::-1]
    peak = np.array([int(np.argmax(both)) for both in line + other], int)
    rows = np.arange(len(power))
    first, second = line[rows, peak], other[rows, peak]
    middle = line.shape[1] // 2  # half the sampling frequency is one line
    share = np.where(np.abs(peak - middle) <= LINE_BINS, first, first + second)
    # A spectrum that falls with the frequency, as that of a step, is largest at the edge.
    inside = np.abs(peak - middle) < middle
    narrow = inside & (share > LINE_SHARE * total[:, -1])
    alike = np.maximum(first, second) < SYMMETRY * np.minimum(first, second)
    return np.asarray(narrow), np.asarray(narrow & alike)


def blocks_of(signal: Array) -> Blocks:
    """Return the noise of the blocks of a signal of shape (rows, 2).

    Third differences remove the smooth signal and have 20 times the variance of the noise. An
    injected signal has few lines in a spectrum, so the median of the spectrum does not contain it.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # garbage may overflow
        differences = np.diff(signal, 3, axis=0)
    rows = max(1, min(NOISE_ROWS, len(differences)))
    whole = differences[: len(differences) // rows * rows]
    parts = whole.reshape(-1, 2 * rows)
    known = np.isfinite(parts)
    counts = known.sum(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        squares = (np.where(known, parts, 0.0) ** 2).sum(axis=1)
    enough = counts >= rows  # half of the block
    level = np.where(enough, squares / np.maximum(counts, 1) / 20, np.nan)
    unknown = np.full(len(parts), np.nan)
    if rows < NOISE_ROWS:
        no = np.zeros(len(parts), bool)
        return Blocks(rows, level, unknown, unknown, no, no)
    turn = np.exp(2j * np.pi * np.arange(rows) / rows)
    window = 1 - turn.real  # Hann: the lines of a signal that turns do not leak
    gain = np.abs(1 - turn) ** 6
    high = gain > np.abs(1 - np.exp(2j * np.pi * LEAST_FREQUENCY)) ** 6
    vectors = (whole[:, 0] + 1j * whole[:, 1]).reshape(-1, rows)
    with np.errstate(over="ignore", invalid="ignore"):
        spectrum = np.fft.fft(vectors * window, axis=1)[:, high]
        power = np.abs(spectrum) ** 2 / (1.5 * rows * gain[high])
    # Power of a bin of white noise: exponential with the mean 2 σ², whose median is 2 σ² ln 2.
    floor = np.median(power, axis=1) / (2 * np.log(2))
    with np.errstate(over="ignore", invalid="ignore"):
        total = power.sum(axis=1)
        clear = total > 2 * power.shape[1] * LINE_RATIO * floor
    lines = np.where(clear, total / (2 * rows), np.where(np.isfinite(total), 0.0, np.nan))
    return Blocks(rows, level, floor, lines, *_strongest(power))


def white_noise(signal: Array) -> float:
    """Return the std of one component of white noise on a smooth signal of shape (rows, 2)."""
    blocks = blocks_of(signal)
    with np.errstate(invalid="ignore"):
        levels = np.where(blocks.level > LINES * blocks.floor, blocks.floor, blocks.level)
    levels = levels[np.isfinite(levels)]
    return float(np.sqrt(np.median(levels))) if len(levels) else 0.0


def injected(current: Array, usual: float) -> NDArray[np.bool_]:
    """Return the rows into which a signal is injected; `usual` is the usual current [A]."""
    marked = np.zeros(len(current), bool)
    blocks = blocks_of(current)
    with np.errstate(invalid="ignore"):
        flags = blocks.narrow & (blocks.lines > (LINE_SIZE * usual) ** 2)
    for n in np.flatnonzero(flags).tolist():
        block = current[n * blocks.rows : (n + 1) * blocks.rows]
        most = float(np.mean(block**2))
        if blocks.pulsating[n]:
            most = max(most, usual**2 / 4)
        if not blocks.lines[n] < LINE_MOST * most:
            continue
        # The differences of a block reach three rows farther.
        marked[n * blocks.rows : (n + 1) * blocks.rows + 3] = True
    return marked
