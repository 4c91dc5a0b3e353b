"""Electromechanical systems, defined by their energies, whose derivatives give the dynamics.

``H_E(λ, q)`` and ``H_M(q, p)`` define the dynamics (equation (1) of the paper)::

    i = ∇_λ H_E        λ̇ = -R i + B u
    q̇ = ∇_p H_M        ṗ = -∇_q H_E - ∇_q H_M - R_M q̇ + F_L

The electric-field dual has the same form, with charge as λ, voltage as i and conductance as R.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...errors import ModelError
from ...simulation.precision import double, real

Energy = Callable[[jax.Array, jax.Array], jax.Array]


class State(NamedTuple):
    """Flux linkage (n_E,) [Wb], position (n_M,) [rad, m], momentum (n_M,)."""

    flux: jax.Array
    position: jax.Array
    momentum: jax.Array


class Power(NamedTuple):
    """Power balance [W]: stored = supplied - dissipated."""

    stored: jax.Array
    supplied: jax.Array
    dissipated: jax.Array


def linear_magnetics(
    inductance: Callable[[jax.Array], jax.Array],
    magnet_flux: Callable[[jax.Array], jax.Array] | None = None,
) -> Energy:
    """Return ``H_E = ½ (λ - μ)ᵀ L⁻¹ (λ - μ)`` of ``λ = L(q) i + μ(q)`` (the paper's Remark 1)."""

    def magnetic_energy(flux: jax.Array, position: jax.Array) -> jax.Array:
        own_flux = flux if magnet_flux is None else flux - magnet_flux(position)
        return jnp.asarray(own_flux @ jnp.linalg.solve(inductance(position), own_flux) / 2)

    return magnetic_energy


def inertia(mass: Any) -> Energy:
    """Return ``H_M = ½ pᵀ M⁻¹ p`` for constant inertia; `mass` is (n_M,) or one number."""
    masses = real("mass", mass)
    if not (np.asarray(masses) > 0).all():
        raise ModelError(f"inertia must be positive, got {masses.tolist()}")

    def mechanical_energy(position: jax.Array, momentum: jax.Array) -> jax.Array:
        return jnp.sum(momentum**2 / masses) / 2

    return mechanical_energy


class ElectromechanicalSystem(eqx.Module):
    """System with electrical ports (flux, current), mechanical ports and two energies.

    Parameters
    ----------
    magnetic_energy : callable
        ``H_E(flux (n_E,), position (n_M,))`` → scalar [J], written with jax.numpy.
    mechanical_energy : callable
        ``H_M(position (n_M,), momentum (n_M,))`` → scalar [J].
    R : (n_E, n_E) array_like
        Resistance [Ω] with positive semi-definite symmetric part. A vector means a diagonal matrix.
    R_M : (n_M, n_M) array_like
        Mechanical damping, with the conditions of R.
    B : (n_E, m) array_like, optional
        Input matrix of full column rank; default identity matrix.
    flux_range, position_range : (low, high), optional
        Operating range, from which random states are drawn. Each bound is one number, or one number
        per port. The defaults are ±1 Wb and ±π.
    name : str

    Raises
    ------
    ModelError
        If an energy is not scalar or not finite within the ranges, or a matrix does not fit.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> pendulum = ElectromechanicalSystem(
    ...     linear_magnetics(lambda q: 0.1 * jnp.eye(1)), inertia(2.0), R=[1.0], R_M=[0.0]
    ... )
    >>> float(pendulum.current(jnp.array([0.2]), jnp.array([0.0]))[0])
    2.0
    """

    magnetic_energy: Energy
    mechanical_energy: Energy
    R: jax.Array
    R_M: jax.Array
    B: jax.Array
    flux_range: jax.Array
    position_range: jax.Array
    name: str = eqx.field(static=True)

    def __init__(
        self,
        magnetic_energy: Energy,
        mechanical_energy: Energy,
        R: Any,
        R_M: Any,
        B: Any = None,
        flux_range: tuple[Any, Any] = (-1.0, 1.0),
        position_range: tuple[Any, Any] = (-np.pi, np.pi),
        name: str = "system",
    ) -> None:
        self.magnetic_energy = magnetic_energy
        self.mechanical_energy = mechanical_energy
        self.R, self.R_M = _damping("R", R), _damping("R_M", R_M)
        self.B = jnp.asarray(np.eye(self.n_E)) if B is None else real("B", B)
        if self.B.ndim != 2 or len(self.B) != self.n_E:
            raise ModelError(f"{name}: B must have {self.n_E} rows, got shape {self.B.shape}")
        if np.linalg.matrix_rank(np.asarray(self.B)) < self.B.shape[1]:
            raise ModelError(f"{name}: B must have full column rank, got {self.B.tolist()}")
        self.flux_range = _range("flux_range", flux_range, self.n_E)
        self.position_range = _range("position_range", position_range, self.n_M)
        self.name = name
        self._probe()

    def _probe(self) -> None:
        """Check that the energies are finite scalars within the ranges."""
        rng = np.random.default_rng(0)
        flux, position = self.random_states(rng, 500)
        momentum = jnp.asarray(rng.standard_normal(position.shape))
        for name, energy, first, second in (
            ("magnetic_energy", self.magnetic_energy, flux, position),
            ("mechanical_energy", self.mechanical_energy, position, momentum),
        ):
            try:
                shape = jnp.shape(jax.eval_shape(energy, first[0], second[0]))
                if shape == ():
                    gradients = jax.jit(jax.vmap(jax.value_and_grad(energy, argnums=(0, 1))))
                    value, slopes = gradients(first, second)
            except (TypeError, ValueError, IndexError) as error:
                raise ModelError(
                    f"{self.name}: {name} fails at shapes {first[0].shape} and {second[0].shape}: "
                    f"{str(error).splitlines()[0]} (write it with jax.numpy; do not use "
                    f"float() or if on its arguments)"
                ) from error
            if shape != ():
                raise ModelError(f"{self.name}: {name} must return one number, got shape {shape}")
            finite = np.isfinite(value)
            for gradient in slopes:
                finite = finite & np.isfinite(gradient).all(axis=1)
            if not finite.all():
                at = int(np.argmin(finite))
                raise ModelError(
                    f"{self.name}: {name} or its gradient is not finite at "
                    f"{np.asarray(first[at]).round(6).tolist()}, "
                    f"{np.asarray(second[at]).round(6).tolist()}; set flux_range and "
                    f"position_range to the machine's operating range"
                )

    @property
    def n_E(self) -> int:
        """Number of electrical ports."""
        return len(self.R)

    @property
    def n_M(self) -> int:
        """Number of mechanical ports."""
        return len(self.R_M)

    def random_states(self, rng: np.random.Generator, count: int) -> tuple[jax.Array, jax.Array]:
        """Return (flux (count, n_E), position (count, n_M)), drawn uniformly from their ranges."""
        states = []
        for bounds in (self.flux_range, self.position_range):
            low, high = np.asarray(bounds)
            states.append(jnp.asarray(low + (high - low) * rng.uniform(size=(count, len(low)))))
        return states[0], states[1]

    def current(self, flux: jax.Array, position: jax.Array) -> jax.Array:
        """Return the current ``i = ∇_λ H_E`` (n_E,) [A]."""
        flux, position = double("flux", flux), double("position", position)
        return jnp.asarray(jax.grad(self.magnetic_energy, 0)(flux, position))

    def force(self, flux: jax.Array, position: jax.Array) -> jax.Array:
        """Return the force or torque ``-∇_q H_E`` (n_M,) of electrical origin."""
        flux, position = double("flux", flux), double("position", position)
        return jnp.asarray(-jax.grad(self.magnetic_energy, 1)(flux, position))

    def velocity(self, position: jax.Array, momentum: jax.Array) -> jax.Array:
        """Return the velocity ``q̇ = ∇_p H_M`` (n_M,)."""
        return jnp.asarray(jax.grad(self.mechanical_energy, 1)(position, momentum))

    def energy(self, state: State) -> jax.Array:
        """Return the energy ``H_E + H_M`` [J]."""
        return self.magnetic_energy(state.flux, state.position) + self.mechanical_energy(
            state.position, state.momentum
        )

    def derivative(self, state: State, voltage: jax.Array, load: jax.Array | None = None) -> State:
        """Return the state's time derivative under source voltages (m,) and load forces (n_M,)."""
        flux, position, momentum = state
        velocity = self.velocity(position, momentum)
        force = self.force(flux, position) - jax.grad(self.mechanical_energy, 0)(position, momentum)
        if load is not None:
            force = force + load
        return State(
            -self.R @ self.current(flux, position) + self.B @ voltage,
            velocity,
            force - self.R_M @ velocity,
        )

    def power(self, state: State, voltage: jax.Array, load: jax.Array | None = None) -> Power:
        """Return the rate of stored energy, the supplied power and the dissipated power [W]."""
        rate = self.derivative(state, voltage, load)
        _, stored = jax.jvp(self.energy, (state,), (rate,))
        i = self.current(state.flux, state.position)
        velocity = self.velocity(state.position, state.momentum)
        supplied = i @ self.B @ voltage + (0.0 if load is None else velocity @ load)
        return Power(stored, supplied, i @ self.R @ i + velocity @ self.R_M @ velocity)


def _damping(name: str, value: Any) -> jax.Array:
    matrix = np.asarray(real(name, value))
    if matrix.ndim == 1:
        matrix = np.diag(matrix)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ModelError(f"{name} must be square, or a vector, got shape {matrix.shape}")
    smallest = np.linalg.eigvalsh((matrix + matrix.T) / 2).min(initial=0.0)
    if smallest < -1e-12 * np.abs(matrix).max(initial=0.0):
        raise ModelError(
            f"{name} must be positive semi-definite, got smallest eigenvalue {smallest:g}"
        )
    return jnp.asarray(matrix)


def _range(name: str, value: tuple[Any, Any], ports: int) -> jax.Array:
    if len(value) != 2:
        raise ModelError(f"{name} must be (low, high), got {len(value)} bounds")
    limits = [np.asarray(real(name, bound)) for bound in value]
    if any(bound.shape not in ((), (ports,)) for bound in limits):
        raise ModelError(f"{name}: each bound must be a number or {ports} numbers")
    bounds = np.stack([np.broadcast_to(bound, (ports,)) for bound in limits])
    if not (bounds[0] < bounds[1]).all():
        raise ModelError(f"{name}: low must be below high, got {bounds.tolist()}")
    return jnp.asarray(bounds)
