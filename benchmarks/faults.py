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
from fluxobs.machines import SurfacePMSM
from fluxobs.machines.rotating import SynchronousMachine
from fluxobs.simulation.closed_form.signals import between_rows, driven, inverter_loss

Complex = NDArray[np.complex128]
H, ROWS, PARTS = 1e-4, 16_000, 6
MACHINES = {"servo-400w": 8.0, "pmsm-2kw2": 5.0, "ipm-2kw2": 5.0, "ipm-5kw6": 12.0}


@dataclass(frozen=True)
class Log:
    """A log with its true position; `known` are the rows that the fault spares.

    `machine` is the machine that is given to the estimate, `size` its usual current [A].
    """

    machine: SynchronousMachine
    size: float
    voltage: Complex
    current: Complex
    theta: Array
    speed: Array
    known: NDArray[np.bool_]
    scored: bool = True  # R_s and ψ are those of the file


@dataclass(frozen=True)
class Simulated:
    """What the signals need of a machine whose flux is not that of its file."""

    R_s: float
    flux_dq: Callable[[Complex], Complex]


def clean(
    rng: np.random.Generator,
    machine: SynchronousMachine,
    size: float,
    true: SynchronousMachine | Simulated | None = None,
) -> Log:
    """Return a log without faults: random speeds and loads, offsets, noise.

    `true` is the machine that runs, by default the one of the file.
    """
    t = H * np.arange(ROWS)
    knots = np.sort(np.concatenate([[0.0, t[-1]], rng.uniform(0, t[-1], 3)]))
    speeds = rng.uniform(250, 700, 5) * np.where(rng.random(5) < 0.15, -1, 1)
    speed = np.interp(t, knots, speeds)
    steps = np.sort(rng.uniform(0.1, t[-1] - 0.1, 3))
    loads = rng.uniform(0.25, 1, 4) * np.where(rng.random(4) < 0.3, -1, 1)
    load = np.interp(t, np.repeat(steps, 2) + np.tile([0, 0.003], 3), np.repeat(loads, 2)[1:-1])
    i_dq = size * (1j * load - (0.3 * np.abs(load) if machine.saliency else 0.0))
    return with_course(rng, machine, size, true or machine, speed, i_dq)


def with_course(
    rng: np.random.Generator,
    machine: SynchronousMachine,
    size: float,
    true: SynchronousMachine | Simulated,
    speed: Array,
    i_dq: Complex,
) -> Log:
    """Return the log of a course of speed and current."""
    run = driven(
        true, H, between_rows(speed, PARTS), between_rows(i_dq, PARTS), PARTS, rng.uniform(-3, 3)
    )
    noise = 0.002 * size * (rng.standard_normal(ROWS) + 1j * rng.standard_normal(ROWS))
    offset = 0.005 * size * complex(*rng.standard_normal(2))
    voltage = np.concatenate([run.voltage, run.voltage[-1:]])
    current = run.current + noise + offset
    return Log(machine, size, voltage, current, run.theta_e, speed, np.ones(ROWS, bool))


def bridge_off(log: Log, rng: np.random.Generator) -> Log:
    """The currents vanish, and the log goes on with the last voltage in rotor coordinates."""
    a, n = int(rng.uniform(4000, 9000)), int(rng.uniform(500, 3000))
    u, i, off = log.voltage.copy(), log.current.copy(), slice(a, a + n)
    size = log.size
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
    rows = (x[keep] for x in (log.voltage, log.current, log.theta, log.speed, known))
    return Log(log.machine, log.size, *rows)


def link_sag(log: Log, rng: np.random.Generator) -> Log:
    """The log assumes a constant link, which sags by 5 to 12 % at full load and ripples by 4 %."""
    sag = rng.uniform(0.05, 0.12) * np.abs(log.current) / log.size
    ripple = 0.04 * np.sin(2 * np.pi * 300 * H * np.arange(ROWS))
    return replace(log, voltage=log.voltage / (1 - sag + ripple))


def sensor_gain(log: Log, rng: np.random.Generator) -> Log:
    """One current sensor reads 5 to 15 % too much."""
    gain = 1 + rng.uniform(0.05, 0.15)
    a = gain * log.current.real
    b = -log.current.real / 2 + 0.75**0.5 * log.current.imag
    return replace(log, current=a + 1j * (a + 2 * b) / 3**0.5)


def outliers(log: Log, rng: np.random.Generator) -> Log:
    """Single currents are far off."""
    i, known = log.current.copy(), log.known.copy()
    at = rng.integers(100, ROWS - 100, 40)
    i[at] += 3 * log.size * np.exp(1j * rng.uniform(0, 6, 40))
    known[at] = False
    return replace(log, current=i, known=known)


def voltage_scale(log: Log, rng: np.random.Generator) -> Log:
    """The DC link is 10 % off in the log."""
    return replace(log, voltage=log.voltage * (1 + 0.1 * rng.choice([-1, 1])))


def duty_gain(log: Log, rng: np.random.Generator) -> Log:
    """The gain of the current sensors falls by up to 10 % with the duty cycle of their phase."""
    return replace(log, current=_by_duty(log, lambda i, duty: i * (1 - 0.1 * duty)))


def pick_up(log: Log, rng: np.random.Generator) -> Log:
    """The current sensors pick up 3 % of the rated current from the voltage of their phase."""
    return replace(log, current=_by_duty(log, lambda i, duty: i + 0.06 * log.size * (duty - 0.5)))


def _by_duty(log: Log, read: Callable[[Array, Array], Array]) -> Complex:
    """Return currents whose phases are read with an error that depends on the duty cycle."""
    turns = np.exp(2j * np.pi / 3 * np.arange(3))
    largest = 1.8 * float(np.abs(log.voltage).max())
    phases = [
        read((log.current * turn.conj()).real, 0.5 + (log.voltage * turn.conj()).real / largest)
        for turn in turns
    ]
    return np.asarray(2 / 3 * sum(p * turn for p, turn in zip(phases, turns, strict=True)))


def injection(log: Log, rng: np.random.Generator) -> Log:
    """A square wave of half the sampling frequency in the d axis, in the first 60 % of the log."""
    machine = log.machine
    amplitude = 0.04 * log.size * rng.uniform(0.5, 2)
    wave = amplitude * (-1.0) ** np.arange(ROWS) * (np.arange(ROWS) < 0.6 * ROWS)
    rotor = np.exp(1j * log.theta)
    current = log.current + wave * rotor
    flux = machine.L_dq[0] * wave * rotor
    mean = (wave[1:] * rotor[1:] + wave[:-1] * rotor[:-1]) / 2
    voltage = log.voltage.copy()
    voltage[:-1] += np.diff(flux) / H + machine.R_s * mean
    return replace(log, voltage=voltage, current=current)


def blocks(log: Log, rng: np.random.Generator, trapezoidal: bool = False) -> Log:
    """Block commutation; the floating phase is logged as 0 or as the mean of the others."""
    from fluxobs.simulation.drive import Profile, simulate_block

    machine, size = fluxobs.example("servo-400w"), MACHINES["servo-400w"]
    run = simulate_block(
        machine,
        H,
        ROWS * H,
        Profile([0, 0.4, 1, 1.6], [rng.uniform(50, 300), *rng.uniform(250, 600, 3)]),
        Profile([0, 0.7, 0.7, 1.6], np.repeat(rng.uniform(0.4, 1, 2), 2) * size),
        48.0,
        advance=rng.uniform(-0.1, 0.4),
        theta_e=rng.uniform(-3, 3),
        noise=0.002 * size,
        trapezoidal=trapezoidal,
        seed=int(rng.integers(1 << 30)),
    )
    record = run.record(str(rng.choice(["zero", "mean"])))
    voltage, current = (x[:, 0] + 1j * x[:, 1] for x in (record.voltage, record.current))
    speed = np.gradient(np.unwrap(run.theta_e), H)
    assert isinstance(machine, SynchronousMachine)
    return Log(machine, size, voltage, current, run.theta_e, speed, np.ones(ROWS, bool))


def trapezoidal_blocks(log: Log, rng: np.random.Generator) -> Log:
    """The same with a trapezoidal EMF."""
    return blocks(log, rng, trapezoidal=True)


def _surface(machine: SynchronousMachine) -> SurfacePMSM:
    return SurfacePMSM(
        R_s=machine.R_s,
        L_s=machine.L_dq[0],
        psi_f=machine.magnet_flux,
        n_p=machine.n_p,
        rated_current=machine.rated_current,
    )


def salient(log: Log, rng: np.random.Generator) -> Log:
    """The machine is salient, and its file says that it is not."""
    given, ratio = _surface(log.machine), rng.uniform(1.4, 2.2)
    L, psi = given.L_s, given.psi_f or 0.0
    true = Simulated(given.R_s, lambda i: psi + L * i.real + 1j * ratio * L * i.imag)
    return clean(rng, given, log.size, true)


def saturated(log: Log, rng: np.random.Generator) -> Log:
    """The inductances fall by 20 to 40 % at the largest current; the file has constant ones."""
    machine, fall = log.machine, rng.uniform(0.2, 0.4)
    (L_d, L_q), psi = machine.L_dq, machine.magnet_flux or 0.0

    def flux(i: Complex) -> Complex:
        left = 1 - fall * (np.abs(i) / log.size) ** 2 / 2  # the incremental one falls faster
        return np.asarray(psi + left * (L_d * i.real + 1j * L_q * i.imag))

    return clean(rng, machine, log.size, Simulated(machine.R_s, flux))


def weaker_magnets(log: Log, rng: np.random.Generator) -> Log:
    """The magnets lose 10 to 25 % of their flux within 5 ms."""
    machine, loss, at = log.machine, rng.uniform(0.1, 0.25), rng.uniform(0.3, 0.7)
    (L_d, L_q), psi = machine.L_dq, machine.magnet_flux or 0.0

    def flux(i: Complex) -> Complex:
        place = np.linspace(0, 1, len(i)) * ROWS * H
        lost = loss * np.clip((place - at * ROWS * H) / 0.005, 0, 1)
        return np.asarray(psi * (1 - lost) + L_d * i.real + 1j * L_q * i.imag)

    changed = clean(rng, machine, log.size, Simulated(machine.R_s, flux))
    known = np.abs(np.arange(ROWS) / ROWS - at) > 0.02
    return replace(changed, known=known, scored=False)


def open_loop(log: Log, rng: np.random.Generator) -> Log:
    """An open-loop start (I/f) with an inverter loss that nobody states."""
    machine, t = log.machine, H * np.arange(ROWS)
    psi = machine.magnet_flux or 0.0
    most = rng.uniform(100, 200)
    speed = np.interp(t, [0.3, 1.2], [0, most]) * (1 + 0.1 * np.sin(2 * np.pi * 6 * t))
    i_dq = np.full(ROWS, 0.6 * log.size * np.exp(1j * rng.uniform(0.3, 0.8)))
    started = with_course(rng, machine, log.size, machine, speed, i_dq)
    loss = rng.uniform(0.1, 0.3) * psi * most
    return replace(
        started, voltage=started.voltage + inverter_loss(started.current, loss, 0.02 * log.size)
    )


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
    "voltage scale": voltage_scale,
    "duty gain": duty_gain,
    "pick-up": pick_up,
    "injection": injection,
    "blocks": blocks,
    "trapezoidal": trapezoidal_blocks,
    "salient": salient,
    "saturated": saturated,
    "weaker magnets": weaker_magnets,
    "open loop": open_loop,
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
    machine = log.machine
    result = fluxobs.estimate((log.voltage, log.current), machine, sample_time=H, lag=0)
    error = np.abs(degrees_error(result["theta_e"], log.theta))
    valid = result["valid"]
    learnt, spared = result.learnt, valid & log.known
    deviations = [0.0]
    if log.scored and learnt is not None and valid.any():
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
    kind, name, seed, number = given
    rng = np.random.default_rng([seed, number, list(KINDS).index(kind)])
    machine = fluxobs.example(name)
    assert isinstance(machine, SynchronousMachine)
    log = clean(rng, machine, MACHINES[name])
    return score(log), score(KINDS[kind](log, rng))


def median(values: list[float]) -> float:
    """Return the median of the known values; NaN without any."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else np.nan


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
                f"{median([s.rms for s in after]):8.2f}"
                f"{np.mean([s.told for s in after]):7.0%}"
                f"{np.mean([s.worst > 10 for s in after]):8.0%}"
                f"{np.mean([s.parameter > 4 for s in after]):12.0%}",
                flush=True,
            )


if __name__ == "__main__":
    main()
