"""Saturated machines, salient machines with varying i_d, and induction machines.

Prints the numbers of docs/theory.md, sections 14 and 15, and docs/benchmarks.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

import fluxobs
from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import (
    AlgebraicSaturation,
    FluxPoints,
    InteriorPMSM,
    SurfacePMSM,
    SynchronousReluctance,
    example,
)
from fluxobs.machines.model.flux_table import add_mirror_images
from fluxobs.observers.derived import derived

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from observers.test_cage import CONSTANT, RAMPS
from observers.test_cage import record as cage_record
from observers.test_maps import MODEL, RELUCTANCE, interior_record, reluctance_record
from support.records import driven, log_columns, profile, wrapped_degrees

H = 1.25e-4


def score(estimate, theta, half_turn=False, start=0.2):
    """Return as text: rms error from `start` [s] on, largest valid error [degrees], valid share."""
    factor = 2 if half_turn else 1
    error = wrapped_degrees(factor * (estimate.theta_e - theta)) / factor
    settled = np.arange(len(error)) * H >= start
    worst = np.abs(error[estimate.valid]).max() if estimate.valid.any() else np.nan
    return (
        f"{np.sqrt(np.mean(error[settled] ** 2)):6.3f} rms, {worst:5.2f} at most on valid rows, "
        f"valid share {estimate.valid[settled].mean():.2f}"
    )


def plain(machine, samples, half_turn=False, **options):
    observer = LeastSquaresObserver.for_machine(machine, sample_time=H, **options)
    return score(observer.run(samples.voltage, samples.current), samples.theta, half_turn)


def adaptive(machine, samples, half_turn=False):
    observer = AdaptiveObserver.for_machine(machine, sample_time=H)
    state, estimate = observer.resume(observer.init(), samples.voltage, samples.current)
    learnt = observer.learnt(state)
    text = f", R {learnt.resistance:.3f} ± {learnt.resistance_std:.3f}"
    return score(estimate, samples.theta, half_turn) + text


def points(model, factor=1.0):
    grid = np.linspace(-44, 44, 45)
    i = (grid[:, None] + 1j * grid[None, :]).ravel()
    return FluxPoints(i, factor * model.flux(i))


def reluctance():
    print("Saturated reluctance machine, 6.7 kW: i_q -12 to 18 A, i_d 8 to 12 A, reversal;")
    print("1.1 V of offset, noise 0.05 A; error [degrees]")
    values = {"R_s": 0.63, "n_p": 2, "rated_current": 22.0}
    samples = reluctance_record()
    for name, machine in (
        ("constant inductances", SynchronousReluctance(**values, L_d=0.047, L_q=0.0085)),
        ("flux map", RELUCTANCE),
        ("map 5 % too large", SynchronousReluctance(**values, flux_map=points(MODEL, 1.05))),
        ("map 10 % too large", SynchronousReluctance(**values, flux_map=points(MODEL, 1.10))),
    ):
        print(f"    {name:22s} {plain(machine, samples, half_turn=True)}")
    for factor in (1.0, 0.5, 1.5):
        machine = RELUCTANCE.with_values(R_s=factor * 0.63)
        print(f"    adaptive, R x {factor:3.1f}      {adaptive(machine, samples, half_turn=True)}")
    worst, deviations, first_valid = [], [], []
    for theta0 in np.arange(-3.1, 3.1, 0.31):
        for seed in (3, 4):
            samples = reluctance_record(theta0=theta0, seed=seed)
            for start in (0, 2400, 5000, 8400):
                rows = slice(start, start + 3000)
                estimate = LeastSquaresObserver.for_machine(RELUCTANCE, sample_time=H).run(
                    samples.voltage[rows], samples.current[rows]
                )
                valid = estimate.valid
                if not valid.any():
                    continue
                error = wrapped_degrees(2 * (estimate.theta_e - samples.theta[rows]))[valid] / 2
                worst.append(np.abs(error).max())
                deviations.append(np.abs(error / np.degrees(estimate.theta_e_std[valid])).max())
                first_valid.append(np.argmax(valid) * H)
    print(
        f"    160 starts at any angle: {len(worst)} valid within 0.375 s, on average after "
        f"{np.mean(first_valid):.3f} s; largest valid error {np.max(worst):.1f}, median "
        f"{np.median(worst):.1f}, at most {np.max(deviations):.1f} standard deviations"
    )


def falling_inductance():
    print("\nSurface machine whose inductance falls at rated current; degrees")
    values = {"R_s": 0.5, "n_p": 4, "L_s": 3e-3, "psi_f": 0.1, "rated_current": 20.0}
    speed = profile((0, 300), (1.0, 300), (1.4, -300), (1.8, -300))
    i_q = profile((0, 3), (0.3, 3), (0.31, 20), (0.8, 20), (0.81, -10), (1.8, 15))
    for share in (0.7, 0.5):
        machine = SurfacePMSM(**values, L_s_rated=share * 3e-3)
        samples = driven(machine, H, speed, 1j * i_q, voltage_bias=0.5 + 0.2j, noise=0.04)
        print(f"    to {share:.0%}, constant L_s  {plain(SurfacePMSM(**values), samples)}")
        print(f"    to {share:.0%}, L_s_rated     {plain(machine, samples)}")


def interior():
    print("\nInterior machine, steps of i_d by its rated current, reversal; degrees")
    machine = example("ipm-2kw2")
    for ratio in (machine.L_q / machine.L_d, 4.0, 6.5):
        salient = machine.with_values(L_q=ratio * machine.L_d)
        samples = interior_record(salient)
        print(f"    L_q/L_d {ratio:3.1f}               {plain(salient, samples)}")
        magnet = salient.with_values(psi_f=1.15 * salient.psi_f)
        print(f"        magnet 15 % too strong {plain(magnet, samples)}")
    model = AlgebraicSaturation(
        a_d0=1 / 0.036, a_dd=15, a_q0=1 / 0.22, a_qq=9, a_dq=5, S=2, psi_f=0.44
    )
    saturated = InteriorPMSM(R_s=3.6, n_p=3, rated_current=6.1, flux_map=model)
    print(f"    saturated, L_q/L_d {saturated.L_q / saturated.L_d:.1f} at rated current")
    print(f"                              {plain(saturated, interior_record(saturated))}")
    measured = example("ipm-5kw6")
    values = {name: value for name, value in measured.parameters().items() if value is not None}
    interpolated = Measured(**values)
    for title, true in (("its splines", measured), ("linear between the points", interpolated)):
        for seed in range(3):
            samples = measured_record(true, seed)
            print(f"    measured map, {title:25s} {plain(measured, samples)}")


class Measured(InteriorPMSM):
    """A machine whose measured map is interpolated linearly between the measured points."""

    def flux_dq(self, current):
        i, psi = add_mirror_images(self.flux_map.current, self.flux_map.flux, True)
        d, q = np.unique(i.real), np.unique(i.imag)
        grid = np.zeros((len(d), len(q)), complex)
        grid[np.searchsorted(d, i.real), np.searchsorted(q, i.imag)] = psi
        at = np.asarray(current, complex)
        return RegularGridInterpolator((d, q), grid)(np.stack([at.real, at.imag], -1))


def measured_record(machine, seed):
    """Return a record with i_d from -2 to -10 A, i_q up to ±14 A, and a reversal at 60 Hz."""
    speed = 377 * profile((0, 0.2), (0.3, 1), (1.2, 1), (1.8, -1), (2, -1))
    i_d = profile(
        *((0, -2), (0.4, -2), (0.41, -10), (0.8, -10), (0.81, -4), (1.3, -4), (1.31, -8), (2, -8))
    )
    i_q = profile(
        *((0, 3), (0.5, 3), (0.51, 14), (0.9, 14), (0.91, -12), (1.3, -12), (1.32, 6), (2, 6))
    )
    options = {"voltage_bias": 1 + 0.5j, "noise": 0.04, "theta0": 2.0 * seed, "seed": seed}
    return driven(machine, H, speed, i_d + 1j * i_q, **options)


def cage():
    print("\nInduction machine, 2.2 kW: run-up, load steps, loaded reversal; degrees")
    machine = example("induction-2kw2")
    for name, psi in (("constant flux", CONSTANT), ("0.9 to 0.5 to 0.9 Wb", RAMPS)):
        voltage, current, theta, mechanical = cage_record(psi)
        for factor in (0.7, 1.0, 1.5) if psi is RAMPS else ():
            guess = machine.with_values(R_R=factor * machine.R_R)
            identified_parameters = fluxobs.identify(
                (voltage, current), guess, free="R_R", sample_time=H, lag=1.0
            ).parameters
            text = ", ".join(
                f"{p.name} {p.value:.4g} ± {p.std:.2g} {p.unit}" for p in identified_parameters
            )
            print(f"    {name:21s} identified from R_R x {factor:3.1f}  {text}")
        for title, believed in (
            ("length assumed constant", machine.with_values(R_R=1e-6)),
            ("length tracked", machine),
            ("R_R x 0.7", machine.with_values(R_R=0.7 * machine.R_R)),
            ("R_R x 1.5", machine.with_values(R_R=1.5 * machine.R_R)),
            ("L_M x 0.7", machine.with_values(L_M=0.7 * machine.L_M)),
        ):
            estimate = LeastSquaresObserver.for_machine(believed, sample_time=H).run(
                voltage, current
            )
            speed = derived(believed, estimate, current)["speed_mech"] - mechanical
            speed_error = np.sqrt(np.mean(speed[1600:] ** 2)) / machine.rated_speed
            print(
                f"    {name:21s} {title:25s} {score(estimate, theta)}, speed error "
                f"{speed_error:.2%} of rated"
            )
        for factor in (0.8, 1.2):
            believed = machine.with_values(R_s=factor * machine.R_s)
            observer = AdaptiveObserver.for_machine(believed, sample_time=H)
            state, estimate = observer.resume(observer.init(), voltage, current)
            learnt = observer.learnt(state)
            print(
                f"    {name:21s} adaptive, R_s x {factor:3.1f}       {score(estimate, theta)}, "
                f"R_s {learnt.resistance:.2f} ± {learnt.resistance_std:.2f}"
            )


class Exact(SynchronousReluctance):
    """The reluctance machine with its exact map, without splines."""

    def flux_dq(self, current):
        return MODEL.flux(current)


def identified():
    exact = Exact(R_s=0.63, n_p=2, rated_current=22.0, L_d=0.047, L_q=0.0085)
    print("\nThe map from the log of the reluctance machine, inductances and R_s 10 % wrong")
    for title, true in (("the model's own map", exact), ("splines, error 0.2 %", RELUCTANCE)):
        identified_from(title, true)


def identified_from(title, true):
    print(f"  {title}")
    values = {"R_s": 0.69, "n_p": 2, "rated_current": 22.0, "L_d": 0.047, "L_q": 0.0085}
    machine = SynchronousReluctance(**values, inverter_voltage=0.0, inverter_voltage_std=0.01)
    inside, resistances, worst, scores = [], [], 0.0, []
    for seed in range(6):
        samples = reluctance_record(seed=seed, theta0=0.5 * seed, machine=true)
        log = {name: np.asarray(column) for name, column in log_columns(samples).items()}
        result = fluxobs.identify(log, machine, free="R_s,map")
        i = result.map.visited[:, None] * np.linspace(0.9, 1, 3)
        i = i[result.map.inside(i)]
        error, std = result.map.flux(i) - true.flux_dq(i), result.map.flux_std(i)
        worst = max(worst, float(np.abs(error).max() / np.abs(true.flux_dq(i)).max()))
        inside += [np.abs(error.real) < 3 * std.real, np.abs(error.imag) < 3 * std.imag]
        resistances.append(result.machine.R_s)
        observer = LeastSquaresObserver.for_machine(result.machine, sample_time=H)
        scores.append(score(observer.run(samples.voltage, samples.current), samples.theta, True))
    print(
        f"    six logs: flux errors at most {worst:.2%} in the visited region; "
        f"{np.mean(np.concatenate(inside)):.0%} of the fluxes within three standard deviations"
    )
    print(f"    R_s {np.min(resistances):.4f} to {np.max(resistances):.4f} (true 0.63)")
    for text in scores:
        print(f"    with the identified map: {text}")


if __name__ == "__main__":
    reluctance()
    falling_inductance()
    interior()
    cage()
    identified()
