"""Imperfections of a real motor affect position and standard deviation.

The adaptive observer's standard deviation covers all imperfections. The plain observer's standard
deviation covers only imperfections that leave a residual.
"""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import example
from support.real_motor import Imperfect, record
from support.records import wrapped_degrees

H = 1.25e-4
MACHINE = example("pmsm-2kw2")
#: (imperfection, largest rms error of the plain and of the adaptive observer [degrees]).
EFFECTS = {
    "nothing": (Imperfect(), 0.1, 0.1),
    "harmonics, 2 %": (Imperfect(fifth=0.02, seventh=0.02), 1.4, 0.4),
    "harmonics, 5 %": (Imperfect(fifth=0.05, seventh=0.05), 4.5, 1.3),
    "saliency, 20 %": (Imperfect(saliency=0.2), 2.5, 2.5),
    "weak magnets, 15 %": (Imperfect(flux=0.85), 0.1, 0.1),
    "resistance, 40 %": (Imperfect(heating=1.4), 1.8, 2.2),
    "iron loss, 2 %": (Imperfect(iron=0.02), 0.55, 0.6),
}
#: Imperfections without residual: only the adaptive observer's standard deviation covers them.
SILENT = ("saliency, 20 %", "resistance, 40 %", "iron loss, 2 %")


@pytest.fixture(params=EFFECTS)
def name(request):
    return request.param


def run(kind, real):
    samples = record(MACHINE, real)
    estimate = kind.for_machine(MACHINE, sample_time=H).run(samples.voltage, samples.current)
    error = wrapped_degrees(estimate.theta_e - samples.theta)
    settled = np.arange(len(error)) * H > 0.5
    rms = float(np.sqrt(np.mean(error[settled] ** 2)))
    valid = settled & estimate.valid
    normalised = error[valid] / np.degrees(estimate.theta_e_std[valid])
    return rms, float(np.sqrt(np.mean(normalised**2))) if valid.any() else 0.0


def test_the_effect_on_the_plain_observer(name):
    real, limit, _ = EFFECTS[name]
    rms, normalised = run(LeastSquaresObserver, real)
    assert rms < limit
    assert (normalised > 1.5) == (name in SILENT)


def test_the_effect_on_the_adaptive_observer(name):
    real, _, limit = EFFECTS[name]
    rms, normalised = run(AdaptiveObserver, real)
    assert rms < limit
    assert normalised < 1.5
