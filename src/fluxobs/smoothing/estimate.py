"""The estimate of a row from the whole log, and its columns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..observers.outputs import documented, output
from .record import SmoothedRecord

#: Largest standard deviation of a valid position [rad]: 10° is then more than three of them.
VALID_STD = np.radians(3.0)


@documented
@dataclass(frozen=True, eq=False)
class SmoothedEstimate:
    """Estimate of the rows of a log from the record before and behind each of them.

    The standard deviations contain every assumption of :mod:`fluxobs.smoothing.assumptions`.
    """

    flux: Array = field(metadata=output("Wb", "Flux linkage", vector=True))
    flux_std: Array = field(
        metadata=output("Wb", "Standard deviation of a component of the flux", vector=True)
    )
    psi_f: Array = field(
        metadata=output(
            "Wb", "Magnet flux; without magnets, rotor flux or length of the auxiliary flux"
        )
    )
    psi_f_std: Array = field(metadata=output("Wb", "Standard deviation of psi_f"))
    theta_e: Array = field(metadata=output("rad", "Electrical position, in (-π, π]"))
    theta_e_std: Array = field(metadata=output("rad", "Standard deviation of theta_e"))
    speed_e: Array = field(metadata=output("rad/s", "Electrical speed"))
    speed_e_std: Array = field(metadata=output("rad/s", "Standard deviation of speed_e"))
    drift: Array = field(
        metadata=output(
            "V", "Slow voltage error that no assumption explains, e.g. an offset", vector=True
        )
    )
    drift_std: Array = field(metadata=output("V", "Standard deviation of a component of the drift"))
    resistance: Array = field(metadata=output("Ω", "Phase resistance"))
    resistance_std: Array = field(metadata=output("Ω", "Standard deviation of resistance"))
    inverter_voltage: Array = field(metadata=output("V", "Dead time and device drops of a phase"))
    inverter_voltage_std: Array = field(
        metadata=output("V", "Standard deviation of inverter_voltage")
    )
    torque: Array = field(metadata=output("W s", "Flux × current", in_files=False))
    torque_std: Array = field(
        metadata=output("W s", "Standard deviation of flux × current", in_files=False)
    )
    innovation: Array = field(
        metadata=output(
            "", "Innovation of the row's block, divided by its standard deviation", in_files=False
        )
    )
    valid: NDArray[np.bool_] = field(
        metadata=output("", "The position is known, and theta_e_std is reliable", boolean=True)
    )


def smoothed_estimate(
    record: SmoothedRecord, inverter_voltage: float, inverter_std: float
) -> SmoothedEstimate:
    """Return the estimate of all rows of a record.

    Parameters
    ----------
    record : SmoothedRecord
    inverter_voltage, inverter_std : float
        Learnt loss of a phase and its standard deviation [V].
    """
    row = record.outputs
    ones = np.ones(len(record.known))
    return SmoothedEstimate(
        flux=np.stack([row["flux_alpha"], row["flux_beta"]], axis=1),
        flux_std=np.stack([row["flux_alpha_std"], row["flux_beta_std"]], axis=1),
        psi_f=row["psi_f"],
        psi_f_std=row["psi_f_std"],
        theta_e=row["theta_e"],
        theta_e_std=row["theta_e_std"],
        speed_e=row["speed_e"],
        speed_e_std=row["speed_e_std"],
        drift=np.stack([row["drift_alpha"], row["drift_beta"]], axis=1),
        drift_std=row["drift_std"],
        resistance=row["resistance"],
        resistance_std=row["resistance_std"],
        inverter_voltage=inverter_voltage * ones,
        inverter_voltage_std=inverter_std * ones,
        torque=row["torque"],
        torque_std=row["torque_std"],
        innovation=row["innovation"],
        valid=record.known & (row["theta_e_std"] < VALID_STD),
    )
