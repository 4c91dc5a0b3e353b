"""Electric-field dual: charge, voltage and conductance replace flux, current and resistance."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ....machines.model.constraint import QuadraticConstraint
from ..system import ElectromechanicalSystem, inertia

EPSILON_0 = 8.8541878128e-12  # F/m, CODATA 2018


def differential_actuator(
    g: float = 2e-6,
    area: float = 4e-8,
    resistance: float = 1e6,
    mass: float = 1e-9,
    damping: float = 1e-6,
    stiffness: float = 1.0,
) -> ElectromechanicalSystem:
    """Plate between two electrodes (MEMS); each electrode is driven through a resistor.

    `flux` is the charge Q [C] and `current` is the voltage v of the capacitor [V], with
    ``Q̇ = (u - v)/resistance``. The system satisfies ``2 g Q₁Q₂ = ε A (v₁Q₂ + v₂Q₁)``.

    Parameters
    ----------
    g, area : float
        Gap [m] and area of a plate [m²].
    resistance : float
        Series resistance of each electrode [Ω].
    mass, damping, stiffness : float
        In [kg], [N s/m] and [N/m].
    """
    k = EPSILON_0 * area

    def electric_energy(charge: jax.Array, position: jax.Array) -> jax.Array:
        gaps = g + jnp.array([-1.0, 1.0]) * position[0]
        return jnp.sum(charge**2 * gaps) / (2 * k)

    spring = inertia(mass)

    def mechanical_energy(position: jax.Array, momentum: jax.Array) -> jax.Array:
        return spring(position, momentum) + stiffness * jnp.sum(position**2) / 2

    size = k / g * 5.0  # five volts
    return ElectromechanicalSystem(
        electric_energy,
        mechanical_energy,
        R=[1 / resistance] * 2,
        R_M=[damping],
        B=jnp.eye(2) / resistance,
        flux_range=(0.1 * size, 2 * size),
        position_range=(-0.8 * g, 0.8 * g),
        name="electrostatic, differential",
    )


def differential_relation(g: float = 2e-6, area: float = 4e-8) -> QuadraticConstraint:
    """``2 g Q₁Q₂ - ε A (v₁Q₂ + v₂Q₁) = 0``."""
    k = EPSILON_0 * area
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    return QuadraticConstraint(g * swap, -k * swap, np.zeros((2, 2)))
