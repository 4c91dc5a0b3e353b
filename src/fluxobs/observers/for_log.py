"""Before the first row: the log opened for its machine, the sizes of its signals, the observer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import FluxobsError, MachineError, ObserverError, RecordError
from ..logs.formats import BATCH
from ..logs.log import Log
from ..logs.scales import Scales, excerpts, measure_scales
from ..machines import Machine, RotatingMachine
from ..machines.model.held import Held
from ..machines.model.immersion import Immersion, Unknown
from . import AdaptiveObserver, ImmersionObserver, LeastSquaresObserver
from .adaptive import RESISTANCE_MOST
from .immersed import describe_invisible
from .plain import MODEL_ERROR
from .unknowns import adapts, check_adapted

#: A drift caused by an offset of this share of the voltage is ordinary: usual converters are off by
#: 0.2 to 2 % of their range, and drives use a fraction of it (benchmarks/measured.py).
VOLTAGE_OFFSET = 0.01
#: A current bias of this share of the rated current is ordinary, for the same reason.
CURRENT_OFFSET = 0.02
#: No sensor is better than this share of the rated current: half a step of a 12-bit converter.
LEAST_NOISE = 1e-4
#: Magnet fluxes to try if none is given, over L times the rated current: two octaves apart, since
#: an estimate does not depend on a scale that is right within a factor of two.
GUESSES = (0.5, 2.0, 8.0, 32.0)
#: Rows per batch of the immersed observer: half a second of work, so that progress shows.
IMMERSED_BATCH = 2000

AnyObserver = LeastSquaresObserver | AdaptiveObserver | ImmersionObserver


@dataclass(frozen=True, eq=False)
class Prepared:
    """What a run needs.

    Attributes
    ----------
    log : Log
        Less the inverter's error if the observer does not model it.
    machine : Machine
    observer : AnyObserver
    scales : Scales
    batch : int
        Rows processed at once.
    """

    log: Log
    machine: Machine
    observer: AnyObserver
    scales: Scales
    batch: int = BATCH

    @property
    def plain_outputs(self) -> bool:
        """Whether a compiled observer runs, whose estimates have an angle and its deviation."""
        return not isinstance(self.observer, ImmersionObserver)


def prepare(
    log: Log,
    machine: Machine,
    unknowns: tuple[str, ...],
    memory: float | None,
    priors: Mapping[str, float],
    scales: Scales | None = None,
) -> Prepared:
    """Choose the observer for these unknowns, and all its settings.

    Parameters
    ----------
    log, machine, unknowns, memory, priors
        See :func:`fluxobs.estimate`.
    scales : Scales, optional
        Sizes of the log's signals; default: measured.

    Raises
    ------
    FluxobsError
        The unknowns cannot be told apart on this machine, or a setting cannot work.
    """
    check_adapted(machine, unknowns, priors)
    if isinstance(machine, RotatingMachine) and adapts(unknowns):
        plain, scales = plain_for(log, machine, memory, scales)
        adaptive = _adaptive_observer(plain, machine, scales, unknowns, priors, memory, log.held)
        return Prepared(log, machine, adaptive, scales)
    log = log.less_inverter(machine.inverter)
    if isinstance(machine, RotatingMachine) and unknowns == ("drift",):
        return Prepared(log, machine, *plain_for(log, machine, memory, scales))
    observer, scales = _immersed_for(log, machine, unknowns, memory, scales)
    return Prepared(log, machine, observer, scales, IMMERSED_BATCH)


def plain_for(
    log: Log, machine: RotatingMachine, memory: float | None = None, scales: Scales | None = None
) -> tuple[LeastSquaresObserver, Scales]:
    """First pass over the log, and the plain observer chosen from machine and log."""
    _check_memory(log, machine, memory)
    scales = measure_scales(log) if scales is None else scales
    psi_f = None
    if machine.flux_base(1.0) is None:
        psi_f = guess_psi_f(log, machine, scales, memory)
    return plain_observer(log, machine, scales, memory, psi_f), scales


def usual_speed(machine: RotatingMachine, scales: Scales, psi_f: float | None) -> float:
    """Electrical speed of a log [rad/s]: of its currents, but no more than its voltages allow."""
    base = machine.flux_base(scales.current, psi_f)
    return min(scales.current_speed, scales.voltage / base) if base else scales.current_speed


def plain_observer(
    log: Log,
    machine: RotatingMachine,
    scales: Scales,
    memory: float | None,
    psi_f: float | None = None,
) -> LeastSquaresObserver:
    """Plain observer for a log; `scales` supplies what the machine does not."""
    rated = machine.rated_current or scales.current
    speed_e = usual_speed(machine, scales, psi_f)
    if memory is None:
        usual = machine.memory_for(log.sample_time, speed_e)
        memory = max(_in_short(usual), 10 * log.sample_time)
    chosen = LeastSquaresObserver.for_machine(
        machine,
        sample_time=log.sample_time,
        memory=memory,
        speed_e=speed_e,
        psi_f=psi_f,
        rated_current=rated,
        current_noise=_in_short(max(scales.current_noise, LEAST_NOISE * rated)),
        held=log.held,
    )
    drift_prior = max(chosen.drift_prior, VOLTAGE_OFFSET * scales.voltage)
    return replace(chosen, drift_prior=_in_short(drift_prior))


def _in_short(measured: float) -> float:
    """A setting to three digits: the command that exports the observer repeats it exactly."""
    return float(f"{measured:.3g}")


def guess_psi_f(log: Log, machine: RotatingMachine, scales: Scales, memory: float | None) -> float:
    """Magnet flux [Wb] for a machine file without one: what the observer itself returns."""
    longest = max(excerpts(log), key=lambda part: len(part.t))
    base = machine.position_inductance * (machine.rated_current or scales.current)
    best, most = base, 0
    for guess in base * np.array(GUESSES):
        observer = plain_observer(log, machine, scales, memory, float(guess))
        found = observer.run(longest.voltage, longest.current)
        if (count := int(found.valid.sum())) > most:
            best, most = float(np.median(found.psi_f[found.valid])), count
    return best


def _check_memory(log: Log, machine: Machine, memory: float | None) -> float:
    """The memory, the machine's own by default, if it spans at least ten rows."""
    least = 10 * log.sample_time
    if memory is not None and not memory >= least:
        raise ObserverError(f"memory {memory:g} s is too short: at least ten samples, {least:g} s")
    chosen = machine.memory if memory is None else memory
    if chosen < least:
        raise RecordError(
            f"{log.path}: a row every {log.sample_time:.6g} s is too slow for a memory of "
            f"{chosen:g} s, which needs at least ten rows. Give a longer memory; or is t in ms? "
            f"Then give --scale t=1e-3"
        )
    return chosen


def _adaptive_observer(
    plain: LeastSquaresObserver,
    machine: RotatingMachine,
    scales: Scales,
    unknowns: tuple[str, ...],
    priors: Mapping[str, float],
    memory: float | None,
    held: Held,
) -> AdaptiveObserver:
    """The adaptive observer around one that was chosen for a log."""
    for name, most, words in (
        ("resistance", RESISTANCE_MOST * machine.R_s, f"{RESISTANCE_MOST:g} times R_s"),
        ("inverter", scales.voltage, "the voltage in this log"),
        ("psi_f", plain.flux_base, "the magnet flux itself"),
    ):
        if priors.get(name, 0.0) > most > 0:
            raise ObserverError(
                f"prior {name}={priors[name]:g}: a standard deviation, in SI units; this is more "
                f"than {words}, {most:.3g}"
            )
    return AdaptiveObserver.for_machine(
        machine,
        sample_time=plain.sample_time,
        unknowns=unknowns,
        memory=plain.memory,
        speed_e=usual_speed(machine, scales, plain.flux_base),
        psi_f=plain.flux_base,
        rated_current=machine.rated_current or scales.current,
        current_noise=plain.current_noise,
        drift_prior=plain.drift_prior,
        held=held,
        psi_f_std=priors.get("psi_f"),
        resistance_std=priors.get("resistance"),
        inverter_std=priors.get("inverter"),
        asymmetry_std=priors.get("asymmetry"),
        dc_link=_in_short(np.sqrt(3) * scales.voltage),  # at least
    )


def _immersed_for(
    log: Log,
    machine: Machine,
    unknowns: Sequence[Any],
    memory: float | None,
    scales: Scales | None,
) -> tuple[ImmersionObserver, Scales]:
    """First pass over the log, and the immersed observer chosen from machine and log."""
    _check_told_apart(machine, unknowns)
    memory = _check_memory(log, machine, memory)
    scales = measure_scales(log) if scales is None else scales
    rated = machine.rated_current or scales.current
    base = machine.flux_base(rated)
    if base is None:
        raise MachineError(
            f"psi_f is missing in the machine ({machine.kind}); a rough value will do"
        )
    noise = max(scales.current_noise, LEAST_NOISE * rated)
    drift = VOLTAGE_OFFSET * scales.voltage * np.abs(machine.B).max()
    size = np.abs(machine.constraint.Q1).max() * base**2
    residual = float(np.hypot(machine.constraint_noise(base, noise), MODEL_ERROR * size))
    bias = CURRENT_OFFSET * rated
    if "current-bias" in unknowns:
        drift = max(drift, bias * np.abs(machine.R).max())
    observer = ImmersionObserver(
        Immersion((machine.constraint,), tuple(unknowns), machine.R),
        machine.R,
        machine.B,
        log.sample_time,
        memory,
        flux_base=np.full(2, base),
        constraint_noise=np.array([residual]),
        drift_prior=np.full(2, drift),
        current_bias_prior=np.full(2, bias),
        current_noise=noise,
        voltage_noise=scales.voltage_noise if machine.measured_voltage else 0.0,
    )
    return observer, scales


def _check_told_apart(machine: Machine, unknowns: Sequence[Unknown]) -> None:
    """Raise FluxobsError, naming what is hidden, if the relation cannot tell these apart."""
    immersion = Immersion((machine.constraint,), tuple(unknowns), machine.R)
    invisible = immersion.invisible()
    if invisible.shape[1] == 0:
        return
    advice = "Run with --unknowns drift"
    if isinstance(machine, RotatingMachine):
        advice += (
            ": the flux returned is then off by L times the current bias, but λ - L i, hence "
            "position and speed, is free of it"
        )
    raise FluxobsError(
        f"{' and '.join(unknowns)} cannot both be found for kind {machine.kind}: "
        f"{describe_invisible(invisible)}. {advice}"
    )
