"""Observers published after the paper, compared with ours on the paper's example.

All observers get the same samples and, except for the immersion, the same regression, which is
exact on samples. Gains and weights are the best choices that we know: the excitation before the
jump balances the gains, and the true residual of the regression weights the data.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from ...core.arrays import Array
from ...machines.model.immersion import Immersion
from ..analysis import balanced_gain, balanced_repaired, immersion_gramian
from ..regression import Parametrisation, SampledRegression, residual
from ..regression.laws import (
    PEBO,
    DremObserver,
    FluxObserver,
    GeneralisedPEBO,
    RiccatiObserver,
    run,
)
from .levitation import CORNER, SCENARIOS, LevitationRecord, benchmark, measured
from .levitation import record as simulate
from .section_v import (
    CONSTANTS_RATE,
    FLUX_RATE,
    LS_SAMPLE_TIME,
    NUMERICAL,
    RUN_IN,
    ErrorCourse,
    least_squares,
    levitation_observer,
    mixing_basis,
    regression_size,
    sizes,
    thinned,
)
from .studies import with_noise

#: Memory of the estimators with forgetting [s].
MEMORY = 1.0
#: Memory of all estimators with forgetting under noise [s].
NOISE_MEMORY = 0.5
#: Time at which the references come to rest in the study of interval excitation [s].
REST = 20.0


@dataclass(frozen=True, eq=False)
class Case:
    """Input of the observers, sampled at :data:`LS_SAMPLE_TIME`."""

    title: str
    record: LevitationRecord
    current: Array
    volt_seconds: Array
    noise: bool = False


def cases() -> list[Case]:
    """Return S1, S3 (weakly excited), S5, and S5 with noise, moving offsets and early rest."""

    def case(title: str, record: LevitationRecord) -> Case:
        rows, v = thinned(record, LS_SAMPLE_TIME)
        return Case(title, record, record.current[rows], v)

    plain = {name: simulate(SCENARIOS[name]) for name in ("S1", "S3", "S5")}
    main = plain["S5"]
    current, v = with_noise(main)
    rows, sums = thinned(replace(main, volt_seconds=v), LS_SAMPLE_TIME)
    machine, _ = benchmark()
    never = float(main.t[-1]) + 1.0
    moving = measured(main.scenario, machine, main.trajectory, never, swing=0.5)
    rest = simulate(replace(SCENARIOS["S5"], excited_until=REST))
    rest = measured(rest.scenario, machine, rest.trajectory, never)
    return [
        case("S1", plain["S1"]),
        case("S3", plain["S3"]),
        case("S5", main),
        Case("S5, noise", main, current[rows], sums, noise=True),
        case("S5, offsets move ± 50 %", moving),
        case(f"S5, at rest from {REST:g} s", rest),
    ]


def courses(case: Case) -> dict[str, ErrorCourse]:
    """Return the flux error divided by the largest flux for every observer."""
    record, h = case.record, LS_SAMPLE_TIME
    memory = NOISE_MEMORY if case.noise else MEMORY
    at, _ = thinned(record, h)
    flux, t = record.flux[at], record.t[at]
    rows, _ = SampledRegression(record.constraint, CORNER, h).run(case.volt_seconds, case.current)
    skip = round(RUN_IN / CORNER / h)
    until = int(np.searchsorted(t, min(record.jump, record.scenario.excited_until) - h / 2))
    nominal = rows.part(slice(skip, until))
    constants = Parametrisation(record.constraint, "structured", CORNER)
    size = sizes(record)[1]
    Gamma = balanced_gain(np.asarray(nominal.Phi_flux), FLUX_RATE)
    truth_residual = np.asarray(
        residual(
            nominal, record.constraint, flux[skip:until], record.drift[0], record.current_bias[0]
        )
    )
    floor = NUMERICAL * regression_size(nominal, size)
    noise = max(floor, float(np.sqrt(np.mean(truth_residual**2) * h)) if case.noise else 0.0)
    basis = mixing_basis(nominal, constants, h, size)
    observers: dict[str, FluxObserver] = {
        "PEBO, least squares": PEBO(2, "least-squares", Gamma),
        "generalised PEBO, least squares": GeneralisedPEBO(constants, size, noise),
        "generalised PEBO, LS + DREM, forgetting": GeneralisedPEBO(
            constants, size, noise, "least-squares-drem", 1 / memory, 10.0
        ),
        "DREM, Kreisselmeier's extension": DremObserver(1.0, memory, basis, constants, 1.0),
        "DREM, finite time": DremObserver(1.0, memory, basis, constants),
        "Riccati": RiccatiObserver(memory, size, noise, constants),
        "adaptive, repaired": balanced_repaired(
            nominal, constants, h, FLUX_RATE, CONSTANTS_RATE, round(2.0 / h)
        ),
    }
    v = jnp.asarray(case.volt_seconds)

    def course(estimates: Array) -> ErrorCourse:
        return ErrorCourse(t, np.linalg.norm(estimates - flux, axis=1) / sizes(record)[0])

    courses = {
        name: course(np.asarray(run(observer, h, v, rows, skip)[0]))
        for name, observer in observers.items()
    }
    if case.noise:
        # 1 mA per sample, and 10 mV at 1 kHz, averaged over a sample.
        noise_std = (1e-3, 1e-2 * np.sqrt(record.h / h))
        observer = levitation_observer(record.machine, h, NOISE_MEMORY, noise_std)
        estimates = observer.run(current=case.current, volt_seconds=case.volt_seconds)
    else:
        estimates = least_squares(record)
    courses["least squares on the immersion"] = course(estimates.flux)
    return courses


@dataclass(frozen=True)
class Observability:
    """Uniform observability of the immersion along a scenario, before the jump.

    Attributes
    ----------
    least : float
        Smallest over largest eigenvalue of the Gramian, scaled to a unit diagonal, in the worst
        window of length :data:`MEMORY`.
    flux_std : float
        Standard deviation of the flux, divided by the flux, in the worst window with 1 mA of
        current noise at 100 Hz and a current bias unknown within 5 mA.
    """

    least: float
    flux_std: float


def observability(record: LevitationRecord) -> Observability:
    """Compute the Gramian in successive windows."""
    machine, h = record.machine, LS_SAMPLE_TIME
    immersion = Immersion((machine.constraint,), ("drift", "current-bias"))
    at, v = thinned(record, h)
    flux = sizes(record)[0]
    relation = machine.constraint
    drift, bias = float(np.abs(record.drift[0]).max()), 5e-3
    slope = 2 * machine.g * flux
    scale = np.ones(immersion.size)
    for name, value in (
        ("s", machine.g * flux**2),
        ("flux", flux),
        ("kappa", slope * drift),
        ("drift", drift),
        ("c", machine.g * drift**2),
        ("current_bias", bias),
    ):
        scale[immersion.slices[name]] = value
    noise = 1e-3 * float(np.linalg.norm(relation.Q2 @ np.full(2, flux))) * np.sqrt(h)
    count = round(MEMORY / h)
    smallest, worst = np.inf, 0.0
    begin, end = round(2.0 / h), int(np.searchsorted(record.t[at], record.jump))
    for start in range(begin, end - count, count):
        window = slice(start, start + count)
        gramian = immersion_gramian(immersion, h, v[window], record.current[at][window], scale)
        unit = 1 / np.sqrt(np.diag(gramian))
        values = np.linalg.eigvalsh(unit[:, None] * gramian * unit)
        smallest = min(smallest, float(max(values[0], 0.0) / values[-1]))
        information = gramian / noise**2 + np.eye(immersion.size)
        std = np.sqrt(np.diag(np.linalg.inv(information))[immersion.slices["flux"]])
        size = np.sqrt(np.mean(np.square(record.flux[at][window])))
        worst = max(worst, float(np.linalg.norm(std) * flux / np.sqrt(2) / size))
    return Observability(smallest, worst)
