"""Choose the observer and its settings for a log, from the sizes of its signals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import FluxobsError, MachineError, ObserverError, RecordError
from ..logs.formats import BATCH
from ..logs.log import Log
from ..logs.quality.detect import Detector
from ..logs.quality.floating import with_back_emf
from ..logs.scales import Scales, excerpts, measure_scales
from ..logs.time.aligned import Aligned, between
from ..machines import Machine, RotatingMachine
from ..machines.model.immersion import Immersion, Unknown
from . import AdaptiveObserver, ImmersionObserver, LeastSquaresObserver
from .adaptive import MAX_RESISTANCE_SHARE, Priors
from .immersed import describe_invisible
from .plain import MODEL_ERROR
from .unknowns import adapts, check_adapted

#: Ordinary voltage offset, as a share of the voltage. Usual converters have offsets of 0.2 to 2 %
#: of their range, and drives use a fraction of that range (benchmarks/measured.py).
VOLTAGE_OFFSET = 0.01
#: Ordinary current bias, as a share of the rated current; for the reason, see VOLTAGE_OFFSET.
CURRENT_OFFSET = 0.02
#: Least current noise, as a share of the rated current: half a step of a 12-bit converter.
LEAST_NOISE = 1e-4
#: Magnet fluxes to try if psi_f is missing, as multiples of L times the rated current. They are two
#: octaves apart: an error of the scale within a factor of two does not affect estimates.
GUESSES = (0.5, 2.0, 8.0, 32.0)
#: Rows per batch of the immersed observer: a batch takes half a second, so that progress shows.
IMMERSED_BATCH = 2000

AnyObserver = LeastSquaresObserver | AdaptiveObserver | ImmersionObserver


@dataclass(frozen=True, eq=False)
class Prepared:
    """Log, observer and settings of a run.

    Attributes
    ----------
    log : Log
        Log without the inverter's error, if the observer does not model that error.
    machine : Machine
    observer : AnyObserver
    scales : Scales
    batch : int
        Rows processed at once.
    samples : Aligned, optional
        All rows of the log, if they are in memory.
    """

    log: Log
    machine: Machine
    observer: AnyObserver
    scales: Scales
    batch: int = BATCH
    samples: Aligned | None = None

    def aligned(self, first: int | None = None, last: int | None = None) -> Iterator[Aligned]:
        """Yield rows first … last - 1 of the log in batches, with marks; by default all rows."""
        if not isinstance(self.machine, RotatingMachine):
            yield from self._batches(first, last)
            return
        scales = self.scales
        usual = max(scales.current, self.machine.rated_current or 0.0)
        detector = Detector(usual, scales.voltage, scales.current_noise)
        for batch in self._batches(first, last):
            yield with_back_emf(detector.marked(batch), self.machine, self.log.sample_time)

    def _batches(self, first: int | None, last: int | None) -> Iterator[Aligned]:
        if self.samples is None:
            yield from self.log.aligned(first, last, self.batch)
            return
        begin = 0 if first is None else first - self.log.first
        end = len(self.samples.t) if last is None else last - self.log.first
        for start in range(begin, end, self.batch):
            yield between(self.samples, start, min(start + self.batch, end))

    @property
    def plain_outputs(self) -> bool:
        """Whether the observer is a compiled one: its estimates include an angle and a
        deviation."""
        return not isinstance(self.observer, ImmersionObserver)


def prepare(
    log: Log,
    machine: Machine,
    unknowns: tuple[str, ...],
    memory: float | None,
    priors: Mapping[str, float],
    scales: Scales | None = None,
) -> Prepared:
    """Choose the observer for these unknowns and all its settings.

    Parameters
    ----------
    log, machine, unknowns, memory, priors
        See :func:`fluxobs.estimate`.
    scales : Scales, optional
        Sizes of the log's signals; by default they are measured.

    Raises
    ------
    FluxobsError
        The unknowns are not identifiable together on this machine, or a setting is impossible.
    """
    check_adapted(machine, unknowns, priors)
    if isinstance(machine, RotatingMachine) and adapts(unknowns):
        plain, scales = plain_for(log, machine, memory, scales)
        adaptive = _adaptive_observer(plain, machine, scales, unknowns, priors)
        return Prepared(log, machine, adaptive, scales)
    log = log.less_inverter(machine.inverter)
    if isinstance(machine, RotatingMachine) and unknowns == ("drift",):
        return Prepared(log, machine, *plain_for(log, machine, memory, scales))
    observer, scales = _immersed_for(log, machine, unknowns, memory, scales)
    return Prepared(log, machine, observer, scales, IMMERSED_BATCH)


def plain_for(
    log: Log, machine: RotatingMachine, memory: float | None = None, scales: Scales | None = None
) -> tuple[LeastSquaresObserver, Scales]:
    """Measure the log's signals and choose the plain observer from machine and log."""
    _check_memory(log, machine, memory)
    scales = measure_scales(log) if scales is None else scales
    psi_f = None
    if machine.flux_base(1.0) is None:
        psi_f = guess_psi_f(log, machine, scales, memory)
    return plain_observer(log, machine, scales, memory, psi_f), scales


def usual_speed(machine: RotatingMachine, scales: Scales, psi_f: float | None) -> float:
    """Return the electrical speed of a log [rad/s]: that of the currents, limited by the
    voltages."""
    base = machine.flux_base(scales.current, psi_f)
    return min(scales.current_speed, scales.voltage / base) if base else scales.current_speed


def plain_observer(
    log: Log,
    machine: RotatingMachine,
    scales: Scales,
    memory: float | None,
    psi_f: float | None = None,
) -> LeastSquaresObserver:
    """Return the plain observer for a log; `scales` replace values missing in the machine."""
    rated = machine.rated_current or scales.current
    speed_e = usual_speed(machine, scales, psi_f)
    if memory is None:
        usual = machine.memory_for(log.sample_time, speed_e)
        memory = max(_rounded(usual), 10 * log.sample_time)
    chosen = LeastSquaresObserver.for_machine(
        machine,
        sample_time=log.sample_time,
        memory=memory,
        speed_e=speed_e,
        psi_f=psi_f,
        rated_current=rated,
        current_noise=_rounded(max(scales.current_noise, LEAST_NOISE * rated)),
        held=log.held,
    )
    drift_prior = max(chosen.drift_prior, VOLTAGE_OFFSET * scales.voltage)
    return replace(chosen, drift_prior=_rounded(drift_prior))


def _rounded(measured: float) -> float:
    """Round a setting to three digits, so that the export command can repeat it exactly."""
    return float(f"{measured:.3g}")


def guess_psi_f(log: Log, machine: RotatingMachine, scales: Scales, memory: float | None) -> float:
    """Estimate the magnet flux [Wb] by the plain observer if the machine file has no psi_f."""
    longest = max(excerpts(log), key=lambda excerpt: len(excerpt.t))
    base = machine.position_inductance * (machine.rated_current or scales.current)
    best_psi_f, best_count = base, 0
    for guess in base * np.array(GUESSES):
        observer = plain_observer(log, machine, scales, memory, float(guess))
        estimates = observer.run(longest.voltage, longest.current)
        if (count := int(estimates.valid.sum())) > best_count:
            best_psi_f, best_count = float(np.median(estimates.psi_f[estimates.valid])), count
    return best_psi_f


def _check_memory(log: Log, machine: Machine, memory: float | None) -> float:
    """Return the memory, by default the machine's; raise if it holds fewer than ten rows."""
    shortest = 10 * log.sample_time
    if memory is not None and not memory >= shortest:
        raise ObserverError(
            f"memory {memory:g} s is too short: give at least ten samples, {shortest:g} s"
        )
    chosen = machine.memory if memory is None else memory
    if chosen < shortest:
        raise RecordError(
            f"{log.path}: a row every {log.sample_time:.6g} s is too slow for a memory of "
            f"{chosen:g} s, which needs at least ten rows. Give a longer memory or, if t is "
            f"in ms, --scale t=1e-3"
        )
    return chosen


def _adaptive_observer(
    plain: LeastSquaresObserver,
    machine: RotatingMachine,
    scales: Scales,
    unknowns: tuple[str, ...],
    priors: Mapping[str, float],
) -> AdaptiveObserver:
    """Return the adaptive observer around the plain observer chosen for a log."""
    for name, largest, limit in (
        ("resistance", MAX_RESISTANCE_SHARE * machine.R_s, f"{MAX_RESISTANCE_SHARE:g} times R_s"),
        ("inverter", scales.voltage, "the voltage in this log"),
        ("psi_f", plain.flux_base, "the magnet flux itself"),
    ):
        if priors.get(name, 0.0) > largest > 0:
            raise ObserverError(
                f"prior {name}={priors[name]:g} is more than {limit}, {largest:.3g}: give a "
                f"standard deviation in SI units"
            )
    return AdaptiveObserver.around(
        plain,
        machine,
        machine.rated_current or scales.current,
        unknowns=unknowns,
        priors=Priors(**priors),
        dc_link=_rounded(np.sqrt(3) * scales.voltage),  # a lower limit of the DC link
    )


def _immersed_for(
    log: Log,
    machine: Machine,
    unknowns: Sequence[Any],
    memory: float | None,
    scales: Scales | None,
) -> tuple[ImmersionObserver, Scales]:
    """Measure the log's signals and choose the immersed observer from machine and log."""
    _check_identifiable(machine, unknowns)
    memory = _check_memory(log, machine, memory)
    scales = measure_scales(log) if scales is None else scales
    rated = machine.rated_current or scales.current
    base = machine.flux_base(rated)
    if base is None:
        raise MachineError(
            f"psi_f is missing in the machine ({machine.kind}); a rough value is enough"
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


def _check_identifiable(machine: Machine, unknowns: Sequence[Unknown]) -> None:
    """Raise FluxobsError, with the hidden offsets, if the unknowns are not identifiable
    together."""
    immersion = Immersion((machine.constraint,), tuple(unknowns), machine.R)
    invisible = immersion.invisible()
    if invisible.shape[1] == 0:
        return
    advice = "Run with --unknowns drift"
    if isinstance(machine, RotatingMachine):
        advice += (
            ": the flux then has an error of L times the current bias, but λ - L i, position "
            "and speed have no error"
        )
    raise FluxobsError(
        f"{' and '.join(unknowns)} cannot both be estimated for kind {machine.kind}: "
        f"{describe_invisible(invisible)}. {advice}"
    )
