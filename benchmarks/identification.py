"""Coverage of `identify` on random records: how often its standard deviations hold.

Three machines run random courses of speed and current over 0.7 to 2 s. R_s is 0.85 to
1.2 times the shipped value. The inverter loses 1 to 4 % of the EMF, with a knee (tanh) of 0.5 to 6
% of the rated current. Offsets are 1 % of the rated current and 0.5 % of the EMF; noise and
quantisation are added. A third of the records also estimates the lag.

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

#: Machines with their rated electrical speed [rad/s].
MACHINES = {"servo-400w": 900.0, "pmsm-2kw2": 600.0, "ipm-2kw2": 600.0}
PARTS = 8
#: Ratio of d current to q current of the salient machine.
ALONG = 0.3


def course(rng: np.random.Generator, t: np.ndarray, size: float, least: float) -> np.ndarray:
    """Draw half cosines between five random knots of both signs."""
    knots = np.sort(rng.uniform(0, t[-1], 5))
    values = size * rng.uniform(least, 1, 5) * rng.choice([1, 1, -1], 5)
    k = np.clip(np.searchsorted(knots, t) - 1, 0, 3)
    share = np.clip((t - knots[k]) / (knots[k + 1] - knots[k]), 0, 1)
    return values[k] + (values[k + 1] - values[k]) * (1 - np.cos(np.pi * share)) / 2


def record(rng: np.random.Generator, seed: int) -> tuple[dict, fluxobs.Machine, dict[str, float]]:
    """Return a log, its machine and the true parameters."""
    name = str(rng.choice(list(MACHINES)))
    machine = rotating(example(name))
    rated_current, psi, rated_speed = machine.rated_current, machine.magnet_flux, MACHINES[name]
    h, emf = 0.12 / rated_speed * rng.uniform(0.7, 1.2), psi * rated_speed
    rows = round(rng.uniform(0.7, 2.0) / h)
    t = np.arange(rows * PARTS + 1) * h / PARTS
    i_q = course(rng, t, rated_current, 0.05)
    i_d = -ALONG * np.abs(i_q) if name.startswith("ipm") else 0.0
    truth = {
        "R_s": machine.R_s * rng.uniform(0.85, 1.2),
        "psi_f": psi,
        "inverter": emf * rng.uniform(0.01, 0.04),
        "lag": 0.0,
    }
    machine = machine.with_values(R_s=truth["R_s"])
    speed, initial_angle = course(rng, t, rated_speed, 0.2), rng.uniform(0, 6)
    signals = driven(machine, h, speed, i_d + 1j * i_q, PARTS, theta0=initial_angle)
    inverter_voltage = inverter_loss(
        signals.mean_current, truth["inverter"], rated_current * rng.uniform(0.005, 0.06)
    )
    t_rows = np.arange(rows) * h
    offsets = rng.normal(0, [[0.005 * emf], [0.01 * rated_current]], (2, 2))
    voltage = Sensor(Steps(offsets[:1]), quantum=1e-4 * emf)
    current = Sensor(Steps(offsets[1:]), 0.002 * rated_current, 0.001 * rated_current)
    u = voltage.measure(t_rows, vectors(signals.voltage + inverter_voltage), seed)
    i = current.measure(t_rows, vectors(signals.current[:-1]), seed)
    columns = {"u_alpha": u[:, 0], "u_beta": u[:, 1], "i_alpha": i[:, 0], "i_beta": i[:, 1]}
    return {"t": t_rows} | columns, machine, truth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--records", type=int, default=60)
    records = parser.parse_args().records
    heading(f"identify on {records} random records: error over standard deviation")
    rng, scaled_errors, not_identified = np.random.default_rng(7), {}, {}
    for n in range(records):
        log, machine, truth = record(rng, n)
        free = ("R_s", "psi_f", "inverter", "lag")[: 4 if n % 3 == 0 else 3]
        for parameter in fluxobs.identify(log, machine, free=free).parameters:
            if parameter.std is None:
                not_identified[parameter.name] = not_identified.get(parameter.name, 0) + 1
            else:
                scaled_errors.setdefault(parameter.name, []).append(
                    (parameter.value - truth[parameter.name]) / parameter.std
                )
    for name, values in scaled_errors.items():
        sizes = np.abs(values)
        print(
            f"    {name:9s} {len(sizes):3d} identified, {not_identified.get(name, 0):2d} not "
            f"identified; {np.mean(sizes < 2):.0%} within two, {np.mean(sizes < 3):.0%} within "
            f"three, largest {sizes.max():.1f}, rms {np.sqrt(np.mean(sizes**2)):.2f}"
        )


if __name__ == "__main__":
    main()
