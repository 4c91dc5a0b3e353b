"""Does a planned test tell what it promises? Simulated drives with the tolerances of a data sheet.

Each drive runs through the planned set points. Its resistance, inductances, magnet flux, inverter,
offsets, gains and scales differ from the plan. Target: errors beyond 2σ on at most 7 %, and
standard deviations as promised.

    python benchmarks/planned_test.py [--drives 8] [--seed 1] [--machines servo-400w …]
"""

from __future__ import annotations

import argparse

import numpy as np
from common import heading
from scipy.ndimage import uniform_filter1d

import fluxobs
from fluxobs import FluxobsError
from fluxobs.benchmark.draws import ROUND, data_sheet
from fluxobs.machines import example, rotating
from fluxobs.planning.sequence import PARTS, Planner, Sequence, known_parameters
from fluxobs.planning.setup import Sensors, rating_of
from fluxobs.simulation.closed_form.signals import driven, inverter_loss, vectors
from fluxobs.smoothing.assumptions import Calibration

MACHINES = ("servo-400w", "drone-900kv", "pmsm-2kw2", "ipm-2kw2", "synrm-6kw7")
#: Wanted standard deviations as shares of the values; of the inverter, of the rated resistive drop.
WANTED, INVERTER, INERTIA = 0.05, 0.1, 0.08
#: Time in which a speed controller changes the torque [s].
RISE = 0.003


def wanted(name: str) -> dict[str, float]:
    machine = rotating(example(name), "a benchmark")
    values = known_parameters(machine, rating_of(machine, name).J)
    stds = {key: WANTED * value for key, value in values.items()}
    stds["inverter"] = INVERTER * machine.R_s * machine.rated_current
    stds["J"] = INERTIA * values["J"]
    return stds


def record(name: str, sequence: Sequence, rng: np.random.Generator):
    """Return the log of a drive with tolerances, and its parameters."""
    nominal = rotating(example(name), "a benchmark")
    rated, I_n = rating_of(nominal, name), nominal.rated_current
    sensors = Sensors.usual(I_n, rated)
    drawn = data_sheet(rng, name)
    values = {"R_s": drawn["R"] * nominal.R_s}
    if name in ROUND:
        values["L_s"] = drawn["L_s"] * nominal.L_s
    else:
        values |= {axis: drawn[axis] * getattr(nominal, axis) for axis in ("L_d", "L_q")}
    if "psi" in drawn:
        values["psi_f"] = drawn["psi"] * nominal.psi_f
    true = nominal.with_values(**values)
    loss = rng.uniform(0, 0.012) * rated.dc_link
    h, n_p = rated.sample_time, nominal.n_p
    rows = round(sequence.duration / h)
    t = np.arange(rows * PARTS + 1) * h / PARTS
    corners = [knot.t for knot in sequence.knots]
    speed = n_p * np.interp(t, corners, [knot.speed for knot in sequence.knots])
    i_d = np.interp(t, corners, [knot.i_d for knot in sequence.knots])
    i_q = np.interp(t, corners, [knot.i_q for knot in sequence.knots])
    # On the ramps, the current is what the true machine and inertia need.
    J = rng.uniform(0.7, 1.4) * rated.J
    free = np.interp(t, corners, [knot.free for knot in sequence.knots]) > 0.99
    gain = 1.5 * n_p * (true.flux_dq(i_d + 0j).real - true.L_dq[1] * i_d)
    rise = round(RISE / h) * PARTS
    smooth = uniform_filter1d(uniform_filter1d(speed, rise), rise)  # a speed controller's
    needed = J * np.gradient(smooth, t) / n_p / gain
    speed = np.where(free, smooth, speed)
    i_q = np.where(free, needed, i_q)
    signals = driven(true, h, speed, i_d + 1j * i_q, PARTS, theta0=rng.uniform(-3, 3))
    voltage = signals.voltage + inverter_loss(signals.mean_current, loss, drawn["knee"] * I_n)
    scale = Calibration.of({})
    gains = 1 + sensors.gain * rng.standard_normal(3)
    axes = np.exp(2j * np.pi / 3 * np.arange(3))
    phases = (signals.current[:-1, None] * axes.conj()).real * gains / gains.mean()
    current = 2 / 3 * phases @ axes + sensors.offset * complex(*rng.standard_normal(2))
    current *= 1 + scale.current * rng.standard_normal()
    measured = vectors(current) + sensors.noise * rng.standard_normal((rows, 2))
    measured = np.round(measured / sensors.step) * sensors.step
    u = vectors(voltage) * (1 + scale.voltage * rng.standard_normal())
    values |= {"inverter": loss, "J": J}
    return (u, measured), values


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machines", nargs="*", default=MACHINES)
    given = parser.parse_args()
    heading(
        f"Planned tests on {given.drives} drives each: promised and stated standard deviation, "
        "rms error [% of the value], share within 2σ (target: 93 %)"
    )
    every: list[bool] = []
    for name in given.machines:
        machine = rotating(example(name), "a benchmark")
        rated, wants = rating_of(machine, name), wanted(name)
        planner = Planner(machine, rated, Sensors.usual(machine.rated_current, rated), wants, {})
        sequence = planner.plan()
        free = [key for key in wants if key != "J"]
        rng = np.random.default_rng([given.seed, len(name)])
        rows: dict[str, list[tuple[float, float]]] = {key: [] for key in wants}
        for _ in range(given.drives):
            log, true = record(name, sequence, rng)
            cut = round(sequence.ramps_from / rated.sample_time)
            parts = [tuple(column[:cut] for column in log), tuple(column[cut:] for column in log)]
            found = []
            for part, names in zip(parts, (free, ["J"]), strict=True):
                try:
                    found += fluxobs.identify(
                        part, machine, free=names, sample_time=rated.sample_time, lag=0
                    ).parameters
                except FluxobsError as error:
                    print(f"      {error}")
            for parameter in found:
                if parameter.std is not None:
                    error = parameter.value - true[parameter.name]
                    rows[parameter.name].append((error, parameter.std))
        print(f"    {name}: {sequence.points} set points, {sequence.duration:.1f} s")
        for key, values in rows.items():
            unit = planner.values[key] if key != "inverter" else wants["inverter"] / INVERTER
            if not values:
                print(f"      {key:9s} promised {sequence.stds[key] / unit:.1%}, never identified")
                continue
            error, std = np.array(values).T
            inside = np.abs(error) <= 2 * std
            every += list(inside)
            print(
                f"      {key:9s} wanted {wants[key] / unit:.1%}, promised "
                f"{sequence.stds[key] / unit:.1%}, stated {np.median(std) / unit:.1%}, error "
                f"{np.sqrt(np.mean(error**2)) / unit:.1%}, within 2σ {inside.mean():.0%}, "
                f"identified on {len(values)} of {given.drives}"
            )
    print(f"    within 2σ of all: {np.mean(every):.1%}")


if __name__ == "__main__":
    main()
