"""Integrate a system under control with an adaptive solver and sample the result uniformly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import matrix_balance

from ...core.arrays import Array
from ...errors import ModelError
from ...simulation.precision import real
from .system import ElectromechanicalSystem, State

Control = Callable[[Any, State], jax.Array]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a simulation; between samples, flux and position are cubic (Hermite).

    The cubic is also a trajectory: its currents come from the energies, so every relation holds
    exactly between samples as well.

    Attributes
    ----------
    t : (rows,) ndarray
        Uniform times [s].
    flux, flux_rate, current : (rows, n_E) ndarray
        In [Wb], [V] and [A].
    position, velocity, momentum : (rows, n_M) ndarray
    voltage : (rows, m) ndarray
        Control voltage at the samples [V].
    """

    system: ElectromechanicalSystem
    t: Array
    flux: Array
    flux_rate: Array
    current: Array
    position: Array
    velocity: Array
    momentum: Array
    voltage: Array

    @property
    def h(self) -> float:
        """Sample time [s]."""
        return float(self.t[1] - self.t[0])

    def inside(self, places: ArrayLike) -> tuple[Array, Array, Array]:
        """Return (flux, flux rate, current) inside each interval, each (rows - 1, places, n_E).

        `places` are positions in the interval, from 0 to 1.
        """
        flux, rate = _hermite(self.flux, self.flux_rate, self.h, places)
        position, _ = _hermite(self.position, self.velocity, self.h, places)
        current = _currents(self.system, jnp.asarray(flux), jnp.asarray(position))
        return flux, rate, np.asarray(current)


@eqx.filter_jit
def _currents(system: ElectromechanicalSystem, flux: jax.Array, position: jax.Array) -> jax.Array:
    return jax.vmap(jax.vmap(system.current))(flux, position)


def _hermite(value: Array, rate: Array, h: float, places: ArrayLike) -> tuple[Array, Array]:
    """Return value and rate of the cubic Hermite interpolant inside each interval."""
    s = np.asarray(places, float)[:, None]
    y0, d0, d1 = value[:-1, None], h * rate[:-1, None], h * rate[1:, None]
    rise = value[1:, None] - y0
    inside = y0 + s * (d0 + s * (3 * rise - 2 * d0 - d1 + s * (d0 + d1 - 2 * rise)))
    slope = d0 + s * (2 * (3 * rise - 2 * d0 - d1) + 3 * s * (d0 + d1 - 2 * rise))
    return inside, slope / h


def volt_seconds(flux: ArrayLike, h: float, drift: ArrayLike) -> Array:
    """Return the exact ``∫ y_m dt = λ_k - λ_{k-1} - h θ`` over the interval that ends at each row.

    `drift` is (n,), or (rows, n) with one value for each interval. The first row has no interval;
    its result is zero.
    """
    x = np.asarray(flux, float)
    step = np.diff(x, axis=0, prepend=x[:1])
    step[1:] -= h * np.broadcast_to(np.asarray(drift, float), x.shape)[1:]
    return np.asarray(step)


def integrate(
    system: ElectromechanicalSystem,
    control: Control,
    t: ArrayLike,
    initial: State,
    scale: State | None = None,
    load: ArrayLike | None = None,
    position_limit: tuple[float, float] | None = None,
    stiff: bool = True,
    rtol: float = 1e-9,
    max_steps: int = 2_000_000,
) -> Trajectory:
    """Integrate a system under control.

    Parameters
    ----------
    system : ElectromechanicalSystem
    control : callable
        ``control(t, state)`` → voltage (m,) [V]; written with jax.numpy.
    t : (rows,) array_like
        Uniform sample times [s], at least two.
    initial : State
        State at t[0].
    scale : State, optional
        Sizes of the states, to which the solver's tolerance is relative. The default is the ranges
        of the system, and 1 for the momentum.
    load : (n_M,) array_like, optional
        Constant load forces.
    position_limit : (low, high), optional
        Allowed range of the position, such as the air gap. A position outside raises an error.
    stiff : bool
        Use an implicit fifth-order solver (Kvaerno5). If false, use an explicit solver (Tsit5),
        which is faster if all time scales of the closed loop are similar.
    rtol : float
        Tolerance of the adaptive step, relative to `scale`.
    max_steps : int

    Raises
    ------
    ModelError
        If the position reaches its limit or the solver fails. The message says when and where.
    """
    times = np.asarray(t, float)
    if times.ndim != 1 or len(times) < 2 or np.ptp(np.diff(times)) > 1e-6 * (times[1] - times[0]):
        raise ModelError("t must be uniform and have at least two rows")
    initial = State(*initial)
    start = State(
        real("initial.flux", initial.flux, (system.n_E,)),
        real("initial.position", initial.position, (system.n_M,)),
        real("initial.momentum", initial.momentum, (system.n_M,)),
    )
    if scale is None:
        reach = [
            jnp.asarray(np.abs(np.asarray(bounds)).max(axis=0))
            for bounds in (system.flux_range, system.position_range)
        ]
        sizes = State(reach[0], reach[1], jnp.ones(system.n_M))
    else:
        sizes = State(*(real("scale", size) for size in scale))
    force = None if load is None else real("load", load, (system.n_M,))
    limit = None if position_limit is None else real("position_limit", position_limit, (2,))
    solution = _solve(
        system, control, jnp.asarray(times), start, sizes, force, limit, stiff, rtol, max_steps
    )
    saved: State = jax.tree.map(np.asarray, solution.ys)
    finite = np.isfinite(np.asarray(solution.ts))
    for values in saved:
        finite &= np.isfinite(np.asarray(values)).all(axis=1)
    if not finite.all():
        at = max(int(np.argmin(finite)) - 1, 0)
        place = (
            f"after t = {times[at]:.6g} s, position {saved.position[at].round(9).tolist()}, "
            f"flux {saved.flux[at].tolist()}"
        )
        if limit is not None and solution.result == diffrax.RESULTS.event_occurred:
            low, high = (float(bound) for bound in limit)
            raise ModelError(
                f"{system.name}: the position left ({low:g}, {high:g}) {place}, where the air gap "
                f"is closed; choose slower references or other gains"
            )
        raise ModelError(
            f"{system.name}: the solver failed {place} ({solution.result}); check that the closed "
            f"loop is stable and that its time scale is near the sample time"
        )
    signals = _signals(system, control, jnp.asarray(times), saved, force)
    rate, current, velocity, voltage = (np.asarray(signal) for signal in signals)
    flux, position, momentum = (np.asarray(values) for values in saved)
    return Trajectory(system, times, flux, rate, current, position, velocity, momentum, voltage)


def poles(system: ElectromechanicalSystem, control: Control, state: State) -> Array:
    """Return the eigenvalues [1/s] of the loop linearised at a state and t = 0, rightmost first."""

    def rate(x: jax.Array) -> jax.Array:
        here = State(*jnp.split(x, cuts))
        return jnp.concatenate(system.derivative(here, control(jnp.zeros(()), here)))

    cuts = np.cumsum([system.n_E, system.n_M])
    x = jnp.concatenate([jnp.asarray(values, float) for values in state])
    jacobian = np.asarray(jax.jit(jax.jacfwd(rate))(x))
    # Balance the matrix, because the states differ by many powers of ten.
    values = np.linalg.eigvals(matrix_balance(jacobian)[0])
    return np.asarray(values[np.argsort(-values.real)])


@eqx.filter_jit
def _solve(
    system: ElectromechanicalSystem,
    control: Control,
    times: jax.Array,
    start: State,
    sizes: State,
    load: jax.Array | None,
    limit: jax.Array | None,
    stiff: bool,
    rtol: float,
    max_steps: int,
) -> diffrax.Solution:
    def unscaled(state: State) -> State:
        return State(*(value * size for value, size in zip(state, sizes, strict=True)))

    @jax.jit  # traced once, although the solver calls it in many places
    def field(t: Any, scaled: State, _: Any) -> State:
        state = unscaled(scaled)
        rate = system.derivative(state, control(t, state), load)
        return State(*(value / size for value, size in zip(rate, sizes, strict=True)))

    event = None
    if limit is not None:

        def outside(t: jax.Array, y: State, args: Any, **_: Any) -> jax.Array:
            position = unscaled(y).position
            return jnp.any((position <= limit[0]) | (position >= limit[1]))

        event = diffrax.Event(outside)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(field),
        diffrax.Kvaerno5() if stiff else diffrax.Tsit5(),
        times[0],
        times[-1],
        (times[1] - times[0]) / 10,
        State(*(value / size for value, size in zip(start, sizes, strict=True))),
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol),
        max_steps=max_steps,
        event=event,
        throw=False,
    )
    rescaled: diffrax.Solution = eqx.tree_at(
        lambda s: s.ys, solution, jax.vmap(unscaled)(solution.ys)
    )
    return rescaled


@eqx.filter_jit
def _signals(
    system: ElectromechanicalSystem,
    control: Control,
    times: jax.Array,
    states: State,
    load: jax.Array | None,
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    def at(t: jax.Array, state: State) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        voltage = control(t, state)
        rate = system.derivative(state, voltage, load)
        return rate.flux, system.current(state.flux, state.position), rate.position, voltage

    return jax.vmap(at)(times, states)
