"""Offsets that jump: plain, adaptive, and the best baseline, on the scenario of the comparison.

The extended Kalman filter with the drift as a state, gains tuned, reaches 0.182 degrees on
`bias-jumps` (docs/observers.md, `benchmarks/compare.py`). Larger jumps: by several of the drift's
priors.

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
        "Offsets that change sign at 2.6 s, 2.2 kW motor: degrees rms from 0.5 s on, largest, "
        "largest on a valid row (target: 0.18 rms, the best baseline's, at 1 x)"
    )
    jumps = scenario("bias-jumps")
    for times in (0.0, 1.0, 2.0, 5.0):
        scaled = replace(
            jumps,
            current_offset=tuple((t, times * a, times * b) for t, a, b in jumps.current_offset),
            voltage_offset=tuple((t, times * a, times * b) for t, a, b in jumps.voltage_offset),
        )
        run, machine, rated = run_scenario(scaled, "pmsm-2kw2")
        record = run.record()
        noise = jumps.noise * machine.rated_current
        for name, make, more in (
            ("plain", LeastSquaresObserver, {}),
            ("adaptive", AdaptiveObserver, {}),
            ("adaptive, R and V known", AdaptiveObserver, {"unknowns": ("drift",)}),
        ):
            observer = make.for_machine(
                machine, sample_time=rated.sample_time, current_noise=noise, **more
            )
            found = observer.run(record)
            error = np.abs(degrees_error(found.theta_e, record.theta_e))
            scored = record.t >= jumps.score_from
            worst = error[scored & found.valid].max()
            print(
                f"    {times:.0f} x, {name:24s} {np.sqrt(np.mean(error[scored] ** 2)):.3f} rms, "
                f"{error[scored].max():.1f} at most, {worst:.1f} on a valid row"
            )


if __name__ == "__main__":
    main()
