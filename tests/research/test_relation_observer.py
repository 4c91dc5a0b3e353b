"""Non-quadratic relations: unsaturated and saturated switched reluctance, and a cage machine."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs import ModelError
from fluxobs.research.energies.integrate import volt_seconds
from fluxobs.research.energies.library import saturated_switched_reluctance, switched_reluctance
from fluxobs.research.relation_observer import RelationObserver

H, ROWS = 1e-3, 3000
DRIFT = np.array([0.02, -0.03, 0.01])
PSI_S, A, L_0 = 0.5, 0.05, 10e-3


def current_products(x):
    return x[1] * x[2], x[0] * x[2], x[0] * x[1]


def cubic(flux, eta, i):
    """Return the residual of λ1 i2 i3 + λ2 i1 i3 + λ3 i1 i2 = 3 L_0 i1 i2 i3, linear in λ."""
    pairs = jnp.stack(current_products(i))
    return (flux @ pairs - 3 * L_0 * jnp.prod(i))[None]


def saturated(flux, eta, i):
    """Return the residual of the cubic relation in z = -ln(1 - λ/ψ_s) instead of λ."""
    z = -jnp.log1p(-jnp.minimum(flux / PSI_S, 0.99))
    return (z @ jnp.stack(current_products(i)) - 3 * A * jnp.prod(i))[None]


@cache
def current_of(name):
    if name == "saturated":
        return jax.jit(jax.vmap(saturated_switched_reluctance(PSI_S, A).current))
    return jax.jit(jax.vmap(switched_reluctance(L_0).current))


def record(name, size, seed=0, noise=0.0):
    """Return (fluxes of one sign over time, currents from the energy, volt-seconds)."""
    t = H * np.arange(ROWS)
    phase = 2 * np.pi * np.arange(3) / 3
    flux = size * (0.6 + 0.3 * np.sin(37 * t[:, None] + phase) + 0.08 * np.sin(91 * t)[:, None])
    position = (30 * t + 0.5 * np.sin(11 * t))[:, None]
    i = np.asarray(current_of(name)(flux, position))
    rng = np.random.default_rng(seed)
    return flux, i + noise * rng.standard_normal(i.shape), volt_seconds(flux, H, DRIFT)


def test_a_relation_linear_in_flux_is_observed_exactly():
    flux, i, v = record("unsaturated", 0.08)
    observer = RelationObserver(cubic, 3, H, 0.1, 0.1, current_noise=1e-6)
    estimates = observer.run(v, i)
    late = slice(ROWS // 2, None)
    assert np.abs(estimates.flux - flux)[late].max() < 1e-6 * 0.08
    np.testing.assert_allclose(estimates.drift[-1], DRIFT, rtol=1e-4)


@pytest.mark.slow
def test_a_saturated_machine_is_observed_in_linearising_variables():
    flux, i, v = record("saturated", 0.4)

    def run(relation, noise=0.01, iterations=5):
        return RelationObserver(
            relation,
            3,
            H,
            0.1,
            0.1,
            1e-3 if noise else 1e-5,
            voltage_noise=noise,
            drift_walk=noise,
            start=[0.2] * 3,
            iterations=iterations,
        ).run(v, i)

    estimates = run(saturated)
    late = slice(ROWS // 2, None)
    assert np.abs(estimates.flux - flux)[late].max() < 1e-6 * 0.4
    np.testing.assert_allclose(estimates.drift[-1], DRIFT, rtol=1e-4)
    # Without assumed noise, one linearisation at a start wrong by half the flux is not enough.
    assert np.abs(run(saturated, 0.0, 1).flux - flux)[late].max() > 10
    assert np.abs(run(saturated, 0.0, 8).flux - flux)[late].max() < 0.01
    # The unsaturated relation, with the same slope at zero, has a large error.
    wrong = run(
        lambda x, eta, i: (x @ jnp.stack(current_products(i)) - 3 * PSI_S * A * jnp.prod(i))[None]
    )
    assert np.abs(wrong.flux - flux)[late].max() > 0.05 * 0.4


def test_standard_deviations_cover_the_errors_under_noise():
    """Over ten noise seeds, the mean square of error over standard deviation is about one."""
    noise, squares = 0.02, []
    for seed in range(10):
        flux, i, v = record("unsaturated", 0.08, seed, noise)
        estimates = RelationObserver(cubic, 3, H, 0.1, 0.1, noise).run(v, i)
        late = slice(ROWS // 2, None, 100)
        squares.append(np.mean(((estimates.flux - flux) / estimates.flux_std)[late] ** 2))
    assert 0.5 < np.mean(squares) < 2.0


def test_noise_of_the_voltage_is_in_the_standard_deviation():
    """Noise of σ volts per sample changes the flux by h σ; the standard deviation covers this."""
    sigma, squares = 5.0, []
    for seed in range(6):
        flux, i, v = record("unsaturated", 0.08, seed, 0.02)
        noise = H * sigma * np.random.default_rng(100 + seed).standard_normal(v.shape)
        observer = RelationObserver(cubic, 3, H, 0.1, 0.1, 0.02, voltage_noise=sigma)
        estimates = observer.run(v + noise, i)
        late = slice(ROWS // 2, None, 50)
        squares.append(np.mean(((estimates.flux - flux) / estimates.flux_std)[late] ** 2))
    assert 0.4 < np.mean(squares) < 2.0


def test_a_moving_relation_estimates_its_moving_coefficient():
    """The relation |λ - L_σ i|² = η², η' = -α η + R_R i_d starts at a wrong length η."""
    L_sigma, R_R, L_M = 0.01, 2.1, 0.22
    alpha = R_R / L_M
    t = H * np.arange(ROWS)
    i_d = 3 + 1.5 * np.sign(np.sin(5 * t))
    eta = np.empty(ROWS)
    eta[0] = 0.66
    for k in range(1, ROWS):
        mean = R_R * (i_d[k] + i_d[k - 1]) / 2 / alpha
        eta[k] = mean + (eta[k - 1] - mean) * np.exp(-alpha * H)
    turn = np.exp(1j * (80 * t + 0.3 * np.sin(13 * t)))
    i = (i_d + 4j) * turn
    x = eta * turn
    flux = L_sigma * i + x
    pair = lambda z: np.stack([z.real, z.imag], axis=1)  # noqa: E731
    drift = np.array([0.5, -0.3])
    v = volt_seconds(pair(flux), H, drift)

    def relation(flux, eta, i):
        x = flux - L_sigma * i
        return (x @ x - eta[0] ** 2)[None]

    def motion(flux, eta, i):
        x = flux - L_sigma * i
        return -alpha * eta + R_R * (x @ i) / jnp.maximum(jnp.linalg.norm(x), 0.1)

    def run(motion):
        return RelationObserver(
            relation,
            2,
            H,
            0.5,
            1.0,
            1e-3,
            start=pair(flux)[0] + 0.1,
            moving=[0.5],
            moving_prior=[0.3],
            motion=motion,
        ).run(v, pair(i))

    estimates = run(motion)
    late = slice(ROWS // 2, None)
    assert np.abs(estimates.moving[late, 0] - eta[late]).max() < 0.01 * 0.66
    assert np.abs(estimates.flux - pair(flux))[late].max() < 0.004
    np.testing.assert_allclose(estimates.drift[-1], drift, atol=0.02)
    assert estimates.moving_std.shape == (ROWS, 1)
    assert estimates.moving_std[0, 0] > 0.1 > 30 * estimates.moving_std[-1, 0] > 0
    # With a constant length, the error is as large as the variation of the length.
    assert np.abs(run(None).flux - pair(flux))[late].max() > 0.02


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sample_time": 0.0}, "sample_time must be positive"),
        ({"iterations": 0}, "iterations must be at least 1"),
        ({"current_noise": -1.0}, "current_noise must be zero or positive"),
        ({"moving": [1.0]}, "moving and moving_prior must have one shape"),
        ({"relation": lambda x, e, i: x @ i}, r"must return residuals \(r,\), got shape \(\)"),
    ],
)
def test_wrong_arguments(change, message):
    arguments = {
        "relation": cubic,
        "n": 3,
        "sample_time": H,
        "flux_prior": 0.1,
        "drift_prior": 0.1,
        "current_noise": 1e-3,
    }
    with pytest.raises(ModelError, match=message):
        RelationObserver(**(arguments | change))


def test_a_record_of_the_wrong_shape():
    observer = RelationObserver(cubic, 3, H, 0.1, 0.1, 1e-3)
    with pytest.raises(ModelError, match=r"must be \(rows, 3\), got \(5, 2\)"):
        observer.run(np.zeros((5, 2)), np.zeros((5, 3)))
