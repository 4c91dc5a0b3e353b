"""Which motions of a rotor are observable: both sides (docs/theorems.md, Theorem 2)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st


def gramian(t, phi):
    """Return ∫ g gᵀ of (λ, θ, ψ) over a window, the time in its length and from its middle."""
    scaled = (t - (t[0] + t[-1]) / 2) / (t[-1] - t[0])
    e = np.stack([np.cos(phi), np.sin(phi)])
    g = np.concatenate([e, scaled * e, -np.ones((1, len(t)))])
    weights = np.full(len(t), t[1] - t[0])
    weights[[0, -1]] /= 2  # trapezoidal rule
    return (g * weights) @ g.T / (t[-1] - t[0])


def smallest(t, phi):
    return np.linalg.eigvalsh(gramian(t, phi))[0]


def test_the_gramian_at_constant_speed_is_that_of_the_closed_form():
    omega = 3.0
    T = 2 * np.pi / omega
    t = np.linspace(-T / 2, T / 2, 20_001)
    expected = np.zeros((5, 5))
    expected[:2, :2] = T / 2 * np.eye(2)
    expected[:2, 2:4] = expected[2:4, :2] = -T / (4 * omega) * np.array([[0, 1], [1, 0]])
    expected[2:4, 2:4] = T**3 / 24 * np.eye(2) + T / (4 * omega**2) * np.diag([1, -1])
    expected[4, 2:4] = expected[2:4, 4] = -T / omega * np.array([0, 1])
    expected[4, 4] = T
    units = np.diag([1, 1, 1 / T, 1 / T, 1]) / T**0.5
    np.testing.assert_allclose(gramian(t, omega * t), units @ expected @ units, atol=1e-6)
    assert smallest(t, omega * t) > 0.005


@pytest.mark.parametrize("c", [0.0, 0.3, -0.3])
@pytest.mark.parametrize("branch", [1, -1])
def test_most_invisible_motions_turn_by_less_than_half_a_turn(c, branch):
    """φ = β ± arccos(c/|a + b t|) fulfils the condition, and the Gramian is singular."""
    t = np.linspace(-30, 30, 8001)
    line = 1.0 + 1j * t  # a = (1, 0), b = (0, 1)
    phi = np.unwrap(np.angle(line) + branch * np.arccos(c / np.abs(line)))
    assert np.ptp(phi) < np.pi
    assert np.ptp(phi) > 0.9 * np.pi
    assert smallest(t, phi) < 1e-10


def test_a_rotor_at_rest_is_not_observable_and_a_moving_one_is_with_a_known_drift():
    t = np.linspace(0, 1, 501)
    rest = np.full_like(t, 0.7)
    assert smallest(t, rest) < 1e-12
    moving = gramian(t, 0.7 + 0.4 * t)
    known_drift = moving[np.ix_([0, 1, 4], [0, 1, 4])]
    assert np.linalg.eigvalsh(known_drift)[0] > 1e-6


@pytest.mark.parametrize("begin", [-30.0, 0.0])
def test_a_motion_that_turns_by_nearly_a_full_turn_is_invisible(begin):
    """φ = 2 arctan t, also after a rest at φ = 0 until t = 0: the line touches the circle |c|."""
    t = np.linspace(-30, 30, 8001)
    phi = np.where(t < begin, 0.0, 2 * np.arctan(np.maximum(t, begin)))
    phi = phi if begin == 0 else 2 * np.arctan(t)
    assert np.ptp(phi) > 0.95 * (2 * np.pi if begin else np.pi)
    assert smallest(t, phi) < 1e-10
    # A little more than a turn, at the same changes of speed, is seen.
    assert smallest(t, phi * 1.1 * 2 * np.pi / np.ptp(phi)) > 1e-7


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=6), st.floats(2 * np.pi, 6 * np.pi))
def test_a_turn_is_observable_however_the_speed_changes(speeds, turned):
    """Piecewise linear speeds, also through zero and reversed, that cover `turned`."""
    t = np.linspace(0, 1, 4001)
    speed = np.interp(t, np.linspace(0, 1, len(speeds)), speeds)
    phi = np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2)]) * (t[1] - t[0])
    if np.ptp(phi) < 1e-3:
        return
    phi *= turned / np.ptp(phi)
    assert smallest(t, phi) > 1e-9
