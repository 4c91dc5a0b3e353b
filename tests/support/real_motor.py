"""Imperfections of a real motor: harmonics, unmodelled saliency, heating, iron loss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fluxobs.machines import RotatingMachine
from fluxobs.simulation.closed_form.signals import vectors
from support.records import Samples, white

Array = NDArray[np.float64]
#: Integration steps per sample.
STEPS = 16


@dataclass(frozen=True)
class Imperfect:
    """Deviations of a motor from its machine file.

    Attributes
    ----------
    fifth, seventh : float
        Harmonics of the magnets' flux, over the fundamental.
    saliency : float
        L_q - L_d over the file's inductance, which is the mean of L_d and L_q.
    flux : float
        Magnet flux over the file's value.
    heating : float
        Resistance at the end of the record over the file's value; the resistance grows evenly.
    iron : float
        Iron loss at rated EMF: current in phase with the EMF, over the rated current.
    """

    fifth: float = 0.0
    seventh: float = 0.0
    saliency: float = 0.0
    flux: float = 1.0
    heating: float = 1.0
    iron: float = 0.0


def record(
    machine: RotatingMachine,
    real: Imperfect,
    sample_time: float = 1.25e-4,
    speed_e: float = 300.0,
    seconds: float = 4.0,
    seed: int = 0,
) -> Samples:
    """Record load steps and a reversal; offset and noise are 1 % and 0.3 % of the rated current."""
    rated, psi = machine.rated_current, real.flux * machine.magnet_flux
    rows = round(seconds / sample_time)
    t = sample_time / STEPS * np.arange(rows * STEPS + 1)
    progress = np.linspace(0, 2.4, len(t))

    def course(*knots: tuple[float, float]) -> Array:
        return np.interp(progress, *zip(*knots, strict=True))

    speed = speed_e * course((0, 0.3), (0.4, 1), (1.6, 1), (2.0, -1), (2.4, -1))
    i_q = rated * course((0, 0.2), (0.6, 0.2), (0.602, 0.8), (1.2, 0.8), (1.202, 0.3), (2.4, 0.6))
    step = sample_time / STEPS
    theta = 0.7 + np.concatenate([[0.0], np.cumsum(step * (speed[1:] + speed[:-1]) / 2)])
    turn = np.exp(1j * theta)
    L_d, L_q = machine.L_dq
    current = 1j * i_q * turn
    i = current * turn.conj()
    magnets = turn + real.fifth * turn**-5 + real.seventh * turn**7
    share_d, share_q = 1 - real.saliency / 2, 1 + real.saliency / 2
    linear = share_d * L_d * i.real + 1j * share_q * L_q * i.imag
    flux = linear * turn + psi * magnets
    emf = np.gradient(flux, step)
    terminal = current + real.iron * rated * emf / (psi * speed_e)
    R = machine.R_s * np.interp(t, [0, t[-1]], [1.0, real.heating])
    drop = np.concatenate([[0.0], np.cumsum(step * ((R * terminal)[1:] + (R * terminal)[:-1]) / 2)])
    at = slice(None, None, STEPS)
    voltage = np.diff(flux[at] + drop[at]) / sample_time
    bias = 0.01 * rated * (0.6 + 0.8j)
    measured = terminal[at][1:] + bias + 0.003 * rated * white(rows, seed)
    return Samples(
        sample_time,
        theta[at][1:],
        vectors(flux[at][1:]),
        vectors(measured),
        vectors(voltage),
        vectors(np.diff(flux[at])),
        vectors(np.array(machine.R_s * bias, complex)),
    )
