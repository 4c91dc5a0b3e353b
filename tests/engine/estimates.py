"""The estimate of a log from complex voltages and currents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.likelihood import Array, Complex
from fluxobs.inference.posterior import MachineFile, Posterior, posterior_of
from fluxobs.machines.model.frames import wrap

#: Relative standard deviations of a machine file: resistance, inductances, magnet flux.
TOLERANCES = (0.3, 0.15, 0.15)
#: Rows of which one has shares of its variances.
STRIDE = 7


class NoEstimate(Exception):
    """The log contradicts the hints, or no parameters that a machine may have explain it."""


def file_of(
    R: float,
    L_d: float,
    L_q: float,
    psi_f: float,
    rated_current: float,
    tolerances: tuple[float, float, float] = TOLERANCES,
    lag: tuple[float, float] = (0.0, 0.3),
    voltage: float | None = None,
) -> MachineFile:
    """Return a machine file with ordinary tolerances; `lag` is a prior: mean and std [samples].

    `voltage`: rms value of a drive with errors of its sensors, iron loss and heat; None: without.
    """
    R_std, L_std, psi_std = tolerances
    numbers = {
        **{"R": R, "L_d": L_d, "L_q": L_q, "psi_f": psi_f, "flux": psi_f},
        **{"rated_current": rated_current, "R_std": R_std, "L_d_std": L_std, "L_q_std": L_std},
        **{"psi_std": psi_std, "lag": lag[0], "lag_std": lag[1], "harmonics": 0.01},
    }
    if voltage is not None:
        errors = {"delay_std": 0.2, "heat_std": 0.05, "gain_std": 0.01}
        errors["iron_std"] = 0.02 * rated_current / voltage
        numbers |= errors | {"offset_std": 0.02 * rated_current}
    return MachineFile(numbers)


def changed(file: MachineFile, **numbers: float) -> MachineFile:
    """Return a machine file with some of its numbers replaced."""
    return replace(file, numbers=dict(file.numbers) | numbers)


def estimate(
    voltage: Complex,
    current: Complex,
    sample_time: float,
    file: MachineFile,
    angle: Array,
    parameters: dict[str, float] | None = None,
    sure: bool = True,
) -> Posterior:
    """Estimate a log from angles, NaN where they are not known; `sure`: those of valid rows.

    NoEstimate if there is none. `parameters`: where learning starts, instead of the machine file.
    """
    u, i = (np.stack([x.real, x.imag], axis=1) for x in (voltage, current))
    done = posterior_of(file, u, i, sample_time, angle, sure, parameters, STRIDE)
    if done is None:
        raise NoEstimate
    return done


def degrees(angle: Array, true: Array) -> Array:
    """Return the error of an angle [°]."""
    return np.degrees(wrap(angle - true))
