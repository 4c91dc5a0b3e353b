"""Steps of the fit behind `check`, each compared with a direct computation."""

import numpy as np
import pytest

from fluxobs.checking.relation import (
    INVERTER,
    PSI,
    L,
    Prior,
    R,
    RelationResidual,
    SegmentRows,
    _initial_flux,
    integrate_segments,
    paired_rows,
)
from fluxobs.checking.segments import Segments
from fluxobs.machines import example
from fluxobs.machines.model.inverter import inverter_direction
from support.records import PMSM

H = 1e-4
TIGHT = Prior(np.zeros(4), np.diag([16.0, 44.0, 156.0, 100.0]))
IPM, SYNRM = example("ipm-2kw2"), example("synrm-6kw7")
RNG = np.random.default_rng(5)


def test_paired_rows_reach_from_the_first_to_the_last_row():
    rows = paired_rows(1001, 1)
    assert len(rows) == 200
    assert (rows[0], rows[-1]) == (0, 1000)
    np.testing.assert_array_equal(rows[1::2], rows[::2] + 1)
    assert set(np.diff(rows[::2])) <= {10, 11}
    np.testing.assert_array_equal(paired_rows(8, 1), [0, 1, 2, 3, 4, 5, 6, 7])
    assert len(paired_rows(200, 1)) == len(paired_rows(201, 1)) == 200
    assert len(paired_rows(199, 1)) == 198
    rows = paired_rows(1001, 4)
    assert (rows[0], rows[-1]) == (0, 1000)
    np.testing.assert_array_equal(rows[1::2], rows[::2] + 4)


def test_integrals_start_at_the_first_row():
    shape = (2, 30)
    current = RNG.standard_normal(shape) + 1j * RNG.standard_normal(shape)
    voltage = RNG.standard_normal(shape) + 1j * RNG.standard_normal(shape)
    data = Segments(H, current, {0: voltage}, None)
    integrated = integrate_segments(data, voltage, current, 0.3)
    rows = paired_rows(30, 1)
    np.testing.assert_allclose(integrated.t, np.tile(H * rows, (2, 1)))
    np.testing.assert_array_equal(integrated.current, current[:, rows])
    assert integrated.size == pytest.approx(np.abs(voltage).mean())
    for k in range(2):
        padded = np.concatenate([np.full(3, current[k, 0]), current[k]])
        # Mean, over the last interval, of the cubic through four samples.
        cubics = (np.polyint(np.polyfit(range(4), padded[n : n + 4], 3)) for n in range(30))
        mean = np.array([np.polyval(cubic, 3) - np.polyval(cubic, 2) for cubic in cubics])
        signs = inverter_direction(np.stack([mean.real, mean.imag], 1), 0.3) @ [1, 1j]
        integrals = [
            (integrated.voltage, voltage[k]),
            (integrated.charge, mean),
            (integrated.inverter, signs),
        ]
        for result, values in integrals:
            total = np.array([H * values[1 : n + 1].sum() for n in rows])
            np.testing.assert_allclose(result[k], total, atol=1e-15)


def circles(centre, slope, radius=0.4):
    t = np.tile(np.linspace(0, 0.05, 60), (len(centre), 1))
    turn = radius * np.exp(1j * (np.array([[0.3], [1.0]]) + np.array([[150.0], [-200.0]]) * t))
    return turn - centre[:, None] - slope[:, None] * t, t


def test_the_start_is_exact_on_circles():
    centre, slope = np.array([0.1 + 2j, -3.0]), np.array([2.0 - 1j, 0.5j])
    y, t = circles(centre, slope)
    first, drift, misfit = _initial_flux(y, t)
    np.testing.assert_allclose(first[:, 0], centre)
    np.testing.assert_allclose(drift[:, 0], slope, atol=1e-9)
    assert misfit < 1e-20


def test_the_misfit_of_an_ellipse():
    """Mean squared residual of |x|² divided by |x|⁴: scale and offset have no effect."""
    y, t = circles(np.zeros(2), np.zeros(2))
    ellipse = y.real + 0.9j * y.imag
    misfit = _initial_flux(ellipse, t)[2]
    assert 1e-5 < misfit < 5e-3
    assert _initial_flux(1e3 * ellipse + 7j, t)[2] == pytest.approx(misfit)
    # The misfit, computed by least squares over the same unknowns.
    losses, squares = [], []
    for z in ellipse:
        z, s = z - z.mean(), t[0] / t[0, -1]
        A = np.stack([2 * z.real, 2 * z.imag, 2 * s * z.real, 2 * s * z.imag, s**0, s, s**2], 1)
        x, *_ = np.linalg.lstsq(A, -(np.abs(z) ** 2), rcond=None)
        losses.append(np.mean((np.abs(z) ** 2 + A @ x) ** 2))
        squares.append(np.mean(np.abs(z + x[0] + 1j * x[1] + s * (x[2] + 1j * x[3])) ** 2))
    assert misfit == pytest.approx(np.mean(losses) / np.mean(squares) ** 2)


def record(machine, i_dq=2 + 3j, inverter=0.0, noise=0.0, speeds=(200.0, -300.0, 120.0)):
    """Return exactly integrated rows of a flux that rotates at constant speed."""
    t = np.tile(H * np.arange(600.0), (len(speeds), 1))
    theta = np.array(speeds)[:, None] * t + np.arange(len(speeds))[:, None]
    turn = np.exp(1j * theta)
    # A different operating point for each segment identifies all parameters.
    i = i_dq * np.linspace(0.4, 1, len(speeds))[:, None] * turn
    L_d, L_q = machine.L_dq
    magnet_flux = machine.magnet_flux or 0.0
    if machine.saturation is None:
        dq = i / turn
        flux = (magnet_flux + L_d * dq.real + 1j * L_q * dq.imag) * turn
    else:
        flux = machine.saturation.table.flux(i / turn) * turn
    charge = (i / (1j * np.array(speeds)[:, None])) - (i / (1j * np.array(speeds)[:, None]))[:, :1]
    sign = np.conj(turn) * H  # any signal that differs from the other signals
    sign = np.cumsum(sign, axis=1) - sign[:, :1]
    size = 100.0
    voltage = flux - flux[:, :1] + machine.R_s * charge + inverter * size * sign
    rows = paired_rows(600, 1)
    i = i + noise * (RNG.standard_normal(i.shape) + 1j * RNG.standard_normal(i.shape))
    cut = [values[:, rows] for values in (t, i, voltage, charge, sign)]
    return SegmentRows(*cut, size), turn[:, rows], flux[:, :1]


@pytest.mark.parametrize("machine", [PMSM, IPM, SYNRM, example("ipm-5kw6")])
def test_right_parameters_leave_no_residual(machine):
    data, turn, _ = record(machine)
    fit = RelationResidual(machine, data, 0.0).fit(TIGHT, np.zeros(4))
    assert fit.share < 2e-3
    np.testing.assert_allclose(fit.values, 0.0, atol=0.02)
    error = np.angle(fit.position / turn)
    error = error if machine.magnets else np.angle((fit.position / turn) ** 2) / 2
    assert np.abs(error).max() < 0.02


def test_wrong_parameters_are_found():
    data, _, _ = record(PMSM, inverter=0.03)
    scaled = PMSM.with_values(R_s=PMSM.R_s / 1.1, L_s=PMSM.L_s / 0.95, psi_f=PMSM.psi_f / 1.05)
    loose = Prior(np.zeros(4), 1e-6 * np.eye(4))
    fit = RelationResidual(scaled, data, 0.0).fit(loose, np.zeros(4))
    values = [np.log(1.1), np.log(0.95), np.log(1.05), 0.03]
    np.testing.assert_allclose(fit.values, values, atol=2e-3)


def full_step(relation, point, prior):
    """Return the Gauss-Newton step: λ₀ and θ of each segment, then the parameters."""
    columns = relation._columns(point)
    P, M, _ = columns.shape
    n = 4 * P + 4
    J, r = np.zeros((P * M, n)), np.zeros(P * M)
    for p in range(P):
        block = slice(p * M, (p + 1) * M)
        J[block, 4 * p : 4 * p + 4] = columns[p, :, :4]
        J[block, -4:] = columns[p, :, 4:8]
        r[block] = columns[p, :, 8]
    H, g = J.T @ J, J.T @ r
    tight = 1 / (0.03 * relation.data.size)
    for p in range(P):
        for k, drift in ((2, point.drift[p].real), (3, point.drift[p].imag)):
            H[4 * p + k, 4 * p + k] += tight**2
            g[4 * p + k] += tight * drift
    H[-4:, -4:] += prior.precision
    g[-4:] += prior.precision @ point.deviation
    return np.linalg.solve(H, -g), np.linalg.inv(H)[-4:, -4:]


def point(machine, prior=TIGHT):
    data, _, _ = record(machine, noise=0.05)
    relation = RelationResidual(machine, data, 0.05)
    values = np.array([0.05, -0.04, 0.03, 0.01])
    shape = (len(data.t), 1)
    rng = np.random.default_rng(2)
    first = np.full(shape, 0.2) + 0.1 * rng.standard_normal(shape)
    slope = 0.3 * rng.standard_normal(shape) + 0.2j
    return (
        relation,
        values,
        relation._linearise(values, first, slope, machine.magnet_flux or 0.4, prior),
        slope,
    )


@pytest.mark.parametrize("machine", [PMSM, IPM])
def test_a_step_equals_that_of_the_whole_system(machine):
    prior = Prior(np.array([0.1, 0.0, -0.1, 0.02]), TIGHT.precision + 3)
    relation, _, linearised, _ = point(machine, prior)
    step, (first, slope) = relation._step(linearised, prior)
    whole, covariance = full_step(relation, linearised, prior)
    np.testing.assert_allclose(step, whole[-4:], rtol=1e-5)
    moves = whole[:-4].reshape(-1, 4)
    np.testing.assert_allclose(first[:, 0], moves[:, 0] + 1j * moves[:, 1], rtol=1e-4)
    np.testing.assert_allclose(slope[:, 0], moves[:, 2] + 1j * moves[:, 3], rtol=1e-4)
    covariance_of_step = np.linalg.inv(relation._information(linearised)[0] + prior.precision)
    np.testing.assert_allclose(covariance_of_step, covariance, rtol=1e-4, atol=1e-12)


def test_the_cost_of_a_point():
    """The distance adds squared drifts, relative to 3 % of the voltage, and squared deviations."""
    prior = Prior(np.array([0.1, 0.0, -0.1, 0.02]), TIGHT.precision)
    relation, values, linearised, slope = point(PMSM, prior)
    drift = np.sum(np.abs(slope / (0.03 * relation.data.size)) ** 2)
    deviation = values - prior.mean
    assert linearised.cost - linearised.misfit == pytest.approx(
        drift + deviation @ prior.precision @ deviation
    )
    psi = PMSM.psi_f * np.exp(values[PSI])
    residual = np.abs(linearised.position.x) - psi
    size = np.sqrt(np.mean(np.abs(linearised.position.x) ** 2))
    assert linearised.share == pytest.approx(
        np.sqrt(np.mean(np.minimum(abs(residual), size) ** 2)) / size
    )


@pytest.mark.parametrize("name", ["ipm-5kw6", "ipm-2kw2", "pmsm-2kw2"])
def test_derivatives_of_the_length(name):
    """The derivatives by flux and by inductances equal finite differences."""
    machine = example(name)
    data, _, start = record(machine)
    relation = RelationResidual(machine, data, 0.0)
    psi = machine.magnet_flux
    values = np.zeros(4) if relation.table else np.array([0.0, 0.05, 0.0, 0.0])
    flux = relation._integral(values) + start

    def length(flux, values):
        position = relation._position(flux, values, psi)
        return np.abs(position.x) - position.from_current

    position = relation._position(flux, values, psi)
    small = 1e-6
    for change, derivative in ((1, position.to_flux.real), (1j, position.to_flux.imag)):
        slope = (length(flux + small * change, values) - length(flux, values)) / small
        np.testing.assert_allclose(derivative, slope, atol=0.06 if relation.table else 1e-4)
    more = values + small * np.eye(4)[L]
    slope = (length(flux, more) - length(flux, values)) / small
    tolerance = (0.06 if relation.table else 1e-4) * np.abs(slope).max()
    np.testing.assert_allclose(position.by_scale, slope, atol=tolerance)


@pytest.mark.parametrize(("degrees", "known"), [(88.0, False), (92.0, True)])
def test_less_than_a_quarter_turn_gives_no_position(degrees, known):
    data, _, _ = record(PMSM, speeds=(np.radians(degrees) / (599 * H),) * 3)
    fit = RelationResidual(PMSM, data, 0.0).fit(TIGHT, np.zeros(4))
    assert np.isfinite(fit.share) == np.isfinite(fit.misfit) == known


def test_a_fit_is_a_minimum_with_an_inverter_voltage_of_at_least_zero():
    data, _, _ = record(PMSM, inverter=-0.02, noise=0.05)
    relation = RelationResidual(PMSM, data, 0.05)
    fit = relation.fit(TIGHT, np.zeros(4))
    assert fit.values[INVERTER] == 0.0
    assert np.all(fit.std[[R, L, PSI, INVERTER]] <= [0.2501, 0.1508, 0.0801, 0.1001])
    refit = relation.fit(TIGHT, fit.values)
    assert refit.misfit + refit.distance == pytest.approx(fit.misfit + fit.distance, abs=0.02)
