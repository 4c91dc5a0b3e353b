"""Machines whose inductances vary with position: plungers, sensors, switched reluctance."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ..system import ElectromechanicalSystem, inertia, linear_magnetics


def affine_pair(L_0: float = 10e-3, slope: float = 0.5) -> ElectromechanicalSystem:
    """Two coils with inductances ``L_0 ± slope q`` [H], such as an LVDT or a plunger pair."""
    return ElectromechanicalSystem(
        linear_magnetics(lambda q: jnp.diag(jnp.array([L_0 + slope * q[0], L_0 - slope * q[0]]))),
        inertia(0.1),
        R=[1.0, 1.0],
        R_M=[0.0],
        flux_range=(-0.01, 0.01),
        position_range=(-0.015, 0.015),
        name="affine-inductance pair",
    )


def _phases(position: jax.Array) -> jax.Array:
    return jnp.cos(position[0] - 2 * np.pi / 3 * jnp.arange(3))


def switched_reluctance(L_0: float = 10e-3, L_1: float = 6e-3) -> ElectromechanicalSystem:
    """Three-phase switched reluctance machine, unsaturated: ``L_k = L_0 + L_1 cos(q - 2πk/3)``."""
    return ElectromechanicalSystem(
        linear_magnetics(lambda q: jnp.diag(L_0 + L_1 * _phases(q))),
        inertia(1e-3),
        R=[0.5] * 3,
        R_M=[0.0],
        flux_range=(0.01, 0.1),
        name="three-phase SRM, unsaturated",
    )


def saturated_switched_reluctance(
    psi_s: float = 0.5, a: float = 0.05, b: float = 0.03
) -> ElectromechanicalSystem:
    """SRM with exponential saturation, ``λ_k = ψ_s (1 - exp(-i_k (a + b cos(q - 2πk/3))))``."""

    def magnetic_energy(flux: jax.Array, position: jax.Array) -> jax.Array:
        free = 1 - flux / psi_s
        return jnp.sum(psi_s * (free * jnp.log(free) + flux / psi_s) / (a + b * _phases(position)))

    return ElectromechanicalSystem(
        magnetic_energy,
        inertia(1e-3),
        R=[0.5] * 3,
        R_M=[0.0],
        flux_range=(0.02, 0.45),
        name="three-phase SRM, saturated",
    )
