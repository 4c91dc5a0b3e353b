"""Smoother for any relation against brute force and closed forms (docs/theorems.md, 8 and 9)."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs.errors import ModelError, RecordError
from fluxobs.research import RelationObserver
from fluxobs.research.energies.library import interior_pmsm, surface_pmsm
from fluxobs.research.energies.position import inverse_inductance_by_position
from fluxobs.research.paper import smoothing
from fluxobs.research.paper.levitation import SCENARIOS, record
from fluxobs.research.relation_smoother import integrated_flux, smooth_record

H = 0.1


@cache  # XLA compiles the relation of an observer once
def three_ports(seed, rows=14):
    """Return (observer, v, i) of a machine with three ports and two linear relations."""
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((2, 2, 3))

    def relation(flux, eta, current):
        return jnp.asarray(A) @ flux + jnp.asarray(B) @ current + eta[:1] * jnp.array([1.0, -0.5])

    observer = RelationObserver(
        relation,
        3,
        H,
        flux_prior=[1.0, 2.0, 0.5],
        drift_prior=0.7,
        current_noise=0.05,
        voltage_noise=0.2,
        drift_walk=0.1,
        start=[0.3, -0.2, 0.1],
        moving=[0.2],
        moving_prior=[0.4],
        floor=0.02,
    )
    return observer, A, B, rng.standard_normal((rows, 3)) * 0.1, rng.standard_normal((rows, 3))


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_a_linear_relation_gives_the_weighted_least_squares_of_all_rows(seed):
    observer, A, B, v, i = three_ports(seed)
    rows, size = len(v), 7
    got = smooth_record(observer, v, i)
    x0 = np.r_[0.3, -0.2, 0.1, 0, 0, 0, 0.2]
    F = np.eye(size)
    F[:3, 3:6] = H * np.eye(3)
    H_row = np.zeros((2, size))
    H_row[:, :3], H_row[:, 6] = A, [1.0, -0.5]
    walk = np.r_[np.full(3, (H * 0.2) ** 2), np.full(3, H * 0.1**2)]
    noise = np.linalg.inv(0.05**2 * B @ B.T + 0.02**2 * np.eye(2))
    information, right = np.zeros((rows * size, rows * size)), np.zeros(rows * size)
    prior = np.diag(1 / np.r_[1.0, 2.0, 0.5, 0.7, 0.7, 0.7, 0.4] ** 2)
    information[:size, :size] += prior
    right[:size] += prior @ x0
    for k in range(rows):
        at = slice(k * size, (k + 1) * size)
        information[at, at] += H_row.T @ noise @ H_row
        right[at] += H_row.T @ noise @ -(B @ i[k])
        if k:
            # The coefficient η does not walk: a very small variance stands for zero.
            both = np.hstack([-F, np.eye(size)])
            weight = np.diag(1 / np.r_[walk, 1e-9])
            pair = slice((k - 1) * size, (k + 1) * size)
            information[pair, pair] += both.T @ weight @ both
            right[pair] += both.T @ weight @ np.r_[v[k], np.zeros(4)]
    covariance = np.linalg.inv(information)
    expected = (covariance @ right).reshape(rows, size)
    std = np.sqrt(np.diag(covariance)).reshape(rows, size)
    states = np.hstack([got.flux, got.drift, got.moving])
    assert got.slope_uncertainty == 0
    assert got.valid
    np.testing.assert_allclose(states, expected, rtol=2e-5, atol=5e-6)
    np.testing.assert_allclose(
        np.hstack([got.flux_std, got.drift_std, got.moving_std]), std, rtol=1e-5
    )


def test_the_last_row_of_a_linear_relation_is_that_of_the_filter():
    observer, _, _, v, i = three_ports(0)
    filtered, smoothed = observer.run(v, i), smooth_record(observer, v, i)
    np.testing.assert_allclose(smoothed.flux[-1], filtered.flux[-1], rtol=1e-9)
    np.testing.assert_allclose(smoothed.flux_std[-1], filtered.flux_std[-1], rtol=1e-9)
    assert (smoothed.flux_std[0] < filtered.flux_std[0]).all()


def at_rest(system, flux, q, ripple, noise, seed, rows=400):
    """Return (true position, smoother's result) of a machine at rest whose flux ripples."""
    wave = (-1.0) ** np.arange(rows)[:, None]
    fluxes = flux + wave * ripple
    current = np.asarray(jax.jit(jax.vmap(lambda x: system.current(x, jnp.asarray(q))))(fluxes))
    observer = RelationObserver(
        lambda x, q, i: (system.current(x, q) - i) / noise,
        2,
        1e-4,
        flux_prior=0.1 * np.linalg.norm(flux),
        drift_prior=1e-9,
        current_noise=noise,
        start=flux,
        moving=q + 0.02,
        moving_prior=[0.05],
        floor=1e-6,
    )
    measured = current + noise * np.random.default_rng(seed).standard_normal(current.shape)
    return smooth_record(observer, np.diff(fluxes, axis=0, prepend=fluxes[:1]), measured)


@pytest.mark.slow  # the levitation at rest has the same closed form
@pytest.mark.parametrize("make", [interior_pmsm, surface_pmsm])
def test_a_salient_machine_at_rest_is_known_to_the_closed_form(make):
    """σ_q = σ_i/√Σ|K'Δλ|², and a machine with one inductance learns nothing."""
    q, noise, ripple = np.array([0.3]), 1e-3, 2e-3 * np.array([1.0, 0.4])
    system = make()
    flux = 0.6 * np.asarray(system.flux_range)[1]
    result = at_rest(system, flux, q, ripple, noise, 0)
    K = np.asarray(eqx.filter_jit(inverse_inductance_by_position)(system, flux, q))[..., 0]
    turned = np.sqrt(400) * np.linalg.norm(K @ ripple)
    if make is surface_pmsm:
        # With a known flux, the current shows the position; its error is that of the flux.
        assert turned < 1e-9
        assert result.moving_std[-1, 0] > 0.02
    else:
        assert result.moving_std[-1, 0] == pytest.approx(noise / turned, rel=0.05)
        assert abs(result.moving[-1, 0] - q[0]) < 4 * noise / turned


def test_the_levitation_at_rest_has_the_error_that_it_states():
    got = smoothing.at_rest(runs=12)
    assert got.position_std == pytest.approx(got.bound, rel=1e-3)
    assert got.position == pytest.approx(got.position_std, rel=0.35)
    assert got.flux == pytest.approx(got.flux_std, rel=0.35)
    assert got.flux < 5e-3


def test_the_levitation_from_all_rows_has_the_error_that_it_states():
    base = record(SCENARIOS["S5"], quick=True)
    got = [smoothing.smoothed(base, 4.0, seed) for seed in (1, 21)]
    mean = np.sqrt(np.mean([run.error**2 / run.claimed**2 for run in got]))
    assert 0.6 < mean < 1.4
    assert max(run.error for run in got) < 0.02  # the least squares of this record: 0.04
    assert np.mean([run.within for run in got]) > 0.9
    assert all(run.valid for run in got)


@pytest.mark.slow
def test_the_levitation_without_bias_flux_is_not_sure_and_wrong():
    """In S1 the slope along the weak direction of the flux is as uncertain as it is large."""
    base = record(SCENARIOS["S1"], quick=True)
    for duration, seed in ((2.0, 21), (10.0, 1)):
        got = smoothing.smoothed(base, duration, seed)
        assert not got.valid
        assert got.slope_uncertainty > 0.65


def test_the_integrated_flux_keeps_the_median_of_the_estimates():
    rng = np.random.default_rng(0)
    v = rng.standard_normal((50, 2))
    drift = np.tile([0.3, -0.1], (50, 1))
    true = np.array([1.0, 2.0]) + np.cumsum(v, axis=0) - v[0] + H * np.arange(50)[:, None] * drift
    spoilt = true.copy()
    spoilt[:12] = 0.0
    drift[:12] = 7.0
    np.testing.assert_allclose(integrated_flux(spoilt, drift, v, H), true, atol=1e-12)


def test_bad_arguments_are_named():
    observer, _, _, v, i = three_ports(0)
    with pytest.raises(ModelError, match="odd"):
        smooth_record(observer, v, i, window=2)
    with pytest.raises(ModelError, match=r"\(rows, 3\)"):
        smooth_record(observer, v[:, :2], i)

    def nowhere(flux, eta, current):
        return jnp.reshape(jnp.exp(flux[0]) + 1.0 + 0 * current[0], 1)

    lost = RelationObserver(nowhere, 1, H, 1e3, 1.0, current_noise=0.0, floor=1e-3)
    with pytest.raises(RecordError, match="converge"):
        smooth_record(lost, np.zeros((5, 1)), np.zeros((5, 1)))
