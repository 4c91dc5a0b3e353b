"""Excitation weaker than (pe1): both sides of Theorem 6 (docs/theorems.md)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from fluxobs.simulation import precision  # noqa: F401  # enables float64


def gradient_error(phi, h, b, start):
    """Return λ̃ along ``λ̃' = -ΦΦᵀλ̃ + b`` with Φ constant over a step: exact steps.

    phi, b: (rows, 2); returns (rows, 2), the error at the end of each step.
    """

    def body(x, row):
        direction, push = row
        q = direction @ direction
        decay, mean = (
            jnp.exp(-q * h),
            jnp.where(q > 0, -jnp.expm1(-q * h) / jnp.maximum(q, 1e-300), h),
        )
        along = direction / jnp.sqrt(jnp.maximum(q, 1e-300))
        part, force = along @ x, along @ push
        x = x + h * push + along * ((decay - 1) * part + (mean - h) * force)
        return x, x

    return np.asarray(jax.lax.scan(body, jnp.asarray(start), (jnp.asarray(phi), jnp.asarray(b)))[1])


def slowing_rotor(duration, h):
    """Return (t, Φ) of a rotor whose speed falls like t^(-1/2): φ = 2√(1 + t)."""
    t = np.arange(round(duration / h)) * h
    phi = 2 * np.sqrt(1 + t)
    return t, 2 * np.stack([np.cos(phi), np.sin(phi)], axis=1)


def test_a_slowing_rotor_converges_without_a_disturbance_but_not_exponentially():
    """The slow direction decays at ω²/|Φ|², so the error falls like (1 + t)^(-1/|Φ|²)."""
    t, Phi = slowing_rotor(2e4, 0.02)
    error = np.linalg.norm(gradient_error(Phi, 0.02, 0 * Phi, [1.0, -1.0]), axis=1)
    late = t > 1e3
    slope = np.polyfit(np.log(1 + t[late]), np.log(error[late]), 1)[0]
    assert slope == pytest.approx(-1 / 4, rel=0.02)


def filtered_rotor(duration, h):
    """Return (t, Φ_λ) of a rotor φ = (4/3)(1 + t)^(3/4): (p/(p + 1))² of 2e(φ), exact for lines."""
    t = np.arange(round(duration / h)) * h
    phi = 4 / 3 * (1 + t) ** 0.75
    n = 2 * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    decay = np.exp(-h)
    mean = -np.expm1(-h) / h  # p/(p + 1) of a line: the high pass of its slope
    for _ in range(2):
        n = lfilter([mean, -mean], [1, -decay], n, axis=0)
    return t, n


def test_a_constant_bias_makes_the_error_of_a_slowing_rotor_grow():
    h = 0.05
    t, Phi = filtered_rotor(2e4, h)
    late = t > 20  # without the filters' transient
    t, Phi = t[late], Phi[late]
    free = np.linalg.norm(gradient_error(Phi, h, 0 * Phi, [1.0, -1.0]), axis=1)
    ends = [2e2, 2e3, 2e4]
    reached = [free[t < end][-1] for end in ends]
    # A power of t: the same factor in every decade.
    factors = np.divide(reached[1:], reached[:-1])
    assert factors.max() < 0.8
    assert np.ptp(factors) < 0.1
    error = np.linalg.norm(
        gradient_error(Phi, h, np.tile([1e-3, 0.0], (len(t), 1)), [0.0, 0.0]), axis=1
    )
    reached = [error[t < end].max() for end in ends]
    assert np.divide(reached[1:], reached[:-1]).min() > 7


@pytest.mark.parametrize("window", [10.0, 40.0, 160.0])
def test_without_excitation_in_some_window_a_bounded_bias_reaches_half_the_window(window):
    """|λ̃| ≥ T - κγφ T^(3/2) √ε for the bias v of size one, with ∫(Φᵀv)² = ε in the window."""
    h = 0.02
    begin = 16 * window**4  # the rotor has become slow enough
    t = begin + np.arange(round(window / h)) * h
    phi = 2 * np.sqrt(1 + t)
    Phi = 2 * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    values, vectors = np.linalg.eigh(h * Phi.T @ Phi)
    v = vectors[:, 0]
    promised = window - 2 * window**1.5 * np.sqrt(values[0])  # κ = γ = 1, |Φ| = 2
    assert promised > window / 2
    error = gradient_error(Phi, h, np.tile(v, (len(t), 1)), [0.0, 0.0])
    assert np.linalg.norm(error[-1]) >= promised


@pytest.mark.parametrize(("power", "limit"), [(1.5, 0.0), (1.0, 1 / 0.6), (0.7, np.inf)])
def test_integrable_disturbances_vanish_and_no_weaker_class_does(power, limit):
    """``x' = -a x/(1 + t) + (1 + t)^(-r)`` tends to zero for r > 1, 1/a for r = 1, else ∞."""
    a = 0.6

    def exact(t):
        if power == 1.0:
            return (1 - (1 + t) ** -a) / a
        return ((1 + t) ** (1 - power) - (1 + t) ** -a) / (a + 1 - power)

    end = 1e6
    solution = solve_ivp(
        lambda t, x: -a * x / (1 + t) + (1 + t) ** -power, (0, end), [0.0], rtol=1e-9, atol=1e-12
    )
    assert solution.y[0, -1] == pytest.approx(exact(end), rel=1e-5)
    if limit == np.inf:
        assert exact(1e12) > 10 * exact(1e8) / 10**0.1 > 0
    else:
        assert exact(1e30) == pytest.approx(limit, abs=1e-4)


def repaired_run(regressors, h, Gamma, G, error):
    """Return (λ̃, θ̃) of the repaired law for one constant that does not move the flux (Heun).

    regressors: (rows, n + 1); error: (n + 1,) at the start.
    """
    rows = jnp.asarray(regressors)
    n = rows.shape[1] - 1

    def slope(state, row):
        flux, theta, U = state
        Phi, phi = row[:n], row[n]
        e = -(Phi @ flux + phi * theta)
        omega = U @ Phi + phi
        moved = -Gamma * Phi * omega
        rate = G * omega * e
        return Gamma * Phi * e + U * rate, rate, moved

    def body(state, pair):
        first, last = pair
        begun = slope(state, first)
        ahead = jax.tree.map(lambda x, k: x + h * k, state, begun)
        ended = slope(ahead, last)
        state = jax.tree.map(lambda x, k, m: x + h / 2 * (k + m), state, begun, ended)
        return state, jnp.r_[state[0], state[1]]

    start = (jnp.asarray(error[:n]), jnp.asarray(error[n]), jnp.zeros(n))
    return np.asarray(jax.lax.scan(body, start, (rows[:-1], rows[1:]))[1])


def test_constants_need_only_weak_excitation_if_the_flux_is_excited():
    """Φ_λ turns at a constant speed; the constant's regressor fades like t^(-1/2)."""
    h = 0.01
    t = np.arange(round(4e3 / h)) * h
    fading = np.sin(3 * t) / np.sqrt(1 + t)
    rows = np.column_stack([np.cos(t), np.sin(t), fading])
    error = np.abs(repaired_run(rows, h, 1.0, 1.2, np.array([1.0, -0.5, 2.0])))
    late = t[1:] > 100
    theta, flux = error[:, 2], np.linalg.norm(error[:, :2], axis=1)
    slope = np.polyfit(np.log(1 + t[1:][late]), np.log(theta[late]), 1)[0]
    # θ̃' = -G⟨Ω²⟩θ̃ with (1 + t)Ω² → the response of the flux error's filter to sin 3t.
    U = np.zeros(2)
    scaled = []
    for k, time in enumerate(t[: round(40 * np.pi / h)]):
        Phi, drive = rows[k, :2], np.sin(3 * time)
        omega = U @ Phi + drive
        scaled.append(omega)
        U = U - h * Phi * omega
    share = np.mean(np.square(scaled[len(scaled) // 2 :]))
    assert slope == pytest.approx(-1.2 * share, rel=0.05)
    assert flux[-1] < 0.1 * flux[t[1:] > 100][0]
    # Persistent excitation fails: over any window, the mean of Ω² tends to zero.
    assert theta[-1] > 1e-3 * theta[late][0]  # slower than any exponential


def burst_times(count):
    """Return t_k = 2, 4, 16, 256, …: each burst of one second starts at the square of the last."""
    return [2.0 ** (2**k) for k in range(count)]


def test_in_ever_rarer_bursts_the_flux_error_vanishes_and_with_a_drift_it_grows():
    """One flux, Φ = 1 in the bursts and 0 otherwise: attractive, but not with an unknown drift."""
    times = burst_times(6)
    # Without a drift, each burst of one second divides the error by e.
    assert np.exp(-len(times)) < 0.01

    def in_burst(_, state):
        eta, theta, U = state
        return [-eta, -U * (eta + U * theta), 1 - U]

    eta, theta, U, now = 1.0, 0.0, 0.0, 0.0
    repaired, least_squares = [], []
    prior, information = np.eye(2), np.eye(2)
    x0 = np.array([1.0, 0.0])
    for begin in times:
        U += begin - now
        repaired.append(abs(eta + U * theta))
        error = np.linalg.solve(information, prior @ x0)
        least_squares.append(abs(error[0] + begin * error[1]))
        eta, theta, U = solve_ivp(
            in_burst, (0, 1), [eta, theta, U], method="Radau", rtol=1e-10, atol=1e-14
        ).y[:, -1]
        now = begin + 1
        # ∫ (1, s)ᵀ(1, s) ds over the burst
        information = information + np.array(
            [[1, begin + 0.5], [begin + 0.5, ((begin + 1) ** 3 - begin**3) / 3]]
        )
    for errors in (repaired, least_squares):
        assert errors[-1] > 30 * errors[-2] > 100 * errors[-3]
        assert errors[-1] > 1e3
