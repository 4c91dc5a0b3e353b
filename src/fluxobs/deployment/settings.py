"""Checks of export settings; messages give the nearest valid value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Integral

from ..errors import FluxobsError
from ..machines import Machine, RotatingMachine
from ..observers.unknowns import adapts, check_adapted
from .c_source import identifier
from .reserved import why_refused

#: Plausible periods of a current control [s]; a number outside is probably in another unit.
PERIODS = (1e-6, 1e-2)
#: Most steps per memory for which single precision stays within 1e-4 of the flux and 0.05°
#: (benchmarks/accuracy.py).
MOST_STEPS = 4000


def check_prefix(prefix: str) -> None:
    """Raise FluxobsError if C names cannot begin with this prefix."""
    if not isinstance(prefix, str):
        raise FluxobsError(f"prefix must be text, such as 'motor'; got {prefix!r}")
    reason = why_refused(prefix)
    if reason is not None:
        nearest = identifier(prefix)
        nearest = "motor" if why_refused(nearest) else nearest
        raise FluxobsError(f"prefix {prefix!r} cannot begin names in C: {reason}; use {nearest!r}")


def check_machine(
    machine: Machine, unknowns: tuple[str, ...], priors: Mapping[str, float]
) -> RotatingMachine:
    """Return the machine if the firmware supports it and can estimate these unknowns."""
    if not isinstance(machine, RotatingMachine):
        raise FluxobsError(
            f"kind {machine.kind}: the firmware's observer is for machines that turn; evaluate "
            f"logs of this machine with `fluxobs estimate`"
        )
    check_adapted(machine, unknowns, priors)
    if "current-bias" in unknowns:
        raise FluxobsError(
            f"unknowns {','.join(unknowns)}: the firmware's observers estimate the drift, which "
            f"includes the effect of a current bias; use drift"
        )
    if machine.inverter_voltage and not adapts(unknowns):
        raise FluxobsError(
            "inverter_voltage in the machine file: the observer for the drift alone does not "
            "compensate the inverter. Compensate the inverter in the drive and remove "
            "inverter_voltage from the file, or export with unknowns drift,inverter"
        )
    missing = ["psi_f"] if machine.magnet_flux is None else []
    missing += ["rated_current"] if machine.rated_current is None else []
    if missing:
        raise FluxobsError(
            f"the machine file lacks {' and '.join(missing)}: add a value that is right "
            f"within a factor of two"
        )
    return machine


def check_times(
    machine: RotatingMachine, sample_time: float, update_every: int, memory: float | None
) -> None:
    """Raise FluxobsError if sample time, steps and memory do not fit together."""
    if not 0 < sample_time < float("inf"):
        nearest = f"{-sample_time:g} s" if -1 < sample_time < 0 else "1e-4 s, 10 kHz,"
        raise FluxobsError(
            f"sample time {sample_time:g} s: must be the period of the current-control interrupt, "
            f"above 0; {nearest} would work"
        )
    if not PERIODS[0] <= sample_time <= PERIODS[1]:
        readings = {
            "µs": 1e-6 * sample_time,
            "ms": 1e-3 * sample_time,
            "Hz": 1 / sample_time,
            "kHz": 1e-3 / sample_time,
        }
        likely = [
            f"{sample_time:g} {unit} is {period:g} s"
            for unit, period in readings.items()
            if PERIODS[0] <= period <= 0.2 * PERIODS[1]
        ]
        raise FluxobsError(
            f"sample time {sample_time:g} s is not the period of a current control"
            + (f"; {', '.join(likely)}" if likely else "; give it in seconds, such as 1e-4")
        )
    if isinstance(update_every, bool) or not isinstance(update_every, Integral) or update_every < 1:
        raise FluxobsError(
            f"update_every {update_every!r}: must be a whole number, at least 1 (every interrupt)"
        )
    step = update_every * sample_time
    memory = machine.memory_for(step) if memory is None else memory
    shortest, longest = 10 * step, MOST_STEPS * step
    if not math.isfinite(memory):
        raise FluxobsError(f"memory {memory:g} s: must be finite, at most {longest:g} s")
    if memory > longest * (1 + 1e-9):
        every = math.ceil(memory / (MOST_STEPS * sample_time))
        raise FluxobsError(
            f"memory {memory:g} s: single precision allows {MOST_STEPS} steps in a memory, "
            f"{longest:g} s with a step every {step:g} s; use update_every {every}"
        )
    if not memory >= shortest * (1 - 1e-9):
        raise FluxobsError(
            f"memory {memory:g} s: must be at least ten steps, {shortest:g} s with a step every "
            f"{step:g} s"
        )
