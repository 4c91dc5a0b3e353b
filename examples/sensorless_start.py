"""Simulate a sensorless drive: start at an unknown angle, load step, reversal. Draw the result.

python examples/sensorless_start.py [PICTURE]
"""

import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from fluxobs.core.plots import BLUE, GREY, ORANGE, STYLE, write
from fluxobs.machines import example
from fluxobs.simulation.drive import (
    Course,
    Profile,
    rating,
    rpm,
    sensorless_drive,
    simulate,
    to_rpm,
)

machine, rated = example("pmsm-2kw2"), rating("pmsm-2kw2")
# The current sensors have noise, and offsets of a few percent; the voltage has an offset too.
drive = sensorless_drive(machine, rated, offset=(0.13, 0.18), noise=0.02)
course = Course(
    speed=Profile([0.2, 0.9, 1.8, 2.6], rpm(np.array([0.0, 750.0, 750.0, -750.0]))),
    dc_link=rated.dc_link,
    load=Profile([1.2, 1.2, 3.0, 3.0], [0.0, rated.torque, rated.torque, 0.0]),
    voltage_offset=(2.2, 0.0),
    theta_e=2.8,
)
run = simulate(drive, course, 3.5)
for event in run.events:
    print(event)

trace, reading = run.trace, run.trace.reading
error = np.degrees(np.angle(np.exp(1j * (reading.theta_e - trace.theta_e))))
running = trace.mode == 1
print(f"rms {np.sqrt(np.mean(error[running] ** 2)):.3f} degrees with the observer in the loop")

with plt.rc_context(STYLE):
    figure, axes = plt.subplots(4, 1, figsize=(9, 8), sharex=True, layout="constrained")
    speed, position, current, drift = axes
    speed.plot(run.t, to_rpm(np.asarray(course.speed.at(run.t))), color=GREY, label="reference")
    speed.plot(run.t, to_rpm(trace.speed), color=BLUE, label="true")
    speed.set_ylabel("speed [rpm]")
    band = 2 * np.degrees(reading.theta_e_std)
    position.fill_between(run.t, -band, band, color=BLUE, alpha=0.18, linewidth=0, label="±2σ")
    position.plot(run.t, error, color=BLUE, linewidth=0.6, label="error")
    position.set_ylim(-1, 1)
    position.set_ylabel("position [°]")
    i = trace.current * np.exp(-1j * trace.theta_e)
    current.plot(run.t, i.real, color=ORANGE, label="i_d")
    current.plot(run.t, i.imag, color=BLUE, label="i_q")
    current.set_ylabel("current [A]")
    true_drift = float(machine.R_s) * np.array([0.13, 0.18]) - np.array([2.2, 0.0])
    for k, (color, axis) in enumerate(((BLUE, "α"), (ORANGE, "β"))):
        estimate = np.where(running, reading.drift[:, k], np.nan)
        drift.plot(run.t, estimate, color=color, label=f"drift {axis}")
        drift.axhline(true_drift[k], color=color, linewidth=0.8, linestyle=":")
    drift.set_ylabel("drift [V]")
    drift.set_ylim(-3, 2)
    drift.set_xlabel("t [s]        grey: current vector rotated open-loop (I/f)")
    for panel in axes:
        panel.axvspan(0, run.t[np.argmax(running)], color="0.9", linewidth=0)
        panel.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, ncols=3)
    figure.suptitle("Sensorless from standstill, both sensors biased: 2.2 kW, full load at 1.2 s")
    picture = Path(sys.argv[1] if len(sys.argv) > 1 else "sensorless_start.png")
    write(figure, picture)
    print(f"Written: {picture}")
