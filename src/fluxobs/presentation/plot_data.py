"""Data that the pictures and sliders of a run need besides its columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..core.arrays import Array
from ..estimation.run import LogRun
from ..logs.log import Log
from ..logs.time.aligned import joined
from ..machines import Machine
from ..machines.model.frames import rotate

#: Contributions that a picture shows by name.
BUDGET_LAYERS = 5


def shown_machine(machine: Machine) -> dict[str, Any]:
    """Return a machine's data that pictures need, ready for JSON."""
    position = machine.position_output
    return {
        "ports": list(machine.ports),
        "n_p": getattr(machine, "n_p", None),
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


def signals(
    log: Log,
    ports: Sequence[str],
    lag: float | None,
    theta_e: Array | None,
    speed_e: Array | None,
) -> dict[str, Array]:
    """Return the currents [A] and voltages [V] of all rows as pictures show them.

    Those of a rotating machine are along d and q of the estimated rotor.

    Parameters
    ----------
    log : Log
    ports : sequence of str
        Of the machine.
    lag : float, optional
        Lag that was learnt [samples]; default: that of the log.
    theta_e, speed_e : (rows,) ndarray, optional
        Estimates [rad], [rad/s].
    """
    rows = joined(list((log if lag is None else log.lagged(lag - log.layout.lag)).aligned()))
    current, voltage, axes = rows.current, rows.voltage, ports
    if theta_e is not None:
        axes = ("d", "q")
        middle = theta_e if speed_e is None else theta_e - speed_e * (log.sample_time / 2)
        current, voltage = rotate(current, -theta_e), rotate(voltage, -middle)
    return {
        f"{name}_{axis}": values[:, n]
        for name, values in (("i", current), ("u", voltage))
        for n, axis in enumerate(axes)
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
