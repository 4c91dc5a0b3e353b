"""Effect of a real motor's imperfections, one at a time, on the plain and the adaptive observer.

Prints the table of docs/benchmarks.md, "What else a real motor has".
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import example

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from support.real_motor import Imperfect, record
from support.records import wrapped_degrees

H = 1.25e-4
CASES = {
    "none": Imperfect(),
    "5th and 7th harmonic, 2 %": Imperfect(fifth=0.02, seventh=0.02),
    "5th and 7th harmonic, 5 %": Imperfect(fifth=0.05, seventh=0.05),
    "L_q - L_d of 20 % of L_s": Imperfect(saliency=0.2),
    "magnets 15 % weaker": Imperfect(flux=0.85),
    "resistance rises by 40 %": Imperfect(heating=1.4),
    "iron loss, 2 % of the current": Imperfect(iron=0.02),
}


def main() -> None:
    machine = example("pmsm-2kw2")
    print(
        "2.2 kW machine, 4 s with load steps and loaded reversal, 1 % offset, 0.3 % noise: error "
        "[degrees]"
    )
    print(f"{'':32s}{'plain: rms':>11s}{'valid':>7s}{'most':>7s}{'stds':>6s}", end="")
    print(f"{'adapt.: rms':>11s}{'valid':>7s}{'most':>7s}{'stds':>6s}  R, V_d")
    for name, imperfection in CASES.items():
        print(f"{name:32s}", end="")
        for kind in (LeastSquaresObserver, AdaptiveObserver):
            samples = record(machine, imperfection)
            observer = kind.for_machine(machine, sample_time=H)
            state, estimate = observer.resume(observer.init(), samples.voltage, samples.current)
            error = wrapped_degrees(estimate.theta_e - samples.theta)
            settled = np.arange(len(error)) * H > 0.5
            valid = estimate.valid & settled
            print(
                f"{np.sqrt(np.mean(error[settled] ** 2)):11.2f}{valid.sum() / settled.sum():7.2f}",
                end="",
            )
            if valid.any():
                z = error[valid] / np.degrees(estimate.theta_e_std[valid])
                print(f"{np.abs(error[valid]).max():7.2f}{np.sqrt(np.mean(z**2)):6.1f}", end="")
            else:
                print(f"{'-':>7s}{'-':>6s}", end="")
        learnt = observer.learnt(state)
        print(
            f"  {learnt.resistance:.2f} ± {learnt.resistance_std:.2f}, "
            f"{learnt.inverter_voltage:.2f} ± {learnt.inverter_std:.2f}"
        )


if __name__ == "__main__":
    main()
