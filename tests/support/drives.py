"""Simulated drives that share their compilation."""

from __future__ import annotations

import importlib
from typing import Any

import equinox as eqx
import jax
import numpy as np

# The package has a function of this name.
module = importlib.import_module("fluxobs.simulation.drive.simulate")
Profile = module.Profile

#: Rows of a run, and knots of a profile, that are compiled for; a run takes the next of them.
ROWS, KNOTS = (2400, 12000, 20000, 32000, 72000), 6
_compiled = module._simulate


def _longer(profile: Any) -> Any:
    return module._padded(profile, KNOTS) if len(profile.times) < KNOTS else profile


def simulate_compiled_once(
    drive: Any, course: Any, noise: np.ndarray, steps: int, delay: bool
) -> Any:
    """In place of `_simulate`: XLA compiles a scan for its length, and for the knots of profiles.

    So runs are made longer than was asked, and profiles get their last knot several times. What is
    returned are the rows that were asked for, which nothing that comes later changes.
    """
    rows = len(noise)
    most = next(length for length in ROWS if length >= rows)

    def is_profile(node: Any) -> bool:
        return isinstance(node, Profile)

    drive, course = jax.tree.map(
        lambda leaf: _longer(leaf) if is_profile(leaf) else leaf,
        (drive, course),
        is_leaf=is_profile,
    )
    more = np.concatenate([noise, np.zeros((most - rows, noise.shape[1]))])
    trace = _compiled(drive, course, more, steps, delay)
    return jax.tree.map(lambda part: part[:rows], eqx.filter(trace, eqx.is_array))
