"""The protocol that every observer keeps, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an observer says, for one sample (leading shape ``()``), a record or a batch.

    Attributes
    ----------
    flux : (..., 2) ndarray
        Flux linkage αβ [Wb]. With a current bias δ_i it is λ + L δ_i: see docs/theory.md, 3.
    psi_f : (...) ndarray
        Length of the position vector λ - L i [Wb]: magnet flux; active flux of a salient machine.
    theta_e : (...) ndarray
        Electrical position straight from the flux, in (-π, π] [rad]. Always finite.
    theta_e_tracked, speed_e : (...) ndarray
        Tracked position in (-π, π] [rad] and electrical speed [rad/s].
    drift : (..., 2) ndarray
        R δ_i - B δ_u [V], the rate at which the open-loop flux integral drifts.
    theta_e_std : (...) ndarray
        Standard deviation of theta_e [rad]; π/√3 (uniform over a turn) where nothing is known.
    valid : (...) ndarray of bool
        The position is known now.
    innovation : (...) ndarray
        Residual of the constraint over its assumed noise, before the sample was used.
    noise_share : (...) ndarray
        Share of the flux information that current noise alone would pretend.
    """

    flux: Array
    psi_f: Array
    theta_e: Array
    theta_e_tracked: Array
    speed_e: Array
    drift: Array
    theta_e_std: Array
    valid: NDArray[np.bool_]
    innovation: Array
    noise_share: Array


class Observer(Protocol):
    """State is data, the observer a frozen object; nothing is mutated.

    `step` takes the current sampled now and the mean voltage over the interval ending now; `run`
    gives the same numbers for a whole record.
    """

    def init(self, batch: tuple[int, ...] = ()) -> Any: ...

    def step(self, state: Any, voltage: ArrayLike, current: ArrayLike) -> tuple[Any, Estimate]: ...

    def run(self, record: Any) -> Estimate: ...
