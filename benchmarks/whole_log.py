"""Simulated drives with every error at once: does the standard deviation of every row hold?

python benchmarks/whole_log.py [--drives 8] [--seed 1] [--machine NAME ...] [--causal]
    [--unknown-lag] [--file MACHINE]

Each error is present in about half of the drives: offsets, unequal gains, dead time with a random
knee, R - 40 to + 60 %, magnet flux and inductances ± 25 %, harmonics, iron loss, heating, currents
late by up to half a sample, clipping, lost samples; courses with stops, reversals, low speed. With
--unknown-lag, half of the logs have a lag of -1, half have 0, and the estimate is told neither.
With --file, the machine file is another one, for example without the saturation of the machine.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from common import degrees_error, heading

import fluxobs
from fluxobs.campaigns.draws import Scenario
from fluxobs.campaigns.drives import drive_of
from fluxobs.campaigns.simulated import ScoredTrace, select_scored
from fluxobs.campaigns.specification import Specification
from fluxobs.core.arrays import Array
from fluxobs.errors import FluxobsError
from fluxobs.machines import example
from fluxobs.simulation.drive.simulate import Trace, check, simulate_lanes, substeps

MACHINES = (
    *("servo-400w", "drone-900kv", "pmsm-2kw2", "ipm-2kw2", "ipm-5kw6"),
    *("synrm-6kw7", "synrm-6kw7-saturated", "induction-2kw2"),
)
COURSES: dict[str, dict[str, Any]] = {
    "mixed": {"speeds": [0.05, 1.0], "stops": 0.15, "reversals": 0.3},
    "stops": {"speeds": [0.1, 0.8], "stops": 0.5, "reversals": 0.4},
    "low speed": {"speeds": [0.02, 0.1], "stops": 0.1, "reversals": 0.3},
    "steady": {"speeds": [0.3, 1.0], "stops": 0.0, "reversals": 0.0, "segment": [1.0, 2.0]},
}
DURATION = 2.5


@dataclass(frozen=True)
class Drive:
    """A simulated log with its true position."""

    machine: str
    course: str
    sample_time: float
    voltage: Array
    current: Array
    theta: Array
    lag: float
    resistance: float
    psi: float
    torque: Array
    mechanics: tuple[float, float, float]


class Simulated(NamedTuple):
    """What is kept of a simulation."""

    scored: ScoredTrace
    torque: Any


def select(row: Trace) -> Simulated:
    """Return the scored quantities and the torque of a row."""
    return Simulated(select_scored(row), row.torque)


@dataclass(frozen=True)
class Score:
    """Score of a drive; angles in degrees."""

    machine: str
    course: str
    rows: int
    valid: int
    good: int
    within: int
    worst: float
    everywhere: float
    ratio: float
    lag_weight: float
    sure_and_wrong: bool
    parameters: tuple[float, ...]


def errors(rng: np.random.Generator, machine: str) -> dict[str, float]:
    """Draw the errors of a drive: quantities of a campaign."""

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
        elif machine in ("servo-400w", "drone-900kv", "pmsm-2kw2"):
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


def simulated(
    machine: str,
    course: str,
    drives: int,
    seed: int,
    late: bool = False,
    draw: Callable[[np.random.Generator, str], dict[str, float]] = errors,
) -> list[Drive]:
    """Return the drives of a machine on a course that neither trip nor diverge.

    Half of the logs have a lag of -1 if `late`; `draw` draws the errors of a drive.
    """
    place = [seed, MACHINES.index(machine), list(COURSES).index(course)]
    rng = np.random.default_rng(place)
    specification = Specification.model_validate(
        {
            **{"name": "whole log", "seed": seed, "scenarios": drives, "machines": [machine]},
            **{"loop": "open", "observers": ["plain"], "vary": {}},
            "course": {
                **{"duration": DURATION, "score_from": 0.0, "loads": [-0.8, 0.8], "ramp": 0.4},
                **{"segment": [0.3, 0.9], **COURSES[course]},
            },
        }
    )
    lanes, scenarios, steps = [], [], []
    for n in range(drives):
        scenario = Scenario(
            1000 * place[2] + n, specification.machines[0], draw(rng, machine), seed
        )
        try:
            lane = drive_of(specification, scenario)
            check(*lane)
            steps.append(substeps(*lane))
        except FluxobsError:  # the drive cannot reach this speed or load
            continue
        lanes.append(lane)
        scenarios.append(scenario)
    if not lanes:
        return []
    h = float(lanes[0][0].sample_time)
    rows = round(DURATION / h)
    noise = np.stack([scenario.generator(2).standard_normal((rows, 3)) for scenario in scenarios])
    finished, (trace, torque) = simulate_lanes(lanes, noise, max(steps), select, 30)
    found = []
    for n in range(len(lanes)):
        if not finished[n] or trace.tripped[n].any():
            continue
        current = np.array(trace.current[n])
        lost = np.random.default_rng([*place, n])
        if lost.random() < 0.5:
            current[lost.random(rows) < lost.uniform(0, 0.002)] = np.nan
        voltage, lag = np.array(trace.voltage[n]), 0.0
        if late and n % 2:
            voltage, lag = np.concatenate([voltage[1:], voltage[-1:]]), -1.0
        values = scenarios[n].values
        model = example(machine)
        resistance = np.nan if "heat" in values else model.R_s * values.get("R", 1.0)
        psi = (model.magnet_flux or np.nan) * values.get("psi", 1.0)
        if machine == "induction-2kw2":
            psi = np.nan  # a cage's flux moves
        theta = np.array(trace.theta_e[n])
        plant = lanes[n][0].plant.mechanics
        mechanics = float(plant.J), float(plant.viscous), float(plant.coulomb)
        found.append(
            Drive(
                *(machine, course, h, voltage, current, theta, lag, resistance, psi),
                *(np.array(torque[n]), mechanics),
            )
        )
    return found


def score(given: tuple[Drive, bool, bool, str | None]) -> Score:
    """Estimate a drive and score it."""
    drive, causal, late, file = given
    result = fluxobs.estimate(
        (drive.voltage, drive.current),
        file or drive.machine,
        sample_time=drive.sample_time,
        lag="auto" if late else drive.lag,
        causal=causal,
    )
    error = np.abs(degrees_error(result["theta_e"], drive.theta))
    std, valid = np.degrees(result["theta_e_std"]), result["valid"]
    return Score(
        drive.machine,
        drive.course,
        len(error),
        int(valid.sum()),
        int((valid & (error < 3)).sum()),
        int((valid & (error < 2 * std)).sum()),
        float(error[valid].max(initial=0.0)),
        float(np.sqrt(np.mean(error**2))),
        float(np.mean((error[valid] / std[valid]) ** 2)) if valid.any() else np.nan,
        np.nan if result.lag is None else result.lag.weights[drive.lag],
        bool((valid & (error > 10) & (error > 5 * std)).any()),
        tuple(parameter_errors(drive, result.learnt)),
    )


def parameter_errors(drive: Drive, learnt: Any) -> Iterator[float]:
    """Yield the errors of resistance and magnet flux at the end, in standard deviations."""
    if learnt is not None and np.isfinite(drive.resistance):
        yield abs(learnt.resistance - drive.resistance) / learnt.resistance_std
    if learnt is not None and np.isfinite(drive.psi) and learnt.psi_f_std > 0:
        yield abs(learnt.psi_f - drive.psi) / learnt.psi_f_std


def line(title: str, scores: list[Score]) -> str:
    """Return a row of the table."""
    rows = sum(score.rows for score in scores)
    valid = sum(score.valid for score in scores)
    worst = np.array([score.worst for score in scores])
    return (
        f"    {title:22s}{len(scores):5d}{valid / rows:8.1%}"
        f"{sum(score.good for score in scores) / rows:8.1%}"
        f"{sum(score.within for score in scores) / max(valid, 1):9.1%}"
        f"{np.mean(worst > 10):8.1%}{np.mean(worst > 20):7.1%}"
        f"{np.median([score.everywhere for score in scores]):9.2f}"
        f"{np.nanmedian([score.ratio for score in scores]):8.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=8, help="per machine and course")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machine", nargs="+", choices=MACHINES, default=MACHINES)
    parser.add_argument("--causal", action="store_true")
    parser.add_argument("--unknown-lag", action="store_true")
    parser.add_argument("--file", choices=MACHINES, help="machine file of all drives")
    options = parser.parse_args()
    heading("Every row of simulated logs with every error at once")
    print(
        "    machine              drives   valid   <3 deg  2 sigma  >10 deg  >20  rms all "
        "(err/sigma)^2"
    )
    scores: list[Score] = []
    # JAX has threads, which a forked process must not inherit.
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for machine in options.machine:
            drives = [
                drive
                for course in COURSES
                for drive in simulated(
                    machine, course, options.drives, options.seed, options.unknown_lag
                )
            ]
            own = list(
                pool.map(
                    score,
                    [
                        (drive, options.causal, options.unknown_lag, options.file)
                        for drive in drives
                    ],
                )
            )
            print(line(machine, own), flush=True)
            scores += own
    print(line("all", scores))
    far = np.array([error for score in scores for error in score.parameters])
    print(
        f"    drives with a valid row beyond 10 deg and 5 sigma: "
        f"{sum(score.sure_and_wrong for score in scores)} of {len(scores)}; R, psi beyond 3 sigma "
        f"at the end: {np.mean(far > 3):.1%} of {len(far)}"
    )
    steady = [score.ratio for score in scores if score.course == "steady"]
    if steady:
        print(f"    (err/sigma)^2 at constant speed and load: median {np.nanmedian(steady):.2f}")
    weights = np.array([score.lag_weight for score in scores])
    weights = weights[np.isfinite(weights)]
    if len(weights):
        print(
            f"    weight of the true lag: mean {np.mean(weights):.2f}, below 0.5 on "
            f"{np.mean(weights < 0.5):.1%}, below 0.05 on {np.mean(weights < 0.05):.1%}"
        )


if __name__ == "__main__":
    main()
