"""Erratum 8: the levitation and its controller, exactly as printed in the paper."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..energies.ida_pbc import IdaPbc
from ..energies.integrate import Control, poles
from ..energies.library import maglev_as_printed
from ..energies.system import State
from .levitation import SCENARIOS, LevitationScenario, benchmark, closed_loop


@dataclass(frozen=True)
class LevitationErrata:
    """Behaviour of the printed equations at the equilibrium of constant references.

    Attributes
    ----------
    literal_growth : float
        Fastest growth rate [1/s] of the literal model under the printed controller.
    poles, printed_poles : tuple of complex
        Poles [1/s] of the consistent model in S2 with corrected and printed z̃₂, rightmost first.
    stiffness, stiffness_without_flux : float
        Smallest per-unit curvature of the shaped energy at its stationary point, with the bias flux
        of S2 and with the paper's φ* = 0. At a minimum, the value is positive.
    """

    literal_growth: float
    poles: tuple[complex, ...]
    printed_poles: tuple[complex, ...]
    stiffness: float
    stiffness_without_flux: float


def _constant(scenario: LevitationScenario, form: str) -> tuple[Control, State, IdaPbc]:
    """Return (controller of a scenario with q* = 0, its equilibrium, the law)."""
    control, _, _ = closed_loop(scenario)
    machine, _ = benchmark()
    law: Any = control.law
    law = replace(law, position_reference=lambda t: jnp.zeros(()), form=form)
    flux = machine.k_2 * scenario.bias_current / machine.g
    state = State(jnp.full(2, flux), jnp.zeros(1), jnp.zeros(1))
    return eqx.tree_at(lambda tree: tree.law, control, law), state, law


def _stiffness(scenario: LevitationScenario) -> float:
    """Return the smallest eigenvalue of the Hessian of H_d over (φ, q, p), in state units."""
    _, state, law = _constant(scenario, "corrected")
    machine, _ = benchmark()
    typical = machine.k_2 * 0.5 / machine.g
    units = jnp.array([typical, typical, 1e-4, 0.1])

    def energy(x: jax.Array) -> jax.Array:
        x = x * units
        return law.shaped_energy(0.0, x[:2], x[2], x[3])

    at = jnp.concatenate([state.flux, state.position, state.momentum]) / units
    hessian = np.asarray(jax.jit(jax.hessian(energy))(at))
    values = np.linalg.eigvalsh(hessian)
    return float(values[0] / values[-1])


def study() -> LevitationErrata:
    """Linearise the printed and the corrected equations."""
    machine, system = benchmark()
    c = np.array([machine.c_1, machine.c_2])
    poles_of = {}
    for form in ("corrected", "printed"):
        control, state, _ = _constant(SCENARIOS["S2"], form)
        linkage = state._replace(flux=state.flux * c)
        poles_of[form] = tuple(complex(pole) for pole in poles(system, control, linkage))
    # The literal model has no c, so the paper's law uses the model's state directly.
    _, state, law = _constant(SCENARIOS["S2"], "printed")

    def literal(t: Any, state: State) -> jax.Array:
        return law(t, state.flux, state.position[0], machine.D * state.momentum[0])

    growth = poles(maglev_as_printed(machine), literal, state)[0].real
    return LevitationErrata(
        float(growth),
        poles_of["corrected"],
        poles_of["printed"],
        _stiffness(SCENARIOS["S2"]),
        _stiffness(SCENARIOS["S1"]),
    )
