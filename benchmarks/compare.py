"""Compare the least squares with all other observers on all scenarios and measured logs."""

from __future__ import annotations

import sys

import numpy as np
from common import MEASURED, heading
from measured import LAYOUT, MACHINE

from fluxobs.comparison.compare import Comparison, compare, compare_scenario
from fluxobs.comparison.report import LEAST_SQUARES, NEAR, least_squares_result, other_results
from fluxobs.comparison.scenarios import SCENARIOS


def line(comparison: Comparison) -> str:
    """Return a line of rms errors [degrees].

    The line shows the least squares with recommended and with tuned gains, the ratio of its
    untracked angle to the bound, and the best other observers.
    """
    untracked = comparison.result(LEAST_SQUARES)
    others = other_results(comparison)
    best, recommended = others[0], min(others, key=lambda result: result.recommended.rms)
    least_squares = least_squares_result(comparison)
    ratio = f"{untracked.tuned.rms / comparison.bound:6.2f}" if comparison.bound else "     -"
    mark = (
        "best"
        if least_squares.tuned.rms < best.tuned.rms
        else ("near" if least_squares.tuned.rms <= NEAR * best.tuned.rms else "    ")
    )
    return (
        f"    {comparison.title:20s} {np.degrees(least_squares.recommended.rms):7.3f} "
        f"{np.degrees(least_squares.tuned.rms):7.3f} {ratio}  {mark}  "
        f"{np.degrees(best.tuned.rms):7.3f} {best.name}; with recommended gains "
        f"{np.degrees(recommended.recommended.rms):.3f} {recommended.name}"
    )


def scenarios(machine: str, names: list[str]) -> None:
    heading(
        f"{machine}: least squares with recommended and with tuned gains [deg rms], ratio of "
        "the raw angle to the bound, best other observer"
    )
    for scenario in names:
        print(line(compare_scenario(SCENARIOS[scenario], machine)), flush=True)


def logs() -> None:
    paths = sorted(MEASURED.glob("data*.csv"))
    if not paths:
        heading(f"Measured logs: skipped, no log in {MEASURED}")
        return
    for psi, source in ((0.032, "as published"), (0.0243, "as estimated by the least squares")):
        heading(
            f"Measured logs, magnet flux {psi} Vs, {source}: rms error [degrees] with gains tuned "
            "on the log"
        )
        machine = MACHINE.with_values(psi_f=psi)
        comparisons = [compare(path, machine, **LAYOUT) for path in paths]
        print(f"    {'':34s}", *(f"{c.title.removesuffix('.csv'):>7s}" for c in comparisons))
        for k, result in enumerate(comparisons[0].results):
            values = [np.degrees(c.results[k].tuned.rms) for c in comparisons]
            print(f"    {result.name:34s}", *(f"{value:7.2f}" for value in values))


if __name__ == "__main__":
    scenarios("pmsm-2kw2", sys.argv[1:] or list(SCENARIOS))
    if not sys.argv[1:]:
        for machine in ("ipm-2kw2", "synrm-6kw7", "servo-400w", "drone-900kv"):
            scenarios(machine, ["noise", "both-biases", "R-120", "load-step", "reversal"])
        logs()
