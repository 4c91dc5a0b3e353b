"""The plan of a drive against simulated drives with the tolerances of a data sheet.

For each machine: the lowest valid speed of `fluxobs machine plan`, and that of drives whose
machine, offsets, gains and start differ at random. Target: within 20 %.

    python benchmarks/plan.py [--drives 6] [--seed 1] [--machines servo-400w …]
"""

from __future__ import annotations

import argparse

import numpy as np
from common import heading

from fluxobs.benchmark.draws import MACHINES, data_sheet
from fluxobs.campaigns.drives import planned_cell
from fluxobs.machines import example, rotating
from fluxobs.planning.limits import Map, map_of, plan_drive, simulate_map
from fluxobs.planning.setup import Sensors, observer_of, quantities, rating_of

#: What a data sheet leaves open; sensors and inverter are those of the plan.
OPEN = ("theta_e", "R", "psi", "L_s", "L_d", "L_q", "L_sigma", "L_M", "knee")
LOADS = (0.0, 0.5)


def drawn(name: str, drives: int, seed: int, plan_loads: tuple[float, ...]) -> np.ndarray:
    """Return the lowest valid speeds (drives, loads) of drives within tolerances."""
    machine = rotating(example(name), "a benchmark")
    rated = rating_of(machine, name)
    cell = planned_cell(name, rated)
    sensors = Sensors.usual(cell.current, cell.rated)
    observer = observer_of(sensors, cell)
    rng = np.random.default_rng([seed, MACHINES.index(name)])
    found = []
    for n in range(drives):
        tolerances = data_sheet(rng, name)
        sign = tuple(rng.standard_normal(4))
        values = quantities(sensors, cell, sign)
        values |= {key: tolerances[key] for key in OPEN if key in tolerances}
        traces = simulate_map(cell, values, plan_loads, seed=100 + n)
        known: Map = map_of(observer, cell, traces, plan_loads)
        found.append(known.lowest())
    return np.array(found)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machines", nargs="*", default=MACHINES)
    given = parser.parse_args()
    heading(
        f"Lowest valid speed: plan against the median of {given.drives} drives "
        "[% of the rated speed] (target: within 20 %)"
    )
    for name in given.machines:
        machine = rotating(example(name), "a benchmark")
        cell = planned_cell(name, rating_of(machine, name))
        plan = plan_drive(cell, Sensors.usual(cell.current, cell.rated))
        loads = list(plan.known.loads)
        planned = 100 * plan.known.lowest()[[loads.index(load) for load in LOADS]]
        speeds = 100 * drawn(name, given.drives, given.seed, LOADS)
        for k, load in enumerate(LOADS):
            middle = np.median(np.nan_to_num(speeds[:, k], nan=100.0))
            print(
                f"    {name:22s} load {load:.1f}: plan {planned[k]:5.1f}, drives {middle:5.1f} "
                f"({np.nanmin(speeds[:, k]):.1f} to {np.nanmax(speeds[:, k]):.1f}), "
                f"{planned[k] / middle - 1:+.0%}"
            )
        best = ", ".join(
            f"{gain.what} {gain.lowest:.2f}, {gain.std:.2f}" for gain in plan.gains[:3]
        )
        print(f"      twice as good (lowest speed, std): {best}")


if __name__ == "__main__":
    main()
