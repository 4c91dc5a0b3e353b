"""The fit behind `check`: its result and derivatives; noise does not bias the result."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs.checking.mistakes import AS_GIVEN, FACTOR, FILE, SIGN, combine
from fluxobs.checking.relation import (
    INDEPENDENT,
    INVERTER,
    MODEL,
    PSI,
    L,
    Prior,
    R,
    RelationResidual,
    integrate_segments,
)
from fluxobs.checking.segments import Segments, cut_segments, without_spikes
from fluxobs.logs import read_log
from support.records import CURRENTS, MACHINES, PMSM, course, log_columns, steady

pytestmark = pytest.mark.mistakes

LOOSE = Prior(np.zeros(4), np.diag([1.0, 1.0, 1.0, 100.0]))
SAMPLES = course(inverter=5.0, smoothing=0.3)


@pytest.fixture(scope="module")
def data():
    return cut_segments(read_log(log_columns(SAMPLES)), PMSM)


def relation(machine, data):
    return RelationResidual(
        machine, integrate_segments(data, data.voltage[0], data.current, 0.3), 0.02
    )


def test_wrong_parameters_are_found(data):
    machine = PMSM.with_values(R_s=PMSM.R_s / 1.4, L_s=PMSM.L_s / 0.8, psi_f=PMSM.psi_f / 1.2)
    residual = relation(machine, data)
    fit = residual.fit(LOOSE, np.zeros(4))
    np.testing.assert_allclose(np.exp(fit.values[[R, PSI]]), [1.4, 1.2], rtol=0.03)
    assert (
        abs(fit.values[L] - np.log(0.8)) < 3 * fit.std[L]
    )  # L is hardly identifiable without current along d
    assert fit.values[INVERTER] * residual.data.size == pytest.approx(5.0, rel=0.05)
    assert fit.share < 0.003


def test_derivatives_are_those_of_the_residual(data, monkeypatch):
    for module in ("checking.relation", "core.robust"):
        monkeypatch.setattr(f"fluxobs.{module}.HUBER", 1e9)
    relation_residual = RelationResidual(
        MACHINES["ipm-2kw2"], integrate_segments(data, data.voltage[0], data.current, 0.3), 0.0
    )
    values = np.array([0.1, -0.1, 0.05, 0.02])
    first = np.full((len(data.current), 1), 0.3 + 0.2j)
    slope = np.full((len(data.current), 1), 0.1 - 0.2j)

    def columns(values, first, slope):
        point = relation_residual._linearise(values, first, slope, 0.5, LOOSE)
        size = np.sqrt(np.mean(np.abs(point.position.x) ** 2))
        return relation_residual._columns(point) * size  # without the weight

    base = columns(values, first, slope)
    moves = [
        *((values, first + step, slope) for step in (1e-6, 1e-6j)),
        *((values, first, slope + step) for step in (1e-6, 1e-6j)),
        *((values + step, first, slope) for step in 1e-6 * np.eye(4)),
    ]
    for k, move in enumerate(moves):
        change = (columns(*move) - base)[..., -1] / 1e-6  # of the neighbour's residual
        own = change.reshape(len(change), -1, 2)[..., ::-1].reshape(change.shape)
        np.testing.assert_allclose(own, base[..., k], atol=1e-4 * np.abs(base[..., k]).max())


@pytest.mark.parametrize("name", ["pmsm-2kw2", "ipm-2kw2"])
def test_noise_causes_no_bias(name):
    machine = MACHINES[name]
    samples = [
        steady(machine, 1e-4, w, 3000, i * CURRENTS[name], noise=0.1, seed=k)
        for k, (w, i) in enumerate([(300.0, 1.0), (150.0, 0.3), (-250.0, -1.0), (400.0, 0.6)])
    ]
    current = np.stack([segment.current @ [1, 1j] for segment in samples])
    voltage = np.stack([segment.voltage @ [1, 1j] for segment in samples])
    noisy = Segments(1e-4, current, {0: voltage}, None)
    loose = Prior(np.zeros(4), np.diag([1.0, 1.0, 1.0, 100.0]))
    fit = RelationResidual(machine, integrate_segments(noisy, voltage, current, 0.3), 0.1).fit(
        loose, np.zeros(4)
    )
    assert abs(fit.values[L]) < 4 * fit.std[L] + 0.02
    assert abs(fit.values[R]) < 4 * fit.std[R] + 0.02


def test_mistakes_are_combined():
    z = np.exp(1j * np.linspace(0, 6, 50))
    twice = combine(SIGN[0], SIGN[0])
    np.testing.assert_allclose(twice.current(z), z)
    both = combine(FILE[1], FACTOR[0])
    assert both.loose == FACTOR[0].loose
    assert combine(AS_GIVEN, SIGN[0]).arrangement == SIGN[0].arrangement


def test_spikes_are_single_rows():
    t = np.linspace(0, 20, 4000)
    clean = np.exp(1j * t)
    spiked = clean.copy()
    spiked[[700, 1900]] += 3
    stepped = np.where(t > 10, clean + 3, clean)
    mended, count = without_spikes(spiked)
    assert count == 2
    np.testing.assert_allclose(mended, clean, atol=1e-4)
    assert without_spikes(stepped)[1] == without_spikes(clean)[1] == 0


@pytest.mark.parametrize("psi_error", [0.0, 0.02, 0.3])
def test_the_misfit_is_hubers_loss_of_pairs(data, psi_error):
    """The loss of small residuals is quadratic, that of large residuals is linear."""
    residual_function = relation(PMSM, data)
    values = np.array([0.0, 0.0, psi_error, 0.0])
    start = np.zeros((len(data.current), 1), complex)
    point = residual_function._linearise(values, start + PMSM.psi_f, start, PMSM.psi_f, LOOSE)
    residual = np.abs(point.position.x) - PMSM.psi_f * np.exp(psi_error)
    size = np.sqrt(np.mean(np.abs(point.position.x) ** 2))
    std = np.hypot(MODEL * size, PMSM.L_s * 0.02)
    first, second = residual[:, 0::2] / std, residual[:, 1::2] / std
    mean = np.abs(first + second) / 2
    loss = np.where(mean > 1.345, 2 * 1.345 * mean - 1.345**2, first * second)
    assert (mean > 1.345).any()
    assert point.misfit == pytest.approx(2 * loss.sum() * INDEPENDENT / residual.shape[1])
    offset = values @ LOOSE.precision @ values
    assert point.cost == pytest.approx(point.misfit + offset)
