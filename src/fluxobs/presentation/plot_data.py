"""Data that the pictures and sliders of a run need besides its columns."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..estimation.run import LogRun
from ..machines import Machine

#: Contributions that a picture shows by name.
BUDGET_LAYERS = 5


def shown_machine(machine: Machine) -> dict[str, Any]:
    """Return a machine's data that pictures need, ready for JSON."""
    position = machine.position_output
    return {
        "ports": list(machine.ports),
        "position": {
            "name": position.name,
            "unit": position.unit,
            "factor": position.factor,
            "title": position.title,
        },
    }


def shown(run: LogRun) -> dict[str, Any]:
    """Return a run's data that the pictures and sliders of a report or the page need."""
    machine, log = run.machine, run.log
    values = machine.parameters()
    return {
        "rows": len(log),
        "sample_time": log.sample_time,
        "lag": log.layout.lag,
        "frame": log.frame,
        "budget": _budget(run),
        "unknowns": list(run.unknowns),
        "adaptive": run.adaptive is not None,
        "memory": run.observer.memory,
        **shown_machine(machine),
        "parameters": {
            "memory": machine.memory,
            "values": {
                name: value
                for name, value in values.items()
                if value is None or isinstance(value, int | float)
            },
        },
    }


def _budget(run: LogRun) -> dict[str, Any] | None:
    """Return the largest contributions to the variance of the position over time [rad^2]."""
    budget = run.budget
    if budget is None or not budget.rows:
        return None
    t, names, layers = budget.layers(BUDGET_LAYERS)
    return {
        "t": t.tolist(),
        "names": names,
        "layers": [np.nan_to_num(layer).tolist() for layer in layers],
    }
