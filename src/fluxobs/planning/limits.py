"""What the adaptive observer will know at each speed and load, and what limits it.

The planned drive is simulated with its nominal machine, at each speed and load, with errors of the
sensors of one standard deviation. The observer then states what it knows: it contains the priors
of everything that a data sheet leaves open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..campaigns.draws import NOISE, Scenario
from ..campaigns.drives import Cell, drive_of
from ..campaigns.simulated import ScoredTrace, select_scored
from ..campaigns.specification import Specification
from ..core.arrays import Array
from ..errors import FluxobsError, UsageError
from ..estimation.lag import shifted
from ..observers import AdaptiveObserver
from ..simulation.drive.simulate import check, simulate_lanes, substeps
from .setup import Sensors, observer_of, quantities

#: Speeds as shares of the rated speed, and loads as shares of the rated torque.
SPEEDS = np.geomspace(0.004, 1.0, 25)
LOADS = (0.0, 0.25, 0.5, 0.75, 1.0)
#: The drive runs up to at least RUN_IN of the rated speed, takes the load, changes to the speed,
#: and stays there for HOLD; the second half of that time counts [s].
RUN_IN, UP, LOADED, THERE, HOLD = 0.3, 0.3, 0.6, 1.0, 1.0
DURATION = THERE + HOLD
#: The drive runs at a speed if it is nearer to it than this share of the rated speed.
FOLLOWED = 0.03
#: A speed is valid if the position is valid on this share of the counted rows.
VALID = 0.5
#: Signs of the errors of the sensors of the nominal drive [standard deviations].
SIGNS = (0.6, 0.8, 0.7, -0.7)
#: Knots to which the courses are padded.
KNOTS = 8


@dataclass(frozen=True, eq=False)
class Map:
    """What the observer knows over load and speed.

    Attributes
    ----------
    speeds : (speeds,) ndarray
        Shares of the rated speed.
    loads : (loads,) ndarray
        Shares of the rated torque.
    valid : (loads, speeds) ndarray
        Share of the counted rows on which the position is valid; NaN where the drive cannot run.
    std : (loads, speeds) ndarray
        Root mean square of the stated standard deviation [rad].
    error : (loads, speeds) ndarray
        Rms error of the simulated drive on its valid rows [rad]; NaN without one.
    """

    speeds: Array
    loads: Array
    valid: Array
    std: Array
    error: Array

    def lowest(self) -> Array:
        """Return the lowest valid speed of each load, as a share of the rated speed; NaN: none."""
        return np.array([_crossing(self.speeds, valid) for valid in self.valid])


def _crossing(speeds: Array, valid: Array) -> float:
    """Return the speed from which on all speeds are valid, interpolated in its logarithm."""
    run = np.isfinite(valid)
    speeds, good = speeds[run], valid[run]
    below = np.flatnonzero(good < VALID)
    if not len(below):
        return float(speeds[0]) if len(speeds) else np.nan
    k = int(below[-1])
    if k + 1 == len(speeds):
        return np.nan
    share = (VALID - good[k]) / (good[k + 1] - good[k])
    return float(speeds[k] * (speeds[k + 1] / speeds[k]) ** share)


def simulate_map(
    cell: Cell,
    values: dict[str, float],
    loads: Sequence[float] = LOADS,
    speeds: Array = SPEEDS,
    seed: int = 1,
) -> list[list[ScoredTrace | None]]:
    """Simulate a drive at each load and speed; None where it cannot run.

    Parameters
    ----------
    cell : Cell
    values : dict
        Quantities of a campaign.
    """
    places, lanes, noise = [], [], []
    h = cell.rated.sample_time
    for m, load in enumerate(loads):
        for n, speed in enumerate(speeds):
            number = 1000 * m + n
            scenario = Scenario(number, cell.name, values, seed)
            try:
                lane = drive_of(_specification(cell, float(speed), load), scenario)
                check(*lane)
                substeps(*lane)
            except FluxobsError:
                continue
            places.append((m, n))
            lanes.append(lane)
            rows = round(DURATION / h)
            noise.append(scenario.generator(NOISE).standard_normal((rows, 3)))
    found: list[list[ScoredTrace | None]] = [[None] * len(speeds) for _ in loads]
    if not lanes:
        return found
    steps = max(substeps(*lane) for lane in lanes)
    finite, trace = simulate_lanes(lanes, np.stack(noise), steps, select_scored, KNOTS)
    for k, (m, n) in enumerate(places):
        row = ScoredTrace(*(signal[k] for signal in trace))
        behind = np.abs(row.speed[-1] - row.reference[-1]) * cell.machine.n_p
        if finite[k] and not row.tripped.any() and behind < FOLLOWED * cell.rated.speed_e:
            found[m][n] = row
    return found


def _specification(cell: Cell, speed: float, load: float) -> Specification:
    first = max(speed, RUN_IN)
    return Specification.model_validate(
        {
            **{"name": "plan", "scenarios": 1, "machines": [cell.name], "observers": ["adaptive"]},
            "drive": {name: getattr(cell.rated, name) for name in vars(cell.rated)},
            "course": {
                "duration": DURATION,
                "score_from": 0.1,
                "speed": [[0, 0], [UP, first], [LOADED, first], [THERE, speed], [DURATION, speed]],
                "load": [[0, 0], [UP, 0], [LOADED, load], [DURATION, load]],
            },
        }
    )


def map_of(
    observer: AdaptiveObserver,
    cell: Cell,
    traces: list[list[ScoredTrace | None]],
    loads: Sequence[float] = LOADS,
    speeds: Array = SPEEDS,
) -> Map:
    """Return what an observer knows of simulated drives."""
    shape = len(loads), len(speeds)
    valid, std, error = (np.full(shape, np.nan) for _ in range(3))
    counted = slice(round((THERE + HOLD / 2) / cell.rated.sample_time), None)
    for m, row in enumerate(traces):
        for n, trace in enumerate(row):
            if trace is None:
                continue
            u, i = (np.stack([v.real, v.imag], axis=-1) for v in (trace.voltage, trace.current))
            estimate = observer.run(shifted(u, -1), i)
            known = estimate.valid[counted]
            valid[m, n] = known.mean()
            std[m, n] = np.sqrt(np.mean(np.minimum(estimate.theta_e_std[counted], np.pi) ** 2))
            if known.any():
                off = cell.machine.position_error(estimate.theta_e, trace.theta_e)[counted]
                error[m, n] = np.sqrt(np.mean(off[known] ** 2))
    return Map(np.asarray(speeds, float), np.asarray(loads, float), valid, std, error)


@dataclass(frozen=True)
class Gain:
    """What the observer gains if a quantity is known or measured twice as well.

    Attributes
    ----------
    what : str
    remedy : str
        How to get it.
    lowest : float
        Lowest valid speed then, over that of the plan [1].
    std : float
        Median standard deviation where both know the position, over that of the plan [1].
    """

    what: str
    remedy: str
    lowest: float
    std: float


#: What could be better known: fields of the observer of which the standard deviation is halved.
KNOWN: dict[str, tuple[tuple[str, ...], str]] = {
    "resistance": (("resistance_std",), "measure R_s warm, state R_s_std"),
    "inverter": (("inverter_std",), "measure its voltage over the current, state inverter_voltage"),
    "magnet flux": (("psi_f_std",), "measure the back-EMF, state psi_f_std"),
    "inductances": (("L_d_std", "L_q_std"), "measure L_d and L_q under load"),
    "lag": (("lag_std", "delay_std"), "state the sampling instants"),
    "iron loss": (("iron_current_std",), "measure the no-load loss"),
    "harmonics": (("harmonic_std",), "measure the waveform of the back-EMF"),
}
#: Sensors that could be better: fields of :class:`Sensors` with factors.
BETTER: dict[str, tuple[dict[str, float], str]] = {
    "offset of the sensors": ({"offset": 0.5}, "calibrate at zero current before each start"),
    "gains of the sensors": ({"gain": 0.5}, "calibrate the phases against each other"),
    "noise": ({"noise": 0.5}, "a filter or averaging within the period"),
    "resolution": ({"range": 0.25}, "two more bits, or a smaller range"),
    "dead time and drop": ({"dead_time": 0.5, "drop": 0.5}, "compensate the inverter"),
}


@dataclass(frozen=True, eq=False)
class Plan:
    """The plan of a drive.

    Attributes
    ----------
    cell : Cell
    sensors : Sensors
    known : Map
    load : float
        Load at which the lowest valid speed is highest; the gains apply there.
    gains : tuple of Gain
        The largest first.
    """

    cell: Cell
    sensors: Sensors
    known: Map
    load: float
    gains: tuple[Gain, ...]


def plan_drive(
    cell: Cell,
    sensors: Sensors,
    progress: Callable[[int, int], Any] | None = None,
    loads: Sequence[float] = LOADS,
    speeds: Array = SPEEDS,
) -> Plan:
    """Return the plan of a drive over loads and speeds, as shares of the rated values.

    Raises
    ------
    UsageError
        The drive cannot run at any speed and load.
    """
    total = 1 + len(KNOWN) + len(BETTER)

    def report(done: int) -> None:
        if progress is not None:
            progress(done, total)

    observer = observer_of(sensors, cell)
    traces = simulate_map(cell, quantities(sensors, cell, SIGNS), loads, speeds)
    known = map_of(observer, cell, traces, loads, speeds)
    report(1)
    if np.isnan(known.valid).all():
        raise UsageError(
            f"the drive reaches none of the speeds under any load: check --torque "
            f"({cell.rated.torque:.3g} N m), --speed and --dc-link ({cell.rated.dc_link:.3g} V)"
        )
    lowest = known.lowest()
    at = int(np.nanargmax(lowest)) if np.isfinite(lowest).any() else 0
    if np.isnan(lowest).any():  # a load at which no speed is valid
        at = int(np.flatnonzero(np.isnan(lowest))[0])
    load = (loads[at],)
    before = Map(
        known.speeds, np.array(load), known.valid[[at]], known.std[[at]], known.error[[at]]
    )
    gains = []
    for what, (names, remedy) in KNOWN.items():
        halved = replace(observer, **{name: 0.5 * getattr(observer, name) for name in names})
        gains.append(_gain(what, remedy, before, map_of(halved, cell, [traces[at]], load, speeds)))
        report(1 + len(gains))
    for what, (factors, remedy) in BETTER.items():
        better = replace(sensors, **{n: f * getattr(sensors, n) for n, f in factors.items()})
        simulated = simulate_map(cell, quantities(better, cell, SIGNS), load, speeds)
        after = map_of(observer_of(better, cell), cell, simulated, load, speeds)
        gains.append(_gain(what, remedy, before, after))
        report(1 + len(gains))
    ranked = sorted(gains, key=lambda gain: gain.lowest * gain.std)
    return Plan(cell, sensors, known, load[0], tuple(ranked))


def _gain(what: str, remedy: str, before: Map, after: Map) -> Gain:
    both = (before.valid > VALID) & (after.valid > VALID)
    std = float(np.median((after.std / before.std)[both])) if both.any() else np.nan
    return Gain(what, remedy, float(after.lowest()[0] / before.lowest()[0]), std)
