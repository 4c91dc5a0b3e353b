"""Coverage of `identify`: over random records, how often its standard deviations hold.

Three machines; speed and current along random courses of 0.7 to 2 s; R_s 15 % low to 20 % high; an
inverter that loses 1 to 4 % of the EMF, with a knee (tanh) of 0.5 to 6 % of the rated current;
offsets of the currents of 1 % of that, of the voltages of 0.5 %; noise and a converter's steps. A
third of the records also leaves the lag free.

    python benchmarks/identification.py [--records 60]
"""

from __future__ import annotations

import argparse

import numpy as np
from common import heading

import fluxobs
from fluxobs.machines import example, rotating
from fluxobs.simulation.closed_form.sensors import Sensor, Steps
from fluxobs.simulation.closed_form.signals import driven, inverter_loss, vectors

#: Machines, with a rated speed each [rad/s, electrical].
MACHINES = {"servo-400w": 900.0, "pmsm-2kw2": 600.0, "ipm-2kw2": 600.0}
PARTS = 8
#: Current along d of the salient machine, over that along q.
ALONG = 0.3


def course(rng: np.random.Generator, t: np.ndarray, size: float, least: float) -> np.ndarray:
    """Half cosines between five random knots of either sign."""
    at = np.sort(rng.uniform(0, t[-1], 5))
    value = size * rng.uniform(least, 1, 5) * rng.choice([1, 1, -1], 5)
    k = np.clip(np.searchsorted(at, t) - 1, 0, 3)
    share = np.clip((t - at[k]) / (at[k + 1] - at[k]), 0, 1)
    return value[k] + (value[k + 1] - value[k]) * (1 - np.cos(np.pi * share)) / 2


def record(rng: np.random.Generator, seed: int) -> tuple[dict, fluxobs.Machine, dict[str, float]]:
    """A log, the machine, and the true parameters."""
    name = str(rng.choice(list(MACHINES)))
    machine = rotating(example(name))
    rated, psi, fast = machine.rated_current, machine.magnet_flux, MACHINES[name]
    h, emf = 0.12 / fast * rng.uniform(0.7, 1.2), psi * fast
    rows = round(rng.uniform(0.7, 2.0) / h)
    t = np.arange(rows * PARTS + 1) * h / PARTS
    i_q = course(rng, t, rated, 0.05)
    i_d = -ALONG * np.abs(i_q) if name.startswith("ipm") else 0.0
    truth = {
        "R_s": machine.R_s * rng.uniform(0.85, 1.2),
        "psi_f": psi,
        "inverter": emf * rng.uniform(0.01, 0.04),
        "lag": 0.0,
    }
    machine = machine.with_values(R_s=truth["R_s"])
    speed, start = course(rng, t, fast, 0.2), rng.uniform(0, 6)
    true = driven(machine, h, speed, i_d + 1j * i_q, PARTS, theta0=start)
    lost = inverter_loss(true.mean_current, truth["inverter"], rated * rng.uniform(0.005, 0.06))
    at = np.arange(rows) * h
    offsets = rng.normal(0, [[0.005 * emf], [0.01 * rated]], (2, 2))
    voltage = Sensor(Steps(offsets[:1]), quantum=1e-4 * emf)
    current = Sensor(Steps(offsets[1:]), 0.002 * rated, 0.001 * rated)
    u = voltage.measure(at, vectors(true.voltage + lost), seed)
    i = current.measure(at, vectors(true.current[:-1]), seed)
    columns = {"u_alpha": u[:, 0], "u_beta": u[:, 1], "i_alpha": i[:, 0], "i_beta": i[:, 1]}
    return {"t": at} | columns, machine, truth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--records", type=int, default=60)
    records = parser.parse_args().records
    heading(f"identify on {records} random records: error over standard deviation")
    rng, off, held = np.random.default_rng(7), {}, {}
    for n in range(records):
        log, machine, truth = record(rng, n)
        free = ("R_s", "psi_f", "inverter", "lag")[: 4 if n % 3 == 0 else 3]
        for one in fluxobs.identify(log, machine, free=free).parameters:
            if one.std is None:
                held[one.name] = held.get(one.name, 0) + 1
            else:
                off.setdefault(one.name, []).append((one.value - truth[one.name]) / one.std)
    for name, values in off.items():
        size = np.abs(values)
        print(
            f"    {name:9s} told {len(size):3d}, not told {held.get(name, 0):2d}; within two "
            f"{np.mean(size < 2):.0%}, three {np.mean(size < 3):.0%}, at most {size.max():.1f}, "
            f"rms {np.sqrt(np.mean(size**2)):.2f}"
        )


if __name__ == "__main__":
    main()
