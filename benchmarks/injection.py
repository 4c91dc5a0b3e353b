"""The usual injection observer beside ours, on records at rest with load steps and slow reversals.

The usual observer demodulates the square wave and tracks the angle with a phase-locked loop; its
bandwidth is the best of a grid for each record. Its half turn is taken from the truth. Errors are
those of all rows.

python benchmarks/injection.py [--seeds 3]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from at_rest import MILD, Case
from common import heading

import fluxobs
from fluxobs.comparison.baselines import SquareWaveInjection
from fluxobs.core.arrays import Array
from fluxobs.simulation.drive import Motor

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from support.at_rest import H, columns_at_rest, estimate_at_rest, interior, record_at_rest

#: A second of motion, two seconds of rest, then reversals between ±2 % of the rated speed.
KNOTS = [(0, 0.3), (1, 0.3), (1.2, 0), (3, 0), (3.2, 0.02), (4, 0.02), (4.5, -0.02), (6, -0.02)]
FROM = 1.5
BANDWIDTHS = 2 * np.pi * np.array([1.25, 2.5, 5, 10, 20, 40, 80])
CASES = {
    "L_q/L_d 1.5, noise 0.2 %, ripple 2 %": MILD,
    "L_q/L_d 1.2, noise 0.2 %, ripple 2 %": replace(MILD, machine=interior(1.2)),
    "L_q/L_d 1.2, noise 0.5 %, ripple 5 %": Case(interior(1.2), ripple=0.05, noise=0.005),
}


def rms(error: Array) -> float:
    """Return the rms of errors, half a turn being right [°]."""
    folded = np.minimum(error, np.abs(180.0 - error))
    return float(np.sqrt(np.mean(folded**2)))


def score(case: Case, seed: int) -> tuple[list[float], float, float]:
    """Return the rms errors of the usual observer for each bandwidth, and of both of ours [°]."""
    t = H * np.arange(round(KNOTS[-1][0] / H))
    speed = np.interp(t, *zip(*KNOTS, strict=True))
    record = record_at_rest(
        case.machine,
        speed,
        seed,
        ripple=case.ripple,
        noise=case.noise,
        resistance=case.resistance,
        loss=case.loss,
    )
    rows = t > FROM
    usual = []
    for bandwidth in BANDWIDTHS:
        observer = SquareWaveInjection(Motor.of(record.assumed), H, bandwidth)
        guess = observer.run(record.samples.voltage[1:], record.current[1:])
        usual.append(rms(record.errors(np.append(0.0, guess.theta_e))[rows]))
    causal = rms(record.errors(estimate_at_rest(record).theta_e)[rows])
    result = fluxobs.estimate(columns_at_rest(record), record.assumed)
    return usual, causal, rms(record.errors(result["theta_e"])[rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    heading("Position at rest: usual injection observer, adaptive observer, whole log")
    print(f"    {'rms':40s}{'usual (best)':>18s}{'adaptive':>10s}{'whole log':>11s}")
    for name, case in CASES.items():
        for share in (1.0, 0.5, 0.25):
            runs = [
                score(replace(case, ripple=share * case.ripple), seed)
                for seed in range(options.seeds)
            ]
            usual = np.sqrt(np.mean([np.square(run[0]) for run in runs], axis=0))
            best = int(np.argmin(usual))
            ours = [float(np.sqrt(np.mean([run[n] ** 2 for run in runs]))) for n in (1, 2)]
            label = name if share == 1 else f"    {share:g} of the ripple"
            bandwidth = BANDWIDTHS[best] / 2 / np.pi
            print(
                f"    {label:40s}{usual[best]:8.2f}° at {bandwidth:2.3g} Hz"
                f"{ours[0]:9.2f}°{ours[1]:10.2f}°"
            )


if __name__ == "__main__":
    main()
