"""Voltages held over a sample, like the mean voltage of an inverter.

Each step of such a voltage causes a kink in the current. The observers compute the mean current of
an interval from a cubic through four samples, which misses the kinks between the samples. The
missing part is the response of the machine's R and L to the voltage steps.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...errors import ObserverError

AnyArray = NDArray[Any]

#: By default, kinks are corrected from this share R h/L on. With 14 samples per period, neglected
#: kinks turn the flux by R h/L times two degrees.
MATTERS: float = _core.usual["MATTERS"]
#: Weights of the cubic through the last four samples for the last interval, newest first, times 24.
CUBIC = (9, 19, -5, 1)

Held = bool | Literal["auto"]


def held_share(held: Held, share: float) -> float:
    """Return the share R h/L if voltages are held, else 0; with "auto" also 0 if it is small.

    Raises
    ------
    ObserverError
        `held` is not True, False or "auto".
    """
    if held not in (True, False, "auto"):
        raise ObserverError(f'held must be True, False or "auto", got {held!r}')
    return share if held is True or (held == "auto" and share >= MATTERS) else 0.0


def kink_weights(share: float) -> tuple[float, float]:
    """Return the weights of the last two voltage steps in the cubic's error, latest first.

    The error is in the volt-seconds of the resistive drop; `share` is R h/L. A step Δu at the start
    of an interval adds ``(1 - exp(-t R/L)) Δu/R`` to the current. The weight of a step is the mean
    of this response over the last interval minus the mean of the cubic, divided by Δu/R. Older
    steps, at or before the oldest of the four samples, need no weight, because the cubic follows
    their response (firmware/fluxobs_config.c).
    """
    return _core.kink_weights(share)


def mean_current(current: AnyArray, axis: int = -1) -> AnyArray:
    """Return the mean over the interval that ends at each row, from a cubic through four samples.

    The current before the first row is assumed constant. `axis` is the axis of the rows.
    """
    i = np.moveaxis(current, axis, -1)
    padded = np.concatenate([np.repeat(i[..., :1], 3, axis=-1), i], axis=-1)
    recent = np.stack([padded[..., 3 - k : 3 - k + i.shape[-1]] for k in range(4)], axis=-1)
    return np.asarray(np.moveaxis(recent @ np.array(CUBIC) / 24, -1, axis))


def without_kinks(voltage: AnyArray, share: float, axis: int = -1) -> AnyArray:
    """Subtract the kinks' part of the resistive drop from held voltages [V].

    A step from or to a missing voltage counts as zero. `axis` is the axis of the rows.
    """
    if share == 0:
        return voltage
    u = np.moveaxis(voltage, axis, -1)
    step = np.diff(u, axis=-1, prepend=u[..., :1])
    step = np.where(np.isfinite(step), step, 0.0)
    previous = np.concatenate([np.zeros_like(step[..., :1]), step[..., :-1]], axis=-1)
    now, before = kink_weights(share)
    return np.asarray(np.moveaxis(u - now * step - before * previous, -1, axis))
