"""Describe the signal that a drive injects to see its rotor at rest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array, runs
from ..time.aligned import Aligned
from .marks import INJECTED
from .noise import LEAST_FREQUENCY, NOISE_ROWS

#: A signal rotates if the line at one sign of the frequency has this multiple of the other's power.
#: A pulsating signal has equal lines. A rotating one has the answer of the saliency at the other
#: sign: (L_q - L_d)² / (L_q + L_d)², 0.18 for L_q/L_d = 2.5.
ROTATING = 3.0
#: Bins on each side of a line that belong to it: Hann's window leaks into one.
LEAK = 2
#: Rows repeat after a number of samples, at most this, if the phase of the signal repeats as well:
#: the cosine of its change.
LONGEST_PERIOD, SAME_PHASE = 16, 0.95


@dataclass(frozen=True)
class Injection:
    """An injected signal.

    Attributes
    ----------
    kind : str
        "square wave" (at half or at a quarter of the sampling rate), "rotating" or "pulsating".
    frequency : float
        [Hz].
    period : int
        Samples after which the signal repeats; 1 if no small number.
    current, voltage : float
        Amplitudes of the vectors [A], [V].
    rows : int
        Rows with the injection.
    """

    kind: str
    frequency: float
    period: int
    current: float
    voltage: float
    rows: int

    @property
    def words(self) -> str:
        """The signal in words."""
        return f"{self.kind}, {self.frequency:.4g} Hz, {self.current:.3g} A, {self.voltage:.3g} V"


def _power(vectors: Array) -> Array:
    """Return the mean power of the bins of blocks of vectors, (blocks, NOISE_ROWS, 2).

    The sum over the bins of a line is the squared amplitude of e^{jωt}.
    """
    turn = 2 * np.pi * np.arange(NOISE_ROWS) / NOISE_ROWS
    window = 1 - np.cos(turn)
    spectrum = np.fft.fft((vectors[..., 0] + 1j * vectors[..., 1]) * window, axis=1)
    power: Array = np.mean(np.abs(spectrum) ** 2, axis=0) / (1.5 * NOISE_ROWS**2)
    return power


def describe_injection(pieces: Iterable[Aligned], sample_time: float) -> Injection | None:
    """Return the strongest injected signal of pieces of a log with marks; None without."""
    currents, voltages, rows = [], [], 0
    for piece in pieces:
        assert piece.marks is not None
        marked = np.asarray(piece.marks & INJECTED > 0)
        rows += int(marked.sum())
        for first, last in runs(marked):
            for start in range(first, last - NOISE_ROWS + 1, NOISE_ROWS):
                current = piece.current[start : start + NOISE_ROWS]
                voltage = piece.voltage[start : start + NOISE_ROWS]
                if np.isfinite(current).all() and np.isfinite(voltage).all():
                    currents.append(current)
                    voltages.append(voltage)
    if not currents:
        return None
    power = _power(np.stack(currents))
    least = int(np.ceil(LEAST_FREQUENCY * NOISE_ROWS))
    high = np.arange(least, NOISE_ROWS - least + 1)
    peak = int(high[np.argmax(power[high])])
    half = NOISE_ROWS // 2
    bins = peak + np.arange(-LEAK, LEAK + 1)
    line = power[bins % NOISE_ROWS]
    share = abs(float(np.sum(bins * line) / np.sum(line)) / NOISE_ROWS)  # of the sampling rate
    other = float(np.sum(power[(NOISE_ROWS - bins) % NOISE_ROWS]))
    square = float(np.sum(line))
    volts = float(np.sum(_power(np.stack(voltages))[bins % NOISE_ROWS]))
    if abs(peak - half) <= 1:
        kind, share, gain = "square wave", 0.5, 1.0
    elif square > ROTATING * other:
        kind, gain = "rotating", 1.0
    elif abs(min(peak, NOISE_ROWS - peak) - half // 2) <= 1:
        # Two lines of 1/√2 of the amplitude.
        kind, share, gain = "square wave", 0.25, 2**0.5
    else:
        kind, gain = "pulsating", 2.0
    share = min(share, 1 - share)
    period = next(
        (
            count
            for count in range(1, LONGEST_PERIOD + 1)
            if np.cos(2 * np.pi * share * count) > SAME_PHASE
        ),
        1,
    )
    return Injection(
        kind,
        share / sample_time,
        period,
        gain * square**0.5,
        gain * volts**0.5,
        rows,
    )
