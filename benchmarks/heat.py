"""A winding that warms up while it drives: is its resistance followed, and is the promise kept?

The demonstration motor (fluxobs.simulation.closed_form.endless) runs 40 s; its
resistance rises exponentially.
"""

from itertools import islice

import numpy as np
from common import heading

import fluxobs
from fluxobs.simulation.closed_form import endless

SECONDS = 40
COLD = 0.36  # Ω


def main() -> None:
    heading("resistance that rises by a share with a time constant; after 1.5 s of each 4 s cycle")
    for warmer, warming in ((0.0, 1.0), (0.15, 100.0), (0.25, 40.0)):
        endless.WARMER, endless.WARMING = warmer, warming
        rows = np.array(list(islice(endless.endless(), round(SECONDS / endless.SAMPLE_TIME))))
        log = dict(zip(endless.COLUMNS, rows.T, strict=True))
        unknowns = ["drift", "resistance", "inverter"]
        found = fluxobs.estimate(log, "servo-400w", unknowns=unknowns, causal=True)
        start = log["t"] // endless.CYCLE * endless.CYCLE
        true = COLD * (1 + warmer * (1 - np.exp(-start / warming)))
        late = log["t"] % endless.CYCLE > 1.5
        off = np.abs(found["resistance"] - true)[late]
        valid = found["valid"]
        error = np.degrees(found["theta_e_error"][valid])
        print(
            f"    {warmer:.0%} in {warming:g} s: R_s off by {1e3 * off.max():.1f} mΩ at most, "
            f"{(off / found['resistance_std'][late]).max():.1f} standard deviations; position "
            f"{np.sqrt(np.mean(error**2)):.2f}° rms, {np.abs(error).max():.1f}° at most"
        )


if __name__ == "__main__":
    main()
