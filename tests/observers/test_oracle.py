"""The C core equals one dense weighted least-squares solution over all past rows.

The oracle shares only the model with the recursion. The oracle stacks all measurements, expresses
each measurement in the present state by products of transitions, weights it by forgetting, adds the
prior and the prior's re-injections likewise, and solves once, in extended precision.
"""

from dataclasses import replace

import numpy as np
import pytest

from fluxobs import LeastSquaresObserver
from fluxobs.machines.model.immersion import Immersion
from support.records import CURRENTS, MACHINES, steady

X = np.longdouble
PERIOD, INTERVAL = 14, 2  # prior re-injection: seven rows in turn, one every other sample


def solve(A, b):
    """Solve least squares by modified Gram-Schmidt, applied twice, in extended precision."""
    A, b = A.copy(), b.copy()
    scale = np.sqrt((A**2).sum(axis=0))
    A /= scale
    n = A.shape[1]
    R = np.eye(n, dtype=X)
    for _ in range(2):
        S = np.zeros((n, n), dtype=X)
        for j in range(n):
            S[j, j] = np.sqrt((A[:, j] ** 2).sum())
            A[:, j] /= S[j, j]
            for k in range(j + 1, n):
                S[j, k] = A[:, j] @ A[:, k]
                A[:, k] -= S[j, k] * A[:, j]
        R = S @ R
    y = A.T @ b
    x = np.zeros(n, dtype=X)
    for j in reversed(range(n)):
        x[j] = (y[j] - R[j, j + 1 :] @ x[j + 1 :]) / R[j, j]
    return x / scale


def dense(observer, volt_seconds, current):
    """Return the estimates (flux, drift) at each row."""
    immersion, h = Immersion(observer.constraint), X(observer.sample_time)
    psi, theta = X(observer.flux_base), X(observer.drift_prior)
    prior = 1 / np.array([psi**2, psi, psi, 2 * psi * theta, theta, theta, theta**2], dtype=X)
    rho = 1 - h / X(observer.memory)
    reinjected = np.sqrt(1 - rho**PERIOD) * prior
    rows, values = np.diag(prior), np.zeros(7, dtype=X)
    estimates = []
    for k, i in enumerate(current.astype(X)):
        if k > 0:
            v = volt_seconds[k].astype(X)
            inverse = immersion.transition(-h, -v)
            rows = np.sqrt(rho) * rows @ inverse
            values = np.sqrt(rho) * values + rows @ immersion.known_input(v)
        row, value = immersion.output_rows(i)
        sigma = X(observer.constraint_noise)
        rows = np.vstack([rows, row / sigma])
        values = np.append(values, value / sigma)
        x = solve(rows, values)
        estimates.append(np.r_[x[1:3], x[4:6]])
        if k % INTERVAL == 0:
            j = k // INTERVAL % 7
            rows = np.vstack([rows, reinjected[j] * np.eye(7, dtype=X)[j]])
            values = np.append(values, reinjected[j] * x[j])
    return np.array(estimates, dtype=float)


@pytest.mark.parametrize("name", MACHINES)
def test_recursion_equals_the_dense_solution(name):
    machine = MACHINES[name]
    rated = machine.rated_current
    samples = steady(
        machine,
        2e-4,
        350 + 150 * np.sin(np.arange(300) / 40),
        300,
        CURRENTS[name],
        current_bias=0.01 * rated * (1 + 0.5j),
        voltage_bias=0.05,
        noise=0.002 * rated,
    )
    # The drift prior is so loose that the observer never widens it.
    observer = LeastSquaresObserver.for_machine(
        machine, sample_time=2e-4, memory=0.02, drift_prior=5.0
    )
    observer = replace(observer, flux_map=None)  # the oracle has no map
    state, estimates = observer.init(), []
    for v, i in zip(samples.volt_seconds, samples.current, strict=True):
        state, estimate = observer.step(state, volt_seconds=v, current=i)
        estimates.append(np.r_[estimate.flux, estimate.drift])
    estimates, expected = (
        np.array(estimates),
        dense(observer, samples.volt_seconds, samples.current),
    )
    size = np.abs(expected).max(axis=0)
    assert np.abs((estimates - expected) / size).max() < 1e-9
