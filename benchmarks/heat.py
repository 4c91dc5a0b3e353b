"""A winding that warms up: error of the estimated resistance against its standard deviation.

The demonstration motor (fluxobs.simulation.closed_form.endless) runs 40 s; its resistance rises
exponentially.
"""

from itertools import islice

import numpy as np
from common import heading

import fluxobs
from fluxobs.simulation.closed_form import endless

SECONDS = 40
COLD = 0.36  # Ω


def main() -> None:
    heading("Resistance that rises with a time constant; scored after 1.5 s of each 4 s cycle")
    for rise, time_constant in ((0.0, 1.0), (0.15, 100.0), (0.25, 40.0)):
        endless.WARMER, endless.WARMING = rise, time_constant
        rows = np.array(list(islice(endless.endless(), round(SECONDS / endless.SAMPLE_TIME))))
        log = dict(zip(endless.COLUMNS, rows.T, strict=True))
        unknowns = ["drift", "resistance", "inverter"]
        estimates = fluxobs.estimate(log, "servo-400w", unknowns=unknowns, causal=True)
        start = log["t"] // endless.CYCLE * endless.CYCLE
        true_resistance = COLD * (1 + rise * (1 - np.exp(-start / time_constant)))
        late = log["t"] % endless.CYCLE > 1.5
        resistance_error = np.abs(estimates["resistance"] - true_resistance)[late]
        scaled_error = resistance_error / estimates["resistance_std"][late]
        valid = estimates["valid"]
        error = np.degrees(estimates["theta_e_error"][valid])
        print(
            f"    {rise:.0%} in {time_constant:g} s: error of R_s up to "
            f"{1e3 * resistance_error.max():.1f} mΩ, {scaled_error.max():.1f} standard deviations; "
            f"position {np.sqrt(np.mean(error**2)):.2f}° rms, {np.abs(error).max():.1f}° at most"
        )


if __name__ == "__main__":
    main()
