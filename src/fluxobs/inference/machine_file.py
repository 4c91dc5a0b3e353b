"""What the engine takes from a machine file, with the priors of an ordinary drive."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..logs.scales import Scales
from ..machines import InductionMachine, RotatingMachine
from .posterior import MachineFile

#: Relative standard deviations (logarithms) of values that nobody states better: R_s, L and ψ_f,
#: all with heavy tails, R_R and L_M. Copper changes by 40 % per 100 K.
RESISTANCE_STD, INDUCTANCE_STD, MAGNET_STD, ROTOR_STD, MAGNETIZING_STD = 0.5, 0.1, 0.25, 0.3, 0.25
#: The same of a magnet flux that was guessed from the log.
GUESSED_MAGNET_STD = 0.5
#: Standard deviations of the lag of the voltages and of the delay of the currents [samples].
LAG_STD, DELAY_STD = 0.15, 0.2
#: Share of the turn of the voltage that it makes within a row: 0 if a row is a period of the
#: inverter, 1 if it is much longer, or if the voltage is sinusoidal.
ROTATION, ROTATION_STD = 0.5, 0.5
#: Change of the resistance over the log [1]; current of the iron loss and offset of the current
#: sensors as shares of the rated current; unequal gains of the sensors; harmonics of the flux.
HEAT_STD, IRON_SHARE, OFFSET_SHARE, GAIN_STD, HARMONICS = 0.05, 0.02, 0.015, 0.01, 0.015
#: A loss of the inverter that the machine file gives without a tolerance is right within this [1].
LOSS_STD = 0.3
#: The least inverter voltage, as a share of the log's voltage: its logarithm must be finite.
LEAST_LOSS = 1e-6


def machine_file(
    machine: RotatingMachine,
    scales: Scales,
    sample_time: float,
    flux_base: float,
    given: Mapping[str, float] | None = None,
) -> MachineFile:
    """Return the machine file of the engine.

    Parameters
    ----------
    machine : RotatingMachine
    scales : Scales
        Sizes of the log's signals; they replace a rated current that the machine file lacks.
    sample_time : float
        [s].
    flux_base : float
        Flux that usually turns with the rotor [Wb].
    given : mapping, optional
        Standard deviations that replace the defaults; see
        :data:`fluxobs.smoothing.assumptions.GIVEN`.
    """
    given = given or {}
    rated = machine.rated_current or scales.current
    cage = isinstance(machine, InductionMachine)
    psi = 0.0 if cage else machine.magnet_flux or (flux_base if machine.magnets else 0.0)
    guessed = machine.magnets and not cage and not machine.magnet_flux
    magnet_std = GUESSED_MAGNET_STD if guessed else MAGNET_STD
    saturates = machine.saturation is not None
    numbers = {
        "R": machine.R_s,
        "psi_f": psi,
        "guessed": float(guessed),
        "flux": flux_base,
        "rated_current": rated,
        "R_std": _relative(given.get("resistance", machine.R_s_std), machine.R_s, RESISTANCE_STD),
        "psi_std": _relative(given.get("psi_f", machine.magnet_flux_std), psi, magnet_std),
        "lag_std": given.get("lag", LAG_STD),
        "rotation": ROTATION,
        "rotation_std": ROTATION_STD,
        "delay_std": given.get("delay", DELAY_STD),
        "iron_std": given.get("iron_loss", IRON_SHARE) * rated / scales.voltage,
        "heat_std": HEAT_STD,
        "offset_std": given.get("offset", OFFSET_SHARE * rated),
        "gain_std": given.get("current_gain", GAIN_STD),
        "harmonics": given.get("harmonics", HARMONICS),
        "saturation_std": given.get("saturation", 0.0),
    }
    names = machine.inductance_names
    for n, axis in enumerate("dq"):
        name = names[min(n, len(names) - 1)]
        L = machine.L_dq[n]
        std = _relative(getattr(machine, f"{name}_std", None), L, INDUCTANCE_STD)
        numbers[f"L_{axis}"] = 1.0 if saturates else L
        numbers[f"L_{axis}_std"] = given.get(name, given.get(f"L_{axis}", std))
    if isinstance(machine, InductionMachine):
        numbers |= {
            "R_R": machine.R_R,
            "L_M": machine.L_M,
            "R_R_std": given.get("R_R", _relative(machine.R_R_std, machine.R_R, ROTOR_STD)),
            "L_M_std": given.get("L_M", MAGNETIZING_STD),
        }
    numbers |= _loss(machine, scales, given.get("inverter", machine.inverter_voltage_std))
    flux_map = machine.map_for(sample_time, flux_base) if saturates else None
    return MachineFile(numbers, None if flux_map is None else flux_map.core())


def _relative(std: float | None, value: float, usual: float) -> float:
    """Return a relative standard deviation; `usual` if nobody states one."""
    return usual if std is None or not value > 0 else std / value


def _loss(machine: RotatingMachine, scales: Scales, std: float | None) -> dict[str, float]:
    """Return the inverter's loss, whose logarithm is normal; nothing if it is not known."""
    voltage = machine.inverter_voltage or 0.0
    if std is None:
        return {"loss": voltage, "loss_std": LOSS_STD} if voltage > 0 else {}
    size = float(np.hypot(voltage, std))
    if not size > 0:
        return {"loss": LEAST_LOSS * scales.voltage}  # exactly none
    return {"loss": size, "loss_std": min(std / size, 1.0) if voltage > 0 else 1.0}
