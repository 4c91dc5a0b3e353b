"""Quantities derived from an estimate and the machine: torque, slip, mechanical speed."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..core.arrays import Array
from ..machines import InductionMachine, Machine, RotatingMachine
from .outputs import Output


def _column(name: str, unit: str, about: str) -> Output:
    return Output(name, unit, about, vector=False, boolean=False, in_files=True)


#: Derived outputs of all machines that turn.
ROTATING = (
    _column("torque", "N m", "Air-gap torque, 1.5 n_p Im(λ* i)"),
    _column("speed_mech", "rad/s", "Mechanical speed"),
)
#: Further outputs of an induction machine.
INDUCTION = (
    _column("speed_mech_std", "rad/s", "Standard deviation of speed_mech due to that of R_R"),
    _column("slip_e", "rad/s", "Electrical speed of the rotor flux relative to the rotor"),
)


class FluxAndSpeed(Protocol):
    """An estimate with (rows, 2) flux [Wb] and (rows,) electrical speed [rad/s]."""

    @property
    def flux(self) -> Array: ...

    @property
    def speed_e(self) -> Array: ...


def derived_outputs(machine: Machine) -> tuple[Output, ...]:
    """Return the outputs that :func:`derived` computes for a machine."""
    if isinstance(machine, InductionMachine):
        return (*ROTATING, *INDUCTION)
    return ROTATING if isinstance(machine, RotatingMachine) else ()


def derived(machine: Machine, estimate: FluxAndSpeed, current: Array) -> dict[str, Array]:
    """Return torque and speeds of the rows.

    Parameters
    ----------
    machine : Machine
        The result is empty for a machine that does not turn.
    estimate : an estimate with flux and speed_e
    current : (rows, 2) ndarray
        Measured current [A].

    Returns
    -------
    dict of str to (rows,) ndarray
        Columns in SI, with the names of :func:`derived_outputs` as keys.
    """
    if not isinstance(machine, RotatingMachine):
        return {}
    flux, i = estimate.flux, current
    torque = 1.5 * machine.n_p * (flux[..., 0] * i[..., 1] - flux[..., 1] * i[..., 0])
    if not isinstance(machine, InductionMachine):
        return {"torque": torque, "speed_mech": estimate.speed_e / machine.n_p}
    slip = machine.slip(flux, i)
    return {
        "torque": torque,
        "speed_mech": (estimate.speed_e - slip) / machine.n_p,
        "speed_mech_std": machine.slip_share_std * np.abs(slip) / machine.n_p,
        "slip_e": slip,
    }
