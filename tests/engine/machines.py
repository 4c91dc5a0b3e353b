"""Machine files of the engine from those of the library."""

from __future__ import annotations

import ctypes

import numpy as np

from engine.likelihood import Complex
from fluxobs.inference.machine_file import machine_file as own_file
from fluxobs.inference.posterior import MAP_FIELDS, MachineFile
from fluxobs.logs.quality.detect import Detector
from fluxobs.logs.quality.marks import NO_MEASUREMENT
from fluxobs.logs.scales import Scales
from fluxobs.logs.time.aligned import Aligned
from fluxobs.machines.rotating import RotatingMachine

#: Errors that an ideal drive does not have.
ERRORS = ("delay_std", "iron_std", "heat_std", "offset_std", "gain_std")


class FluxMap(ctypes.Structure):
    """fo_map; see firmware/fluxobs_map.h."""

    _fields_ = (
        ("kind", ctypes.c_int),
        ("magnets", ctypes.c_bool),
        ("nodes_d", ctypes.c_int32),
        ("nodes_q", ctypes.c_int32),
        *((name, ctypes.c_double) for name in MAP_FIELDS),
        ("coefficients", ctypes.POINTER(ctypes.c_double)),
    )


def flux_map(machine: RotatingMachine, sample_time: float) -> FluxMap:
    """Return the flux map of a machine that saturates, for the likelihood."""
    core = machine_file(machine, sample_time, current=1.0).map
    assert core is not None
    table = np.ascontiguousarray(core["coefficients"], float)
    numbers = [float(core[name]) for name in MAP_FIELDS]
    pointer = table.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
    own = FluxMap(int(core["kind"]), core["magnets"], *table.shape[:2], *numbers, pointer)
    own.table = table  # as long as the map
    return own


def machine_file(
    machine: RotatingMachine,
    sample_time: float,
    lag: tuple[float, float] = (0.0, 0.1),
    current: float | None = None,
    voltage: float | None = None,
    true: dict[str, float] | None = None,
) -> MachineFile:
    """Return the file of a machine, with ordinary tolerances.

    Parameters
    ----------
    machine : RotatingMachine
    sample_time : float
        [s].
    lag : (float, float)
        That the voltages act later than the log says: mean and std [samples].
    current : float, optional
        Rated current [A], if the machine has none.
    voltage : float, optional
        Usual voltage [V] of a drive with errors of its sensors, iron loss and heat.
    true : dict, optional
        Factors on the values of the file.
    """
    factors = true or {}
    rated = machine.rated_current or current
    assert rated is not None
    flux = machine.flux_base(rated, machine.magnet_flux)
    assert flux is not None
    scales = Scales(rated, voltage or 1.0, 0.0, 0.0, 0.0)
    file = own_file(machine, scales, sample_time, flux)
    numbers = dict(file.numbers) | {"lag": lag[0], "lag_std": lag[1]}
    if voltage is None:
        numbers |= dict.fromkeys(ERRORS, 0.0)
    for name in ("R", "R_R", "L_M"):
        if name in numbers:
            numbers[name] *= factors.get(name, 1.0)
    for name in ("psi_f", "flux"):
        numbers[name] *= factors.get("psi", 1.0)
    for name in ("L_d", "L_q"):
        scale = factors.get(name, factors.get("L_s", factors.get("L_sigma", 1.0)))
        numbers[name] *= scale
    return MachineFile(numbers, file.map)


def measured(voltage: Complex, current: Complex, sample_time: float) -> tuple[Complex, Complex]:
    """Return voltage and current, NaN where the marks of the log say that they are not these.

    Nor are they in a row that repeats the one before it bit by bit, zeros included: a logger that
    repeats rows or a drive that counts as stopped.
    """
    i, u = (np.stack([x.real, x.imag], axis=1) for x in (current, voltage))
    sizes = [float(np.nanpercentile(np.abs(x), 95)) for x in (current, voltage)]
    rows = Aligned(sample_time * np.arange(len(i)), i, u, None)
    marks = Detector(*sizes, 0.0).marks(rows)
    same = np.zeros(len(current), bool)
    same[1:] = (np.diff(current) == 0) & (np.diff(voltage) == 0)
    known = np.where(same | (marks & NO_MEASUREMENT > 0), np.nan, current)
    return np.where(same, np.nan, voltage), known
