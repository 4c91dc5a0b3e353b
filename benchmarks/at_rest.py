"""Position at rest and at a creep: an injected i_d, with the adaptive observer and the whole log.

The record begins with a second at 30 % of the rated speed, so that the position is known. Then the
rotor stands for three seconds and creeps at +1 % and -1 % of the rated speed, with load steps of
60 % of the rated current twice a second. Offsets of the currents 1 %, of the voltages 0.3 %.

python benchmarks/at_rest.py [--seeds 4] [--quick]
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from common import heading

import fluxobs
from fluxobs.machines import RotatingMachine, example

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from support.at_rest import H, columns_at_rest, estimate_at_rest, interior, record_at_rest

TURNING, REST, CREEP = 1.0, 3.0, 2.0


@dataclass(frozen=True)
class Case:
    """A machine, its injection, and what the observer does not know.

    `ripple` is the amplitude of i_d, `noise` that of the current, as shares of the rated current;
    `resistance` is the assumed R over the true one, `loss` the voltage lost per phase [V].
    """

    machine: RotatingMachine
    ripple: float = 0.02
    noise: float = 0.002
    resistance: float = 1.2
    loss: float = 3.0
    i_d: float = 0.0  # mean of i_d as a share of the rated current
    wave: Sequence[complex] = (1, -1)  # a period


MILD = Case(interior(1.5))
CASES = {
    "no injection": replace(MILD, ripple=0.0),
    "R and V_d right": replace(MILD, resistance=1.0, loss=0.0),
    "R + 20 %": replace(MILD, loss=0.0),
    "dead time 1 %": replace(MILD, resistance=1.0),
    "both": MILD,
    "both, L_q / L_d 1.2": replace(MILD, machine=interior(1.2)),
    "both, 1.2, noise 0.5 %, ripple 5 %": Case(interior(1.2), ripple=0.05, noise=0.005),
    "both, square wave at a quarter of the rate": replace(MILD, wave=(1, 1, -1, -1)),
    "both, pulsating at a fifth of the rate": replace(
        MILD, wave=np.cos(0.4 * np.pi * np.arange(5)), ripple=0.03
    ),
    "both, rotating at a fifth of the rate": replace(
        MILD, wave=np.exp(0.4j * np.pi * np.arange(5))
    ),
    "both, PM-assisted with map": Case(example("ipm-5kw6")),
    "both, reluctance": Case(example("synrm-6kw7"), i_d=0.4),
    "both, saturated reluctance": Case(example("synrm-6kw7-saturated"), i_d=0.4),
    "both, surface machine": Case(example("pmsm-2kw2")),
}


def score(case: Case, seed: int, whole_log: bool) -> tuple[float, ...]:
    """Return share of valid rows, rms and largest error [°], median std [°], share within 2 std."""
    t = H * np.arange(round((TURNING + REST + 2 * CREEP) / H))
    speed = np.interp(
        t,
        [0, TURNING, TURNING + 0.2, TURNING + REST, TURNING + REST + 0.2],
        [0.3, 0.3, 0.0, 0.0, 0.01],
    )
    speed[t > TURNING + REST + CREEP] *= -1
    conditions = {field.name: getattr(case, field.name) for field in fields(case)}
    record = record_at_rest(speed=speed, seed=seed, **conditions)
    rows = t > TURNING + 0.5
    if whole_log:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a surface machine is hardly valid
            result = fluxobs.estimate(columns_at_rest(record), record.assumed)
        theta_e, std, valid = (result[name] for name in ("theta_e", "theta_e_std", "valid"))
    else:
        estimate = estimate_at_rest(record)
        theta_e, std, valid = estimate.theta_e, estimate.theta_e_std, estimate.valid
    error, valid, std = record.errors(theta_e)[rows], valid[rows] > 0, np.degrees(std)[rows]
    if not valid.any():
        return 0.0, np.nan, np.nan, np.nan, np.nan
    return (
        float(valid.mean()),
        float(np.sqrt(np.mean(error[valid] ** 2))),
        float(error[valid].max()),
        float(np.median(std[valid])),
        float(np.mean(error[valid] < 2 * std[valid])),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--quick", action="store_true", help="two cases, one seed")
    parser.add_argument("--whole-log", action="store_true", help="fluxobs estimate, all rows")
    options = parser.parse_args()
    heading("Position at rest and at a creep, from an injected i_d")
    print("    valid rows from half a second after the stop begins; mean over the seeds")
    print(f"    {'':44s}   valid     rms    most   sigma  2 sigma")
    names = ["no injection", "both"] if options.quick else list(CASES)
    for name in names:
        seeds = 1 if options.quick else options.seeds
        rows = np.array([score(CASES[name], seed, options.whole_log) for seed in range(seeds)])
        valid, rms, std, within = rows[:, 0], rows[:, 1], rows[:, 3], rows[:, 4]
        if not valid.any():
            print(f"    {name:44s}{0:8.1%}")
            continue
        print(
            f"    {name:44s}{valid.mean():8.1%}{np.sqrt(np.nanmean(rms**2)):7.2f}°"
            f"{np.nanmax(rows[:, 2]):7.2f}°{np.nanmean(std):7.2f}°{np.nanmean(within):9.1%}"
        )


if __name__ == "__main__":
    main()
