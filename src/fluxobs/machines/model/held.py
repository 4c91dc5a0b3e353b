"""Voltages that are held over a sample, as the mean voltage of an inverter is.

Each step of such a voltage puts a kink into the current. The observers take the mean current of an
interval from a cubic through four samples, which knows nothing of the kinks inside those samples.
What it misses is known from the steps: the response of the machine's own R and L.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...errors import ObserverError

AnyArray = NDArray[Any]

#: Share R h/L from which kinks are counted in by default: with 14 samples a period, what is missed
#: turns the flux by R h/L times two degrees.
MATTERS: float = _core.usual["MATTERS"]
#: Weights of the cubic through the last four samples for the last interval, newest first, times 24.
CUBIC = (9, 19, -5, 1)

Held = bool | Literal["auto"]


def held_share(held: Held, share: float) -> float:
    """The share R h/L if voltages are held, else 0; "auto": if they may be and it matters.

    Raises
    ------
    ObserverError
        `held` is none of True, False and "auto".
    """
    if held not in (True, False, "auto"):
        raise ObserverError(f'held must be True, False or "auto", got {held!r}')
    return share if held is True or (held == "auto" and share >= MATTERS) else 0.0


def kink_weights(share: float) -> tuple[float, float]:
    """Of the last step of the voltage and of the one before it, in the volt-seconds that the cubic
    leaves in the resistive drop; `share` is R h/L.

    A step Δu at the start of an interval adds ``(1 - exp(-t R/L)) Δu/R`` to the current. Its mean
    over the last interval less the cubic's, over Δu/R, is the weight. Steps further back lie before
    all four samples or at the oldest, where the cubic meets the response
    (firmware/fluxobs_config.c).
    """
    return _core.kink_weights(share)


def mean_current(current: AnyArray, axis: int = -1) -> AnyArray:
    """Mean over the interval that ends at each row, by the cubic through four samples; before the
    first row the current is taken to have stood. `axis` is that of the rows."""
    i = np.moveaxis(current, axis, -1)
    padded = np.concatenate([np.repeat(i[..., :1], 3, axis=-1), i], axis=-1)
    recent = np.stack([padded[..., 3 - k : 3 - k + i.shape[-1]] for k in range(4)], axis=-1)
    return np.asarray(np.moveaxis(recent @ np.array(CUBIC) / 24, -1, axis))


def without_kinks(voltage: AnyArray, share: float, axis: int = -1) -> AnyArray:
    """Held voltages less what the kinks of the current add to the resistive drop [V].

    A step from or to a voltage that is missing counts as none; `axis` is that of the rows.
    """
    if share == 0:
        return voltage
    u = np.moveaxis(voltage, axis, -1)
    step = np.diff(u, axis=-1, prepend=u[..., :1])
    step = np.where(np.isfinite(step), step, 0.0)
    before = np.concatenate([np.zeros_like(step[..., :1]), step[..., :-1]], axis=-1)
    now, earlier = kink_weights(share)
    return np.asarray(np.moveaxis(u - now * step - earlier * before, -1, axis))
