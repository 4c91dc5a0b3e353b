"""The adaptive observer starts fast; it learns resistance, inverter, magnet flux, inductances.

The numbers come from firmware/fluxobs_adaptive.c, the same source that runs in a drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from .. import _core, _core_single
from ..core.arrays import Array
from ..errors import ObserverError
from ..machines import RotatingMachine, rotating
from ..machines.model.flux_map import LinearMap
from ..machines.model.held import Held
from ..machines.model.inverter import SMOOTHING
from .base import Estimate
from .compiled import CompiledObserver, CompiledState, make_core, read_columns
from .outputs import documented, output
from .plain import LeastSquaresObserver
from .unknowns import ADAPTED

#: Time when the immersion is projected, see :class:`AdaptiveObserver`.
Projection = Literal["never", "start"]
PROJECTIONS: tuple[Projection, ...] = ("never", "start")

#: Default standard deviations: of resistance, magnet flux and inductance as shares of their values;
#: of the inverter's voltage as shares of the rated resistive drop and of the DC link.
RESISTANCE_SHARE: float = _core.usual["RESISTANCE_SHARE"]
PSI_SHARE: float = _core.usual["PSI_SHARE"]
INDUCTANCE_SHARE: float = _core.usual["INDUCTANCE_SHARE"]
INVERTER_SHARE: float = _core.usual["INVERTER_SHARE"]
DC_LINK_SHARE: float = _core.usual["DC_LINK_SHARE"]
#: Default standard deviations: of a current offset as a share of the rated current, of the
#: asymmetry [1], of the lag [samples].
OFFSET_SHARE: float = _core.usual["OFFSET_SHARE"]
ASYMMETRY_STD: float = _core.usual["ASYMMETRY_STD"]
LAG_STD: float = _core.usual["LAG_STD"]
#: Largest standard deviation as a share of the resistance; a larger one must have a wrong unit.
MAX_RESISTANCE_SHARE = 10.0
#: Time in which a parameter may change by one standard deviation [s].
SLOW_MEMORY: float = _core.usual["SLOW_MEMORY"]
#: The numbers of fo_adaptive_config, named as in the C header.
NUMBERS = (
    *("saliency", "L_d_std", "L_q_std", "lag_std", "psi_f", "psi_f_std", "resistance_std"),
    *("inverter_voltage", "inverter_std", "inverter_current", "offset_std", "asymmetry_std"),
    "slow_memory",
)


@dataclass(frozen=True)
class Learnt:
    """Learnt parameters of an adaptive observer, with their standard deviations."""

    psi_f: float
    psi_f_std: float
    resistance: float
    resistance_std: float
    inverter_voltage: float
    inverter_std: float
    offset: tuple[float, float]
    offset_std: tuple[float, float]
    asymmetry: tuple[float, float]
    asymmetry_std: tuple[float, float]
    inductance_error: tuple[float, float]
    inductance_std: tuple[float, float]


@documented
@dataclass(frozen=True, eq=False)
class AdaptiveEstimate(Estimate):
    """Estimate of the adaptive observer: an :class:`Estimate` with learnt parameters.

    psi_f is the magnet flux here, not the active flux of a salient machine. Until `adapting` is
    true for the first time, psi_f is the length of the position vector, and psi_f_std is the prior
    standard deviation.
    """

    psi_f_std: Array = field(metadata=output("Wb", "Standard deviation of psi_f"))
    drift_std: Array = field(metadata=output("V", "Standard deviation of a component of the drift"))
    resistance: Array = field(metadata=output("Ω", "Phase resistance"))
    resistance_std: Array = field(metadata=output("Ω", "Standard deviation of resistance"))
    inverter_voltage: Array = field(metadata=output("V", "Dead time and device drops of a phase"))
    inverter_voltage_std: Array = field(
        metadata=output("V", "Standard deviation of inverter_voltage")
    )
    theta_e_other: Array = field(
        metadata=output("rad", "Less likely candidate position, while two candidates are possible")
    )
    weight_other: Array = field(metadata=output("", "Weight of theta_e_other, up to ½"))
    adapting: NDArray[np.bool_] = field(
        metadata=output(
            "",
            "The filter for all unknowns runs; before that, candidates are fitted",
            boolean=True,
            in_files=False,
        )
    )


def default_resistance_std(machine: RotatingMachine) -> float:
    """Return the standard deviation of R_s [Ω] from the machine file, by default half of R_s."""
    std = machine.R_s_std
    return RESISTANCE_SHARE * machine.R_s if std is None else std


def default_inverter_std(machine: RotatingMachine, rated_current: float, dc_link: float) -> float:
    """Return the standard deviation of the inverter's voltage [V].

    The machine file states it; the default is a quarter of the rated resistive drop or 2 % of the
    DC link, whichever is larger.
    """
    std = machine.inverter_voltage_std
    drop = INVERTER_SHARE * machine.R_s * rated_current
    return max(drop, DC_LINK_SHARE * dc_link) if std is None else std


@dataclass(frozen=True, eq=False)
class AdaptiveObserver(CompiledObserver[AdaptiveEstimate]):
    """Observer that starts within a fraction of a turn, and learns errors of the machine file.

    A fast filter for (flux, drift) uses the residual of the machine's relation, averaged over an
    eighth of a turn. The parameters (magnet flux, resistance, the inverter's voltage loss, current
    offsets, an asymmetry of the phases) are learnt from the innovations of the fast filter; the
    rows of the parameters follow those of the filter in the same information factor. The
    uncertainty of the parameters is part of the position's standard deviation, and decides whether
    a position can be valid. A parameter that the data do not determine keeps its prior: at constant
    speed and load, resistance, inverter and magnet flux are not identifiable separately. A standard
    deviation of 0 marks a parameter as exact.

    A :class:`LeastSquaresObserver` runs inside, on voltages corrected by the learnt parameters.
    This plain observer starts the filter and guards it. Until the position of the plain observer is
    known, its information is projected on the manifold of consistent (flux, drift, magnet flux).

    :meth:`for_machine` chooses these fields from a machine.

    Parameters
    ----------
    plain : LeastSquaresObserver
        The observer that runs inside.
    saliency : float
        L_d - L_q [H]; 0 for a machine with one inductance.
    psi_f, psi_f_std : float
        Assumed magnet flux and its standard deviation [Wb]; 0, 0 without magnets.
    resistance_std : float
        Standard deviation of the plain observer's resistance [Ω].
    inverter_voltage, inverter_std : float
        Assumed dead time and device drops of a phase, and their standard deviation [V].
    inverter_current : float
        Phase current at which the inverter's smoothed sign, tanh(i / this), reaches three quarters
        [A]. Only the order of magnitude matters: the loss is a sum of a harder and a softer sign.
    offset_std : float
        Standard deviation of the offset of a current component [A].
    asymmetry_std : float
        Standard deviation of both components of g in u' = u + g conj(u) [1].
    L_d_std, L_q_std : float
        Standard deviations of the inductances along d and q, as shares of the inductances [1]. The
        observer learns L_d if there is a current along d, and L_q if the machine is salient. An
        error of L_q turns the position; the uncertainty of L_q is part of the position's standard
        deviation.
    lag_std : float
        Standard deviation of the delay of the voltages [s]. An error of the delay leaves no
        residual; this standard deviation is part of the standard deviation of the position.
    slow_memory : float
        Time in which a parameter may change by one standard deviation [s].
    projection : {"start", "never"}
        "never": the start waits for the plain observer's position, about a turn.

    Raises
    ------
    ObserverError
        A value is negative or not finite, sizes are inconsistent, a standard deviation is far
        larger than its parameter, or the slow memory is shorter than the memory of the plain
        observer.

    References
    ----------
    docs/theory.md, section 13; firmware/fluxobs_learning.c. Information factors and considered
    parameters: Bierman, Factorization Methods for Discrete Sequential Estimation, 1977. Separate
    filters: Friedland, Treatment of bias in recursive filtering, 1969,
    doi:10.1109/TAC.1969.1099223.

    Examples
    --------
    >>> from fluxobs import AdaptiveObserver
    >>> from fluxobs.machines import example
    >>> observer = AdaptiveObserver.for_machine(
    ...     example("servo-400w"), sample_time=1e-4, unknowns=("drift", "resistance")
    ... )
    >>> state, estimate = observer.step(observer.init(), voltage=[0.0, 0.0], current=[0.1, 0.0])
    >>> bool(estimate.adapting), float(estimate.inverter_voltage_std)
    (False, 0.0)
    """

    plain: LeastSquaresObserver
    saliency: float
    psi_f: float
    psi_f_std: float
    resistance_std: float
    inverter_voltage: float
    inverter_std: float
    inverter_current: float
    offset_std: float = 0.0
    asymmetry_std: float = 0.0
    L_d_std: float = 0.0
    L_q_std: float = 0.0
    lag_std: float = 0.0
    slow_memory: float = SLOW_MEMORY
    projection: Projection = "start"
    _core: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in NUMBERS:
            value, lower = getattr(self, name), -np.inf if name == "saliency" else 0.0
            positive = name in ("inverter_current", "slow_memory")
            if not (np.isfinite(value) and value >= lower and not (positive and value == 0)):
                requirement = "positive and finite" if positive else "finite and not negative"
                requirement = "finite" if name == "saliency" else requirement
                raise ObserverError(f"{name} must be {requirement}, got {value}")
        for name, value, largest in (
            ("psi_f_std", self.psi_f_std, self.psi_f),
            ("resistance_std", self.resistance_std, MAX_RESISTANCE_SHARE * self.resistance),
        ):
            if value > largest:
                raise ObserverError(
                    f"{name} = {value:g} exceeds {largest:g}: give a standard deviation in SI units"
                )
        if self.slow_memory < self.memory:
            raise ObserverError(
                f"slow_memory = {self.slow_memory:g} s is shorter than the memory of the plain "
                f"observer, {self.memory:g} s"
            )
        if self.projection not in PROJECTIONS:
            raise ObserverError(
                f"projection must be one of {', '.join(PROJECTIONS)}, got {self.projection!r}"
            )
        c = self.plain.constraint
        if not (np.array_equal(c.Q1, np.eye(2)) and not c.E.any() and not c.C.any()):
            raise ObserverError(
                "the adaptive observer requires a relation with Q1 = I, E = 0, C = 0"
            )
        object.__setattr__(self, "_core", self._make_core())

    def configuration(self) -> dict[str, Any]:
        """Return the numbers of fo_adaptive_config (firmware/fluxobs_adaptive.h), in SI."""
        config: dict[str, Any] = {name: getattr(self, name) for name in NUMBERS}
        return config | {"projection": PROJECTIONS.index(self.projection)}

    def _make_core(self) -> Any:
        module = _core if self.plain.precision == "double" else _core_single
        return make_core(module.Adaptive, self.plain._core, self.configuration())

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key != "_core"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        object.__setattr__(self, "_core", self._make_core())

    @property
    def sample_time(self) -> float:
        """Sample time [s]."""
        return self.plain.sample_time

    @property
    def memory(self) -> float:
        """Memory of the plain observer [s]."""
        return self.plain.memory

    @property
    def resistance(self) -> float:
        """Assumed phase resistance [Ω]."""
        return float(self.plain.R[0, 0])

    @classmethod
    def for_machine(
        cls,
        machine: RotatingMachine,
        *,
        sample_time: float,
        unknowns: tuple[str, ...] = ("drift", "resistance", "inverter"),
        memory: float | None = None,
        speed_e: float | None = None,
        psi_f: float | None = None,
        psi_f_std: float | None = None,
        resistance_std: float | None = None,
        inverter_std: float | None = None,
        asymmetry_std: float | None = None,
        offset_std: float | None = None,
        inductance_std: float | None = None,
        lag_std: float | None = None,
        rated_current: float | None = None,
        current_noise: float | None = None,
        drift_prior: float | None = None,
        held: Held = "auto",
        dc_link: float | None = None,
        slow_memory: float = SLOW_MEMORY,
        projection: Projection = "start",
        precision: Literal["double", "single"] = "double",
    ) -> Self:
        """Return an observer with all settings chosen from the machine.

        Parameters
        ----------
        machine : RotatingMachine
            The machine, with the assumed inverter_voltage and inverter_current.
        sample_time : float
            Sample time [s].
        unknowns : tuple of {"drift", "resistance", "inverter", "asymmetry"}
            The unknowns. The drift, which current offsets cause, is always estimated.
        psi_f_std, resistance_std, inverter_std : float, optional
            Standard deviations of the assumed values [Wb], [Ω], [V]. The machine file states them
            as psi_f_std, R_s_std and inverter_voltage_std. Otherwise they are a quarter of the
            magnet flux, half of the resistance, and a quarter of the rated resistive drop or 2 % of
            the DC link, whichever is larger. With a magnet flux known to 1 %, the start is faster
            and the resistance is identifiable at constant speed and load.
        asymmetry_std, offset_std, inductance_std, lag_std : float, optional
            Standard deviations. The defaults are 0.01 for the asymmetry [1], 2 % of the rated
            current for an offset [A], and 0.15 samples for the lag [s]. The default for an
            inductance is that of the machine file (L_s_std, …) or 0.1, as a share of the inductance
            [1].
        dc_link : float, optional
            Voltage of the inverter's DC link [V].
        memory, speed_e, psi_f, rated_current, current_noise, drift_prior, held, precision
            See :meth:`LeastSquaresObserver.for_machine`.
        slow_memory, projection
            See the class.

        Raises
        ------
        ObserverError
            A required value is missing in both machine and call, this observer does not estimate an
            unknown, or a standard deviation is given for a quantity that is not an unknown.
        """
        for name in unknowns:
            if name not in ("drift", *ADAPTED):
                raise ObserverError(
                    f"unknown {name!r}: this observer estimates drift, {', '.join(ADAPTED)}"
                )
        stds = {
            "resistance": resistance_std,
            "inverter": inverter_std,
            "asymmetry": asymmetry_std,
        }
        for name, std in stds.items():
            if std and name not in unknowns:
                raise ObserverError(f"{name}_std is given, but {name} is not among the unknowns")
        machine = rotating(machine, "AdaptiveObserver")
        plain = LeastSquaresObserver.for_machine(
            machine,
            sample_time=sample_time,
            memory=memory,
            speed_e=speed_e,
            psi_f=psi_f,
            rated_current=rated_current,
            current_noise=current_noise,
            drift_prior=drift_prior,
            held=held,
            precision=precision,
        )
        if isinstance(plain.flux_map, LinearMap):
            # The filter models i_d itself, and its guard must not depend on the filter's angle.
            plain = replace(plain, flux_map=None)
        rated = rated_current if rated_current is not None else machine.rated_current
        assert rated is not None  # the plain observer requires a rated current
        if not machine.magnets and psi_f_std:
            raise ObserverError(f"psi_f_std: a {machine.kind} has no magnets")
        flux = plain.flux_base if machine.magnets else 0.0

        def first_given(*candidates: float | None) -> float:
            return next(value for value in candidates if value is not None)

        defaults = {
            "resistance": default_resistance_std(machine),
            "inverter": default_inverter_std(machine, rated, dc_link or 0.0),
            "asymmetry": ASYMMETRY_STD,
        }

        inductance_stds = machine.inductance_stds(INDUCTANCE_SHARE)
        L_d_std, L_q_std = (
            first_given(inductance_std, inductance_stds[name] / L)
            for name, L in zip(machine.inductances, machine.L_dq, strict=True)
        )

        def prior_std(name: str) -> float:
            return first_given(stds[name], defaults[name]) if name in unknowns else 0.0

        return cls(
            plain=plain,
            saliency=machine.saliency,
            psi_f=flux,
            psi_f_std=first_given(psi_f_std, machine.magnet_flux_std, PSI_SHARE * flux),
            resistance_std=prior_std("resistance"),
            inverter_voltage=machine.inverter_voltage or 0.0,
            inverter_std=prior_std("inverter"),
            inverter_current=machine.inverter_current or SMOOTHING * rated,
            offset_std=first_given(offset_std, OFFSET_SHARE * rated),
            asymmetry_std=prior_std("asymmetry"),
            L_d_std=L_d_std,
            L_q_std=L_q_std,
            lag_std=first_given(lag_std, LAG_STD * sample_time),
            slow_memory=slow_memory,
            projection=projection,
        )

    def learnt(self, state: CompiledState, lane: int = 0) -> Learnt:
        """Return the parameters learnt in one lane of `state`."""
        raw_values: dict[str, Any] = self._core.learnt(state.raw, lane)
        raw_values["resistance"] = self.resistance + raw_values.pop("resistance_error")
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in raw_values.items()
        }
        return Learnt(**values)

    def restart(self, state: CompiledState, *, frozen: bool = False) -> CompiledState:
        """Return an initial state with the parameters learnt in `state`, as after a power cycle.

        With `frozen`, the parameters and their standard deviations stay fixed.
        """
        return CompiledState(self._core.restart(state.raw, frozen), state.batch)

    def restarts(self, state: CompiledState, lane: int = 0) -> int:
        """Return how often the guard restarted the filter in one lane of `state`."""
        return int(self._core.restarts(state.raw, lane))

    def parameters(self) -> dict[str, Any]:
        """Return all numbers that a step uses in addition to the plain observer's numbers.

        The order is that of fo_adaptive (firmware/fluxobs_adaptive.h).
        """
        parameters: dict[str, Any] = self._core.parameters()
        return parameters

    def _estimate(self, columns: Array, valid: NDArray[np.bool_]) -> AdaptiveEstimate:
        fields = read_columns(_core.adaptive_outputs, columns)
        fields["resistance"] = self.resistance + fields.pop("resistance_error")
        adapting = fields.pop("adapting") > 0
        return AdaptiveEstimate(**fields, valid=valid, adapting=adapting)

    def _seed(
        self, numbers: dict[str, float], current: Array, state: CompiledState
    ) -> NDArray[np.uint8]:
        raw: NDArray[np.uint8] = self._core.seed(numbers, current, state.raw)
        return raw
