"""Lemma 1 on samples, without discretisation error.

The kernel ``g ↔ ((1 - z⁻¹)/(1 - a z⁻¹))²``, a = e^{-νh}, is applied to the constraint at all past
samples. The volt-seconds relate each past flux to the present flux (docs/theory.md, section 8).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...machines.model.constraint import QuadraticConstraint
from ...simulation.precision import real
from .regressors import Regressors


class Moments(NamedTuple):
    """Sums over the past, weighted by a double pole. Each sum has two rows: shape (2, …).

    S is the volt-seconds from a past sample until now, j is that sample's age in samples; a, c and
    i are the known signals at that sample. ``SS`` sums Sᵀ Q1 S.
    """

    one: jax.Array
    j: jax.Array
    jj: jax.Array
    S: jax.Array
    jS: jax.Array
    SS: jax.Array
    a: jax.Array
    ja: jax.Array
    Sa: jax.Array
    c: jax.Array
    i: jax.Array


class SampledRegression(eqx.Module):
    """Exact sampled regression.

    Parameters
    ----------
    constraint : QuadraticConstraint
    corner : float
        ν [rad/s], > 0.
    sample_time : float
        h [s], > 0.
    """

    Q1: jax.Array
    Q2: jax.Array
    Q3: jax.Array
    E: jax.Array
    C: jax.Array
    corner: jax.Array
    sample_time: jax.Array

    def __init__(self, constraint: QuadraticConstraint, corner: float, sample_time: float) -> None:
        for name, value in (("corner", corner), ("sample_time", sample_time)):
            if not value > 0:
                raise ModelError(f"{name} must be positive, got {value}")
        for name in ("Q1", "Q2", "Q3", "E", "C"):
            setattr(self, name, jnp.asarray(getattr(constraint, name)))
        # As arrays, new values do not trigger a compilation.
        self.corner, self.sample_time = jnp.asarray(corner), jnp.asarray(sample_time)

    def init(self) -> Moments:
        """Return the moments of an empty past."""
        n = len(self.E)
        scalar, vector = jnp.zeros(2), jnp.zeros((2, n))
        return Moments(
            scalar, scalar, scalar, vector, vector, scalar, vector, vector, scalar, scalar, vector
        )

    def step(
        self, moments: Moments, volt_seconds: jax.Array, current: jax.Array
    ) -> tuple[Moments, Regressors, tuple[jax.Array, jax.Array]]:
        """Process one sample: the volt-seconds [Wb] of the interval ending now and the current [A].

        Returns
        -------
        moments, regressors
        start : (m0, m1)
            Moments of the kernel so far. They decay within 15/ν … 20/ν. Until then, the regression
            is exact if ``m0 s - h m1 κ`` is added to its right side. s and κ are those of the
            immersion; here, the immersion's E is part of a.
        """
        m, v = moments, volt_seconds
        q = self.Q1 @ v
        # Express the past in the new flux. Order matters: each line uses old values of later lines.
        SS = m.SS + 2 * m.S @ q + m.one * (v @ q)
        Sa = m.Sa + m.a @ v
        jS = m.jS + m.S + (m.j + m.one)[:, None] * v
        S = m.S + m.one[:, None] * v
        ja = m.ja + m.a
        jj = m.jj + 2 * m.j + m.one
        j = m.j + m.one
        zero = jnp.zeros(())
        a_now = self.Q2 @ current + self.E
        c_now = current @ self.Q3 @ current + self.C @ current
        vector = jnp.zeros_like(current)
        inputs = Moments(
            jnp.ones(()), zero, zero, vector, vector, zero, a_now, vector, zero, c_now, current
        )
        aged = Moments(m.one, j, jj, S, jS, SS, m.a, ja, Sa, m.c, m.i)
        pole = jnp.exp(-self.corner * self.sample_time)

        def push(past: jax.Array, new: jax.Array) -> jax.Array:
            first = pole * past[0] + new
            return jnp.stack([first, pole * past[1] + first])

        moments = Moments(*(push(past, new) for past, new in zip(aged, inputs, strict=True)))
        c2, c1, c0 = 1 - 2 / pole + 1 / pole**2, 2 / pole - 2 / pole**2, 1 / pole**2
        G = Moments(
            *(
                c2 * sums[1] + c1 * sums[0] + c0 * new
                for sums, new in zip(moments, inputs, strict=True)
            )
        )
        h = self.sample_time
        regressors = Regressors(
            -(G.SS - G.Sa + G.c),
            -2 * self.Q1 @ G.S + G.a,
            h * (2 * self.Q1 @ G.jS - G.ja),
            -G.S,
            G.i,
            h**2 * G.jj,
        )
        return moments, regressors, (G.one, G.j)

    def run(
        self, volt_seconds: Any, current: Any
    ) -> tuple[Regressors, tuple[jax.Array, jax.Array]]:
        """Process the currents of a record and the volt-seconds before each row, both (rows, n)."""
        v, i = real("volt_seconds", volt_seconds), real("current", current)
        if v.shape != i.shape or v.ndim != 2 or v.shape[1] != len(self.E):
            raise ModelError(
                f"volt_seconds and current must have shape (rows, {len(self.E)}), "
                f"got {v.shape} and {i.shape}"
            )
        return _run(self, v, i)


@eqx.filter_jit
def _run(
    regression: SampledRegression, volt_seconds: jax.Array, current: jax.Array
) -> tuple[Regressors, tuple[jax.Array, jax.Array]]:
    def body(moments: Moments, row: tuple[jax.Array, jax.Array]) -> tuple[Moments, Any]:
        moments, regressors, start = regression.step(moments, *row)
        return moments, (regressors, start)

    _, samples = jax.lax.scan(body, regression.init(), (volt_seconds, current))
    return samples  # type: ignore[no-any-return]
