"""Random drives with everything unknown: what a valid row and a standard deviation are worth.

Eight machines, random courses with reversals, steps of load and stops; R off by up to a half, the
magnet by a fifth, an inverter of up to 3 % of the DC link whose curve the observer does not know
exactly, offsets of 2 % of the rated current, noise of 0.05 to 1 %.

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
#: The sign of a phase current over its size, as inverters have it.
CURVES = {
    "sign": np.sign,
    "tanh": np.tanh,
    "ramp": lambda x: np.clip(x, -1, 1),
    "arctan": lambda x: 2 / np.pi * np.arctan(x),
}


def course(rng: np.random.Generator, h: float, stops: float) -> tuple[Array, Array]:
    """Speed and current of a random course, per-unit."""
    rows = int(DURATION / h)
    speed, load, at, sign = np.zeros(rows), np.zeros(rows), 0, rng.choice([-1, 1])
    while at < rows:
        length = int(rng.uniform(0.3, 1.2) / h)
        sign = -sign if rng.random() < 0.4 else sign
        size = np.exp(rng.uniform(np.log(0.02), 0.0))
        speed[at : at + length] = 0.0 if rng.random() < stops else sign * size
        step = at
        while step < at + length:
            until = step + int(rng.uniform(0.1, 0.6) / h)
            load[step:until] = rng.uniform(-1, 1)
            step = until
        at += length
    return gaussian_filter1d(speed, 0.05 / h), gaussian_filter1d(load, 0.003 / h)


def loss(current: Array, curve: str, knee: float) -> Array:
    """Direction of the inverter's loss for complex currents."""
    turn = np.exp(2j * np.pi / 3)
    phases = [(current * np.conj(turn**k)).real for k in range(3)]
    return 2 / 3 * sum(turn**k * CURVES[curve](x / knee) for k, x in enumerate(phases))


class Drive(NamedTuple):
    """A simulated record, and the machine file that its user believes."""

    machine: RotatingMachine
    believed: RotatingMachine
    sample_time: float
    voltage: Complex  # over the interval that ends at the row; the first is not known
    current: Complex
    theta: Array
    inverter: float
    dc_link: float
    noise: float


def simulate(name: str, seed: int, stops: float) -> Drive:
    """A random course of a machine, with everything that is unknown drawn."""
    machine, h, rated = MACHINES[name]
    rng, current = np.random.default_rng([sum(map(ord, name)), seed]), machine.rated_current
    speed, load = course(rng, h, stops)
    link = 1.6 * rated * (machine.magnet_flux or 0.5 * machine.L_dq[0] * current)
    volts = rng.uniform(0, 0.03) * link
    knee = np.exp(rng.uniform(*np.log([0.005, 0.08]))) * current
    curve = str(rng.choice(list(CURVES)))
    i_dq = 0.7j * load * current
    if name == "synrm":
        i_dq = (0.35 + 0.5j * load) * current
    elif name == "ipm":
        i_dq = (-0.25 * load**2 + 0.7j * load) * current
    noise = np.exp(rng.uniform(*np.log([0.0005, 0.01]))) * current
    true = driven(
        machine,
        h,
        between_rows(rated * speed, PARTS),
        between_rows(i_dq, PARTS),
        PARTS,
        rng.uniform(-np.pi, np.pi),
    )
    u = np.concatenate([[np.nan], true.voltage + volts * loss(true.mean_current, curve, knee)])
    i = true.current + 0.02 * current * np.exp(2j * np.pi * rng.random())
    i += noise * (rng.standard_normal(len(i)) + 1j * rng.standard_normal(len(i)))
    believed = {"R_s": machine.R_s / rng.uniform(0.5, 1.5)}
    if machine.magnets:
        believed["psi_f"] = machine.psi_f / rng.uniform(0.8, 1.2)
    return Drive(
        machine, machine.with_values(**believed), h, u, i, true.theta_e, volts, link, noise
    )


def drive(job: tuple[str, int, float]) -> list[float]:
    """Rows, valid ones, those 10 and 20 degrees off, worst; then share within three: R, V_d."""
    one = simulate(*job)
    observer = AdaptiveObserver.for_machine(
        one.believed,
        sample_time=one.sample_time,
        unknowns=("drift", "resistance", "inverter", "asymmetry"),
        current_noise=one.noise,
        dc_link=one.dc_link,
        inductance_std=0.0,  # they are exact here
        lag_std=0.0,
    )
    found = observer.run(vectors(one.voltage), vectors(one.current))
    error = np.abs(degrees_error(found.theta_e, one.theta, one.machine.half_turn_ambiguous))
    valid = found.valid
    within = [
        (np.abs(x - y) <= 3 * s)[valid].mean() if valid.any() else np.nan
        for x, y, s in (
            (found.resistance, one.machine.R_s, found.resistance_std),
            (found.inverter_voltage, one.inverter, found.inverter_voltage_std),
        )
    ]
    off = error[valid]
    return [
        len(valid),
        valid.sum(),
        (off > 10).sum(),
        (off > 20).sum(),
        off.max(initial=0),
        *within,
    ]


def main(drives: int, stops: float) -> None:
    heading(
        f"{drives} random drives of each machine, {stops:.0%} of the segments stopped: valid rows, "
        "share of them 10 and 20 degrees off (target 1e-4, 0), worst; rows on which R_s and V_d "
        "are within three standard deviations (target 95 %)"
    )
    everything = []
    with ProcessPoolExecutor() as pool:
        for name in MACHINES:
            rows = np.array(list(pool.map(drive, [(name, seed, stops) for seed in range(drives)])))
            everything.append(rows)
            show(name, rows)
    show("all", np.concatenate(everything))


def show(name: str, rows: Array) -> None:
    total, valid, ten, twenty = rows[:, :4].sum(axis=0)
    print(
        f"    {name:7s} valid {valid / total:.0%}; {ten / valid:.1e}, {twenty / valid:.1e}, worst "
        f"{rows[:, 4].max():.1f}; R_s {np.nanmean(rows[:, 5]):.0%}, V_d "
        f"{np.nanmean(rows[:, 6]):.0%}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=16)
    parser.add_argument("--stops", type=float, default=0.25)
    options = parser.parse_args()
    main(options.drives, options.stops)
