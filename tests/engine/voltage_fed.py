"""Machines with a controller that knows the rotor, from equations written apart from the engine's.

Currents come from the flux by Newton's method on the machine's map, or from leakage and rotor flux
of a cage; the integration is Runge–Kutta of fourth order in stator coordinates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from engine.likelihood import Array, Complex
from engine.loop import runge_kutta

H = 1e-4
#: Share of the current's error that the controller removes in a sample.
BANDWIDTH = 0.15


@dataclass(frozen=True, eq=False)
class Run:
    """Voltage and current of a drive, the true angle of d and the rotor's electrical speed."""

    voltage: Complex
    current: Complex
    angle: Array
    speed: Array


@dataclass(frozen=True)
class Mapped:
    """A machine with a flux map in rotor coordinates: `at` gives flux, ∂/∂i_d and ∂/∂i_q."""

    R: float
    at: Callable[[complex], tuple[complex, complex, complex]]
    L: complex  # of the controller: L_d + j L_q

    def current(self, x: Complex, turn: complex, guess: complex) -> complex:
        i = guess
        for _ in range(12):
            flux, by_d, by_q = self.at(i)
            r = x[0] / turn - flux
            det = by_d.real * by_q.imag - by_q.real * by_d.imag
            step = complex(
                (by_q.imag * r.real - by_q.real * r.imag) / det,
                (by_d.real * r.imag - by_d.imag * r.real) / det,
            )
            i += step
            if abs(step) < 1e-9:
                break
        return i * turn

    def slope(self, x: Complex, i: complex, u: complex, speed: float) -> Complex:
        return np.array([u - self.R * i])

    def start(self, wanted: complex) -> Complex:
        return np.array([self.at(wanted)[0]])

    def turns(self, x: Complex) -> complex:
        """Return e^{jθ} of d if the machine itself determines it, else 0."""
        return 0j


@dataclass(frozen=True)
class Cage:
    """A cage machine: states are stator and rotor flux; d is along the rotor flux."""

    R: float
    L_sigma: float
    R_R: float
    L_M: float

    @property
    def L(self) -> complex:
        return complex(self.L_sigma, self.L_sigma)

    def current(self, x: Complex, turn: complex, guess: complex) -> complex:
        return complex(x[0] - x[1]) / self.L_sigma

    def slope(self, x: Complex, i: complex, u: complex, speed: float) -> Complex:
        rotor = self.R_R * i + (1j * speed - self.R_R / self.L_M) * x[1]
        return np.array([u - self.R * i, rotor])

    def start(self, wanted: complex) -> Complex:
        psi = self.L_M * wanted.real
        return np.array([psi + self.L_sigma * wanted, psi], complex)

    def turns(self, x: Complex) -> complex:
        return complex(x[1] / abs(x[1]))


def through(
    machine: Mapped | Cage, x: Complex, u: complex, rotor: tuple[float, float], guess: complex
) -> Complex:
    """Return the states after an interval (Runge–Kutta, fourth order)."""
    theta, speed = rotor

    def slope(y: Complex, t: float) -> Complex:
        turn = machine.turns(y) or np.exp(1j * (theta + speed * t))
        return machine.slope(y, machine.current(y, turn, guess), u, speed)

    return runge_kutta(slope, x, H)


def run(machine: Mapped | Cage, speeds: Array, wanted: Complex, noise: float, seed: int) -> Run:
    """Simulate a drive at these electrical speeds [rad/s] and set points of the current [A]."""
    rng = np.random.default_rng(seed)
    rows = len(speeds)
    white = noise * (rng.standard_normal((rows, 2)) @ [1, 1j])
    out = Run(*(np.empty(rows, kind) for kind in (complex, complex, float)), speeds)
    theta, x = 0.4, machine.start(complex(wanted[0])) * np.exp(0.4j)
    i_dq, integral, own = complex(wanted[0]), 0j, 0j
    for k in range(rows):
        turn = machine.turns(x) or np.exp(1j * theta)
        i = machine.current(x, turn, i_dq)
        i_dq = i / turn
        measured = i + white[k]
        difference = complex(wanted[k]) - measured / turn
        drop = complex(machine.L.real * difference.real, machine.L.imag * difference.imag)
        ahead = turn * np.exp(0.5j * H * speeds[k])
        own = (BANDWIDTH / H * drop + integral + 1j * speeds[k] * x[0] / turn) * ahead
        integral += BANDWIDTH * machine.R * difference
        out.voltage[k], out.current[k], out.angle[k] = own, measured, np.angle(turn)
        x = through(machine, x, own, (theta, float(speeds[k])), i_dq)
        theta += H * speeds[k]
    out.angle[:] = np.unwrap(out.angle)
    return out
