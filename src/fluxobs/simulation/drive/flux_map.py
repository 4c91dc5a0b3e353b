"""Flux maps in JAX, equivalent to firmware/fluxobs_map.c, for simulated motors."""

from __future__ import annotations

from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ...machines.model.flux_map import DEGREE, CageMap, FluxMap, TableMap

#: Newton steps from a flux to its current, after which the residual is a rounding error.
NEWTON = 8


class Map(eqx.Module):
    """A :class:`fluxobs.machines.model.flux_map.FluxMap` in JAX; create it with :meth:`of`."""

    cage: bool = eqx.field(static=True)
    is_table: bool = eqx.field(static=True)
    magnets: bool = eqx.field(static=True)
    psi: Array
    L_d: Array
    L_q: Array
    least: Array  # Smallest i_d and i_q (2,) [A].
    most: Array  # Largest i_d and i_q (2,) [A].
    over: Array  # Intervals per ampere (2,).
    coefficients: Array  # Shape (d, q, 2).

    @classmethod
    def of(cls, flux_map: FluxMap) -> Self:
        """Convert a map to JAX."""
        fields: dict[str, Any] = flux_map.core()
        ends = {
            name: jnp.asarray([fields[f"{name}_d"], fields[f"{name}_q"]], float)
            for name in ("least", "most", "over")
        }
        numbers = {
            name: jnp.asarray(fields[name], float) for name in ("psi", "L_d", "L_q", "coefficients")
        }
        table = isinstance(flux_map, TableMap)
        return cls(
            cage=isinstance(flux_map, CageMap),
            is_table=table,
            magnets=flux_map.magnets,
            **ends,
            **numbers,
        )

    def at(self, current: Array, rotor_flux: Array | float = 0.0) -> tuple[Array, Array, Array]:
        """Return (flux, its derivative by i_d, its derivative by i_q) at a current d + j q.

        `rotor_flux` [Wb] is the rotor flux of a cage.
        """
        if not self.is_table:
            psi = rotor_flux if self.cage else self.psi
            flux = jax.lax.complex(psi + self.L_d * current.real, self.L_q * current.imag)
            zero = jnp.zeros_like(self.L_d)
            return flux, jax.lax.complex(self.L_d, zero), jax.lax.complex(zero, self.L_q)
        i = jnp.stack([current.real, current.imag])
        inside = jnp.clip(i, self.least, self.most)
        intervals = jnp.array(self.coefficients.shape[:2]) - DEGREE
        scaled = (inside - self.least) * self.over
        first = jnp.clip(scaled.astype(int), 0, intervals - 1)
        values, slopes = _weights(scaled - first)
        slopes = slopes * self.over[:, None]
        local = jax.lax.dynamic_slice(self.coefficients, (*first, 0), (DEGREE + 1, DEGREE + 1, 2))
        c = jax.lax.complex(local[..., 0], local[..., 1])
        along_q = c @ values[1].astype(c.dtype)
        flux = values[0] @ along_q
        by_d, by_q = slopes[0] @ along_q, values[0] @ (c @ slopes[1].astype(c.dtype))
        beyond = i - inside
        return flux + beyond[0] * by_d + beyond[1] * by_q, by_d, by_q

    def current(self, flux: Array, L_d: Array, L_q: Array) -> Array:
        """Return the current at a flux, in rotor coordinates.

        Newton's method starts from the linear machine.
        """
        start = jax.lax.complex((flux.real - self.psi) / L_d, flux.imag / L_q)

        def step(_: Any, i: Array) -> Array:
            mapped, by_d, by_q = self.at(i)
            error = flux - mapped
            det = by_d.real * by_q.imag - by_d.imag * by_q.real
            return i + jax.lax.complex(
                (by_q.imag * error.real - by_q.real * error.imag) / det,
                (by_d.real * error.imag - by_d.imag * error.real) / det,
            )

        current: Array = start
        for k in range(NEWTON):
            current = step(k, current)
        return current


def _weights(t: Array) -> tuple[Array, Array]:
    """Return (values, derivatives) of the three splines at t in [0, 1], each (..., 3)."""
    u = 1 - t
    values = [u * u / 2, 1 / 2 + t * u, t * t / 2]
    slopes = [-u, u - t, t]
    return jnp.stack(values, -1), jnp.stack(slopes, -1)
