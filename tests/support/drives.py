"""Simulated drives that share compiled code."""

from __future__ import annotations

import importlib
from typing import Any

import equinox as eqx
import jax
import numpy as np

# This is the module; the package has a function of the same name.
module = importlib.import_module("fluxobs.simulation.drive.simulate")
Profile = module.Profile

#: Compiled lengths of runs, and knots of profiles; a run uses the next larger length.
ROWS, KNOTS = (2400, 12000, 20000, 32000, 72000), 6
_compiled = module._simulate


def _longer(profile: Any) -> Any:
    return module._padded(profile, KNOTS) if len(profile.times) < KNOTS else profile


def simulate_compiled_once(
    drive: Any, course: Any, noise: np.ndarray, steps: int, delay: bool
) -> Any:
    """Replace `_simulate`: XLA compiles a scan again for each length and each number of knots.

    Runs are longer than requested, and profiles repeat their last knot. Only the requested rows are
    returned; later rows do not affect them.
    """
    rows = len(noise)
    compiled_rows = next(length for length in ROWS if length >= rows)

    def is_profile(node: Any) -> bool:
        return isinstance(node, Profile)

    drive, course = jax.tree.map(
        lambda leaf: _longer(leaf) if is_profile(leaf) else leaf,
        (drive, course),
        is_leaf=is_profile,
    )
    padded = np.concatenate([noise, np.zeros((compiled_rows - rows, noise.shape[1]))])
    trace = _compiled(drive, course, padded, steps, delay)
    return jax.tree.map(lambda values: values[:rows], eqx.filter(trace, eqx.is_array))
