"""Accuracy on closed-form records: exactness, quadrature, noise, standstill, single precision."""

from __future__ import annotations

import numpy as np
from common import Drive, degrees_error, heading

from fluxobs import LeastSquaresObserver
from fluxobs.machines import SurfacePMSM, example


def magnet_machines() -> dict[str, SurfacePMSM]:
    names = ("servo-400w", "pmsm-2kw2", "drone-900kv")
    return {name: example(name) for name in names}  # type: ignore[misc]


def exactness() -> None:
    heading("Offsets of 1 to 10 % of rated, no noise, exact volt-seconds (target 1e-6 rad)")
    for name, machine in magnet_machines().items():
        worst = 0.0
        for per_period in (8, 12, 24):
            for bias in (0.01, 0.03, 0.1):
                h, rated_current = 2e-4, machine.rated_current
                omega = 2 * np.pi / (per_period * h)
                drive = Drive(machine, omega, 0.5j * rated_current, h)
                theta, i, v, _ = drive.samples(2000)
                current_bias = bias * rated_current * np.array([0.6, 0.8])
                voltage_bias = bias * omega * machine.psi_f * np.array([0.8, -0.6])
                v = v - h * (machine.R_s * current_bias - voltage_bias)
                observer = LeastSquaresObserver.for_machine(machine, sample_time=h)
                estimate = observer.run(volt_seconds=v, current=i + current_bias)
                error = np.radians(degrees_error(estimate.theta_e, theta))
                worst = max(worst, np.abs(error[int(5 * observer.memory / h) :]).max())
        print(f"    {name:12s} {worst:.1e} rad after five memories")


def quadrature() -> None:
    heading("Mean voltage and sampled currents only, 12 samples per period (target 0.05 degrees)")
    for name, machine in magnet_machines().items():
        h, rated_current = 2e-4, machine.rated_current
        omega = 2 * np.pi / (12 * h)
        drive = Drive(machine, omega, (0.2 + 1j) * rated_current, h)
        theta, i, _, u = drive.samples(2000)
        estimate = LeastSquaresObserver.for_machine(machine, sample_time=h).run(u, i)
        drop = machine.R_s * abs(drive.current) / (omega * machine.psi_f)
        worst = np.abs(degrees_error(estimate.theta_e, theta)[-500:]).max()
        print(f"    {name:12s} {worst:.4f} degrees, resistive drop {drop:.0%} of the back EMF")


def noise_floor() -> None:
    heading("White current noise, after two electrical periods (target 1.3 L sigma / psi)")
    for name, machine in magnet_machines().items():
        h, noise = 1e-4, 0.005 * machine.rated_current
        for omega in (200.0, 600.0, 2000.0):
            squares = []
            for seed in range(8):
                rng = np.random.default_rng(seed)
                drive = Drive(machine, omega, 3j, h, theta0=seed)
                theta, i, _, u = drive.samples(6000)
                observer = LeastSquaresObserver.for_machine(
                    machine, sample_time=h, current_noise=noise
                )
                estimate = observer.run(u, i + noise * rng.standard_normal(i.shape))
                start = int(4 * np.pi / omega / h)
                squares.append(np.mean(degrees_error(estimate.theta_e, theta)[start:] ** 2))
            rms, floor = np.sqrt(np.mean(squares)), np.degrees(machine.L_s * noise / machine.psi_f)
            resistive_noise = machine.R_s * np.sqrt(h * observer.memory) / machine.L_s
            print(
                f"    {name:12s} {omega:5.0f} rad/s  {rms:.3f} degrees, {rms / floor:.2f} × the "
                f"floor; noise through R is {resistive_noise:.2f} times the noise through L"
            )


def standstill() -> None:
    heading(
        "Ten noisy minutes at standstill, then motion (target: no valid row, then valid in one "
        "period)"
    )
    for name, machine in magnet_machines().items():
        h, noise, rows = 2e-4, 0.005 * machine.rated_current, 3000
        observer = LeastSquaresObserver.for_machine(machine, sample_time=h, current_noise=noise)
        slowest_valid = observer.drift_prior / (np.pi / 22.5 * machine.psi_f)  # speed [rad/s]
        omega = max(250.0, 2 * slowest_valid)
        drive = Drive(machine, omega, 3j, h)
        theta, i, _, u = drive.samples(rows)
        standstill_rows = 3_000_000
        i = np.concatenate([np.repeat(i[:1], standstill_rows, axis=0), i])
        u = np.concatenate([np.repeat(machine.R_s * i[:1], standstill_rows, axis=0), u])
        i += 0.1 + noise * np.random.default_rng(0).standard_normal(i.shape)
        estimate = observer.run(u, i)
        valid = estimate.valid[standstill_rows:]
        error = degrees_error(estimate.theta_e[standstill_rows:], theta)
        print(
            f"    {name:12s} {estimate.valid[:standstill_rows].sum()} rows are valid at "
            f"standstill; at {omega:.0f} rad/s, rows are valid after "
            f"{np.argmax(valid) * h * omega / 2 / np.pi:.2f} turns with errors up to "
            f"{np.abs(error[valid]).max():.2f} degrees"
        )


def single_precision() -> None:
    heading("float32 against double over 100 s (target 1e-4 of the flux)")
    for name, machine in magnet_machines().items():
        h, rows = 1e-4, 1_000_000
        drive = Drive(machine, 700.0, 3j, h)
        _, i, _, u = drive.samples(rows)
        i = i + 0.1 + 0.002 * np.random.default_rng(0).standard_normal(i.shape)
        double, single = (
            LeastSquaresObserver.for_machine(machine, sample_time=h, precision=p).run(u, i)
            for p in ("double", "single")
        )
        settled = slice(2000, None)
        flux = np.abs(single.flux - double.flux)[settled].max() / machine.psi_f
        angle = np.abs(degrees_error(single.theta_e, double.theta_e))[settled].max()
        print(f"    {name:12s} flux {flux:.1e} of psi, angle {angle:.1e} degrees")


def long_memories() -> None:
    heading("float32 against double for several steps per memory (servo, 20 kHz, ten memories)")
    machine = magnet_machines()["servo-400w"]
    for steps in (600, 2000, 4000, 10_000, 20_000):
        h, rows = 5e-5, 20 * steps
        drive = Drive(machine, 600.0, 3j, h)
        _, i, _, u = drive.samples(rows)
        i = i + 0.1 + 0.02 * np.random.default_rng(0).standard_normal(i.shape)
        double, single = (
            LeastSquaresObserver.for_machine(
                machine, sample_time=h, memory=steps * h, precision=p
            ).run(u, i)
            for p in ("double", "single")
        )
        settled = slice(rows // 2, None)
        flux = np.abs(single.flux - double.flux)[settled].max() / machine.psi_f
        angle = np.abs(degrees_error(single.theta_e, double.theta_e))[settled].max()
        print(f"    {steps:6d} steps  flux {flux:.1e} of psi, angle {angle:.1e} degrees")


if __name__ == "__main__":
    exactness()
    quadrature()
    noise_floor()
    standstill()
    single_precision()
    long_memories()
