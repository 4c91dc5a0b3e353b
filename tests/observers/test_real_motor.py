"""What a real motor has beside its machine file: its effect, and that the standard deviation of the
adaptive observer, and the plain one's where the effect leaves a residual, says so."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import example
from support.real_motor import Imperfect, record
from support.records import wrapped_degrees

H = 1.25e-4
MACHINE = example("pmsm-2kw2")
#: Imperfection; rms of the plain and of the adaptive observer [degrees], at most.
EFFECTS = {
    "nothing": (Imperfect(), 0.1, 0.1),
    "harmonics, 2 %": (Imperfect(fifth=0.02, seventh=0.02), 1.4, 0.4),
    "harmonics, 5 %": (Imperfect(fifth=0.05, seventh=0.05), 4.5, 1.0),
    "saliency, 20 %": (Imperfect(saliency=0.2), 2.5, 2.5),
    "weak magnets, 15 %": (Imperfect(flux=0.85), 0.1, 0.1),
    "resistance, 40 %": (Imperfect(heating=1.4), 1.8, 2.2),
    "iron loss, 2 %": (Imperfect(iron=0.02), 0.55, 0.6),
}
#: What leaves no residual is in the adaptive observer's standard deviation only.
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
    z = error[valid] / np.degrees(estimate.theta_e_std[valid])
    return rms, float(np.sqrt(np.mean(z**2))) if valid.any() else 0.0


def test_the_effect_on_the_plain_observer(name):
    real, most, _ = EFFECTS[name]
    rms, z = run(LeastSquaresObserver, real)
    assert rms < most
    assert (z > 1.5) == (name in SILENT)


def test_the_effect_on_the_adaptive_observer(name):
    real, _, most = EFFECTS[name]
    rms, z = run(AdaptiveObserver, real)
    assert rms < most
    assert z < 1.5
