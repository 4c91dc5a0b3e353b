"""The classical Runge-Kutta step, for states that are any tree of arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import jax

State = TypeVar("State")
#: Where in a step a rate is asked for: at its start, in its middle, at its end.
Place = Literal[0, 1, 2]


def runge_kutta_step(rate: Callable[[State, Place], State], state: State, h: Any) -> State:
    """State after h, of order four; `rate` gives the derivative of a state at a place."""

    def along(rates: State, step: Any) -> State:
        moved: State = jax.tree.map(lambda x, r: x + step * r, state, rates)
        return moved

    k1 = rate(state, 0)
    k2 = rate(along(k1, h / 2), 1)
    k3 = rate(along(k2, h / 2), 1)
    k4 = rate(along(k3, h), 2)
    mean: State = jax.tree.map(lambda a, b, c, d: (a + 2 * b + 2 * c + d) / 6, k1, k2, k3, k4)
    return along(mean, h)
