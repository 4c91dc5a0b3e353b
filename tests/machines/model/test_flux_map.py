"""Flux maps: splines, derivatives, auxiliary flux; Python, C and JAX agree."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import NdBSpline

from fluxobs import LeastSquaresObserver, ModelError
from fluxobs.machines import AlgebraicSaturation, SynchronousReluctance
from fluxobs.machines.model.flux_map import CageMap, LinearMap, TableMap
from fluxobs.machines.model.flux_table import fit_table

#: A 6.7 kW reluctance machine (Hinkkanen and others, doi:10.1109/TIA.2016.2644624).
MODEL = AlgebraicSaturation(a_d0=17.4, a_dd=373, a_q0=52.1, a_qq=658, a_dq=1120)
RELUCTANCE = SynchronousReluctance(R_s=0.63, n_p=2, rated_current=22.0, flux_map=MODEL)
LINEAR = LinearMap(0.545, 0.036, 0.051)


def currents(count=300, limit=40.0, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-limit, limit, count) + 1j * rng.uniform(-limit, limit, count)


@pytest.fixture(scope="module")
def table() -> TableMap:
    return RELUCTANCE.saturation.table


def test_a_table_agrees_with_scipy(table):
    knots = tuple(
        span[0] + (span[1] - span[0]) / n * np.arange(-2, n + 3)
        for span, n in zip((table.d, table.q), table.intervals, strict=True)
    )
    spline = NdBSpline(knots, np.asarray(table.coefficients), 2)
    i = currents()
    mapped = table.at(i)
    points = np.stack([i.real, i.imag], -1)
    for nu, evaluated in (((0, 0), mapped.flux), ((1, 0), mapped.by_d), ((0, 1), mapped.by_q)):
        expected = spline(points, nu=nu) @ [1, 1j]
        np.testing.assert_allclose(evaluated, expected, atol=1e-12)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_c_evaluates_the_same_map(table, precision):
    observer = LeastSquaresObserver.for_machine(RELUCTANCE, sample_time=1e-4, precision=precision)
    i = np.concatenate([currents(), currents(50, 90.0)])  # some currents are outside the table
    evaluated = observer._core.mapped(np.stack([i.real, i.imag], -1), np.zeros(len(i)))
    mapped = table.at(i)
    vectors = (mapped.flux, mapped.by_d, mapped.by_q, mapped.auxiliary(i))
    expected = np.concatenate([np.stack([v.real, v.imag], -1) for v in vectors], axis=1)
    np.testing.assert_allclose(
        evaluated[:, :8], expected, atol=1e-12 if precision == "double" else 3e-6
    )
    np.testing.assert_array_equal(evaluated[:, 8] > 0, table.outside(i))


@pytest.mark.parametrize("kind", ["table", "linear"])
def test_an_error_of_the_angle_moves_the_flux_by_the_auxiliary_flux(table, kind):
    flux_map = table if kind == "table" else LINEAR
    i, e = currents(limit=25.0), 1e-6
    change = np.exp(1j * e) * flux_map.flux(i * np.exp(-1j * e)) - flux_map.flux(i)
    a = flux_map.at(i).auxiliary(i)
    np.testing.assert_allclose(change / e, 1j * a, atol=2e-5)


def test_the_auxiliary_flux_of_a_linear_machine():
    i = currents()
    saliency = LINEAR.L_d - LINEAR.L_q
    expected = LINEAR.psi + saliency * i.conj()
    np.testing.assert_allclose(LINEAR.at(i).auxiliary(i), expected, atol=1e-12)


def test_a_table_is_extrapolated_linearly_and_outside_detects_it(table):
    edge = table.d[1]
    inside, beyond = table.at(np.array(edge + 3j)), table.at(np.array(edge + 2 + 3j))
    assert beyond.flux == pytest.approx(inside.flux + 2 * inside.by_d, abs=1e-9)
    assert table.outside(edge + 2 + 3j)
    assert not table.outside(edge + 3j)


def test_jax_evaluates_and_inverts_the_same_map(table):
    jax = pytest.importorskip("jax")
    from fluxobs.simulation.drive.flux_map import Map

    i = currents(40, 25.0)
    twin = Map.of(table)
    flux, by_d, by_q = jax.vmap(twin.at)(i)
    mapped = table.at(i)
    for evaluated, expected in ((flux, mapped.flux), (by_d, mapped.by_d), (by_q, mapped.by_q)):
        np.testing.assert_allclose(evaluated, expected, atol=1e-12)
    inverted = jax.vmap(lambda psi: twin.current(psi, RELUCTANCE.L_d, RELUCTANCE.L_q))(flux)
    np.testing.assert_allclose(inverted, i, atol=1e-6)


def test_noise_of_measured_points_is_averaged():
    i = currents(900, 30.0)
    true = MODEL.flux(i)
    rng = np.random.default_rng(1)
    noise = 0.005 * (rng.standard_normal(900) + 1j * rng.standard_normal(900))
    fit = fit_table(i, true + noise, magnets=False)
    assert fit.residual == pytest.approx(0.005, rel=0.2)
    inner = currents(200, 25.0, seed=2)
    error = np.abs(fit.table.flux(inner) - MODEL.flux(inner))
    assert np.sqrt(np.mean(error**2)) < 0.003


def test_points_of_one_quadrant_are_mirrored():
    axis = np.linspace(0, 30, 31)
    i = (axis[:, None] + 1j * axis[None, :]).ravel()
    fit = fit_table(i, MODEL.flux(i), magnets=False)
    i_dq = np.array([8 + 9j, -8 + 9j, 8 - 9j, -8 - 9j])
    np.testing.assert_allclose(fit.table.flux(i_dq), MODEL.flux(i_dq), atol=1e-3)
    assert fit.reciprocity < 0.01


def test_implausible_maps_are_detected():
    i = currents(400, 30.0)
    psi = MODEL.flux(i)
    assert fit_table(i, psi + 0.01j * i.real, magnets=False).reciprocity > 0.3
    with pytest.raises(ModelError, match="psi_q falls with i_q"):
        fit_table(i, psi.conj(), magnets=True)
    with pytest.raises(ModelError, match="same i_d"):
        fit_table(1 + 1j * i.imag, psi, magnets=True)
    with pytest.raises(ModelError, match="point 3 of the map is not finite"):
        fit_table(i, np.where(np.arange(400) == 2, np.nan, psi), magnets=False)
    with pytest.raises(ModelError, match="current and flux must have the same size"):
        fit_table(i, psi[:-1], magnets=False)


def test_a_map_that_c_cannot_use_is_refused():
    with pytest.raises(ModelError, match="must not be empty"):
        TableMap(np.array([1.0, 1.0]), np.array([0.0, 1.0]), np.zeros((4, 4, 2)))
    with pytest.raises(ModelError, match="finite"):
        TableMap(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.full((4, 4, 2), np.nan))
    with pytest.raises(ModelError, match="at least one interval"):
        TableMap(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.zeros((2, 4, 2)))
    cage = CageMap(0.02, 0.2, 2.0, 1e-4, 0.9, 0.5, 0.07)
    assert cage.fields()["decay"] == pytest.approx(2.0 * 1e-4 / 0.2)
