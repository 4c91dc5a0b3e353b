"""Accuracy on measured logs of a surface PMSM with encoder; without these logs, it is skipped.

Data: lab449/med2021-spmsm-ft-observer, not part of this project. FLUXOBS_DATA names the folder.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from common import MEASURED, heading

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
    heading("Measured logs, default setting, all rows (target: mean 0.72, all rows valid)")
    logs = sorted(MEASURED.glob("data*.csv"))
    if not logs:
        print(f"    skipped: no measured logs in {MEASURED}")
        return
    everywhere = []
    for path in logs:
        log = fluxobs.read_log(path, **LAYOUT)
        estimates = fluxobs.estimate(log, MACHINE)
        error = np.degrees(estimates["theta_e_error"])
        std = np.degrees(estimates["theta_e_std"])
        valid = estimates["valid"]
        squares = error[valid] ** 2
        everywhere.append(float(np.sqrt(np.mean(error**2))))
        print(
            f"    {path.stem}: all rows {everywhere[-1]:.2f} degrees rms, "
            f"mean {error.mean():+.2f}, worst {np.abs(error).max():.1f}; "
            f"{valid.mean():.1%} valid, from {estimates['t'][valid].min(initial=np.inf):.3g} s on; "
            f"{(np.abs(error) < 2 * std)[valid].mean():.1%} of them within 2 sigma, "
            f"sigma {np.sqrt(np.mean(std[valid] ** 2)):.2f}, rms {np.sqrt(squares.mean()):.2f}"
        )
    print(f"    mean over the logs: {np.mean(everywhere):.2f} degrees rms over all rows")


if __name__ == "__main__":
    main()
