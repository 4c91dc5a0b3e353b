"""A step in every M-th interrupt: mean number of instructions, and position error under noise."""

from __future__ import annotations

import numpy as np
from common import Drive, degrees_error, heading
from numbers_data import Numbers

from fluxobs import LeastSquaresObserver
from fluxobs.deployment.costs import read_costs
from fluxobs.machines import SurfacePMSM, example

SAMPLE_TIME, NOISE = 5e-5, 0.005


def main() -> None:
    heading("A step in every M-th interrupt at 20 kHz, noise of 0.5 % of the rated current")
    build = next(
        entry for entry in read_costs()["plain"]["builds"] if entry["name"] == "Cortex-M4F, -O2"
    )
    header = ("M", "instructions per interrupt, mean", "servo-400w", "pmsm-2kw2")
    rows = []
    print(f"    | {' | '.join(header)} |\n    |---|---|---|---|")
    for every in (1, 2, 4, 8, 16):
        cells = []
        for name in ("servo-400w", "pmsm-2kw2"):
            machine = example(name)
            assert isinstance(machine, SurfacePMSM)
            noise, squares = NOISE * machine.rated_current, []
            for seed in range(6):
                rng = np.random.default_rng(seed)
                drive = Drive(machine, 600.0, 3j, SAMPLE_TIME, seed)
                theta, i, _, u = drive.samples(16_000)
                i = i + noise * rng.standard_normal(i.shape)
                mean_current = (i + np.concatenate([i[:1], i[:-1]])) / 2
                volt_seconds = SAMPLE_TIME * (u - machine.R_s * mean_current)
                volt_seconds = volt_seconds.reshape(-1, every, 2).sum(axis=1)
                observer = LeastSquaresObserver.for_machine(
                    machine, sample_time=every * SAMPLE_TIME, current_noise=noise
                )
                stepped = slice(every - 1, None, every)
                estimate = observer.run(volt_seconds=volt_seconds, current=i[stepped])
                error = degrees_error(estimate.theta_e_tracked, theta[stepped])
                squares.append(np.mean(error[len(error) // 4 :] ** 2))
            cells.append(f"{np.sqrt(np.mean(squares)):.3f}°")
        cost = build["mean"] if every == 1 else build["mean"] / every + build["gather"]
        rows.append((str(every), f"{cost:.0f}", *cells))
        print(f"    | {' | '.join(rows[-1])} |")
    with Numbers("update_every", ("src/fluxobs/deployment/costs.json",)) as numbers:
        numbers.table("every", header, rows)


if __name__ == "__main__":
    main()
