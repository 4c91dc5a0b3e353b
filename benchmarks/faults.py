"""Logs that go wrong: is the fault found, and is the estimate with it right or silent?

python benchmarks/faults.py [--drives 20] [--seed 1] [--kind NAME ...]

Closed-form records of random machines and courses. Each kind of fault is put into one log per
drive. "clean" is the log without it; "marks" its rows with a mark of a fault.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from common import degrees_error, heading
from numpy.typing import NDArray

import fluxobs
from fluxobs.core.arrays import Array
from fluxobs.logs.quality.marks import FAULTS
from fluxobs.machines.rotating import SynchronousMachine
from fluxobs.simulation.closed_form.signals import between_rows, driven

Complex = NDArray[np.complex128]
H, ROWS, PARTS = 1e-4, 16_000, 6
MACHINES = {"servo-400w": 8.0, "pmsm-2kw2": 5.0, "ipm-2kw2": 5.0, "ipm-5kw6": 12.0}


@dataclass(frozen=True)
class Log:
    """A log with its true position; `known` are the rows that the fault spares."""

    machine: str
    voltage: Complex
    current: Complex
    theta: Array
    speed: Array
    known: NDArray[np.bool_]


def clean(rng: np.random.Generator, machine_name: str) -> Log:
    """Return a log without faults: random speeds and loads, offsets, noise."""
    machine = fluxobs.example(machine_name)
    assert isinstance(machine, SynchronousMachine)
    t = H * np.arange(ROWS)
    knots = np.sort(np.concatenate([[0.0, t[-1]], rng.uniform(0, t[-1], 3)]))
    speeds = rng.uniform(250, 700, 5) * np.where(rng.random(5) < 0.15, -1, 1)
    speed = np.interp(t, knots, speeds)
    steps = np.sort(rng.uniform(0.1, t[-1] - 0.1, 3))
    loads = rng.uniform(0.25, 1, 4) * np.where(rng.random(4) < 0.3, -1, 1)
    load = np.interp(t, np.repeat(steps, 2) + np.tile([0, 0.003], 3), np.repeat(loads, 2)[1:-1])
    size = MACHINES[machine_name]
    i_dq = size * (1j * load - (0.3 * np.abs(load) if machine.saliency else 0.0))
    true = driven(
        machine, H, between_rows(speed, PARTS), between_rows(i_dq, PARTS), PARTS, rng.uniform(-3, 3)
    )
    noise = 0.002 * size * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    offset = 0.005 * size * complex(*rng.standard_normal(2))
    voltage = np.concatenate([true.voltage, true.voltage[-1:]])
    return Log(
        machine_name,
        voltage,
        true.current + noise + offset,
        true.theta_e,
        speed,
        np.ones(ROWS, bool),
    )


def bridge_off(log: Log, rng: np.random.Generator) -> Log:
    """The currents vanish, and the log goes on with the last voltage in rotor coordinates."""
    a, n = int(rng.uniform(4000, 9000)), int(rng.uniform(500, 3000))
    u, i, off = log.voltage.copy(), log.current.copy(), slice(a, a + n)
    size = MACHINES[log.machine]
    i[off] = 0.002 * size * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    u[off] = u[a - 1] * np.exp(1j * (log.theta[off] - log.theta[a - 1]))
    known = log.known.copy()
    known[a - 30 : a + n + 30] = False
    return replace(log, voltage=u, current=i, known=known)


def repeated(log: Log, rng: np.random.Generator) -> Log:
    """The logger repeats a row, several times."""
    u, i, known = log.voltage.copy(), log.current.copy(), log.known.copy()
    for _ in range(int(rng.integers(2, 8))):
        a, n = int(rng.uniform(500, ROWS - 800)), int(rng.uniform(5, 300))
        u[a : a + n], i[a : a + n] = u[a], i[a]
        known[a : a + n + 30] = False
    return replace(log, voltage=u, current=i, known=known)


def held(log: Log, rng: np.random.Generator) -> Log:
    """The current is held for a few samples, often: a shunt that cannot measure."""
    i, known = log.current.copy(), log.known.copy()
    for _ in range(200):
        a, n = int(rng.uniform(100, ROWS - 100)), int(rng.integers(2, 6))
        i[a : a + n] = i[a]
        known[a : a + n] = False
    return replace(log, current=i, known=known)


def clipped(log: Log, rng: np.random.Generator) -> Log:
    """Two phase currents clip at 60 to 85 % of their largest value."""
    limit = rng.uniform(0.6, 0.85) * float(np.abs(log.current).max())
    a = np.clip(log.current.real, -limit, limit)
    b = np.clip(-log.current.real / 2 + 0.75**0.5 * log.current.imag, -limit, limit)
    i = a + 1j * (a + 2 * b) / 3**0.5
    return replace(log, current=i, known=np.abs(i - log.current) < 1e-9)


def lost_rows(log: Log, rng: np.random.Generator) -> Log:
    """Three consecutive rows have no value, thirty times."""
    u, i, known = log.voltage.copy(), log.current.copy(), log.known.copy()
    for a in rng.integers(100, ROWS - 100, 30):
        u[a : a + 3] = i[a : a + 3] = np.nan
        known[a : a + 4] = False
    return replace(log, voltage=u, current=i, known=known)


def silent_gap(log: Log, rng: np.random.Generator) -> Log:
    """Sixty rows are lost, and nothing tells it."""
    a = int(rng.uniform(4000, 12_000))
    keep = np.ones(ROWS, bool)
    keep[a : a + 60] = False
    known = log.known.copy()
    known[a - 60 : a + 120] = False
    return Log(
        log.machine, *(x[keep] for x in (log.voltage, log.current, log.theta, log.speed, known))
    )


def link_sag(log: Log, rng: np.random.Generator) -> Log:
    """The log assumes a constant link, which sags by 5 to 12 % at full load and ripples by 4 %."""
    sag = rng.uniform(0.05, 0.12) * np.abs(log.current) / MACHINES[log.machine]
    ripple = 0.04 * np.sin(2 * np.pi * 300 * H * np.arange(ROWS))
    return Log(
        log.machine, log.voltage / (1 - sag + ripple), log.current, log.theta, log.speed, log.known
    )


def sensor_gain(log: Log, rng: np.random.Generator) -> Log:
    """One current sensor reads 5 to 15 % too much."""
    gain = 1 + rng.uniform(0.05, 0.15)
    a = gain * log.current.real
    b = -log.current.real / 2 + 0.75**0.5 * log.current.imag
    return Log(
        log.machine, log.voltage, a + 1j * (a + 2 * b) / 3**0.5, log.theta, log.speed, log.known
    )


def outliers(log: Log, rng: np.random.Generator) -> Log:
    """Single currents are far off."""
    i, known = log.current.copy(), log.known.copy()
    at = rng.integers(100, ROWS - 100, 40)
    i[at] += 3 * MACHINES[log.machine] * np.exp(1j * rng.uniform(0, 6, 40))
    known[at] = False
    return replace(log, current=i, known=known)


KINDS: dict[str, Callable[[Log, np.random.Generator], Log]] = {
    "bridge off": bridge_off,
    "repeated": repeated,
    "held": held,
    "clipped": clipped,
    "lost rows": lost_rows,
    "silent gap": silent_gap,
    "link sag": link_sag,
    "sensor gain": sensor_gain,
    "outliers": outliers,
}


@dataclass(frozen=True)
class Score:
    """Score of an estimate.

    Attributes
    ----------
    valid, rms, worst : float
        Share of the spared rows, error of their valid rows, largest error of any valid row [°].
    parameter : float
        Largest error of R_s and ψ in standard deviations.
    marked : float
        Share of the rows with a mark of a fault.
    told : bool
        Whether a warning was given.
    """

    valid: float
    rms: float
    worst: float
    parameter: float
    marked: float
    told: bool


def score(log: Log) -> Score:
    """Estimate a log and score it."""
    machine = fluxobs.example(log.machine)
    assert isinstance(machine, SynchronousMachine)
    result = fluxobs.estimate((log.voltage, log.current), machine, sample_time=H, lag=0)
    error = np.abs(degrees_error(result["theta_e"], log.theta))
    valid = result["valid"]
    learnt, spared = result.learnt, valid & log.known
    deviations = [0.0]
    if learnt is not None and valid.any():
        for value, true, std in (
            (learnt.resistance, machine.R_s, learnt.resistance_std),
            (learnt.psi_f, machine.magnet_flux or 0.0, learnt.psi_f_std),
        ):
            deviations.append(abs(value - true) / std if std > 0 else 0.0)
    return Score(
        float(valid[log.known].mean()),
        float(np.sqrt(np.mean(error[spared] ** 2))) if spared.any() else np.nan,
        float(error[valid].max(initial=0.0)),
        float(max(deviations)),
        float((np.asarray(result["quality"]) & FAULTS > 0).mean()),
        bool(result.warnings),
    )


def pair(given: tuple[str, str, int, int]) -> tuple[Score, Score]:
    """Return the scores of a log without and with a fault."""
    kind, machine, seed, number = given
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    log = clean(rng, machine)
    return score(log), score(KINDS[kind](log, rng))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--drives", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=list(KINDS))
    options = parser.parse_args()
    heading("Logs with faults: median share of valid rows among those that the fault spares")
    print(
        "    fault          clean valid  rms  marks | faulty valid   rms  told   >10 deg  "
        "parameter > 4 sigma"
    )
    names = list(MACHINES)
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for kind in options.kind:
            given = [(kind, names[n % len(names)], options.seed, n) for n in range(options.drives)]
            pairs = list(pool.map(pair, given))
            before, after = zip(*pairs, strict=True)
            print(
                f"    {kind:14s}{np.median([s.valid for s in before]):8.1%}"
                f"{np.nanmedian([s.rms for s in before]):8.2f}"
                f"{np.mean([s.marked for s in before]):9.1e} |"
                f"{np.median([s.valid for s in after]):9.1%}"
                f"{np.nanmedian([s.rms for s in after]):8.2f}"
                f"{np.mean([s.told for s in after]):7.0%}"
                f"{np.mean([s.worst > 10 for s in after]):8.0%}"
                f"{np.mean([s.parameter > 4 for s in after]):12.0%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
