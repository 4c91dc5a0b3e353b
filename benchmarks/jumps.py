"""Jumping offsets: plain and adaptive observer on the scenario `bias-jumps` of the comparison.

The best baseline, the extended Kalman filter with drift state and tuned gains, reaches 0.182
degrees (docs/observers.md, `benchmarks/compare.py`). The larger jumps here are several times the
drift's prior.

    python benchmarks/jumps.py
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from common import degrees_error, heading

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.comparison.scenarios import run_scenario, scenario


def main() -> None:
    heading(
        "Offsets that change sign at 2.6 s, 2.2 kW motor: error [degrees] from 0.5 s on, as rms, "
        "largest, and largest on a valid row (target at 1 x: 0.18 rms, like the best baseline)"
    )
    jumps = scenario("bias-jumps")
    for factor in (0.0, 1.0, 2.0, 5.0):
        scaled = replace(
            jumps,
            current_offset=tuple((t, factor * a, factor * b) for t, a, b in jumps.current_offset),
            voltage_offset=tuple((t, factor * a, factor * b) for t, a, b in jumps.voltage_offset),
        )
        run, machine, rated = run_scenario(scaled, "pmsm-2kw2")
        record = run.record()
        noise = jumps.noise * machine.rated_current
        for name, make, options in (
            ("plain", LeastSquaresObserver, {}),
            ("adaptive", AdaptiveObserver, {}),
            ("adaptive, R and V known", AdaptiveObserver, {"unknowns": ("drift",)}),
        ):
            observer = make.for_machine(
                machine, sample_time=rated.sample_time, current_noise=noise, **options
            )
            estimate = observer.run(record)
            error = np.abs(degrees_error(estimate.theta_e, record.theta_e))
            scored = record.t >= jumps.score_from
            worst = error[scored & estimate.valid].max()
            print(
                f"    {factor:.0f} x, {name:24s} {np.sqrt(np.mean(error[scored] ** 2)):.3f} rms, "
                f"{error[scored].max():.1f} at most, {worst:.1f} at most on a valid row"
            )


if __name__ == "__main__":
    main()
