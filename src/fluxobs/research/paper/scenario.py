"""All results of one scenario in a form that processes can exchange."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.arrays import Array
from .levitation import SCENARIOS, LevitationScenario
from .levitation import record as simulate
from .section_v import ErrorCourse, levitation_run, sizes
from .stability import Growth, growth
from .studies import (
    ConstantEstimate,
    Excited,
    Noisy,
    Robust,
    excited,
    mechanics,
    noisy,
    parameters,
    robust,
)

#: Scenarios of the noise study.
NOISY = ("S1", "S3", "S5")
#: Scenarios in the figures and, unless deep, in the stability study: the paper's own scenario S1
#: and the well-posed S5.
SHOWN = ("S1", "S5")
#: Scenario on which the claims are checked and the robust observer's error is computed.
MAIN = "S5"


@dataclass(frozen=True, eq=False)
class ScenarioResult:
    """Error courses of all observers, trajectory for the figures, and results of the studies.

    Attributes
    ----------
    jump : float
        Time at which the biases change [s].
    courses : dict
        Observer → error course.
    t, position, reference, flux : ndarray
        Thinned signals of the first 5 s.
    tracking : float
        Rms error of the position against the reference [m].
    largest_flux : float
        Largest |λ| [Wb]; errors are relative to this value.
    growth : Growth or None
        Stability of Proposition 2; None in a quick run, and for S2 and S3 unless the run is deep.
    parameters : dict
        "before" or "after" (the jump) → constant → its estimate by least squares.
    mechanics : (float, float)
        Rms errors of the position [m] and velocity [m/s] estimated from the flux.
    noise : Noisy or None
        Result of the least squares with noise; None in a quick run.
    """

    scenario: LevitationScenario
    jump: float
    courses: dict[str, ErrorCourse]
    t: Array
    position: Array
    reference: Array
    flux: Array
    tracking: float
    excited: Excited
    largest_flux: float
    growth: Growth | None
    parameters: dict[str, dict[str, ConstantEstimate]]
    mechanics: tuple[float, float]
    robust: Robust | None
    noise: Noisy | None


def run_levitation(name: str, quick: bool = False, deep: bool = False) -> ScenarioResult:
    """Simulate one scenario; run the observers and the studies.

    The orbits of S2 and S3 need almost a minute; the stability of S2 and S3 is studied only if
    `deep`.
    """
    record = simulate(SCENARIOS[name], quick=quick)
    run = levitation_run(record, all_observers=name == MAIN and not quick)
    shown = slice(0, round(5.0 / record.h), 5)
    error = record.trajectory.position[:, 0] - record.reference
    return ScenarioResult(
        record.scenario,
        record.jump,
        run.courses,
        record.t[shown],
        record.trajectory.position[shown, 0],
        record.reference[shown],
        record.flux[shown],
        float(np.sqrt(np.mean(error**2))),
        excited(run),
        sizes(record)[0],
        growth(record, run.rows) if deep or (name in SHOWN and not quick) else None,
        parameters(run),
        mechanics(run),
        robust(run) if name == MAIN else None,
        noisy(record, 10.0, 0.5) if name in NOISY and not quick else None,
    )
