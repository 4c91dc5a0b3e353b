"""The plain observer: square-root information least squares on the exact immersion.

The numbers come from firmware/fluxobs.c, the same source that runs in a drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from .. import _core, _core_single
from ..core.validation import number
from ..errors import ObserverError
from ..machines import RotatingMachine, rotating
from ..machines.model.constraint import QuadraticConstraint
from ..machines.model.flux_map import FluxMap
from ..machines.model.held import Held, kink_weights
from .base import Estimate
from .compiled import CompiledObserver, CompiledState, make_core, read_columns
from .requirements import (
    finite_matrix,
    require_memory,
    require_not_negative,
    require_positive,
)

#: Usual memory [s]. One value suited all records tried, 75 to 5000 rad/s electrical. Within a much
#: shorter memory, slow machines turn too little. Within a much longer memory, drift, inverter error
#: and magnet flux, which are assumed constant, change.
MEMORY: float = _core.usual["MEMORY"]
#: Bandwidth of the tracker times the memory: the tracker follows load steps within a memory.
TRACKER: float = _core.usual["TRACKER"]
#: Real machines violate their relation by this share of the flux squared (saturation, slots,
#: inverter). This share is part of the assumed noise, which balances prior against data. The
#: innovations determine the level of the reported standard deviations.
MODEL_ERROR: float = _core.usual["MODEL_ERROR"]
#: Settings that are positive numbers, named as in fo_config (firmware/fluxobs.h).
POSITIVE = (
    "sample_time",
    "memory",
    "flux_base",
    "current_noise",
    "constraint_noise",
    "current_limit",
    "drift_prior",
    "length_min",
    "tracker_bandwidth",
)


@dataclass(frozen=True, eq=False)
class LeastSquaresObserver(CompiledObserver[Estimate]):
    """Observer for flux, position, speed and drift by exponentially forgetting least squares.

    :meth:`for_machine` chooses these fields from a machine.

    Parameters
    ----------
    constraint : QuadraticConstraint
        Quadratic relation with two ports.
    R, B : (2, 2) array_like
        Matrices of ``λ̇ = -R i + B u`` [Ω], [-].
    position_inductance : float
        L of the position vector λ - L i [H].
    sample_time : float
        Sample time [s], > 0.
    memory : float
        Exponential memory [s], ten to a million samples.
    flux_base : float
        Magnitude of the flux [Wb]; a factor of a few does not matter.
    constraint_noise : float
        Std of the constraint's residual, in the constraint's unit (Wb² for Q1 = I).
    current_noise : float
        Std of a current component [A].
    current_limit : float
        A longer current vector is implausible [A].
    drift_prior : float
        Largest plausible drift [V]. A smaller prior makes the start faster; a prior that proves too
        small is widened.
    length_min : float
        Shortest position vector that gives a position [Wb].
    tracker_bandwidth : float
        Bandwidth of the tracker [rad/s].
    held : float
        R h/L if voltages are held over a sample, else 0. R h/L is the share of a current's kink
        that decays within the sample; it adds the kinks to the resistive drop. With 0 the current
        is assumed smooth.
    precision : {"double", "single"}
        "single" computes the same numbers as a microcontroller.
    flux_map : FluxMap, optional
        Flux as a function of current, if inductance or magnet flux is not constant. Q1 of the
        constraint must then be 1; the other terms of the constraint only scale the noise.

    Raises
    ------
    ObserverError
        A value is not positive or not finite, the memory is shorter than ten samples or longer than
        a million samples, or sizes are inconsistent (a unit is wrong).

    References
    ----------
    docs/theory.md, sections 4 to 6; firmware/fluxobs.c.

    Examples
    --------
    >>> import numpy as np
    >>> from fluxobs.machines import example
    >>> observer = LeastSquaresObserver.for_machine(example("servo-400w"), sample_time=1e-4)
    >>> state, estimate = observer.step(observer.init(), voltage=[0.0, 0.0], current=[0.1, 0.0])
    >>> bool(estimate.valid)
    False
    """

    constraint: QuadraticConstraint
    R: NDArray[np.float64]
    B: NDArray[np.float64]
    position_inductance: float
    sample_time: float
    memory: float
    flux_base: float
    constraint_noise: float
    current_noise: float
    current_limit: float
    drift_prior: float
    length_min: float
    tracker_bandwidth: float
    held: float = 0.0
    precision: Literal["double", "single"] = "double"
    flux_map: FluxMap | None = None
    _core: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.constraint.n != 2:
            raise ObserverError(
                f"the compiled observer has two ports, got a constraint with {self.constraint.n}"
            )
        if self.precision not in ("double", "single"):
            raise ObserverError(f'precision must be "double" or "single", got {self.precision!r}')
        for name in ("R", "B"):
            object.__setattr__(self, name, finite_matrix(name, getattr(self, name), (2, 2)))
        require_not_negative("held = R h/L", self.held)
        for name in POSITIVE:
            require_positive(name, number(name, getattr(self, name), "SI"))
        require_memory(self.memory, self.sample_time)
        if not self.memory <= 1e6 * self.sample_time:
            raise ObserverError(
                f"memory must be at most a million samples, {1e6 * self.sample_time:g} s here, "
                f"got {self.memory:g} s"
            )
        object.__setattr__(self, "_core", self._make_core())

    def configuration(self) -> dict[str, Any]:
        """Return the numbers and matrices of fo_config (firmware/fluxobs.h), in SI."""
        c = self.constraint
        size = np.abs(c.Q1).max()
        config = {
            "Q1": c.Q1,
            "Q2": np.ascontiguousarray(c.Q2),
            "Q3": c.Q3,
            "E": c.E,
            "C": c.C,
            "R": self.R,
            "B": self.B,
            "L_position": self.position_inductance,
            **dict(zip(("kink_now", "kink_before"), kink_weights(self.held), strict=True)),
            # Without λᵀQ1λ, the mixed term determines the size; any positive number serves here.
            "constraint_base": float(size) * self.flux_base**2 if size else self.constraint_noise,
        }
        return config | {name: getattr(self, name) for name in POSITIVE}

    def _make_core(self) -> Any:
        module = _core if self.precision == "double" else _core_single
        flux_map = {} if self.flux_map is None else self.flux_map.core()
        return make_core(module.Core, self.configuration(), flux_map)

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key != "_core"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        object.__setattr__(self, "_core", self._make_core())

    @classmethod
    def for_machine(
        cls,
        machine: RotatingMachine,
        *,
        sample_time: float,
        memory: float | None = None,
        speed_e: float | None = None,
        psi_f: float | None = None,
        rated_current: float | None = None,
        current_noise: float | None = None,
        drift_prior: float | None = None,
        held: Held = "auto",
        precision: Literal["double", "single"] = "double",
    ) -> Self:
        """Return an observer with all settings chosen from the machine.

        Parameters
        ----------
        machine : RotatingMachine
        sample_time : float
            Sample time [s].
        memory : float, optional
            Exponential memory [s], the only tuning parameter. The default is 0.03 s, which suited
            all records tried. The default is shorter if L/R is so short that noise in the resistive
            drop would dominate (:meth:`RotatingMachine.memory_for`).
        speed_e : float, optional
            Usual electrical speed [rad/s] for the default memory; by default the machine's
            rated_speed.
        psi_f, rated_current : float, optional
            Values that replace those of the machine [Wb], [A peak]. They are only scales: a factor
            of two does not matter.
        current_noise : float, optional
            Std of a current component [A]; default 0.2 % of the rated current.
        drift_prior : float, optional
            Largest plausible drift [V]. The default is 3 % of the rated resistive drop or the drift
            that turns the flux by 0.1 rad within the memory, whichever is larger.
        held : {"auto", True, False}
            Whether each voltage is held over its sample, like an inverter's mean voltage. The
            choice matters where R h/L is large: the motor's time constant is small, or samples per
            period are few. "auto": held if R h/L is above 0.15. False: each voltage is the mean of
            a smooth voltage.
        precision : {"double", "single"}

        Raises
        ------
        ObserverError
            A required value is missing in both machine and call; the message names it.
        """
        machine = rotating(machine, "LeastSquaresObserver")
        sample_time = number("sample_time", sample_time, "s")
        rated = rated_current if rated_current is not None else machine.rated_current
        if rated is None:
            raise ObserverError(
                f"rated_current is missing: give it in the machine ({machine.kind}) or to "
                f"for_machine(…, rated_current=…) [A peak]; a rough value is enough"
            )
        flux_base = machine.flux_base(rated, psi_f)
        if flux_base is None:
            raise ObserverError(
                f"psi_f is missing: give it in the machine ({machine.kind}) or to "
                f"for_machine(…, psi_f=…) [Wb]; a rough value is enough"
            )
        # The firmware's formulas (firmware/fluxobs_config.c) choose the settings that are not
        # given.
        given = {"memory": memory, "current_noise": current_noise, "drift_prior": drift_prior}
        given_values = [
            value if value is not None and value > 0 else 0.0 for value in given.values()
        ]
        chosen = _core.choose(machine.sizes(flux_base, rated, speed_e), sample_time, *given_values)
        chosen |= {name: value for name, value in given.items() if value is not None}
        return cls(
            constraint=machine.constraint,
            R=machine.R,
            B=machine.B,
            position_inductance=machine.position_inductance,
            held=machine.held_share(held, sample_time),
            precision=precision,
            flux_map=machine.map_for(sample_time, flux_base),
            **{name: chosen[name] for name in POSITIVE},
        )

    def parameters(self) -> dict[str, Any]:
        """Return all numbers that a step uses, in per-unit and in the order of fo_observer.

        The struct fo_observer is in firmware/fluxobs.h.
        """
        parameters: dict[str, Any] = self._core.parameters()
        return parameters

    def _estimate(self, columns: NDArray[np.float64], valid: NDArray[np.bool_]) -> Estimate:
        return Estimate(**read_columns(_core.outputs, columns), valid=valid)

    def _seed(
        self, numbers: dict[str, float], current: NDArray[np.float64], state: CompiledState
    ) -> NDArray[np.uint8]:
        raw: NDArray[np.uint8] = self._core.seed(numbers, current)
        return raw
