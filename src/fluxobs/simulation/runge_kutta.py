"""The classical Runge-Kutta step for states that are trees of arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import jax

State = TypeVar("State")
#: Point of a step at which a rate is evaluated: start, middle or end.
Place = Literal[0, 1, 2]


def runge_kutta_step(rate: Callable[[State, Place], State], state: State, h: Any) -> State:
    """Return the state after h; the order is four. `rate` returns the derivative at a place."""

    def advance(rates: State, step: Any) -> State:
        moved: State = jax.tree.map(lambda x, r: x + step * r, state, rates)
        return moved

    k1 = rate(state, 0)
    k2 = rate(advance(k1, h / 2), 1)
    k3 = rate(advance(k2, h / 2), 1)
    k4 = rate(advance(k3, h), 2)
    mean: State = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
    return advance(mean, h)
