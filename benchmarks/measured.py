"""Accuracy on measured logs of a surface PMSM with encoder; without these logs, it is skipped.

Data: lab449/med2021-spmsm-ft-observer, not part of this project. FLUXOBS_DATA names the folder.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from common import MEASURED, degrees_error, heading

import fluxobs
from fluxobs import SurfacePMSM

#: Published data; the rated current is missing and is therefore estimated from the record.
MACHINE = SurfacePMSM(R_s=0.39, L_s=1.4e-3, n_p=8, psi_f=0.032)
Q8 = 1 / 256
LAYOUT: dict[str, Any] = {
    "sample_time": 2e-4,
    "lag": -1,
    "columns": {"i_alpha": "i_a", "i_beta": "i_b", "u_alpha": "u_a", "u_beta": "u_b"},
    "scale": dict.fromkeys(("i_alpha", "i_beta", "u_alpha", "u_beta", "theta_mech"), Q8),
    "truth": {"theta_mech": "AngMes"},
}


def main() -> None:
    heading("Measured logs, default setting, scored from 0.2 s (target: rms 1.4, mean 1.2, 70 %)")
    logs = sorted(MEASURED.glob("data*.csv"))
    if not logs:
        print(f"    skipped: no measured logs in {MEASURED}")
        return
    for path in logs:
        log = fluxobs.read_log(path, **LAYOUT)
        estimates = fluxobs.estimate(log, MACHINE)
        error = np.degrees(estimates["theta_e_error"])
        std = np.degrees(estimates["theta_e_std"])
        valid = estimates["valid"]
        true_angle = np.unwrap(estimates["theta_e"] - estimates["theta_e_error"])
        period = np.argmax(np.abs(true_angle - true_angle[0]) > 2 * np.pi) * log.sample_time
        start = (np.flatnonzero(np.abs(error[:1000]) > 10).max() + 1) * log.sample_time
        scored = slice(int(0.2 / log.sample_time), None)
        mean = error[scored].mean()
        tracked = degrees_error(
            estimates["theta_e_tracked"],
            estimates["theta_e"] - estimates["theta_e_error"],
        )[scored]
        coverage = (np.abs(error) < 2 * std)[scored].mean()
        print(
            f"    {path.stem}: error {error[scored].std():.2f} degrees rms about the mean, mean "
            f"{mean:+.2f}, tracked {tracked.std():.2f}; below 10 degrees after {1e3 * start:.1f} "
            f"ms (first period {1e3 * period:.0f} ms); {coverage:.0%} within 2 sigma; "
            f"{valid.mean():.0%} valid with errors up to {np.abs(error[valid]).max():.1f}"
        )


if __name__ == "__main__":
    main()
