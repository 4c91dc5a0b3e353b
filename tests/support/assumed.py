"""Assumptions of the smoother for tests."""

from __future__ import annotations

import numpy as np

from fluxobs.smoothing.assumptions import NAMES
from fluxobs.smoothing.record import Assumed, SmoothingModel


def alone(model: SmoothingModel, name: str) -> Assumed:
    """Return assumptions of which only one is uncertain."""
    variance = np.zeros(len(model.active))
    variance[model.active.index(name)] = model.stds[name] ** 2
    return Assumed(dict.fromkeys(NAMES, 0.0), np.diag(variance), 1.0)
