"""The estimate of a row from the whole log, and its columns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array, runs
from ..observers.outputs import documented, output
from .assumptions import Calibration, with_scale
from .record import SmoothedRecord

#: Largest standard deviation of a valid position [rad]: 10° is then more than three of them.
VALID_STD = np.radians(3.0)

#: Beyond this standard deviation the linear model does not hold [rad]: twice that of a valid row.
LOST_STD = 2 * VALID_STD
#: Fewest rotation of a stretch of valid rows [rad].
LEAST_TURN = 2 * np.pi


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


def trusted(angle: Array, std: Array, doubtful: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which rows have a reliable standard deviation below VALID_STD.

    The standard deviation is that of a linear model. Between rows of which little is known, the
    estimate can be at another solution, with a small standard deviation. Therefore the rows count
    only if the rotor turns once without such rows between them.
    """
    known = std < VALID_STD
    result = np.zeros(len(std), bool)
    for start, end in runs(np.asarray((std < LOST_STD) & ~doubtful)):
        rows = start + np.flatnonzero(known[start:end])
        if len(rows) and np.ptp(np.unwrap(angle[rows])) > LEAST_TURN:
            result[rows] = True
    return result


def smoothed_estimate(
    record: SmoothedRecord,
    inverter_voltage: float,
    inverter_std: float,
    calibration: Calibration,
) -> SmoothedEstimate:
    """Return the estimate of all rows of a record.

    Parameters
    ----------
    record : SmoothedRecord
    inverter_voltage, inverter_std : float
        Learnt loss of a phase and its standard deviation [V].
    calibration : Calibration
        Common scales of the voltages and of the currents.
    """
    row, stds = record.outputs, record.model.stds

    def scaled(name: str, scale: float, prior: float = np.inf) -> Array:
        return np.asarray(with_scale(row[f"{name}_std"], row[name], scale, prior))

    psi_prior = stds["psi_f"] if record.model.magnets else np.inf
    ones = np.ones(len(record.known))
    return SmoothedEstimate(
        flux=np.stack([row["flux_alpha"], row["flux_beta"]], axis=1),
        flux_std=np.stack(
            [
                scaled("flux_alpha", calibration.voltage),
                scaled("flux_beta", calibration.voltage),
            ],
            axis=1,
        ),
        psi_f=row["psi_f"],
        psi_f_std=scaled("psi_f", calibration.voltage, psi_prior),
        theta_e=row["theta_e"],
        theta_e_std=row["theta_e_std"],
        speed_e=row["speed_e"],
        speed_e_std=row["speed_e_std"],
        drift=np.stack([row["drift_alpha"], row["drift_beta"]], axis=1),
        drift_std=row["drift_std"],
        resistance=row["resistance"],
        resistance_std=scaled("resistance", calibration.ratio, stds["resistance"]),
        inverter_voltage=inverter_voltage * ones,
        inverter_voltage_std=inverter_std * ones,
        torque=row["torque"],
        torque_std=scaled("torque", calibration.ratio),
        innovation=row["innovation"],
        valid=record.known & trusted(row["theta_e"], row["theta_e_std"], row["doubtful"] > 0),
    )
