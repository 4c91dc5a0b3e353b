"""Magnetic levitation and bearings; position is the displacement [m] from mid-gap."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ....machines import MagLev2DOF
from ..system import ElectromechanicalSystem, inertia, linear_magnetics

#: Share of the gap in which positions are drawn.
INSIDE = 0.8


def _coils(
    inductances: Any, gap: float, name: str, ports: int, axes: int = 1, magnet: Any = None
) -> ElectromechanicalSystem:
    """Coils without mutual inductance, λ_k = L_k(q) (i_k + magnet_k), with fluxes of one sign."""
    size = 1e-2
    offset = None
    if magnet is not None:
        offset = lambda q: inductances(q) * jnp.asarray(magnet)  # noqa: E731
    return ElectromechanicalSystem(
        linear_magnetics(lambda q: jnp.diag(inductances(q)), offset),
        inertia([0.5] * axes),
        R=[1.0] * ports,
        R_M=[0.0] * axes,
        flux_range=(0.1 * size, size),
        position_range=(-INSIDE * gap, INSIDE * gap),
        name=name,
    )


def maglev_1dof(k: float = 1e-5, g: float = 1e-3) -> ElectromechanicalSystem:
    """One coil above a body, ``λ = k i / (g - q)``; it has no relation."""
    return _coils(lambda q: jnp.array([k / (g - q[0])]), g, "MagLev, one coil", 1)


def maglev_2dof(machine: MagLev2DOF) -> ElectromechanicalSystem:
    """Opposed coils on a lever, the paper's Section V-B, in canonical port-Hamiltonian form.

    The flux is the linkage ``λ = c φ`` with the force constants c; ``-∇_q H_E`` is then the force
    of Knospe's benchmark. The momentum is p/D, and ``λ̇ = -(c/N) R i + (c/N) u`` (docs/theory.md,
    section 11).
    """
    c, k = np.array([machine.c_1, machine.c_2]), np.array([machine.k_1, machine.k_2])
    g, sign = machine.g, np.array([-1.0, 1.0])

    def magnetic_energy(flux: jax.Array, position: jax.Array) -> jax.Array:
        return jnp.sum(flux**2 * (g + sign * position[0]) / (c * k)) / 2

    size = c * k * 0.5 / g  # half an ampere
    return ElectromechanicalSystem(
        magnetic_energy,
        inertia(machine.J / machine.D**2),
        R=machine.resistance * c / machine.N,
        R_M=[0.0],
        B=np.diag(c / machine.N),
        flux_range=(0.1 * size, 2 * size),
        position_range=(-INSIDE * g, INSIDE * g),
        name="MagLev, opposed coils",
    )


def maglev_as_printed(machine: MagLev2DOF) -> ElectromechanicalSystem:
    """The paper's equations (hmaglev) and (sysmaglev) exactly as printed, for erratum 8.

    The energy lacks the force constants c, and the input lacks 1/N: ``λ̇ = -R/(N c) i + u``. The
    state is still called λ, but the controller uses it as the core flux, as in the paper.
    """
    c, k = np.array([machine.c_1, machine.c_2]), np.array([machine.k_1, machine.k_2])
    g, sign = machine.g, np.array([-1.0, 1.0])
    size = k * 0.5 / g  # half an ampere
    return ElectromechanicalSystem(
        lambda flux, position: jnp.sum(flux**2 * (g + sign * position[0]) / k) / 2,
        inertia(machine.J / machine.D**2),
        R=machine.resistance / (machine.N * c),
        R_M=[0.0],
        flux_range=(0.1 * size, 2 * size),
        position_range=(-INSIDE * g, INSIDE * g),
        name="MagLev as printed",
    )


def maglev_leakage(
    k: tuple[float, float] = (1e-5, 1.2e-5), g: float = 1e-3, leakage: float = 2e-3
) -> ElectromechanicalSystem:
    """Opposed coils with leakage inductance l [H]; their relation has λ - l i instead of λ."""
    return _coils(
        lambda q: jnp.array([k[0] / (g - q[0]), k[1] / (g + q[0])]) + leakage,
        g,
        "MagLev with leakage",
        2,
    )


def maglev_biased(k: float = 1e-5, g: float = 1e-3, magnet: float = 0.8) -> ElectromechanicalSystem:
    """Opposed coils with core magnets of `magnet` ampere; their relation has a linear term E."""
    return _coils(
        lambda q: jnp.array([k / (g - q[0]), k / (g + q[0])]),
        g,
        "MagLev, magnet-biased",
        2,
        magnet=(magnet, magnet),
    )


def four_pole_bearing(k: float = 1e-5, g: float = 1e-3) -> ElectromechanicalSystem:
    """Two pairs of opposed coils, one pair per axis."""
    return _coils(
        lambda q: k / jnp.array([g - q[0], g + q[0], g - q[1], g + q[1]]),
        g,
        "four-pole bearing",
        4,
        axes=2,
    )


def three_coils(k: float = 1e-5, g: float = 1e-3) -> ElectromechanicalSystem:
    """Three coils on one axis with different gaps; any two coils give a relation."""
    return _coils(
        lambda q: jnp.array([k / (g - q[0]), 1.1 * k / (g + q[0]), 0.9 * k / (1.5 * g + q[0])]),
        g,
        "three coils on one axis",
        3,
    )
