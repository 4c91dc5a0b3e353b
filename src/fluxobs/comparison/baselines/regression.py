"""Observers on the paper's regression (PEBO, DREM), run sample by sample."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ...machines.model.constraint import QuadraticConstraint
from ...research.regression import SampledRegression
from ...research.regression.sampled import Moments
from ...simulation.drive.vectors import pair, vector
from .base import Baseline, Guess, PllState, angle, leaf, pll, pll_start


class RegressionState(NamedTuple):
    moments: Moments
    observer: Any
    k: Array
    pll: PllState


class OnRegression(Baseline):
    """An observer of :mod:`fluxobs.research.regression.laws` on the exact sampled regression.

    The start-up of the regression's filters, a time of 15/corner, is ignored.

    Parameters
    ----------
    constraint : QuadraticConstraint
        Relation of the machine's flux and current.
    observer : FluxObserver
        PEBO, DREM, …
    corner : float
        ν of the regression's filters [rad/s].
    bandwidth : float
        Bandwidth of the phase-locked loop for the speed [rad/s].
    """

    regression: SampledRegression
    observer: Any
    bandwidth: Array

    def __init__(
        self,
        motor: Any,
        sample_time: Any,
        constraint: QuadraticConstraint,
        observer: Any,
        corner: float,
        bandwidth: Any,
    ) -> None:
        self.motor, self.sample_time = motor, leaf(sample_time)
        self.regression = SampledRegression(constraint, corner, float(sample_time))
        self.observer, self.bandwidth = observer, leaf(bandwidth)

    def start(self) -> RegressionState:
        return RegressionState(
            self.regression.init(), self.observer.init(), jnp.zeros(()), pll_start()
        )

    def advance(
        self,
        state: RegressionState,
        voltage: Array,
        volt_seconds: Array,
        current: Array,
        previous: Array,
    ) -> tuple[RegressionState, Guess]:
        h = self.sample_time
        v = pair(volt_seconds)
        moments, row, _ = self.regression.step(state.moments, v, pair(current))
        weight = jnp.where(state.k * h * self.regression.corner > 15.0, 1.0, 0.0)
        row = jax.tree.map(lambda leaf: weight * leaf, row)
        observer = self.observer.step(state.observer, h, v, row)
        flux = vector(self.observer.estimate(observer)[0])
        theta = angle(self.active(flux, current))
        loop = pll(state.pll, theta, self.bandwidth, h)
        return RegressionState(moments, observer, state.k + 1, loop), Guess(
            theta, loop.speed, flux, loop.theta
        )
