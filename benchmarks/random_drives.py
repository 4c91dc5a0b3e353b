"""Random drives with all parameters unknown: errors of valid rows and of standard deviations.

Eight machines run random courses with reversals, load steps and stops. R is wrong by up to 50 % and
the magnet flux by up to 20 %. The inverter loses up to 3 % of the DC link, with a curve that the
observer does not know exactly. Offsets are 2 % of the rated current, noise is 0.05 to 1 %.

    python benchmarks/random_drives.py [--drives 16] [--stops 0.25]
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
from common import Array, degrees_error, heading
from scipy.ndimage import gaussian_filter1d

from fluxobs import AdaptiveObserver, SurfacePMSM
from fluxobs.machines import RotatingMachine, example
from fluxobs.observers import Priors
from fluxobs.simulation.closed_form.signals import Complex, between_rows, driven, vectors

DURATION, PARTS = 6.0, 4
#: Machine, sample time [s], rated electrical speed [rad/s].
MACHINES: dict[str, tuple[RotatingMachine, float, float]] = {
    "servo": (example("servo-400w"), 1e-4, 1257.0),
    "pmsm": (example("pmsm-2kw2"), 1.25e-4, 471.0),
    "ipm": (example("ipm-2kw2"), 1.25e-4, 471.0),
    "synrm": (example("synrm-6kw7"), 1e-4, 660.0),
    "drone": (example("drone-900kv"), 5e-5, 4000.0),
    "gimbal": (
        SurfacePMSM(R_s=10.0, L_s=2.5e-3, psi_f=0.008, n_p=7, rated_current=1.0),
        *(1e-4, 600.0),
    ),
    "hub": (
        SurfacePMSM(R_s=0.11, L_s=0.18e-3, psi_f=0.021, n_p=15, rated_current=30.0),
        *(5e-5, 900.0),
    ),
    "20 kW": (
        SurfacePMSM(R_s=0.12, L_s=2.3e-3, psi_f=0.45, n_p=4, rated_current=65.0),
        *(1e-4, 942.0),
    ),
}
#: Curves of inverter loss over phase current; each curve is a smoothed sign.
CURVES = {
    "sign": np.sign,
    "tanh": np.tanh,
    "ramp": lambda x: np.clip(x, -1, 1),
    "arctan": lambda x: 2 / np.pi * np.arctan(x),
}


def course(rng: np.random.Generator, h: float, stops: float) -> tuple[Array, Array]:
    """Draw speed and current of a random course, per unit."""
    rows = int(DURATION / h)
    speed, load, start, sign = np.zeros(rows), np.zeros(rows), 0, rng.choice([-1, 1])
    while start < rows:
        length = int(rng.uniform(0.3, 1.2) / h)
        sign = -sign if rng.random() < 0.4 else sign
        magnitude = np.exp(rng.uniform(np.log(0.02), 0.0))
        speed[start : start + length] = 0.0 if rng.random() < stops else sign * magnitude
        load_start = start
        while load_start < start + length:
            load_end = load_start + int(rng.uniform(0.1, 0.6) / h)
            load[load_start:load_end] = rng.uniform(-1, 1)
            load_start = load_end
        start += length
    return gaussian_filter1d(speed, 0.05 / h), gaussian_filter1d(load, 0.003 / h)


def loss_direction(current: Array, curve: str, knee: float) -> Array:
    """Return the direction of the inverter's voltage loss for complex currents."""
    rotation = np.exp(2j * np.pi / 3)
    phases = [(current * np.conj(rotation**k)).real for k in range(3)]
    return (
        2
        / 3
        * sum(rotation**k * CURVES[curve](component / knee) for k, component in enumerate(phases))
    )


class Drive(NamedTuple):
    """A simulated record, and the machine that its user assumes."""

    machine: RotatingMachine
    believed: RotatingMachine
    sample_time: float
    voltage: Complex  # means over the intervals that end at the rows; the first is NaN
    current: Complex
    theta: Array
    inverter: float
    dc_link: float
    noise: float


def simulate(name: str, seed: int, stops: float) -> Drive:
    """Simulate a random course of a machine with random parameters."""
    machine, h, rated_speed = MACHINES[name]
    rng, rated_current = np.random.default_rng([sum(map(ord, name)), seed]), machine.rated_current
    speed, load = course(rng, h, stops)
    dc_link = 1.6 * rated_speed * (machine.magnet_flux or 0.5 * machine.L_dq[0] * rated_current)
    inverter_voltage = rng.uniform(0, 0.03) * dc_link
    knee = np.exp(rng.uniform(*np.log([0.005, 0.08]))) * rated_current
    curve = str(rng.choice(list(CURVES)))
    i_dq = 0.7j * load * rated_current
    if name == "synrm":
        i_dq = (0.35 + 0.5j * load) * rated_current
    elif name == "ipm":
        i_dq = (-0.25 * load**2 + 0.7j * load) * rated_current
    noise = np.exp(rng.uniform(*np.log([0.0005, 0.01]))) * rated_current
    signals = driven(
        machine,
        h,
        between_rows(rated_speed * speed, PARTS),
        between_rows(i_dq, PARTS),
        PARTS,
        rng.uniform(-np.pi, np.pi),
    )
    u = np.concatenate(
        [
            [np.nan],
            signals.voltage + inverter_voltage * loss_direction(signals.mean_current, curve, knee),
        ]
    )
    i = signals.current + 0.02 * rated_current * np.exp(2j * np.pi * rng.random())
    i += noise * (rng.standard_normal(len(i)) + 1j * rng.standard_normal(len(i)))
    believed = {"R_s": machine.R_s / rng.uniform(0.5, 1.5)}
    if machine.magnets:
        believed["psi_f"] = machine.psi_f / rng.uniform(0.8, 1.2)
    return Drive(
        machine,
        machine.with_values(**believed),
        h,
        u,
        i,
        signals.theta_e,
        inverter_voltage,
        dc_link,
        noise,
    )


def drive(job: tuple[str, int, float]) -> list[float]:
    """Run one drive.

    Returns (rows, valid rows, valid rows with errors above 10 degrees, above 20 degrees, largest
    valid error, share of valid rows with R within three standard deviations, the same share for
    V_d).
    """
    record = simulate(*job)
    observer = AdaptiveObserver.for_machine(
        record.believed,
        sample_time=record.sample_time,
        unknowns=("drift", "resistance", "inverter", "asymmetry"),
        current_noise=record.noise,
        dc_link=record.dc_link,
        priors=Priors(inductance=0.0, lag=0.0),  # both are exact here
    )
    estimate = observer.run(vectors(record.voltage), vectors(record.current))
    error = np.abs(
        degrees_error(estimate.theta_e, record.theta, record.machine.half_turn_ambiguous)
    )
    valid = estimate.valid
    shares_within = [
        (np.abs(x - y) <= 3 * s)[valid].mean() if valid.any() else np.nan
        for x, y, s in (
            (estimate.resistance, record.machine.R_s, estimate.resistance_std),
            (estimate.inverter_voltage, record.inverter, estimate.inverter_voltage_std),
        )
    ]
    valid_errors = error[valid]
    return [
        len(valid),
        valid.sum(),
        (valid_errors > 10).sum(),
        (valid_errors > 20).sum(),
        valid_errors.max(initial=0),
        *shares_within,
    ]


def main(drives: int, stops: float) -> None:
    heading(
        f"{drives} random drives of each machine, {stops:.0%} of the segments stopped: share of "
        "valid rows; share of the valid rows with errors above 10 and 20 degrees (targets 1e-4, "
        "0); worst valid row; shares of valid rows with R_s and V_d within three standard "
        "deviations (target 95 %)"
    )
    all_rows = []
    with ProcessPoolExecutor() as pool:
        for name in MACHINES:
            drive_rows = np.array(
                list(pool.map(drive, [(name, seed, stops) for seed in range(drives)]))
            )
            all_rows.append(drive_rows)
            show(name, drive_rows)
    show("all", np.concatenate(all_rows))


def show(name: str, drive_rows: Array) -> None:
    total, valid, ten, twenty = drive_rows[:, :4].sum(axis=0)
    print(
        f"    {name:7s} valid {valid / total:.0%}; {ten / valid:.1e}, {twenty / valid:.1e}, worst "
        f"{drive_rows[:, 4].max():.1f}; R_s {np.nanmean(drive_rows[:, 5]):.0%}, V_d "
        f"{np.nanmean(drive_rows[:, 6]):.0%}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=16)
    parser.add_argument("--stops", type=float, default=0.25)
    options = parser.parse_args()
    main(options.drives, options.stops)
