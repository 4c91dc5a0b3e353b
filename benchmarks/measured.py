"""Accuracy on measured logs of a surface PMSM with encoder; skipped where they are absent.

Data: lab449/med2021-spmsm-ft-observer, not part of this project. FLUXOBS_DATA names their folder.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import polars as pl
from common import MEASURED, degrees_error, heading

from fluxobs.estimation.estimate import estimate
from fluxobs.logs.formats import open_table
from fluxobs.logs.layout import Layout
from fluxobs.logs.log import open_log
from fluxobs.machines import SurfacePMSM

#: As published; no rated current, so that is taken from the record.
MACHINE = SurfacePMSM(R_s=0.39, L_s=1.4e-3, n_p=8, psi_f=0.032)
Q8 = 1 / 256
LAYOUT = Layout(
    sample_time=2e-4,
    lag=-1,
    columns={"i_alpha": "i_a", "i_beta": "i_b", "u_alpha": "u_a", "u_beta": "u_b"},
    scale=dict.fromkeys(("i_alpha", "i_beta", "u_alpha", "u_beta", "theta_mech"), Q8),
    truth={"theta_mech": "AngMes"},
)


def main() -> None:
    heading("Measured logs, default setting, scored from 0.2 s (target: rms 1.4, mean 1.2, 70 %)")
    logs = sorted(MEASURED.glob("data*.csv"))
    if not logs:
        print(f"    skipped: no measured logs in {MEASURED}")
        return
    for path in logs:
        log = open_log(open_table(path), LAYOUT, MACHINE.n_p)
        with tempfile.TemporaryDirectory() as folder:
            estimate(log, MACHINE, Path(folder) / "out.parquet")
            found = pl.read_parquet(Path(folder) / "out.parquet")
        error = np.degrees(found["theta_e_error"].to_numpy())
        std = np.degrees(found["theta_e_std"].to_numpy())
        valid = found["valid"].to_numpy()
        true = np.unwrap(found["theta_e"].to_numpy() - found["theta_e_error"].to_numpy())
        period = np.argmax(np.abs(true - true[0]) > 2 * np.pi) * log.sample_time
        start = (np.flatnonzero(np.abs(error[:1000]) > 10).max() + 1) * log.sample_time
        scored = slice(int(0.2 / log.sample_time), None)
        mean = error[scored].mean()
        tracked = degrees_error(
            found["theta_e_tracked"].to_numpy(),
            found["theta_e"].to_numpy() - found["theta_e_error"].to_numpy(),
        )[scored]
        held = (np.abs(error) < 2 * std)[scored].mean()
        print(
            f"    {path.stem}: {error[scored].std():.2f} degrees rms about the mean, mean "
            f"{mean:+.2f}, tracked {tracked.std():.2f}; below 10 after {1e3 * start:.1f} ms (first "
            f"period {1e3 * period:.0f} ms); 2 sigma holds {held:.0%}; valid {valid.mean():.0%}, "
            f"then at most {np.abs(error[valid]).max():.1f} off"
        )


if __name__ == "__main__":
    main()
