"""Accuracy on measured logs of a surface PMSM with encoder; without these logs, it is skipped.

Data: lab449/med2021-spmsm-ft-observer, not part of this project. FLUXOBS_DATA names the folder.
With --write, the numbers go to docs/numbers/measured.json.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import MEASURED, Array, heading
from numbers_data import Numbers, text

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
HEADER = ("log", "rms over all rows", "mean", "largest error", "valid", "±2σ holds", "σ, rms")
CAUSAL_HEADER = ("log", "valid", "rms of valid rows", "largest error of them", "±2σ holds")


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True)
class Errors:
    """Errors and standard deviations of the electrical angle [°], row by row."""

    error: Array
    std: Array
    valid: Array

    @property
    def largest_valid(self) -> float:
        return float(np.abs(self.error[self.valid]).max())

    @property
    def within(self) -> float:
        """Share of the valid rows within two standard deviations [%]."""
        return float(100 * (np.abs(self.error) < 2 * self.std)[self.valid].mean())

    @property
    def valid_share(self) -> float:
        """Share of valid rows [%]."""
        return float(100 * self.valid.mean())


def percent(share: float) -> str:
    """Return a share [%] with one decimal; all is 100 %."""
    return f"{share:.1f} %".replace("100.0", "100")


def errors(estimates: fluxobs.Result) -> Errors:
    error, std = (np.degrees(estimates[name]) for name in ("theta_e_error", "theta_e_std"))
    return Errors(np.asarray(error), np.asarray(std), np.asarray(estimates["valid"], bool))


@dataclass(frozen=True)
class Log:
    """Estimates of a log, and what they say about the machine."""

    name: str
    whole: Errors
    causal: Errors
    first_turn: float  # duration of the first electrical period [s]
    psi_f: float  # [Wb]
    inverter: float  # [V]
    wrong_flux: bool  # The examination rejects the magnet flux of the machine file.


def estimated(path: Path) -> Log:
    """Estimate and examine a log."""
    log = fluxobs.read_log(path, **LAYOUT)
    whole, causal = (fluxobs.estimate(log, MACHINE, causal=causal) for causal in (False, True))
    items = {item.name: item for item in fluxobs.check(log, MACHINE).items}
    angle = np.unwrap(whole["theta_e"] - whole["theta_e_error"])
    turned = np.argmax(np.abs(angle - angle[0]) >= 2 * np.pi)
    return Log(
        path.stem,
        errors(whole),
        errors(causal),
        float(whole["t"][turned] - whole["t"][0]),
        items["magnet flux"].value,
        items["inverter voltage"].value,
        items["magnet flux"].verdict == "look at it",
    )


def row(log: Log) -> tuple[str, ...]:
    """Return the cells of a log's row."""
    whole = log.whole
    return (
        log.name,
        f"{rms(whole.error):.2f}°",
        f"{whole.error.mean():+.2f}°".replace("-", "−"),
        f"{np.abs(whole.error).max():.1f}°",
        percent(whole.valid_share),
        percent(whole.within),
        f"{rms(whole.std[whole.valid]):.2f}°",
    )


def causal_row(log: Log) -> tuple[str, ...]:
    causal = log.causal
    return (
        log.name,
        percent(causal.valid_share),
        f"{rms(causal.error[causal.valid]):.2f}°",
        f"{causal.largest_valid:.1f}°",
        percent(causal.within),
    )


def record(logs: list[Log], numbers: Numbers) -> None:
    """Keep the numbers of the docs."""
    everywhere = sorted(rms(log.whole.error) for log in logs)
    causal = [log.causal for log in logs]
    numbers.table("logs", HEADER, map(row, logs))
    numbers.table("causal", CAUSAL_HEADER, map(causal_row, logs))
    numbers.value("mean", np.mean(everywhere), "{:.2f}°")
    numbers.value("best_four", [everywhere[0], everywhere[-2]], "{:.1f}–{:.1f}°")
    numbers.value("worst", everywhere[-1], "{:.1f}°")
    numbers.value("largest_valid", max(log.whole.largest_valid for log in logs), "{:.1f}°")
    numbers.value("within", percent(min(log.whole.within for log in logs)))
    rms_causal = sorted(rms(one.error[one.valid]) for one in causal)
    numbers.value("causal", [rms_causal[0], rms_causal[-1]], "{:.1f}–{:.1f}°")
    shares = sorted(one.valid_share for one in causal)
    numbers.value("causal_valid", [shares[0], shares[-1]], "{:.0f} to {:.0f} %")
    turns = sorted(1e3 * log.first_turn for log in logs)
    numbers.value("first_turn", [turns[0], turns[-1]], "{:.0f}–{:.0f} ms")
    # A uniform error within a step of the encoder.
    numbers.value("encoder", np.degrees(MACHINE.n_p * Q8) / np.sqrt(12), "{:.2f}°")
    rejected = [log for log in logs if log.wrong_flux]
    numbers.value("rejected", len(rejected))
    losses = sorted(log.inverter for log in rejected)
    numbers.value("inverter", [losses[0], losses[-1]], "{:.1f}–{:.1f} V")
    fluxes = sorted(1e3 * log.psi_f for log in rejected)
    numbers.value("psi_f", [fluxes[0], fluxes[-1]], "{:.1f}–{:.1f} mWb")


def main() -> None:
    heading("Measured logs, default setting, all rows (target: mean 0.72, all rows valid)")
    paths = sorted(MEASURED.glob("data*.csv"))
    if not paths:
        print(f"    skipped: no measured logs in {MEASURED}")
        return
    logs = list(map(estimated, paths))
    for title, header, cells in (
        ("from the whole log", HEADER, map(row, logs)),
        ("forwards, as in firmware", CAUSAL_HEADER, map(causal_row, logs)),
    ):
        print(f"    {title}: {' | '.join(header)}")
        for line in cells:
            print(f"    {' | '.join(line)}")
    with Numbers("measured") as numbers:
        record(logs, numbers)
    for key in numbers.values:
        print(f"    {key}: {text(numbers.values[key])}")


if __name__ == "__main__":
    main()
