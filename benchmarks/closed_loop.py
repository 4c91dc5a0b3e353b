"""Sensorless closed loop: the least squares starts at standstill with an unknown angle."""

from __future__ import annotations

import numpy as np
from common import degrees_error, heading

from fluxobs.comparison.scenarios import believed_machine
from fluxobs.machines import RotatingMachine, example
from fluxobs.simulation.drive import (
    Course,
    Profile,
    Rating,
    Run,
    rating,
    sensorless_drive,
    simulate,
)

MACHINE = "pmsm-2kw2"


def errors(run: Run, half_turn: bool = False) -> np.ndarray:
    """Return the error of the drive's angle [°]."""
    return degrees_error(run.trace.reading.theta_e, run.trace.theta_e, half_turn)


def course(ratings: Rating, machine: RotatingMachine, speed, load=((0, 0),), **options) -> Course:
    """Return a course from speeds and loads, given as shares of the rated values."""
    return Course(
        Profile([t for t, _ in speed], [x * ratings.speed_e / machine.n_p for _, x in speed]),
        ratings.dc_link,
        Profile([t for t, _ in load], [x * ratings.torque for _, x in load]),
        **options,
    )


def losses(run: Run) -> str:
    """Describe the times of hand-over and of losses."""
    hand_overs = [event.at for event in run.events if event.what == "observer in the loop"]
    loss_times = [
        event.at for event in run.events if event.what in ("position lost", "overcurrent trip")
    ]
    text = f"in the loop from {hand_overs[0]:.2f} s" if hand_overs else "never in the loop"
    return text + (f", lost at {', '.join(f'{t:.2f}' for t in loss_times)} s" if loss_times else "")


def table_of_theory() -> None:
    heading(
        "Cases of theory section 5, sensorless: rms error [degrees] at 0.5 pu, 1 pu, ramp, -0.3 pu"
    )
    rated, machine = rating(MACHINE), example(MACHINE)
    offsets = {"offset": (0.22 * 0.6, 0.22 * 0.8)}
    wrong = believed_machine(machine, {"R": 1.2})
    cases = [
        ("bias 0.22 A, 2.2 V", 1.0, 2.2, offsets, None),
        ("same, noise 0.02 A", 1.0, 2.2, offsets | {"noise": 0.02}, None),
        ("R + 20 %, noise, half load", 0.5, 0.0, {"noise": 0.02}, wrong),
        ("R + 20 %, noise, full load", 1.0, 0.0, {"noise": 0.02}, wrong),
    ]
    speed = ((0, 0), (0.2, 0), (1.0, 0.5), (1.8, 0.5), (2.4, 1.0), (3.0, 1.0), (4.0, -0.3))
    segments = ((1.4, 1.8), (2.6, 3.0), (3.0, 4.0), (4.1, 5.0))
    for name, load, volts, sensors, believed in cases:
        drive = sensorless_drive(machine, rated, believed=believed, **sensors)
        loads = ((1.0, 0), (1.1, load))
        options = {"voltage_offset": (volts, 0.0), "theta_e": 2.0}
        run = simulate(drive, course(rated, machine, speed, loads, **options), 5.0)
        error = errors(run)
        rms = [np.sqrt(np.mean(error[(run.t >= a) & (run.t < b)] ** 2)) for a, b in segments]
        print(f"    {name:27s}", *(f"{x:6.3f}" for x in rms), f"  {losses(run)}")


def speeds() -> None:
    heading(
        "Both directions, 1 to 100 % of rated speed: full load step, bias 0.22 A and 2.2 V, "
        "noise 0.02 A"
    )
    rated, machine = rating(MACHINE), example(MACHINE)
    sensors = {"offset": (0.22 * 0.6, 0.22 * 0.8), "noise": 0.02}
    for share in (0.01, 0.02, 0.05, 0.1, 0.3, 1.0):
        for sign in (1, -1):
            # `sensorless_drive` recommends the time of half a turn; use at least the default.
            memory = max(0.03, np.pi / (share * rated.speed_e))
            ramp_end = 0.2 + max(0.1, 2 * share)
            settled = ramp_end + 4 * memory + 0.5
            target = sign * share
            speed = ((0, 0), (0.2, 0), (ramp_end, target))
            # At 1 % of the rated EMF, voltage errors other than offsets must be small.
            prior = min(0.1 * machine.psi_f / memory, 0.1 * share * rated.speed_e * machine.psi_f)
            drive = sensorless_drive(
                machine, rated, memory, speed_bandwidth=50.0, drift_prior=prior, **sensors
            )
            load = ((settled, 0), (settled, sign * 1.0))
            run = simulate(
                drive,
                course(rated, machine, speed, load, voltage_offset=(2.2, 0.0), theta_e=2.0),
                settled + 2.0,
            )
            error = errors(run)[run.trace.mode == 1]
            late = run.t > settled + 1.0
            speed_error = run.trace.speed[late] * machine.n_p / rated.speed_e - target
            print(
                f"    {100 * target:+6.0f} %, memory {memory:.2f} s: rms "
                f"{np.sqrt(np.mean(error**2)):.3f}, largest {np.abs(error).max():.2f} degrees, "
                f"speed error under load "
                f"{100 * np.abs(speed_error).max():.2f} % of rated; {losses(run)}"
            )


def resistance_in_the_loop() -> None:
    heading(
        "R + 20 %, half speed, half load: error by speed bandwidth times memory, last half second"
    )
    rated, machine = rating(MACHINE), example(MACHINE)
    wrong = believed_machine(machine, {"R": 1.2})
    for memory, bandwidth in ((0.1, 50.0), (0.1, 7.5), (0.03, 25.0)):
        drive = sensorless_drive(
            machine, rated, memory, believed=wrong, noise=0.02, speed_bandwidth=bandwidth
        )
        speed, load = ((0, 0), (0.2, 0), (1.0, 0.5)), ((1.0, 0), (1.1, 0.5))
        run = simulate(drive, course(rated, machine, speed, load, theta_e=2.0), 2.5)
        late = run.t > 2.0
        i_q = (run.trace.current * np.exp(-1j * run.trace.theta_e)).imag
        print(
            f"    {bandwidth * memory:4.2f}: rms {np.sqrt(np.mean(errors(run)[late] ** 2)):.2f} "
            f"degrees, i_q oscillates by {i_q[late].std():.2f} A rms"
        )


def jumps() -> None:
    heading("Biases that change sign during operation, under full load (2.2 V and 0.22 A)")
    rated, machine = rating(MACHINE), example(MACHINE)
    for share in (0.1, 0.3, 1.0):
        offset = np.array([0.22 * 0.6, 0.22 * 0.8])
        drive = sensorless_drive(
            machine, rated, offset=Profile([0, 2.0, 2.0], [offset, offset, -offset]), noise=0.02
        )
        volts = Profile([0, 2.5, 2.5], [(2.2, 0.0), (2.2, 0.0), (-2.2, 0.0)])
        run = simulate(
            drive,
            course(
                rated,
                machine,
                ((0, 0), (0.2, 0), (0.4 + share, share)),
                ((1.6, 0), (1.6, 1)),
                voltage_offset=volts,
                theta_e=1.0,
            ),
            3.0,
        )
        error = np.abs(errors(run))
        for kind, jump_time in (("current", 2.0), ("voltage", 2.5)):
            window = (run.t >= jump_time) & (run.t < jump_time + 0.5)
            above = error[window] > 1
            recovery = (np.flatnonzero(above)[-1] + 1 if above.any() else 0) * run.sample_time
            print(
                f"    {100 * share:4.0f} %, {kind} offset: error at most {error[window].max():.2f} "
                f"degrees, below 1 degree after {1e3 * recovery:.0f} ms; {losses(run)}"
            )


def starts() -> None:
    heading("Start from 16 unknown angles, bias 0.22 A and 2.2 V, noise 0.02 A")
    rated, machine = rating(MACHINE), example(MACHINE)
    sensors = {"offset": (0.22 * 0.6, 0.22 * 0.8), "noise": 0.02}
    drive = sensorless_drive(machine, rated, **sensors)
    times, worst = [], []
    for k, angle in enumerate(2 * np.pi * np.arange(16) / 16):
        run = simulate(
            drive,
            course(
                rated,
                machine,
                ((0, 0), (0.2, 0), (0.7, 0.3)),
                voltage_offset=(2.2, 0.0),
                theta_e=angle,
            ),
            1.5,
            seed=k,
        )
        hand_overs = [event.at for event in run.events if event.what == "observer in the loop"]
        assert len(hand_overs) == 1, losses(run)
        times.append(hand_overs[0])
        worst.append(np.abs(errors(run)[run.trace.mode == 1]).max())
    print(
        f"    in the loop after {min(times):.2f} to {max(times):.2f} s (the reference starts at "
        f"0.2 s), then error at most {max(worst):.2f} degrees"
    )


def machines() -> None:
    heading("Other machines: start, full load at half speed, reversal; offsets 1 %, noise 0.3 %")
    for name in ("pmsm-2kw2", "ipm-2kw2", "synrm-6kw7", "servo-400w", "drone-900kv"):
        machine, rated = example(name), rating(name)
        I_n = machine.rated_current
        noise = 0.003 * I_n
        drive = sensorless_drive(
            machine, rated, offset=(0.006 * I_n, 0.008 * I_n), noise=noise, current_noise=noise
        )
        run = simulate(
            drive,
            course(
                rated,
                machine,
                ((0, 0), (0.2, 0), (0.8, 0.5), (1.6, 0.5), (2.2, -0.5)),
                ((1.0, 0), (1.0, 0.8)),
                theta_e=2.0,
            ),
            3.0,
        )
        running = run.trace.mode == 1
        error = errors(run, machine.half_turn_ambiguous)[running]
        rms = np.sqrt(np.mean(error**2)) if running.any() else np.nan
        largest = np.abs(error).max() if running.any() else np.nan
        print(f"    {name:12s} rms {rms:.3f}, largest {largest:.2f} degrees; {losses(run)}")


if __name__ == "__main__":
    table_of_theory()
    speeds()
    resistance_in_the_loop()
    jumps()
    starts()
    machines()
