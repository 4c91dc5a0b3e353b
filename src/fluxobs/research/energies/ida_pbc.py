"""Passivity-based controller of the levitation benchmark for the consistent model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from ...errors import ModelError
from ...machines import MagLev2DOF


class IdaPbc(eqx.Module):
    """Interconnection and damping assignment for two opposed coils (the paper's Section V-B).

    States are core fluxes φ [Wb], position q [m] and angular momentum p = J Θ̇ [kg m²/s]. With
    constant references, the closed loop has the energy :meth:`shaped_energy` and, in the
    coordinates (φ, q, p), the dissipation ``diag(R/(N c_1), R/(N c_2), R_a, 0)``; with the angle
    Θ = q/D instead of q, the third entry is ``R_a/D²``.

    Parameters
    ----------
    machine : MagLev2DOF
    alpha, beta, R_a, G : float
        Conditions: α > 0 > β, R_a > 0, G > 0.
    flux_reference : callable
        Function t → φ_2* [Wb], >= 0. At φ_2* = 0, the shaped energy has no minimum and the loop is
        unstable.
    position_reference : callable
        Function t → q* [m].
    form : {"corrected", "printed"}
        "printed" uses the paper's third term of z̃₂, D (q - q*) (erratum 8).

    References
    ----------
    H. Rodriguez, R. Ortega, I. Mareels, "A novel passivity-based controller for an active magnetic
    bearing benchmark experiment", American Control Conference, 2000. Corrected: docs/errata.md, 8.
    """

    machine: MagLev2DOF = eqx.field(static=True)
    alpha: Any
    beta: Any
    R_a: Any
    G: Any
    flux_reference: Callable[[Any], Any]
    position_reference: Callable[[Any], Any]
    form: Literal["corrected", "printed"] = eqx.field(static=True, default="corrected")

    def __check_init__(self) -> None:
        if not (self.alpha > 0 > self.beta and self.R_a > 0 and self.G > 0):
            raise ModelError(
                f"IDA-PBC needs alpha > 0 > beta, R_a > 0 and G > 0, got alpha = {self.alpha:g}, "
                f"beta = {self.beta:g}, R_a = {self.R_a:g}, G = {self.G:g}"
            )

    def _references(self, t: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        m = self.machine
        phi_2 = jnp.asarray(self.flux_reference(t))
        phi_1 = jnp.sqrt(m.k_1 * m.c_2 / (m.k_2 * m.c_1)) * phi_2
        return phi_1, phi_2, jnp.asarray(self.position_reference(t))

    def z_2(self, t: Any, flux: jax.Array, position: jax.Array, momentum: jax.Array) -> jax.Array:
        """z̃₂ of the paper; its third term is ``D (Θ - Θ*) = q - q*``."""
        phi_1, phi_2, q = self._references(t)
        D = self.machine.D
        lever = D if self.form == "printed" else 1.0
        return jnp.asarray(
            D / (2 * self.alpha) * (flux[0] - phi_1)
            + D / (2 * self.beta) * (flux[1] - phi_2)
            + lever * (position - q)
            + self.R_a / D * momentum
        )

    def __call__(
        self, t: Any, flux: jax.Array, position: jax.Array, momentum: jax.Array
    ) -> jax.Array:
        """Return the voltages u (2,) [V]."""
        m = self.machine
        _, phi_2, _ = self._references(t)
        star = m.c_2 * phi_2**2 / (2 * m.k_2)
        z, R = self.z_2(t, flux, position, momentum), m.resistance
        u_1 = (
            R * (m.g - position) / m.k_1 * flux[0]
            - R * m.D / (self.alpha * m.c_1) * (m.c_1 * flux[0] ** 2 / (2 * m.k_1) - star)
            - (R * m.D / (2 * self.alpha * m.c_1) + m.N * self.alpha * self.R_a / m.D) * self.G * z
            - m.N * self.alpha / m.J * momentum
        )
        u_2 = (
            R * (m.g + position) / m.k_2 * flux[1]
            + R * m.D / (self.beta * m.c_2) * (m.c_2 * flux[1] ** 2 / (2 * m.k_2) - star)
            - (R * m.D / (2 * self.beta * m.c_2) + m.N * self.beta * self.R_a / m.D) * self.G * z
            - m.N * self.beta / m.J * momentum
        )
        return jnp.array([u_1, u_2])

    def shaped_energy(
        self, t: Any, flux: jax.Array, position: jax.Array, momentum: jax.Array
    ) -> jax.Array:
        """Return H_d [J]; it decreases along the closed loop if the references are constant."""
        m = self.machine
        _, phi_2, _ = self._references(t)
        star = m.c_2 * phi_2**2 / (2 * m.k_2)
        z = self.z_2(t, flux, position, momentum)
        return jnp.asarray(
            m.D / self.alpha * (m.c_1 * flux[0] ** 3 / (6 * m.k_1) - star * flux[0])
            - m.D / self.beta * (m.c_2 * flux[1] ** 3 / (6 * m.k_2) - star * flux[1])
            + self.G * z**2 / 2
            + momentum**2 / (2 * m.J)
        )
