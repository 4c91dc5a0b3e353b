"""The least squares against every other observer: all scenarios, then the measured logs."""

from __future__ import annotations

import sys

import numpy as np
from common import MEASURED, heading
from measured import LAYOUT, MACHINE

from fluxobs.comparison.compare import Comparison, compare, compare_scenario
from fluxobs.comparison.report import LEAST_SQUARES, NEAR, other_results, least_squares_result
from fluxobs.comparison.scenarios import SCENARIOS


def line(found: Comparison) -> str:
    """Rms degrees: the least squares recommended and tuned, its raw angle over the bound, the best
    of the other_results."""
    raw = found.result(LEAST_SQUARES)
    rest = other_results(found)
    best, recommended = rest[0], min(rest, key=lambda r: r.recommended.rms)
    mine = least_squares_result(found)
    ratio = f"{raw.tuned.rms / found.bound:6.2f}" if found.bound else "     -"
    mark = (
        "best"
        if mine.tuned.rms < best.tuned.rms
        else ("near" if mine.tuned.rms <= NEAR * best.tuned.rms else "    ")
    )
    return (
        f"    {found.title:20s} {np.degrees(mine.recommended.rms):7.3f} "
        f"{np.degrees(mine.tuned.rms):7.3f} {ratio}  {mark}  {np.degrees(best.tuned.rms):7.3f} "
        f"{best.name}; as recommended {np.degrees(recommended.recommended.rms):.3f} "
        f"{recommended.name}"
    )


def scenarios(machine: str, names: list[str]) -> None:
    heading(f"{machine}: least squares recommended, tuned [deg rms], raw over bound; best other")
    for name in names:
        print(line(compare_scenario(SCENARIOS[name], machine)), flush=True)


def logs() -> None:
    paths = sorted(MEASURED.glob("data*.csv"))
    if not paths:
        heading(f"Measured logs: skipped, no log in {MEASURED}")
        return
    for psi, what in ((0.032, "as published"), (0.0243, "as estimated by the least squares")):
        heading(f"Measured logs, magnet flux {psi} Vs, {what}: rms degrees, gains tuned on the log")
        machine = MACHINE.with_values(psi_f=psi)
        found = [compare(p, machine, **LAYOUT) for p in paths]
        print(f"    {'':34s}", *(f"{c.title.removesuffix('.csv'):>7s}" for c in found))
        for k, result in enumerate(found[0].results):
            values = [np.degrees(c.results[k].tuned.rms) for c in found]
            print(f"    {result.name:34s}", *(f"{value:7.2f}" for value in values))


if __name__ == "__main__":
    scenarios("pmsm-2kw2", sys.argv[1:] or list(SCENARIOS))
    if not sys.argv[1:]:
        for machine in ("ipm-2kw2", "synrm-6kw7", "servo-400w", "drone-900kv"):
            scenarios(machine, ["noise", "both-biases", "R-120", "load-step", "reversal"])
        logs()
