"""Periodic signals for tests of the regression's analysis."""

import numpy as np

from fluxobs.machines.model.constraint import QuadraticConstraint
from fluxobs.research.regression.periodic import Orbit


def smooth(rng, t, ports, harmonics=3):
    """Return random sums of the first harmonics of a period of 2π, (rows, ports)."""
    phases = np.outer(t, np.arange(1, harmonics + 1))
    return sum(
        part @ rng.standard_normal((harmonics, ports)) for part in (np.cos(phases), np.sin(phases))
    )


def random_orbit(seed, samples, n=2):
    """Return (constraint, orbit, gradient of the relation, t) with random smooth signals.

    Flux and current do not fulfil the relation: statements on regressors hold for any signals.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * 2 * np.pi / samples
    flux, current = smooth(rng, t, n), smooth(rng, t, n)
    order = np.fft.fftfreq(samples, 1 / samples)[:, None]
    rate = np.fft.ifft(np.fft.fft(flux, axis=0) * 1j * order, axis=0).real
    square = rng.standard_normal((n, n))
    constraint = QuadraticConstraint(
        square + square.T, rng.standard_normal((n, n)), np.zeros((n, n))
    )
    gradient = 2 * flux @ constraint.Q1 + current @ constraint.Q2.T
    return constraint, Orbit(2 * np.pi, rate, current), gradient, t
