"""Run all observers on one record, with recommended gains and with the best gains of a grid."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..core.arrays import Array
from ..errors import FluxobsError, RecordError, UsageError
from ..logs.for_machine import open_for
from ..logs.log import Log
from ..logs.quality.noise import injected, white_noise
from ..logs.read import Source
from ..machines import MachineSource, RotatingMachine, as_machine, rotating
from ..observers import Observer
from ..observers.for_log import LEAST_NOISE, VOLTAGE_OFFSET
from ..presentation.estimate import estimate
from ..presentation.result import Result
from ..simulation.drive.simulate import stack
from ..simulation.drive.vectors import vector
from .bound import position_bound
from .cages import entries_for
from .catalogue import Entry, Gains, Setting
from .scenarios import SCENARIOS, Scenario, believed_machine, run_scenario
from .scoring import Score, Truth, score, scored_error, true_speed

if TYPE_CHECKING:
    from typing import Unpack

    from ..logs.meaning.options import ReadOptions

#: Number of gain sets that each observer runs at once; equal for comparable run times.
LANES = 24
#: The observers of `fluxobs estimate`: they learn the drive's parameters from the record.
WHOLE_LOG, ADAPTIVE = "whole log", "adaptive"
#: Suffix that names the least squares' tracked angle.
TRACKED = ", tracked"


@dataclass(frozen=True, eq=False)
class ObserverResult:
    """Result of one observer on one record.

    Attributes
    ----------
    recommended, tuned : Score
        Scores with the gains of the literature, and with the gains of smallest rms position error.
    recommended_gains, gains : dict
        Gains of the literature; tuned gains.
    error : (rows,) ndarray
        Position error with the tuned gains [rad].
    time : float
        Run time per sample [s], compiled, in a batch of 24.
    """

    name: str
    recommended: Score
    tuned: Score
    recommended_gains: Gains
    gains: Gains
    error: Array
    time: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """A record, and the results of all observers on it.

    Attributes
    ----------
    bound : float or None
        Rms of the Cramér–Rao bound over the scored rows [rad]; None without current noise, for
        salient machines, with wrong parameters, and for logs.
    limit : str
        Phrase that names the limitation of the least squares on this record, besides noise.
    """

    title: str
    about: str
    setting: Setting
    truth: Truth
    bound: float | None
    results: tuple[ObserverResult, ...]
    limit: str = ""

    @property
    def psi(self) -> float:
        """Magnitude of the machine's flux [Wb]."""
        return self.setting.voltage / self.setting.speed_e

    @property
    def learnt(self) -> list[ObserverResult]:
        """Results of the observers of `fluxobs estimate`, if they ran."""
        return [result for result in self.results if result.name in (WHOLE_LOG, ADAPTIVE)]

    @property
    def ranked(self) -> list[ObserverResult]:
        """Results of the observers of the catalogue, the smallest tuned rms error first."""
        learnt = self.learnt
        others = [result for result in self.results if result not in learnt]
        return sorted(others, key=lambda result: result.tuned.rms)

    def result(self, name: str) -> ObserverResult:
        return next(result for result in self.results if result.name == name)

    @property
    def best(self) -> ObserverResult:
        """Result with the smallest tuned rms position error, of the observers of the catalogue."""
        return self.ranked[0]


class _Outputs(NamedTuple):
    """Estimates of an observer, JAX or NumPy arrays of leading shape (lanes, rows)."""

    theta_e: Any
    tracked: Any
    speed_e: Any
    flux: Any
    valid: Any


def _run_lane(observer: Observer[Any, Any], voltage: jax.Array, current: jax.Array) -> _Outputs:
    def body(state: Any, row: tuple[jax.Array, jax.Array]) -> tuple[Any, _Outputs]:
        state, estimate = observer.step(state, *row)
        angles = estimate.theta_e, estimate.theta_e_tracked
        return state, _Outputs(*angles, estimate.speed_e, vector(estimate.flux), estimate.valid)

    return jax.lax.scan(body, observer.init(), (voltage, current))[1]


@eqx.filter_jit
def _run_lanes(observers: Any, voltage: jax.Array, current: jax.Array) -> _Outputs:
    return jax.vmap(_run_lane, in_axes=(0, None, None))(observers, voltage, current)


def _compile(observers: Any, voltage: jax.Array, current: jax.Array) -> Any:
    run_lanes: Any = _run_lanes
    return run_lanes.lower(observers, voltage, current).compile()


def hold_last(samples: Array) -> Array:
    """Replace missing samples by the last finite one, or by zero before the first."""
    finite = np.isfinite(samples).all(axis=1)
    last_finite = np.maximum.accumulate(np.where(finite, np.arange(len(samples)), -1))
    return np.where(last_finite[:, None] >= 0, samples[last_finite], 0.0)


def setting_for(
    sample_time: float, voltage: Array, current: Array, machine: RotatingMachine, speed_e: float
) -> Setting:
    """Return the setting of a record, derived as `fluxobs estimate` derives it from a log."""
    i = current[np.isfinite(current).all(axis=1)]
    u = voltage[np.isfinite(voltage).all(axis=1)]
    rated_current = machine.rated_current or float(np.percentile(np.hypot(*i.T), 95))
    psi = machine.flux_base(rated_current)
    if psi is None:
        raise FluxobsError(
            f"psi_f is missing in the {machine.kind}; most observers need the magnet flux"
        )
    return Setting(
        machine,
        sample_time,
        speed_e,
        rated_current,
        speed_e * psi,
        max(white_noise(current), LEAST_NOISE * rated_current),
        VOLTAGE_OFFSET * float(np.percentile(np.hypot(*u.T), 95)),
        hold_last(voltage),
        hold_last(current),
    )


def compare_record(
    title: str,
    about: str,
    voltage: Array,
    current: Array,
    setting: Setting,
    truth: Truth,
    bound: float | None = None,
    limit: str = "",
    entries: Sequence[Entry] | None = None,
    progress: Callable[[str], Any] = lambda name: None,
) -> Comparison:
    """Run and score all observers on a record.

    `voltage` and `current` have the shape (rows, 2). The voltage of row k is the mean over the
    interval that ends at row k, NaN where missing.
    """
    injection = bool(injected(setting.current_rows, setting.current).any())
    selected = entries_for(setting.machine, injection) if entries is None else entries
    measured = jnp.asarray(voltage), jnp.asarray(current)
    filled = jnp.asarray(setting.mean_voltage), jnp.asarray(setting.current_rows)

    def prepare(entry: Entry) -> tuple[Entry, list[Gains], Any, Any, Any]:
        gains = list(entry.candidates(setting))
        instances = [entry.build(setting, gain) for gain in gains]
        observers = stack(instances + instances[:1] * (LANES - len(instances)))
        signals = measured if entry.least_squares else filled
        return entry, gains, observers, signals, _compile(observers, *signals)

    results: list[ObserverResult] = []
    with ThreadPoolExecutor(2) as pool:
        for entry, gains, observers, signals, compiled in list(pool.map(prepare, selected)):
            progress(entry.name)
            started = time.perf_counter()
            outputs = jax.tree.map(np.asarray, compiled(observers, *signals))
            seconds = (time.perf_counter() - started) / LANES / len(current)
            raw_angle, tracked = outputs.theta_e, outputs.tracked
            if entry.least_squares:
                results.append(_score_best(entry.name, gains, outputs, [raw_angle], truth, seconds))
                name = entry.name + TRACKED
                results.append(_score_best(name, gains, outputs, [tracked], truth, seconds))
            else:
                angles = [raw_angle, tracked]
                results.append(_score_best(entry.name, gains, outputs, angles, truth, seconds))
    return Comparison(title, about, setting, truth, bound, tuple(results), limit)


def _score_best(
    name: str,
    gains: list[Gains],
    outputs: _Outputs,
    angles: list[Any],
    truth: Truth,
    seconds: float,
) -> ObserverResult:
    """Score the first angle with the first gains, and the best of all angles and gains."""
    choices = [(angle, k) for angle in angles for k in range(len(gains))]
    scores = [
        score(angle[k], outputs.speed_e[k], outputs.flux[k], truth, outputs.valid[k])
        for angle, k in choices
    ]
    best = int(np.argmin([s.rms for s in scores]))
    angle, k = choices[best]
    error = scored_error(angle[k], truth)
    return ObserverResult(name, scores[0], scores[best], gains[0], gains[k], error, seconds)


def _estimated(estimates: Result, truth: Truth, name: str, seconds: float) -> ObserverResult:
    """Score the estimates of `fluxobs estimate`."""
    theta, flux = estimates["theta_e"], estimates["flux_alpha"] + 1j * estimates["flux_beta"]
    scores = score(theta, estimates["speed_e"], flux, truth, estimates["valid"])
    error = np.where(estimates["valid"], scored_error(theta, truth), np.nan)
    return ObserverResult(name, scores, scores, {}, {}, error, seconds / len(theta))


def with_estimates(
    comparison: Comparison,
    log: Source,
    machine: RotatingMachine,
    whole: tuple[Result, float] | None = None,
) -> Comparison:
    """Add the observers of `fluxobs estimate` to a comparison.

    Parameters
    ----------
    comparison : Comparison
    log : Log or Record
    machine : RotatingMachine
    whole : (Result, float), optional
        The estimates of the whole log and their time [s], if they are known.
    """
    whole, adaptive = whole or _timed(log, machine), _timed(log, machine, causal=True)
    results = (
        _estimated(estimates, comparison.truth, name, seconds)
        for name, (estimates, seconds) in ((WHOLE_LOG, whole), (ADAPTIVE, adaptive))
    )
    return replace(comparison, results=(*results, *comparison.results))


def _timed(log: Source, machine: RotatingMachine, causal: bool = False) -> tuple[Result, float]:
    """Return the estimates of a log and the time that they took [s]."""
    began = time.perf_counter()
    estimates = estimate(log, machine, causal=causal)
    return estimates, time.perf_counter() - began


def compare(
    log: Source,
    machine: MachineSource | None = None,
    *,
    seed: int = 0,
    settle: float = 0.2,
    progress: Callable[[str], Any] = lambda name: None,
    **layout: Unpack[ReadOptions],
) -> Comparison:
    """Run all observers of the catalogue on a log or a scenario, and score them.

    Each observer runs with its usual gains, and with the best gains of a grid for this record.
    Needs the extra "design" (JAX).

    Parameters
    ----------
    log : str, or as for :func:`fluxobs.read_log`
        The name of a scenario, or a log with a true angle.
    machine : Machine, path, name of a shipped machine, or mapping of a machine file
        A scenario needs the name of a shipped machine; default pmsm-2kw2.
    seed : int
        Seed of a scenario's sensor noise.
    settle : float
        Initial time of a log [s], in which observers settle and are not scored.
    progress : callable
        Called with the name of each observer as it runs.
    layout : optional
        As for :func:`fluxobs.read_log`.

    Raises
    ------
    FluxobsError
        `log` is neither a scenario nor a log, or the log has no true angle.
    """
    if isinstance(log, str) and log in SCENARIOS:
        name = "pmsm-2kw2" if machine is None else machine
        if not isinstance(name, str | Path):
            raise UsageError(f"scenario {log!r}: give the name of a shipped machine")
        return compare_scenario(SCENARIOS[log], str(name), seed, progress=progress)
    check_comparable(log, machine)
    assert machine is not None
    rotating_machine = rotating(as_machine(machine), "the comparison")
    opened = open_for(log, rotating_machine, **layout)
    return compare_log(
        opened.less_inverter(rotating_machine.inverter), rotating_machine, settle, progress=progress
    )


def check_comparable(log: Source, machine: MachineSource | None) -> None:
    """Raise FluxobsError unless it is a scenario, or a log with its machine."""
    if isinstance(log, str | Path) and str(log) not in SCENARIOS:
        if not Path(log).exists():
            raise FluxobsError(
                f"{str(log)!r} is neither a file nor a scenario; `fluxobs compare list` "
                f"lists the scenarios"
            )
        if machine is None:
            raise FluxobsError(f"a log ({log}) needs a machine: give --machine")
    elif machine is None and not isinstance(log, str):
        raise FluxobsError("a log needs a machine: give machine")


def compare_scenario(
    scenario: Scenario,
    machine_name: str,
    seed: int = 0,
    entries: Sequence[Entry] | None = None,
    progress: Callable[[str], Any] = lambda name: None,
) -> Comparison:
    """Simulate a scenario, and compare the observers on its record."""
    run, machine, rating = run_scenario(scenario, machine_name, seed)
    record = run.record()
    believed = believed_machine(machine, scenario.believed)
    voltage, current = record.interval_voltage(), record.current
    setting = setting_for(record.sample_time, voltage, current, believed, rating.speed_e)
    truth = Truth(
        run.t,
        np.asarray(run.trace.theta_e),
        true_speed(machine, run.trace.theta_e, run.trace.speed, run.sample_time),
        np.asarray(run.trace.flux),
        scenario.score_from,
        machine,
    )
    # The bound holds for a machine with one inductance and correct parameters.
    bounded = scenario.noise > 0 and machine.saliency == 0.0 and not scenario.believed
    bound = _bound(scenario, machine, setting, run.trace) if bounded else None
    about = scenario.about + "".join(f"; {event}" for event in run.events)
    comparison = compare_record(
        scenario.name,
        about,
        voltage,
        current,
        setting,
        truth,
        bound,
        scenario.limit,
        entries,
        progress,
    )
    return comparison if entries is not None else with_estimates(comparison, record, believed)


def compare_log(
    log: Log,
    machine: RotatingMachine,
    settle: float,
    entries: Sequence[Entry] | None = None,
    progress: Callable[[str], Any] = lambda name: None,
) -> Comparison:
    """Compare the observers on a measured log, which must fit into memory.

    Raises
    ------
    RecordError
        The log has no true angle, or ends before `settle`.
    """
    path, named = log.path, log.truth
    if named is None:
        raise RecordError(
            f"{path}: the log has no true angle to score observers; give "
            f"--truth theta_mech=COLUMN or theta_e=COLUMN"
        )
    whole: tuple[Result, float] | None = None
    if entries is None:  # all observers read the log with the lag that it tells
        whole = _timed(log, machine)
        decision = whole[0].lag
        log = log if decision is None else log.lagged(decision.lag - log.layout.lag)
    batches = list(log.aligned())
    t, current, voltage, true_angle = (
        np.concatenate([np.asarray(batch[k]) for batch in batches]) for k in range(4)
    )
    true_angle = machine.true_position(named[0], true_angle)
    h = log.sample_time
    if t[-1] - t[0] <= settle:
        raise RecordError(
            f"{path}: the log is {t[-1] - t[0]:.4g} s long; --settle {settle:g} s must be shorter"
        )
    # Speed from the encoder, averaged over 10 ms.
    window = max(1, round(0.01 / h))
    unwrapped = np.unwrap(np.where(np.isfinite(true_angle), true_angle, 0.0))
    speed = np.abs(unwrapped[window:] - unwrapped[:-window]) / (window * h)
    setting = setting_for(h, voltage, current, machine, float(np.percentile(speed, 95)))
    truth = Truth(t - t[0], true_angle, None, None, settle, machine)
    about = f"{len(t)} rows of {h:g} s; lag {log.layout.lag:g}"
    comparison = compare_record(
        path.name, about, voltage, current, setting, truth, entries=entries, progress=progress
    )
    return comparison if entries is not None else with_estimates(comparison, log, machine, whole)


def _bound(scenario: Scenario, machine: RotatingMachine, setting: Setting, trace: Any) -> float:
    """Return the rms of the bound over the scored rows, with the true parameters."""
    L = machine.position_inductance
    x = np.asarray(trace.flux) - L * np.asarray(trace.current)
    assert machine.rated_current is not None
    sigma = position_bound(
        np.angle(x),
        np.abs(x),
        setting.sample_time,
        L,
        machine.R_s,
        scenario.noise * machine.rated_current,
        0.1 * setting.voltage,
    )
    scored = np.arange(len(sigma)) * setting.sample_time >= scenario.score_from
    return float(np.sqrt(np.mean(sigma[scored] ** 2)))
