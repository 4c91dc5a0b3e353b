"""Errors of the drives of the suite, as quantities of a campaign."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Machines of the suite.
MACHINES = (
    *("servo-400w", "drone-900kv", "pmsm-2kw2", "ipm-2kw2", "ipm-5kw6"),
    *("synrm-6kw7", "synrm-6kw7-saturated", "induction-2kw2"),
)
#: Machines with one inductance.
ROUND = ("servo-400w", "drone-900kv", "pmsm-2kw2")
#: Courses of speed and load, as a campaign's table.
COURSES: dict[str, dict[str, float | list[float]]] = {
    "mixed": {"speeds": [0.05, 1.0], "stops": 0.15, "reversals": 0.3},
    "stops": {"speeds": [0.1, 0.8], "stops": 0.5, "reversals": 0.4},
    "low speed": {"speeds": [0.02, 0.1], "stops": 0.1, "reversals": 0.3},
    "steady": {"speeds": [0.3, 1.0], "stops": 0.0, "reversals": 0.0, "segment": [1.0, 2.0]},
}
#: Courses of the closed loop: [time in s, share of the rated value] of speed and load. All drives
#: start at rest without load.
LOOP_COURSES: dict[str, dict[str, list[list[float]]]] = {
    "run up": {
        "speed": [[0.2, 0.0], [1.2, 0.3], [2.0, 1.0], [4.0, 1.0]],
        "load": [[2.2, 0.0], [2.3, 0.5], [4.0, 0.5]],
    },
    "load step": {
        "speed": [[0.2, 0.0], [1.2, 0.3], [4.0, 0.3]],
        "load": [[1.6, 0.0], [1.6, 0.8], [2.8, 0.8], [2.8, 0.0]],
    },
    "reversal": {
        "speed": [[0.2, 0.0], [1.2, 0.5], [2.4, 0.5], [3.4, -0.5], [4.0, -0.5]],
        "load": [[1.6, 0.0], [1.6, 0.4], [2.2, 0.4], [2.2, 0.0]],
    },
    "low speed": {
        "speed": [[0.2, 0.0], [1.2, 0.3], [2.0, 0.3], [2.5, 0.1], [4.0, 0.1]],
        "load": [[1.5, 0.0], [1.6, 0.3], [4.0, 0.3]],
    },
}
Draw = Callable[[np.random.Generator, str], dict[str, float]]


def every_error(rng: np.random.Generator, machine: str) -> dict[str, float]:
    """Draw each error with a probability of one half, as large as logs in the field have it."""

    def half() -> bool:
        return bool(rng.random() < 0.5)

    values: dict[str, float] = {"theta_e": rng.uniform(-3, 3)}
    if half():
        values |= {f"offset_{port}": rng.normal(0, 0.015) for port in ("alpha", "beta")}
    if half():
        values |= {f"voltage_offset_{port}": rng.normal(0, 0.003) for port in ("alpha", "beta")}
    if half():
        values |= {f"gain_{phase}": 1 + rng.normal(0, 0.012) for phase in "abc"}
    if half():
        values["dead_time"] = rng.uniform(0.002, 0.03)
    if half():
        values["drop"] = rng.uniform(0, 0.003)
    values["knee"] = float(np.exp(rng.uniform(np.log(0.01), np.log(0.09))))
    if half():
        values["R"] = rng.uniform(0.6, 1.6)
    if half() and "synrm" not in machine:
        values["psi"] = rng.uniform(0.8, 1.25)
    if half():
        if machine == "induction-2kw2":
            values |= {"L_sigma": rng.uniform(0.75, 1.25), "L_M": rng.uniform(0.75, 1.25)}
        elif machine in ROUND:
            values["L_s"] = rng.uniform(0.75, 1.25)
        else:
            values |= {"L_d": rng.uniform(0.8, 1.2), "L_q": rng.uniform(0.8, 1.2)}
    if machine == "induction-2kw2":
        values.pop("psi", None)
        if half():
            values["R_R"] = rng.uniform(0.7, 1.4)
    elif "synrm" not in machine and half():
        values |= {"fifth": rng.normal(0, 0.02), "seventh": rng.normal(0, 0.02)}
    if half():
        values["iron_loss"] = rng.uniform(0, 0.03)
    if half():
        values["heat"] = rng.uniform(-0.02, 0.1)
    if half():
        values["lag"] = rng.uniform(-0.5, 0.5)
    if half():
        values["range"] = rng.uniform(1.0, 1.6)
    values["noise"] = float(np.exp(rng.uniform(np.log(0.0005), np.log(0.004))))
    values["quantum"] = 5 / 2 ** int(rng.integers(10, 13))
    values["load"] = 1.0
    return values


def data_sheet(rng: np.random.Generator, machine: str) -> dict[str, float]:
    """Draw a drive from the tolerances of its data sheet."""
    values = {
        "theta_e": rng.uniform(-3, 3),
        "R": rng.uniform(0.9, 1.25),
        "dead_time": rng.uniform(0.002, 0.02),
        "knee": float(np.exp(rng.uniform(np.log(0.01), np.log(0.06)))),
        "noise": float(np.exp(rng.uniform(np.log(0.0005), np.log(0.003)))),
        "quantum": 5 / 2**12,
        "load": 1.0,
    }
    values |= {f"offset_{port}": rng.normal(0, 0.008) for port in ("alpha", "beta")}
    values |= {f"gain_{phase}": 1 + rng.normal(0, 0.006) for phase in "abc"}
    if machine == "induction-2kw2":
        return values | {"L_sigma": rng.uniform(0.92, 1.08), "L_M": rng.uniform(0.92, 1.08)}
    if "synrm" not in machine:
        values["psi"] = rng.uniform(0.92, 1.08)
    if machine in ROUND:
        values["L_s"] = rng.uniform(0.92, 1.08)
    else:
        values |= {"L_d": rng.uniform(0.92, 1.08), "L_q": rng.uniform(0.92, 1.08)}
    return values


def right_model(rng: np.random.Generator, machine: str) -> dict[str, float]:
    """Draw a drive whose machine file is right; only offsets and noise disturb the observer."""
    values = {"theta_e": rng.uniform(-3, 3), "noise": 0.001, "load": 1.0}
    return values | {f"offset_{port}": rng.normal(0, 0.008) for port in ("alpha", "beta")}


#: Kinds of errors.
ERRORS: dict[str, Draw] = {
    "right model": right_model,
    "data sheet": data_sheet,
    "every error": every_error,
}
