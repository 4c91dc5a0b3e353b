"""The observers of the comparison, with their usual gains and a grid for tuning.

Usual gains: 0.2 |ω| for the voltage model, 1000 1/s for the gradient (ODrive), level 1 for the
clamp, 1 and 2π 40 rad/s for the speed-adaptive observer (motulator), 2π 40 rad/s for phase-locked
loops. The covariances of the Kalman filters, the cutoffs of the EMF observers, and the rates and
corners of PEBO and DREM have no usual values; the values here are right within a small factor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from ..core.arrays import Array
from ..machines import RotatingMachine
from ..observers import LeastSquaresObserver, Observer
from ..observers.plain import MEMORY, TRACKER
from ..research.analysis import balanced_basis
from ..research.regression import Parametrisation, SampledRegression
from ..research.regression.laws import PEBO, DremObserver
from ..simulation.drive import Motor
from ..simulation.drive.loop_observer import LoopObserver
from .baselines import (
    Baseline,
    ClampedIntegrator,
    ExtendedEmf,
    FilteredVoltageModel,
    KalmanFilter,
    LengthGradient,
    OnRegression,
    SlidingMode,
    SpeedAdaptiveObserver,
    SquareWaveInjection,
)


@dataclass(frozen=True, eq=False)
class Setting:
    """Data for building observers: the machine that they assume, and the scales of the signals.

    Attributes
    ----------
    machine : RotatingMachine
    sample_time : float
        Sample time [s].
    speed_e : float
        Rated electrical speed [rad/s].
    current, voltage : float
        Rated peak current [A]; rated peak voltage [V].
    noise : float
        Std of a current component [A].
    drift_prior : float or None
        Largest plausible drift [V].
    mean_voltage, current_rows : (rows, 2) ndarray
        The record, on which the observers of the regression balance their gains.
    """

    machine: RotatingMachine
    sample_time: float
    speed_e: float
    current: float
    voltage: float
    noise: float
    drift_prior: float | None
    mean_voltage: Array
    current_rows: Array

    @property
    def filter_noise(self) -> float:
        """Current noise of the Kalman filters [A], always above 0."""
        return max(self.noise, 1e-3 * self.current)

    @property
    def motor(self) -> Motor:
        return Motor.of(self.machine)


Gains = dict[str, float]


@dataclass(frozen=True)
class Entry:
    """One observer: its constructor, its recommended gains, and a grid for tuning."""

    name: str
    build: Callable[[Setting, Gains], Observer[Any, Any]]
    recommended: Callable[[Setting], Gains]
    grid: Callable[[Setting], dict[str, list[float]]]
    least_squares: bool = False

    def candidates(self, setting: Setting) -> Iterator[Gains]:
        """Yield the recommended gains, then the gains of the grid."""
        yield self.recommended(setting)
        grid = self.grid(setting)
        for values in product(*grid.values()):
            yield dict(zip(grid, values, strict=True))


PLL = 2 * np.pi * 40


def _build_least_squares(s: Setting, g: Gains) -> LoopObserver:
    compiled = LeastSquaresObserver.for_machine(
        s.machine,
        sample_time=s.sample_time,
        memory=g["memory"],
        rated_current=s.current,
        current_noise=s.noise,
    )
    if s.drift_prior is not None:
        compiled = replace(compiled, drift_prior=max(compiled.drift_prior, s.drift_prior))
    if "tracker" in g:
        compiled = replace(compiled, tracker_bandwidth=g["tracker"])
    return LoopObserver.of(compiled)


def _memories(s: Setting) -> list[float]:
    return [m for m in (0.01, 0.03, 0.1, 0.3, 1.0) if m >= 10 * s.sample_time]


@lru_cache(maxsize=4)  # settings with the same corner share the rows
def _regression_rows(s: Setting, corner: float) -> tuple[Any, Parametrisation]:
    constraint = s.machine.constraint
    i, R = s.current_rows, s.machine.R_s
    previous = np.concatenate([i[:1], i[:-1]])
    volt_seconds = s.sample_time * (np.nan_to_num(s.mean_voltage) - R * (i + previous) / 2)
    rows, _ = SampledRegression(constraint, corner, s.sample_time).run(volt_seconds, i)
    return rows, Parametrisation(constraint, "voltage-bias", corner)


def _build_on_regression(s: Setting, inner: Any, g: Gains) -> OnRegression:
    return OnRegression(
        s.motor, s.sample_time, s.machine.constraint, inner, g["corner"], g["bandwidth"]
    )


def _build_pebo(s: Setting, g: Gains) -> OnRegression:
    rows, _ = _regression_rows(s, g["corner"])
    phi = np.asarray(rows.Phi_flux)[len(rows.y) // 4 :]  # after the start-up of the filters
    Gamma = g["rate"] / np.mean(phi**2)
    return _build_on_regression(s, PEBO(2, "gradient", float(Gamma)), g)


def _build_drem(s: Setting, g: Gains) -> OnRegression:
    rows, constants = _regression_rows(s, g["corner"])
    start = len(rows.y) // 4
    psi = np.asarray(constants.psi_record(rows))[start:]
    gramian = psi.T @ psi / len(psi)
    # Regularise directions that the record does not excite (constant speed).
    scale = np.sqrt(np.diag(gramian))
    gramian += 1e-6 * np.diag(np.where(scale > 0, scale, scale.max()) ** 2)
    basis = balanced_basis(gramian, 1.0)
    return _build_on_regression(s, DremObserver(g["rate"], g["memory"], basis, constants), g)


def _build_kalman(s: Setting, g: Gains, with_drift: bool) -> KalmanFilter:
    return KalmanFilter(
        s.motor,
        s.sample_time,
        g["voltage_noise"],
        g["acceleration"],
        s.filter_noise,
        s.speed_e,
        g.get("drift_walk", 0.0),
        s.drift_prior or 0.01 * s.voltage,
        with_drift,
    )


def baseline(
    kind: Callable[..., Baseline], **constants: Any
) -> Callable[[Setting, Gains], Observer[Any, Any]]:
    """Return a function that builds a baseline from gains and these constant arguments."""
    return lambda s, g: kind(s.motor, s.sample_time, **g, **constants)


def _entries() -> list[Entry]:
    cutoffs = (0.03, 0.1, 0.3, 1.0)
    return [
        Entry(
            "least squares",
            _build_least_squares,
            lambda s: {"memory": MEMORY},
            lambda s: {"memory": _memories(s), "tracker": [200.0, TRACKER / MEMORY, 2000.0]},
            least_squares=True,
        ),
        Entry(
            "voltage model, low-pass",
            baseline(FilteredVoltageModel, order=1),
            lambda s: {"cutoff": 0.2, "least": 0.005 * s.speed_e, "bandwidth": PLL},
            lambda s: {
                "cutoff": list(cutoffs),
                "least": [0.002 * s.speed_e, 0.02 * s.speed_e],
                "bandwidth": [PLL / 4, PLL],
            },
        ),
        Entry(
            "voltage model, high-pass",
            baseline(FilteredVoltageModel, order=2),
            lambda s: {"cutoff": 0.2, "least": 0.005 * s.speed_e, "bandwidth": PLL},
            lambda s: {
                "cutoff": list(cutoffs),
                "least": [0.002 * s.speed_e, 0.02 * s.speed_e],
                "bandwidth": [PLL / 4, PLL],
            },
        ),
        Entry(
            "gradient (Ortega, Lee)",
            baseline(LengthGradient),
            lambda s: {"gain": 1000.0, "bandwidth": 2 * PLL},
            lambda s: {
                "gain": [10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0],
                "bandwidth": [PLL, 2 * PLL, 4 * PLL],
            },
        ),
        Entry(
            "gradient, adapting",
            baseline(LengthGradient),
            lambda s: {"gain": 1000.0, "adaptation": 10.0, "bandwidth": 2 * PLL},
            lambda s: {
                "gain": [30.0, 100.0, 300.0],
                "adaptation": [1.0, 10.0, 100.0],
                "bandwidth": [PLL, 3 * PLL],
            },
        ),
        Entry(
            "clamped integrator (MXLEMMING)",
            baseline(ClampedIntegrator),
            lambda s: {"level": 1.0, "bandwidth": 2 * PLL},
            lambda s: {
                "level": [0.8, 0.9, 1.0, 1.1, 1.2],
                "bandwidth": [PLL, 2 * PLL, 4 * PLL],
            },
        ),
        Entry(
            "speed-adaptive (Hinkkanen)",
            baseline(SpeedAdaptiveObserver),
            lambda s: {"gain": 1.0, "bandwidth": PLL},
            lambda s: {
                "gain": [0.03, 0.1, 0.3, 1.0, 3.0],
                "bandwidth": [PLL / 4, PLL, 2 * PLL, 4 * PLL],
            },
        ),
        Entry(
            "sliding mode",
            baseline(SlidingMode),
            lambda s: {"switching": 1.5 * s.voltage, "cutoff": s.speed_e, "bandwidth": PLL},
            lambda s: {
                "switching": [1.5 * s.voltage],
                "cutoff": [0.3 * s.speed_e, s.speed_e, 3 * s.speed_e],
                "bandwidth": [PLL / 4, PLL / 2, PLL, 2 * PLL],
            },
        ),
        Entry(
            "extended EMF with PLL",
            baseline(ExtendedEmf),
            lambda s: {"cutoff": s.speed_e, "bandwidth": PLL},
            lambda s: {
                "cutoff": [0.3 * s.speed_e, s.speed_e, 3 * s.speed_e],
                "bandwidth": [PLL / 4, PLL / 2, PLL, 2 * PLL],
            },
        ),
        Entry(
            "extended Kalman filter",
            lambda s, g: _build_kalman(s, g, False),
            lambda s: {"voltage_noise": 0.01 * s.voltage, "acceleration": 30.0 * s.speed_e**0.5},
            lambda s: {
                "voltage_noise": [x * s.voltage for x in (1e-3, 1e-2, 1e-1, 1.0)],
                "acceleration": [x * s.speed_e**0.5 for x in (3.0, 30.0, 300.0, 3000.0)],
            },
        ),
        Entry(
            "extended Kalman filter with drift",
            lambda s, g: _build_kalman(s, g, True),
            lambda s: {
                "voltage_noise": 0.001 * s.voltage,
                "acceleration": 30.0 * s.speed_e**0.5,
                "drift_walk": 1e-3 * s.voltage,
            },
            lambda s: {
                "voltage_noise": [x * s.voltage for x in (1e-4, 1e-3, 1e-1)],
                "acceleration": [x * s.speed_e**0.5 for x in (3.0, 30.0, 300.0)],
                "drift_walk": [1e-4 * s.voltage, 1e-2 * s.voltage],
            },
        ),
        Entry(
            "PEBO (gradient)",
            _build_pebo,
            lambda s: {"corner": 0.5 * s.speed_e, "rate": 30.0, "bandwidth": PLL},
            lambda s: {
                "corner": [0.1 * s.speed_e, 0.5 * s.speed_e],
                "rate": [3.0, 30.0, 300.0],
                "bandwidth": [PLL, 3 * PLL],
            },
        ),
        Entry(
            "DREM",
            _build_drem,
            lambda s: {"corner": 0.5 * s.speed_e, "rate": 100.0, "memory": 0.1, "bandwidth": PLL},
            lambda s: {
                "corner": [0.1 * s.speed_e, 0.5 * s.speed_e],
                "rate": [10.0, 1000.0],
                "memory": [0.1, 0.5],
                "bandwidth": [PLL, 3 * PLL],
            },
        ),
    ]


CATALOGUE = _entries()
#: For records with an injected signal, and a salient machine.
INJECTION = Entry(
    "square-wave injection (Yoon, Sul)",
    baseline(SquareWaveInjection),
    lambda s: {"bandwidth": PLL / 2},
    lambda s: {"bandwidth": [PLL / 16, PLL / 8, PLL / 4, PLL / 2, PLL, 2 * PLL]},
)
