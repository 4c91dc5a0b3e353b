"""Data that the pictures and sliders of a run need besides its columns."""

from __future__ import annotations

from typing import Any

from ..estimation.run import LogRun
from ..machines import Machine


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
