"""Refuses settings that cannot work, and names the nearest that can."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Integral

from ..errors import FluxobsError
from ..machines import Machine, RotatingMachine
from ..observers.unknowns import adapts, check_adapted
from .c_source import identifier
from .reserved import why_refused

#: Plausible periods of a current control [s]; other numbers must be in another unit.
PERIODS = (1e-6, 1e-2)
#: Steps in a memory up to which single precision stays within 1e-4 of the flux and 0.05°
#: (benchmarks/accuracy.py).
MOST_STEPS = 4000


def check_prefix(prefix: str) -> None:
    """Raise FluxobsError if names in C cannot begin with this prefix."""
    if not isinstance(prefix, str):
        raise FluxobsError(f"prefix must be text, such as 'motor'; got {prefix!r}")
    why = why_refused(prefix)
    if why is not None:
        near = identifier(prefix)
        near = "motor" if why_refused(near) else near
        raise FluxobsError(f"prefix {prefix!r} cannot begin names in C: {why}; {near!r} can")


def check_machine(
    machine: Machine, unknowns: tuple[str, ...], priors: Mapping[str, float]
) -> RotatingMachine:
    """Return the machine if the firmware supports it and can find these unknowns."""
    if not isinstance(machine, RotatingMachine):
        raise FluxobsError(
            f"kind {machine.kind}: the firmware's observer is for machines that turn; logs of "
            f"this one can be evaluated with `fluxobs estimate`"
        )
    check_adapted(machine, unknowns, priors)
    if "current-bias" in unknowns:
        raise FluxobsError(
            f"unknowns {','.join(unknowns)}: the firmware's observers find the drift, which "
            f"includes the effect of a current bias; use drift"
        )
    if machine.inverter_voltage and not adapts(unknowns):
        raise FluxobsError(
            "inverter_voltage in the machine file: the observer for the drift alone leaves the "
            "inverter to the drive. Compensate it there and remove it from the file, or export "
            "with unknowns drift,inverter"
        )
    lacking = ["psi_f"] if machine.magnet_flux is None else []
    lacking += ["rated_current"] if machine.rated_current is None else []
    if lacking:
        raise FluxobsError(
            f"the machine file lacks {' and '.join(lacking)}: give a value that is right "
            f"within a factor of two"
        )
    return machine


def check_times(
    machine: RotatingMachine, sample_time: float, update_every: int, memory: float | None
) -> None:
    """Raise FluxobsError if memory and sample time do not fit each other."""
    if not 0 < sample_time < float("inf"):
        near = f"{-sample_time:g} s" if -1 < sample_time < 0 else "1e-4 s, 10 kHz,"
        raise FluxobsError(
            f"sample time {sample_time:g} s: it is the period of the current-control interrupt, "
            f"above 0; {near} would do"
        )
    if not PERIODS[0] <= sample_time <= PERIODS[1]:
        meant = {
            "µs": 1e-6 * sample_time,
            "ms": 1e-3 * sample_time,
            "Hz": 1 / sample_time,
            "kHz": 1e-3 / sample_time,
        }
        likely = [
            f"{sample_time:g} {unit} is {period:g} s"
            for unit, period in meant.items()
            if PERIODS[0] <= period <= 0.2 * PERIODS[1]
        ]
        raise FluxobsError(
            f"sample time {sample_time:g} s is not the period of a current control"
            + (f"; {', '.join(likely)}" if likely else "; give it in seconds, such as 1e-4")
        )
    if isinstance(update_every, bool) or not isinstance(update_every, Integral) or update_every < 1:
        raise FluxobsError(
            f"update_every {update_every!r}: a whole number, at least 1, a step every interrupt"
        )
    step = update_every * sample_time
    memory = machine.memory_for(step) if memory is None else memory
    least, most = 10 * step, MOST_STEPS * step
    if not math.isfinite(memory):
        raise FluxobsError(f"memory {memory:g} s: it must be finite, up to {most:g} s")
    if memory > most * (1 + 1e-9):
        every = math.ceil(memory / (MOST_STEPS * sample_time))
        raise FluxobsError(
            f"memory {memory:g} s: single precision is good for {MOST_STEPS} steps in a memory, "
            f"{most:g} s with a step every {step:g} s; with update_every {every} it would do"
        )
    if not memory >= least * (1 - 1e-9):
        raise FluxobsError(
            f"memory {memory:g} s: with a step every {step:g} s it must be at least ten steps, "
            f"{least:g} s"
        )
