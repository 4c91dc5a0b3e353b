"""What the pictures and the sliders of a run need to know besides its columns."""

from __future__ import annotations

from typing import Any

from ..machines import Machine
from .run import LogRun


def shown_machine(machine: Machine) -> dict[str, Any]:
    """What pictures need to know of a machine, as JSON can hold it."""
    where = machine.position_output
    return {
        "ports": list(machine.ports),
        "position": {
            "name": where.name,
            "unit": where.unit,
            "factor": where.factor,
            "title": where.title,
        },
    }


def shown(run: LogRun) -> dict[str, Any]:
    """What they need to know of a run; a report carries it, the page gets it from its worker."""
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
