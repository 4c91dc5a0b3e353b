"""Rotating machines as energies in stationary coordinates; the position is the mechanical angle."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..system import ElectromechanicalSystem, inertia, linear_magnetics


def unit(angle: jax.Array) -> jax.Array:
    """Return ``(cos, sin)``."""
    return jnp.array([jnp.cos(angle), jnp.sin(angle)])


def turn(angle: jax.Array) -> jax.Array:
    """Return the (2, 2) rotation matrix."""
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    return jnp.array([[cos, -sin], [sin, cos]])


def _range(flux: Any) -> dict[str, Any]:
    return {"flux_range": (-np.asarray(flux), np.asarray(flux))}


def surface_pmsm(
    R_s: float = 0.36,
    L_s: float = 0.6e-3,
    psi_f: float = 0.0125,
    n_p: int = 4,
    J: float = 3e-5,
    friction: float = 1e-5,
) -> ElectromechanicalSystem:
    """Surface PMSM in αβ, ``λ = L_s i + ψ_f e(n_p q)`` (the paper's Section V-A).

    Units: R_s [Ω], L_s [H], psi_f [Wb], J [kg m²], friction [N m s]. Torques are in two-phase
    power-invariant coordinates, as in the paper.
    """
    return ElectromechanicalSystem(
        linear_magnetics(lambda q: L_s * jnp.eye(2), lambda q: psi_f * unit(n_p * q[0])),
        inertia(J),
        R=[R_s, R_s],
        R_M=[friction],
        name="surface PMSM",
        **_range(2 * psi_f),
    )


def salient_pmsm(
    R_s: float,
    L_d: float,
    L_q: float,
    psi_f: float,
    n_p: int,
    J: float,
    friction: float,
    name: str,
) -> ElectromechanicalSystem:
    """Salient PMSM, ``λ = T diag(L_d, L_q) Tᵀ i + ψ_f e``, where T rotates by n_p q."""

    def inductance(q: jax.Array) -> jax.Array:
        T = turn(n_p * q[0])
        return T @ jnp.diag(jnp.array([L_d, L_q])) @ T.T

    return ElectromechanicalSystem(
        linear_magnetics(inductance, lambda q: psi_f * unit(n_p * q[0])),
        inertia(J),
        R=[R_s, R_s],
        R_M=[friction],
        name=name,
        **_range(2 * (psi_f or L_d)),
    )


def interior_pmsm(
    R_s: float = 0.02,
    L_d: float = 0.2e-3,
    L_q: float = 0.5e-3,
    psi_f: float = 0.07,
    n_p: int = 4,
    J: float = 0.05,
    friction: float = 1e-3,
) -> ElectromechanicalSystem:
    """Interior PMSM in αβ; it has no quadratic relation, but a relation of degree four."""
    return salient_pmsm(R_s, L_d, L_q, psi_f, n_p, J, friction, "interior PMSM")


def synchronous_reluctance(
    R_s: float = 0.5,
    L_d: float = 0.05,
    L_q: float = 0.01,
    n_p: int = 2,
    J: float = 0.01,
    friction: float = 1e-3,
) -> ElectromechanicalSystem:
    """Synchronous reluctance machine in αβ."""
    return salient_pmsm(R_s, L_d, L_q, 0.0, n_p, J, friction, "synchronous reluctance")


def five_phase_pmsm(
    L_1: float = 2e-3,
    L_3: float = 1e-3,
    psi_1: float = 0.05,
    psi_3: float = 0.01,
    phase_3: float = 0.4,
    n_p: int = 3,
) -> ElectromechanicalSystem:
    """Five-phase PMSM with third-harmonic magnets in the planes (α₁, β₁) and (α₃, β₃)."""
    return ElectromechanicalSystem(
        linear_magnetics(
            lambda q: jnp.diag(jnp.array([L_1, L_1, L_3, L_3])),
            lambda q: jnp.concatenate(
                [psi_1 * unit(n_p * q[0]), psi_3 * unit(3 * n_p * q[0] + phase_3)]
            ),
        ),
        inertia(1e-3),
        R=[0.2] * 4,
        R_M=[1e-4],
        name="five-phase PMSM, third harmonic",
        **_range([0.1, 0.1, 0.02, 0.02]),
    )


def wound_field(
    L_d: float = 8e-3, L_q: float = 5e-3, L_F: float = 0.6, M: float = 0.05, n_p: int = 2
) -> ElectromechanicalSystem:
    """Salient wound-field synchronous machine with a field port; its ports are (α, β, F).

    Vectors are power-invariant (f = 1): otherwise no energy gives these inductances.
    """
    rotor = jnp.array([[L_d, 0.0, M], [0.0, L_q, 0.0], [M, 0.0, L_F]])

    def inductance(q: jax.Array) -> jax.Array:
        T = jnp.eye(3).at[:2, :2].set(turn(n_p * q[0]))
        return T @ rotor @ T.T

    return ElectromechanicalSystem(
        linear_magnetics(inductance),
        inertia(0.1),
        R=[0.1, 0.1, 5.0],
        R_M=[1e-2],
        name="wound field, salient",
        **_range([0.3, 0.3, 3.0]),
    )


def doubly_fed(
    L_s: float = 0.12, L_r: float = 0.11, M: float = 0.1, n_p: int = 2
) -> ElectromechanicalSystem:
    """Induction machine with ports (α_s, β_s, α_r, β_r); the rotor ports are in rotor axes.

    Both windings have ports; for a cage machine, leave the rotor ports unmeasured.
    """

    def inductance(q: jax.Array) -> jax.Array:
        T = M * turn(n_p * q[0])
        return jnp.block([[L_s * jnp.eye(2), T], [T.T, L_r * jnp.eye(2)]])

    return ElectromechanicalSystem(
        linear_magnetics(inductance),
        inertia(0.05),
        R=[0.5, 0.5, 0.4, 0.4],
        R_M=[1e-3],
        name="doubly fed induction",
    )
