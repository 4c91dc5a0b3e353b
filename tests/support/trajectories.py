"""Smooth closed-form trajectories that satisfy a constraint exactly, in continuous time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from fluxobs import QuadraticConstraint
from fluxobs.research.regression import FilteredRegression
from fluxobs.simulation import precision  # noqa: F401  # float64


@dataclass(frozen=True)
class Case:
    """True flux(t) and current(t); `measured` adds the constant bias and drift."""

    constraint: QuadraticConstraint
    flux: Callable
    current: Callable
    current_bias: np.ndarray
    drift: np.ndarray

    def measured(self, t):
        """Return y_m = λ̇ - θ and i_m = i + δ."""
        rate = jax.jvp(self.flux, (t,), (jnp.ones_like(t),))[1]
        return rate - self.drift, self.current(t) + self.current_bias


def pmsm():
    L, psi = 3e-3, 0.1
    identity = np.eye(2)

    def angle(t):
        return 60 * t + 0.5 * jnp.sin(25 * t)

    def current(t):
        return jnp.array([3 * jnp.sin(40 * t), 2 * jnp.cos(31 * t) + 1])

    def flux(t):
        return L * current(t) + psi * jnp.array([jnp.cos(angle(t)), jnp.sin(angle(t))])

    constraint = QuadraticConstraint(identity, -2 * L * identity, L * L * identity, d=-(psi**2))
    return Case(constraint, flux, current, np.array([0.2, -0.1]), np.array([0.05, 0.08]))


def synrm():
    L_d, L_q = 0.05, 0.01
    identity = np.eye(2)

    def stationary(t, d, q):
        angle = 50 * t + 0.4 * jnp.sin(20 * t)
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        return jnp.array([cos * d - sin * q, sin * d + cos * q])

    def i_d(t):
        return 3 + jnp.sin(17 * t)

    def i_q(t):
        return 2 * jnp.cos(23 * t) + 1

    constraint = QuadraticConstraint(identity, -(L_d + L_q) * identity, L_d * L_q * identity)
    return Case(
        constraint,
        lambda t: stationary(t, L_d * i_d(t), L_q * i_q(t)),
        lambda t: stationary(t, i_d(t), i_q(t)),
        np.array([0.1, -0.05]),
        np.array([0.3, -0.2]),
    )


def maglev():
    k, g = np.array([2.2e-8, 2.0e-8]), 3.3e-4

    def position(t):
        return 1e-4 * jnp.sin(13 * t)

    def flux(t):
        return jnp.array([3e-5 + 1e-5 * jnp.sin(9 * t), 3e-5 + 0.8e-5 * jnp.cos(7 * t)])

    def current(t):
        return flux(t) * (g + jnp.array([-1.0, 1.0]) * position(t)) / k

    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    constraint = QuadraticConstraint(
        g * swap, -np.array([[0.0, k[1]], [k[0], 0.0]]), np.zeros((2, 2))
    )
    return Case(constraint, flux, current, np.array([-3e-3, 2.5e-3]), np.array([1e-6, -2e-6]))


def three_port(seed=3):
    """Random relation with all terms, also C and E; the flux moves on it along one direction."""
    rng = np.random.default_rng(seed)
    Q1, Q2, Q3 = rng.standard_normal((3, 3, 3))
    E, C, along = rng.standard_normal((3, 3))
    Q1 = (Q1 + Q1.T) / 2
    if along @ Q1 @ along < 0:
        along = np.linalg.eigh(Q1)[1][:, -1]
    square = along @ Q1 @ along
    constraint = QuadraticConstraint(Q1, Q2, Q3, E, C, d=-50 * square)

    def current(t):
        return jnp.array([jnp.sin(3 * t), jnp.cos(5 * t), jnp.sin(7 * t + 1)])

    def flux(t):
        base = jnp.array([jnp.cos(2 * t), jnp.sin(4 * t), jnp.cos(6 * t)])
        i = current(t)
        # w at base + x·along is a quadratic in x with a positive discriminant.
        b = 2 * along @ Q1 @ base + along @ Q2 @ i + E @ along
        c = base @ Q1 @ base + base @ Q2 @ i + i @ Q3 @ i + E @ base + C @ i - 50 * square
        return base + (-b + jnp.sqrt(b**2 - 4 * square * c)) / (2 * square) * along

    return Case(
        constraint, flux, current, 0.1 * rng.standard_normal(3), 0.1 * rng.standard_normal(3)
    )


CASES = {"pmsm": pmsm, "synrm": synrm, "maglev": maglev, "three-port": three_port}


def filtered(case: Case, corner: float, times, form="corrected", from_zero=True):
    """Return the regression at `times`; its filters are integrated from times[0] to 1e-13."""
    regression = FilteredRegression(case.constraint, corner, form)

    def field(t, xi, _):
        return regression.derivative(xi, *case.measured(t))

    steps = jnp.linspace(times[0], times[-1], 4000)
    # Steps end at the requested times: interpolation between steps is not exact enough.
    grid = jnp.unique(jnp.concatenate([steps, jnp.asarray(times)]))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Dopri8(),
        times[0],
        times[-1],
        None,
        regression.init(),
        saveat=diffrax.SaveAt(ts=jnp.asarray(times)),
        stepsize_controller=diffrax.StepTo(ts=grid),
        max_steps=len(grid) + 2,
    )
    rows = jax.vmap(lambda xi, t: regression.read_out(xi, case.measured(t)[1]))(
        solution.ys, jnp.asarray(times)
    )
    return rows, jax.vmap(case.flux)(jnp.asarray(times))
