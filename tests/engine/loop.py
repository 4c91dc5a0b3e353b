"""Synchronous machines under a current controller.

The acceleration is a random walk, as the likelihood assumes. The controller takes its angle from
its own flux observer, or from an encoder, which puts its knowledge of the rotor into the voltages.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
SPEED = 250.0  # [rad/s], at the first row
#: Time and i_q of the set points.
LOADS = ((0.0, 0.2, 0.201, 0.4, 0.401, 0.6), (3.0, 3.0, 2.0, 2.0, 8.0, 8.0))
#: Steps of the integration in a sampling interval.
SUBSTEPS = 2


@dataclass(frozen=True)
class Conditions:
    """A drive and its errors; units are SI, `lag` in samples.

    `bandwidth` is kp h / L of the current controller; `moving_mean` the number of samples over
    which the sensor's noise is averaged; `drift` the std of a component of the logged
    voltages' constant error; `loss` and `knee` the inverter's: V_d tanh(i/knee) of each phase, of
    which the controller knows nothing.
    """

    R: float = 0.36
    L_d: float = 6e-4
    L_q: float = 6e-4
    psi: float = 0.0125
    noise: float = 0.03
    bandwidth: float = 0.35
    lag: int = 0
    i_d: float = 0.0
    acceleration: float = 500.0
    duration: float = 0.6
    sample_time: float = 1e-4
    moving_mean: int = 1
    drift: float = 0.05
    encoder: bool = False
    loss: float = 0.0
    knee: float = 0.36


@dataclass(frozen=True, eq=False)
class Record:
    """Voltages and currents of many drives, (rows, drives), and what is true.

    The torque is over 3/2 of the pole pairs [W s]; `drift` of each drive is the error of its logged
    voltages.
    """

    voltage: Complex
    current: Complex
    angle: Array
    speed: Array
    flux: Complex
    torque: Array
    drift: Complex


def simulated(
    conditions: Conditions,
    drives: int,
    seed: int = 0,
    jumps: Array | None = None,
    loads: tuple[tuple[float, ...], tuple[float, ...]] = LOADS,
) -> Record:
    """Simulate drives that differ in noise, speed and first angle.

    `jumps`: an acceleration of each row [rad/s²], besides the random walk. `loads`: time [s] and
    set point of i_q [A].
    """
    c, rng = conditions, np.random.default_rng(seed)
    h, rows = c.sample_time, round(c.duration / c.sample_time)
    white = rng.standard_normal((rows + c.moving_mean - 1, drives, 2)) @ [1, 1j]
    kernel = np.full(c.moving_mean, c.noise / np.sqrt(c.moving_mean))
    noise = sum(k * white[n : n + rows] for n, k in enumerate(kernel))
    steps = c.acceleration * np.sqrt(h) * rng.standard_normal((rows, drives))
    accelerations = np.cumsum(steps, axis=0)
    if jumps is not None:
        accelerations = accelerations + jumps[:, None]
    speeds = SPEED + h * np.cumsum(accelerations, axis=0)
    angle = rng.uniform(0, 2 * np.pi, drives)
    drift = c.drift * (rng.standard_normal((drives, 2)) @ [1, 1j])

    def flux_of(i: Complex) -> Complex:
        return c.L_d * i.real + 1j * c.L_q * i.imag + c.psi

    def current_of(flux: Complex) -> Complex:
        return (flux.real - c.psi) / c.L_d + 1j * flux.imag / c.L_q

    def wanted(t: float) -> complex:
        return complex(c.i_d, np.interp(t, *loads))

    flux = flux_of(np.full(drives, wanted(0.0)))
    own = Controller(c, angle, flux * np.exp(1j * angle))
    before = np.zeros(drives, complex)
    kinds = (complex, complex, float, float, complex, float)
    record = Record(*(np.empty((rows, drives), kind) for kind in kinds), drift)
    for k in range(rows):
        measured = current_of(flux) * np.exp(1j * angle) + noise[k]
        if c.encoder:
            own.angle, own.speed = angle, speeds[k]
        voltage = own.voltage(measured, wanted(k * h), flux_of)
        record.voltage[k], record.current[k] = voltage + drift, measured
        record.angle[k], record.speed[k] = angle, speeds[k]
        record.flux[k] = flux * np.exp(1j * angle)
        record.torque[k] = (flux.conj() * current_of(flux)).imag
        applied, before = (before if c.lag else voltage), voltage
        own.integrate(applied, measured)
        flux = _through(flux, angle, speeds[k], applied, c, current_of)
        angle = angle + h * speeds[k]
    return record


class Controller:
    """PI current control in the coordinates of a gradient observer of the flux."""

    def __init__(self, conditions: Conditions, angle: Array, flux: Complex) -> None:
        self.c, self.angle, self.flux = conditions, angle.copy(), flux.copy()
        self.speed, self.integral = np.full(len(angle), SPEED), np.zeros(len(angle), complex)
        self.i_d = np.zeros(len(angle))

    def voltage(
        self, measured: Complex, wanted: complex, flux_of: Callable[[Complex], Complex]
    ) -> Complex:
        c = self.c
        if not c.encoder:
            error = np.angle((self.flux - c.L_q * measured) * np.exp(-1j * self.angle))
            self.angle = self.angle + 0.2 * error
            self.speed = self.speed + 0.01 * error / c.sample_time
        current = measured * np.exp(-1j * self.angle)
        self.i_d, difference = current.real, wanted - current
        gain = c.bandwidth / c.sample_time
        drop = gain * (c.L_d * difference.real + 1j * c.L_q * difference.imag)
        command = drop + self.integral + 1j * self.speed * flux_of(current)
        self.integral = self.integral + c.bandwidth * c.R * difference
        return command * np.exp(1j * (self.angle + 0.5 * c.sample_time * self.speed))

    def integrate(self, applied: Complex, measured: Complex) -> None:
        c, h = self.c, self.c.sample_time
        active = self.flux - c.L_q * measured
        excess = c.psi + (c.L_d - c.L_q) * self.i_d - np.abs(active)
        self.flux = self.flux + h * (applied - c.R * measured) + 100 * h * active / c.psi * excess
        self.angle = self.angle + h * self.speed


def _through(
    flux: Complex,
    angle: Array,
    speed: Array,
    voltage: Complex,
    c: Conditions,
    current_of: Callable[[Complex], Complex],
) -> Complex:
    """Return the flux in rotor coordinates after an interval (Runge–Kutta, fourth order)."""

    def slope(x: Complex, t: float) -> Complex:
        i, turn = current_of(x), np.exp(1j * (angle + speed * t))
        lost = c.loss * _signs(i * turn, c.knee) if c.loss else 0.0
        return (voltage - lost) * np.conj(turn) - c.R * i - 1j * speed * x

    return runge_kutta(slope, flux, c.sample_time)


def runge_kutta(slope: Callable[[Complex, float], Complex], x: Complex, h: float) -> Complex:
    """Return x after the time h (Runge–Kutta, fourth order, SUBSTEPS steps)."""
    g = h / SUBSTEPS
    for n in range(SUBSTEPS):
        t = n * g
        k1 = slope(x, t)
        k2 = slope(x + 0.5 * g * k1, t + 0.5 * g)
        k3 = slope(x + 0.5 * g * k2, t + 0.5 * g)
        k4 = slope(x + g * k3, t + g)
        x = x + g / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def _signs(current: Complex, knee: float) -> Complex:
    """Return the smoothed signs of the phase currents as a vector."""
    return sum(  # type: ignore[return-value]
        2 / 3 * phase * np.tanh((current * np.conj(phase)).real / knee)
        for phase in np.exp(2j * np.pi / 3 * np.arange(3))
    )


SURFACE = Conditions()
INTERIOR = replace(SURFACE, L_d=4e-4, L_q=9e-4, i_d=-2.0)
