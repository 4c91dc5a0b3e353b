"""True signals of a rotating machine in closed form, without growing integration errors.

Position and currents are prescribed. The machine model gives the flux linkage; the flux change and
the integral of the current give the mean voltage over each interval. The demo log, the firmware's
test record, tests and benchmarks use these signals. Sensors (sensors.py) and inverter
(:func:`inverter_loss`) are applied later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...core.arrays import Array
from ...machines import InductionMachine, RotatingMachine
from ...machines.model.frames import clarke

Complex = NDArray[np.complex128]
AnyComplex = NDArray[np.complexfloating]


@dataclass(frozen=True, eq=False)
class Signals:
    """Space vectors α + j β at rows + 1 instants and over the intervals between these instants.

    Attributes
    ----------
    sample_time : float
        [s].
    theta_e : (rows + 1,) ndarray
        Unwrapped electrical angle [rad].
    flux, current : (rows + 1,) complex ndarray
        Values at the instants [Wb], [A].
    mean_current, voltage : (rows,) complex ndarray
        Means over the intervals [A], [V], with
        ``voltage = R_s mean_current + Δflux / sample_time``.
    """

    sample_time: float
    theta_e: Array
    flux: Complex
    current: Complex
    mean_current: Complex
    voltage: Complex

    @property
    def volt_seconds(self) -> Complex:
        """∫ (u - R_s i) dt over the intervals [Wb]."""
        return np.diff(self.flux)


def steady(
    machine: RotatingMachine,
    sample_time: float,
    speed: ArrayLike,
    rows: int,
    i_dq: complex,
    theta0: float = 0.0,
) -> Signals:
    """Return signals with a constant current in rotor coordinates [A].

    `speed` [rad/s] is one number, or one number per row; it is constant in each interval. Every
    integral is exact.
    """
    omega = np.broadcast_to(np.asarray(speed, float), (rows,)).copy()
    if np.ndim(speed) == 0:  # a sum over millions of rows would lose digits
        theta = theta0 + omega[0] * sample_time * np.arange(rows + 1)
    else:
        theta = theta0 + np.concatenate([[0.0], np.cumsum(omega * sample_time)])
    turn = np.exp(1j * theta)
    moving = np.abs(omega) > 1e-9  # the quotient below is 0/0 at rest
    divisor = np.where(moving, omega, 1.0)
    means = np.where(moving, np.diff(turn) / (1j * divisor * sample_time), turn[1:])
    flux = complex(machine.flux_dq(i_dq)) * turn
    return _with_voltage(machine, sample_time, theta, flux, i_dq * turn, i_dq * means)


def driven(
    machine: RotatingMachine,
    sample_time: float,
    speed: Array,
    i_dq: AnyComplex,
    parts: int,
    theta0: float = 0.0,
) -> Signals:
    """Return signals for arbitrary speed [rad/s] and current in rotor coordinates [A] over time.

    Speed and current have rows · parts + 1 instants: `parts` (an even number) per sample. The
    trapezoidal rule integrates the angle; it is exact if the speed is linear between the instants.
    Simpson's rule integrates the current; its relative error is about 1e-9 at 36 samples per period
    and 16 parts.
    """
    h = sample_time / parts
    theta = theta0 + np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * h)])
    turn = np.exp(1j * theta)
    current = i_dq * turn
    flux = machine.flux_dq(i_dq) * turn
    means = interval_means(current, parts)
    return _with_voltage(
        machine, sample_time, theta[::parts], flux[::parts], current[::parts], means
    )


def driven_cage(
    machine: InductionMachine,
    sample_time: float,
    speed: Array,
    psi: Array,
    i_q: Array,
    parts: int,
    theta0: float = 0.0,
) -> tuple[Signals, Array]:
    """Return signals of an induction machine whose rotor flux is prescribed.

    Parameters
    ----------
    machine : InductionMachine
    sample_time : float
        [s].
    speed, psi, i_q : (rows parts + 1,) ndarray
        Rotor flux: electrical speed [rad/s], length [Wb], and current perpendicular to it [A].
    parts : int
        Even number of instants per sample.
    theta0 : float
        Initial angle of the rotor flux [rad].

    Returns
    -------
    signals : Signals
        theta_e is the angle of the rotor flux; psi and its derivative determine i_d.
    mechanical : (rows + 1,) ndarray
        Speed of the shaft [rad/s].
    """
    h = sample_time / parts
    theta = theta0 + np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * h)])
    i_d = (np.gradient(psi, h) + machine.R_R / machine.L_M * psi) / machine.R_R
    i_dq = i_d + 1j * i_q
    turn = np.exp(1j * theta)
    current = i_dq * turn
    flux = (psi + machine.L_sigma * i_dq) * turn
    means = interval_means(current, parts)
    mechanical = (speed - machine.R_R * i_q / psi) / machine.n_p
    true = _with_voltage(
        machine, sample_time, theta[::parts], flux[::parts], current[::parts], means
    )
    return true, mechanical[::parts]


def interval_means(values: AnyComplex, parts: int) -> Complex:
    """Return means (rows,) over intervals of `parts` (even) steps, by Simpson's rule."""
    weights = np.tile([2.0, 4.0], parts // 2) / (3 * parts)
    weights[0] /= 2
    inner = values[:-1].reshape(-1, parts) @ weights
    return np.asarray(inner + values[parts::parts] / (3 * parts))


def between_rows(values: ArrayLike, parts: int) -> NDArray[np.generic]:
    """Interpolate linearly to ``parts`` values per sample, for :func:`driven`."""
    rows = np.asarray(values)
    knots, k = np.arange(len(rows)), np.arange((len(rows) - 1) * parts + 1) / parts
    if np.iscomplexobj(rows):
        return np.asarray(np.interp(k, knots, rows.real) + 1j * np.interp(k, knots, rows.imag))
    return np.asarray(np.interp(k, knots, rows))


def inverter_loss(current: AnyComplex, voltage: float, knee: float) -> Complex:
    """Return the voltage lost through dead time and device drops: `voltage` per phase [V].

    The loss opposes the phase current, whose sign is ``tanh(i / knee)`` with knee in ampere.
    """
    phases = ((current * np.exp(-2j * np.pi / 3 * k)).real for k in range(3))
    direction = clarke(*(np.tanh(phase / knee) for phase in phases))
    return np.asarray(voltage * (direction @ [1, 1j]))


def vectors(z: AnyComplex) -> Array:
    """Return (α, β) of complex numbers as an array (..., 2)."""
    return np.stack([np.real(z), np.imag(z)], axis=-1)


def _with_voltage(
    machine: RotatingMachine,
    sample_time: float,
    theta: Array,
    flux: AnyComplex,
    current: AnyComplex,
    mean_current: AnyComplex,
) -> Signals:
    """Return the signals together with the voltage."""
    voltage = np.diff(flux) / sample_time + machine.R_s * mean_current
    space_vectors = (np.asarray(z, complex) for z in (flux, current, mean_current, voltage))
    return Signals(sample_time, theta, *space_vectors)
