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
from ..machines.model.inverter import SMOOTHING
from .base import Estimate
from .compiled import CompiledObserver, CompiledState, make_core, read_columns
from .outputs import documented, output
from .plain import LeastSquaresObserver
from .requirements import require_not_negative, require_positive
from .unknowns import ADAPTED

#: Time when the immersion is projected, see :class:`AdaptiveObserver`.
Projection = Literal["never", "start"]
PROJECTIONS: tuple[Projection, ...] = ("never", "start")

#: Why a position is not valid, by the number in `valid_reason`; the words of fluxobs.h.
REASONS = (
    *("valid", "no data", "searching", "settling", "slow", "uncertain", "contradicted"),
    *("unconfirmed", "outside map", "bad sample"),
)

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
#: Of the considered parameters: delay of the currents [samples], unequal gains of the current
#: sensors [1], current of the iron loss as a share of the rated current, harmonics [1].
DELAY_STD: float = _core.usual["DELAY_STD"]
CURRENT_GAIN_STD: float = _core.usual["CURRENT_GAIN_STD"]
IRON_SHARE: float = _core.usual["IRON_SHARE"]
HARMONIC_STD: float = _core.usual["HARMONIC_STD"]
#: Largest standard deviation as a share of the resistance; a larger one must have a wrong unit.
MAX_RESISTANCE_SHARE = 10.0
#: Time in which a parameter may change by one standard deviation [s].
SLOW_MEMORY: float = _core.usual["SLOW_MEMORY"]
#: The numbers of fo_adaptive_config, named as in the C header.
NUMBERS = (
    *("saliency", "L_d_std", "L_q_std", "lag_std", "delay_std", "current_gain_std"),
    *("iron_current_std", "harmonic_std", "psi_f", "psi_f_std", "resistance_std"),
    *("inverter_voltage", "inverter_std", "inverter_current", "offset_std", "asymmetry_std"),
    "slow_memory",
)


@dataclass(frozen=True)
class Priors:
    """Standard deviations of the values that an adaptive observer assumes; None: the default.

    Parameters
    ----------
    psi_f : float, optional
        Of the magnet flux [Wb]; default psi_f_std of the machine file, otherwise a quarter of the
        flux. With a magnet flux known to 1 %, the start is faster, and the resistance is
        identifiable at constant speed and load.
    resistance : float, optional
        [Ω]; default R_s_std of the machine file, otherwise half of R_s.
    inverter : float, optional
        Of the inverter's voltage loss [V]; default inverter_voltage_std of the machine file,
        otherwise the larger of a quarter of the rated resistive drop and 2 % of the DC link.
    asymmetry : float, optional
        [1]; default 0.01.
    offset : float, optional
        Of a current component [A]; default 2 % of the rated current.
    inductance : float, optional
        As a share of each inductance [1]; default L_s_std, … of the machine file, otherwise 0.1.
    lag : float, optional
        Of the delay of the voltages [s]; default 0.15 samples.
    delay : float, optional
        Of the delay of the currents [s]; default 0.2 samples.
    current_gain : float, optional
        Of both components of g in i' = i + g conj(i), for unequal gains of the sensors [1];
        default 0.01.
    iron_current : float, optional
        Of the current of the iron loss [A]; default 1 % of the rated current.
    harmonics : float, optional
        Of the 5th and 7th harmonics of the magnet flux, as shares of it [1]; default 0.015.
    """

    psi_f: float | None = None
    resistance: float | None = None
    inverter: float | None = None
    asymmetry: float | None = None
    offset: float | None = None
    inductance: float | None = None
    lag: float | None = None
    delay: float | None = None
    current_gain: float | None = None
    iron_current: float | None = None
    harmonics: float | None = None

    def check(self, unknowns: tuple[str, ...], machine: RotatingMachine) -> None:
        """Raise ObserverError if a value belongs to no unknown, or an unknown does not exist."""
        for name in unknowns:
            if name not in ("drift", *ADAPTED):
                raise ObserverError(
                    f"unknown {name!r}: this observer estimates drift, {', '.join(ADAPTED)}"
                )
        for name in ADAPTED:
            if getattr(self, name) and name not in unknowns:
                raise ObserverError(f"prior of {name} is given, but {name} is not an unknown")
        if self.psi_f and not machine.magnets:
            raise ObserverError(f"prior of psi_f: a {machine.kind} has no magnets")


def _first_given(*candidates: float | None) -> float:
    """Return the first value that is not None."""
    return next(value for value in candidates if value is not None)


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
    valid_reason: Array = field(
        metadata=output(
            "",
            "Why the position is not valid: "
            + ", ".join(f"{number} {word}" for number, word in enumerate(REASONS)),
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
    delay_std : float
        Standard deviation of the delay of the currents [s]; like the next three, the standard
        deviation of a considered parameter: it is not learnt, but it is part of the standard
        deviation of the position, and reduces what a row tells about the other parameters.
    current_gain_std : float
        Of both components of g in i' = i + g conj(i), for unequal gains of the sensors [1].
    iron_current_std : float
        Of the current of the iron loss [A].
    harmonic_std : float
        Of the 5th and 7th harmonics of the magnet flux, as shares of it [1].
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
    delay_std: float = 0.0
    current_gain_std: float = 0.0
    iron_current_std: float = 0.0
    harmonic_std: float = 0.0
    slow_memory: float = SLOW_MEMORY
    projection: Projection = "start"
    _core: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in NUMBERS:
            value = getattr(self, name)
            if name in ("inverter_current", "slow_memory"):
                require_positive(name, value)
            elif name != "saliency":
                require_not_negative(name, value)
            elif not np.isfinite(value):
                raise ObserverError(f"saliency must be finite, got {value}")
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
        priors: Priors = Priors(),
        dc_link: float | None = None,
        slow_memory: float = SLOW_MEMORY,
        projection: Projection = "start",
        **settings: Any,
    ) -> Self:
        """Return an observer with all settings chosen from the machine.

        Parameters
        ----------
        machine : RotatingMachine
            The machine, with the assumed inverter_voltage and inverter_current.
        sample_time : float
            Sample time [s].
        unknowns : tuple of {"drift", "resistance", "inverter", "asymmetry"}
            The drift, which current offsets cause, is always estimated.
        priors : Priors
            Standard deviations of the assumed values; the default chooses all of them.
        dc_link : float, optional
            Voltage of the inverter's DC link [V].
        slow_memory, projection
            See the class.
        settings
            memory, speed_e, psi_f, rated_current, current_noise, drift_prior, held, precision of
            the plain observer, see :meth:`LeastSquaresObserver.for_machine`.

        Raises
        ------
        ObserverError
            A required value is missing in both machine and call, this observer does not estimate an
            unknown, or a standard deviation is given for a quantity that is not an unknown.
        """
        machine = rotating(machine, "AdaptiveObserver")
        plain = LeastSquaresObserver.for_machine(machine, sample_time=sample_time, **settings)
        rated_current = settings.get("rated_current") or machine.rated_current
        assert rated_current is not None  # the plain observer requires it
        return cls.around(
            plain,
            machine,
            rated_current,
            unknowns=unknowns,
            priors=priors,
            dc_link=dc_link,
            slow_memory=slow_memory,
            projection=projection,
        )

    @classmethod
    def around(
        cls,
        plain: LeastSquaresObserver,
        machine: RotatingMachine,
        rated_current: float,
        *,
        unknowns: tuple[str, ...] = ("drift", "resistance", "inverter"),
        priors: Priors = Priors(),
        dc_link: float | None = None,
        slow_memory: float = SLOW_MEMORY,
        projection: Projection = "start",
    ) -> Self:
        """Return an observer around a given plain one; parameters as for :meth:`for_machine`.

        Parameters
        ----------
        rated_current : float
            Peak of the phase current [A].
        """
        priors.check(unknowns, machine)
        if isinstance(plain.flux_map, LinearMap):
            # The filter models i_d itself, and its guard must not depend on the filter's angle.
            plain = replace(plain, flux_map=None)
        flux = plain.flux_base if machine.magnets else 0.0
        inductance_stds = machine.inductance_stds(INDUCTANCE_SHARE)
        L_d_std, L_q_std = (
            _first_given(priors.inductance, inductance_stds[name] / L)
            for name, L in zip(machine.inductances, machine.L_dq, strict=True)
        )
        defaults = {
            "resistance": default_resistance_std(machine),
            "inverter": default_inverter_std(machine, rated_current, dc_link or 0.0),
            "asymmetry": ASYMMETRY_STD,
        }
        stds = {
            name: _first_given(getattr(priors, name), default) if name in unknowns else 0.0
            for name, default in defaults.items()
        }
        return cls(
            plain=plain,
            saliency=machine.saliency,
            psi_f=flux,
            psi_f_std=_first_given(priors.psi_f, machine.magnet_flux_std, PSI_SHARE * flux),
            resistance_std=stds["resistance"],
            inverter_voltage=machine.inverter_voltage or 0.0,
            inverter_std=stds["inverter"],
            inverter_current=machine.inverter_current or SMOOTHING * rated_current,
            offset_std=_first_given(priors.offset, OFFSET_SHARE * rated_current),
            asymmetry_std=stds["asymmetry"],
            L_d_std=L_d_std,
            L_q_std=L_q_std,
            lag_std=_first_given(priors.lag, LAG_STD * plain.sample_time),
            delay_std=_first_given(priors.delay, DELAY_STD * plain.sample_time),
            current_gain_std=_first_given(priors.current_gain, CURRENT_GAIN_STD),
            iron_current_std=_first_given(priors.iron_current, IRON_SHARE * rated_current),
            harmonic_std=_first_given(priors.harmonics, HARMONIC_STD),
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
