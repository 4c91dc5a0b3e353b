"""Injected signals are recognised and described."""

import numpy as np
import pytest

from fluxobs.logs.quality.detect import Detector
from fluxobs.logs.quality.injection import describe_injection
from fluxobs.logs.quality.marks import INJECTED
from fluxobs.logs.time.aligned import Aligned

H = 1e-4
ROWS = 6000
NOISE = 0.01


def rows(wave, load=4.0, first=0):
    """Return a log at rest with this wave from a row on; the voltage is 300 times the current."""
    rng = np.random.default_rng(1)
    injected = np.resize(np.asarray(wave, complex), ROWS) * np.exp(0.4j)
    injected[:first] = 0.0
    z = load * np.exp(1j * 2e-3 * np.arange(ROWS)) + injected
    current = np.stack([z.real, z.imag], axis=1) + NOISE * rng.standard_normal((ROWS, 2))
    voltage = 300 * np.stack([injected.real, injected.imag], axis=1) + 20.0
    unmarked = Aligned(H * np.arange(ROWS), current, voltage, None)
    return unmarked._replace(marks=Detector(4.0, 100.0, NOISE).marks(unmarked))


WAVES = [
    ([0.2, -0.2], "square wave", 5000.0, 2),
    ([0.2, 0.2, -0.2, -0.2], "square wave", 2500.0, 4),
    (0.2 * np.exp(0.4j * np.pi * np.arange(5)), "rotating", 2000.0, 5),
    (0.2 * np.exp(-0.5j * np.pi * np.arange(4)), "rotating", 2500.0, 4),
    (0.2 * np.cos(0.4 * np.pi * np.arange(5)), "pulsating", 2000.0, 5),
    (0.2 * np.cos(2 * np.pi * 3 / 14 * np.arange(14)), "pulsating", 2142.9, 14),
]


# A rotating signal without load may be the fundamental, logged too slowly: it is not in this list.
@pytest.mark.parametrize(
    ("wave", "kind", "frequency", "period", "load"),
    [(*wave, load) for wave in WAVES for load in (0.0, 4.0) if load or wave[1] != "rotating"],
)
def test_kind_frequency_and_amplitude(wave, kind, frequency, period, load):
    injection = describe_injection([rows(wave, load)], H)
    assert injection.kind == kind
    assert injection.frequency == pytest.approx(frequency, rel=0.01)
    assert injection.period == period
    assert injection.current == pytest.approx(0.2, rel=0.03)
    assert injection.voltage == pytest.approx(60.0, rel=0.03)


def test_only_rows_with_injection_are_marked():
    piece = rows([0.2, -0.2], first=3000)
    marked = piece.marks & INJECTED > 0
    assert not marked[:2700].any()
    assert marked[3300:-300].all()
    assert describe_injection([rows([0.0])], H) is None
