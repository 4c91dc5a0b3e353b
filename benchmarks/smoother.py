"""Is the smoother with the right model at the Cramér–Rao bound from both sides?

python benchmarks/smoother.py [--records 8]

Closed-form records with white current noise only; every assumption is exact, the drift is not.
"""

from __future__ import annotations

import argparse

import numpy as np
from common import heading

import fluxobs
from fluxobs.comparison.bound import Unknowns, two_sided_bound
from fluxobs.core.arrays import Array
from fluxobs.machines.model.frames import wrap
from fluxobs.machines.rotating import SynchronousMachine
from fluxobs.simulation.closed_form.signals import between_rows, driven, vectors
from fluxobs.smoothing.record import DRIFT_CURRENT, DRIFT_VOLTAGE

H, ROWS, PARTS = 1e-4, 8000, 8
T = H * np.arange(ROWS)
#: Run-up with a load step, and a reversal under load.
SPEED = np.interp(T, [0, 0.2, 0.4, 0.6, 0.8], [200, 200, 600, 600, -300])
LOAD = np.interp(T, [0, 0.1, 0.15, 0.5, 0.55], [0.3, 0.3, 1, 1, 0.5])
#: Machine → rotor-frame current [A], noise [A].
MACHINES = {
    "servo-400w": (8j, 0.02),
    "ipm-2kw2": (6j, 0.02),
    "ipm-5kw6": (-6 + 12j, 0.05),
    "synrm-6kw7": (15 + 15j, 0.05),
    "synrm-6kw7-saturated": (12 + 14j, 0.05),
}
EXACT = (
    *("resistance", "inverter", "lag", "offset", "current_gain", "voltage_gain", "iron_loss"),
    *("L_d", "voltage_scale", "current_scale"),
)


def ratio(name: str, records: int) -> tuple[float, float, float]:
    """Return rms error, bound and mean standard deviation of the estimate, in degrees."""
    machine = fluxobs.example(name)
    assert isinstance(machine, SynchronousMachine)
    current, noise = MACHINES[name]
    priors = dict.fromkeys(EXACT, 0.0)
    if machine.magnets:
        priors |= {"harmonics": 0.0, "psi_f": 0.0}
    if machine.saliency:
        priors["L_q"] = 0.0
    true = driven(
        machine, H, between_rows(SPEED, PARTS), between_rows(LOAD * current, PARTS), PARTS, 0.7
    )
    u = np.concatenate([true.voltage, true.voltage[-1:]])
    squares, stds = [], []
    for seed in range(records):
        rng = np.random.default_rng(seed)
        white = noise * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
        result = fluxobs.estimate(
            (u, true.current + white), machine, sample_time=H, lag=0, priors=priors
        )
        squares.append(wrap(result["theta_e"] - true.theta_e) ** 2)
        stds.append(result["theta_e_std"])
    rated = machine.rated_current or 1.0
    drift: float = max(DRIFT_CURRENT * rated * machine.R_s, DRIFT_VOLTAGE * result.scales.voltage)
    bound: Array = two_sided_bound(
        machine, true.theta_e, vectors(true.current), H, Unknowns(noise, drift)
    )
    rms = [float(np.degrees(np.sqrt(np.mean(x)))) for x in (squares, bound**2, np.square(stds))]
    return rms[0], rms[1], rms[2]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--records", type=int, default=8)
    options = parser.parse_args()
    heading("Smoother with the right model, all rows (asked: within 1.05 of the bound)")
    for name in MACHINES:
        error, bound, std = ratio(name, options.records)
        print(
            f"    {name:22s} error {error:.4f}°, bound {bound:.4f}°, ratio {error / bound:.3f}; "
            f"standard deviation {std:.4f}°"
        )


if __name__ == "__main__":
    main()
