"""A log for the smoother, and smoothed records."""

from __future__ import annotations

import numpy as np

from fluxobs.estimation import whole_log
from fluxobs.smoothing.record import OUTPUTS, QUANTITIES, SHARES, Cost, SmoothedRecord

from .records import SERVO, Samples, driven


def fast_run() -> Samples:
    """Return a fast run with load steps, and a reversal."""
    t = 1e-4 * np.arange(20_000)
    speed = np.interp(t, [0, 0.3, 1.2, 1.6, 2.0], [200, 1500, 1500, -900, -900])
    current = 1j * np.interp(
        t, [0, 0.5, 0.51, 0.8, 0.81, 1.7, 1.71, 2], [2, 2, 11, 11, 3, 3, -9, -9]
    )
    return driven(SERVO, 1e-4, speed, current, noise=0.02)


def record(seed: int, offset: float) -> SmoothedRecord:
    """Return a record of 12 rows with random estimates around `offset`."""
    rng = np.random.default_rng(seed)
    rows, blocks = 12, 3
    outputs = {name: offset + 0.1 * rng.random(rows) for name in OUTPUTS}
    shares = rng.random((blocks, len(QUANTITIES), len(SHARES)))
    model = type("Model", (), {"rows_per_block": 4})()
    return SmoothedRecord(
        model,
        None,
        0.01,
        Cost(0.0, 0.0, 0.0, 0.0),
        True,
        False,
        outputs,
        np.ones(rows, bool),
        None,
        shares,
    )


def shorten_windows(monkeypatch) -> None:
    """Make a log of 20,000 rows a long one: two windows, parameters learnt from two segments."""
    monkeypatch.setattr(whole_log, "WINDOW_ROWS", 8_192)
    monkeypatch.setattr(whole_log, "OVERLAP_ROWS", 2_048)
    monkeypatch.setattr(whole_log, "SEGMENTS", 2)
    monkeypatch.setattr(whole_log, "SEGMENT_ROWS", 10_000)
