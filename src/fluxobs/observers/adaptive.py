"""The adaptive observer: quick start, errors of resistance and inverter, magnet flux, saliency.

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
from .compiled import CompiledObserver, CompiledState, read_columns, wrapped
from .outputs import documented, output
from .plain import LeastSquaresObserver
from .unknowns import ADAPTED

#: When the immersion is projected: see :class:`AdaptiveObserver`.
Projection = Literal["never", "start"]
PROJECTIONS: tuple[Projection, ...] = ("never", "start")

#: Default standard deviations: of resistance, magnet flux and inductance, as shares of the values
#: given; of the inverter's voltage, as a share of the rated resistive drop and of the DC link.
RESISTANCE_SHARE: float = _core.usual["RESISTANCE_SHARE"]
PSI_SHARE: float = _core.usual["PSI_SHARE"]
INDUCTANCE_SHARE: float = _core.usual["INDUCTANCE_SHARE"]
INVERTER_SHARE: float = _core.usual["INVERTER_SHARE"]
DC_LINK_SHARE: float = _core.usual["DC_LINK_SHARE"]
#: ... of a current offset, as a share of the rated current; of the asymmetry; of the lag [samples].
OFFSET_SHARE: float = _core.usual["OFFSET_SHARE"]
ASYMMETRY_STD: float = _core.usual["ASYMMETRY_STD"]
LAG_STD: float = _core.usual["LAG_STD"]
#: A standard deviation beyond this many times the resistance must have a wrong unit.
RESISTANCE_MOST = 10.0
#: Time in which a parameter may change by one standard deviation [s].
SLOW_MEMORY: float = _core.usual["SLOW_MEMORY"]
#: The numbers of fo_adaptive_config, in the names of the C header.
NUMBERS = (
    *("saliency", "L_d_std", "L_q_std", "lag_std", "psi_f", "psi_f_std", "resistance_std"),
    *("inverter_voltage", "inverter_std", "inverter_current", "offset_std", "asymmetry_std"),
    "slow_memory",
)


@dataclass(frozen=True)
class Learnt:
    """What an adaptive observer has learnt: every parameter, and its standard deviation."""

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
    """What the adaptive observer returns: an :class:`Estimate`, and more.

    psi_f is the magnet flux here, not the active flux of a salient machine. Until `adapting` first
    holds, it is the length of the position vector, and psi_f_std is the prior's.
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
        metadata=output("rad", "While two positions are in question, the less likely one")
    )
    weight_other: Array = field(metadata=output("", "Weight of theta_e_other, up to ½"))
    adapting: NDArray[np.bool_] = field(
        metadata=output(
            "",
            "The filter for all unknowns runs; before that, positions that fit so far are followed",
            boolean=True,
            in_files=False,
        )
    )


def default_resistance_std(machine: RotatingMachine) -> float:
    """Standard deviation of R_s [Ω]: the machine file's, else half of it."""
    given = machine.R_s_std
    return RESISTANCE_SHARE * machine.R_s if given is None else given


def default_inverter_std(machine: RotatingMachine, rated_current: float, dc_link: float) -> float:
    """Standard deviation of the inverter's voltage [V]: the machine file's, else the larger of a
    quarter of the rated resistive drop and 2 % of the DC link."""
    given = machine.inverter_voltage_std
    drop = INVERTER_SHARE * machine.R_s * rated_current
    return max(drop, DC_LINK_SHARE * dc_link) if given is None else given


@dataclass(frozen=True, eq=False)
class AdaptiveObserver(CompiledObserver[AdaptiveEstimate]):
    """Starts within a fraction of a turn, and learns what the machine file says wrong.

    A fast filter on (flux, drift) takes the residual of the machine's relation, averaged over an
    eighth of a turn. Below it, in the same triangle, the parameters (magnet flux, resistance, the
    inverter's voltage loss, current offsets, an asymmetry of the phases) learn from what the fast
    filter leaves. Their uncertainty is in the position's standard deviation, and decides whether a
    position can be valid. A parameter that the data do not determine keeps its prior: at constant
    speed and load, resistance, inverter and magnet flux cannot be told apart. A standard deviation
    of 0 marks a parameter as known.

    A :class:`LeastSquaresObserver` runs inside, on voltages corrected by what has been learnt. It
    starts the filter and guards it. Until its position is known, its information is projected on
    the manifold of consistent (flux, drift, magnet flux).

    Use :meth:`for_machine` unless you know better.

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
        [A]. Only its order matters: the loss is a sum of a harder and a softer one.
    offset_std : float
        Standard deviation of the offset of a current component [A].
    asymmetry_std : float
        Standard deviation of both components of g in u' = u + g conj(u) [1].
    L_d_std, L_q_std : float
        Standard deviations of the inductances along d and q, as shares of them [1]. They are learnt
        where they leave a trace: L_d where a current flows along d, L_q where the machine is
        salient. L_q turns the position; what is not known of it is in the standard deviation.
    lag_std : float
        Standard deviation of the time by which the voltages come late [s]. An error of this leaves
        no residual; it is in the position's standard deviation.
    slow_memory : float
        Time in which a parameter may change by a standard deviation [s].
    projection : {"start", "never"}
        "never": the start waits for the plain observer's position, about a turn.

    Raises
    ------
    ObserverError
        A value is negative or not finite, sizes do not fit each other, a standard deviation is
        far larger than its parameter, or the slow memory is shorter than the plain observer's.

    References
    ----------
    docs/theory.md, section 13; firmware/fluxobs_learning.c. Bierman, Factorization Methods for
    Discrete Sequential Estimation, 1977, for triangles and considered parameters. Friedland,
    Treatment of bias in recursive filtering, 1969, doi:10.1109/TAC.1969.1099223, for the two parts.

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
            value, least = getattr(self, name), -np.inf if name == "saliency" else 0.0
            positive = name in ("inverter_current", "slow_memory")
            if not (np.isfinite(value) and value >= least and not (positive and value == 0)):
                wanted = "positive and finite" if positive else "finite and not negative"
                wanted = "finite" if name == "saliency" else wanted
                raise ObserverError(f"{name} must be {wanted}, got {value}")
        for name, value, of in (
            ("psi_f_std", self.psi_f_std, self.psi_f),
            ("resistance_std", self.resistance_std, RESISTANCE_MOST * self.resistance),
        ):
            if value > of:
                raise ObserverError(
                    f"{name} = {value:g} is above {of:g}: give a standard deviation, in SI units"
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
            raise ObserverError("the adaptive observer needs a relation with Q1 = I, E = 0, C = 0")
        object.__setattr__(self, "_core", self._make_core())

    def configuration(self) -> dict[str, Any]:
        """The numbers of fo_adaptive_config (firmware/fluxobs_adaptive.h), in SI."""
        config: dict[str, Any] = {name: getattr(self, name) for name in NUMBERS}
        return config | {"projection": PROJECTIONS.index(self.projection)}

    def _make_core(self) -> Any:
        module = _core if self.plain.precision == "double" else _core_single
        return wrapped(module.Adaptive, self.plain._core, self.configuration())

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key != "_core"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        object.__setattr__(self, "_core", self._make_core())

    @property
    def sample_time(self) -> float:
        """[s]."""
        return self.plain.sample_time

    @property
    def memory(self) -> float:
        """[s]."""
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
        """Observer with everything chosen from the machine.

        Parameters
        ----------
        machine : RotatingMachine
            Its inverter_voltage and inverter_current are the values assumed for the inverter.
        sample_time : float
            [s].
        unknowns : tuple of {"drift", "resistance", "inverter", "asymmetry"}
            The unknowns; the drift, which a current offset causes, is always one of them.
        psi_f_std, resistance_std, inverter_std : float, optional
            Standard deviations of the assumed values [Wb], [Ω], [V]; default: those of the machine
            file (psi_f_std, R_s_std, inverter_voltage_std), else a quarter of the machine's magnet
            flux, half of its resistance, and the larger of a quarter of its rated resistive drop
            and 2 % of the DC link. A magnet flux known to 1 % speeds up the start and reveals the
            resistance at constant speed and load.
        asymmetry_std, offset_std, inductance_std, lag_std : float, optional
            Default: 0.01; 2 % of the rated current [A]; the machine file's L_s_std, …, else 0.1, as
            a share of each inductance [1]; 0.15 samples [s].
        dc_link : float, optional
            Voltage of the inverter's DC link [V].
        memory, speed_e, psi_f, rated_current, current_noise, drift_prior, held, precision
            See :meth:`LeastSquaresObserver.for_machine`.
        slow_memory, projection
            See the class.

        Raises
        ------
        ObserverError
            Neither the machine nor the call gives a value that is needed; this observer does not
            find one of the unknowns; or a standard deviation is given for what is not an unknown.
        """
        for name in unknowns:
            if name not in ("drift", *ADAPTED):
                raise ObserverError(
                    f"unknown {name!r}: this observer finds drift, {', '.join(ADAPTED)}"
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
        assert rated is not None  # the plain observer needs it
        if not machine.magnets and psi_f_std:
            raise ObserverError(f"psi_f_std: a {machine.kind} has no magnets")
        flux = plain.flux_base if machine.magnets else 0.0

        def otherwise(*given: float | None) -> float:
            return next(value for value in given if value is not None)

        defaults = {
            "resistance": default_resistance_std(machine),
            "inverter": default_inverter_std(machine, rated, dc_link or 0.0),
            "asymmetry": ASYMMETRY_STD,
        }

        stds_of_L = machine.inductance_stds(INDUCTANCE_SHARE)
        L_d_std, L_q_std = (
            otherwise(inductance_std, stds_of_L[name] / L)
            for name, L in zip(machine.inductances, machine.L_dq, strict=True)
        )

        def believed(name: str) -> float:
            return otherwise(stds[name], defaults[name]) if name in unknowns else 0.0

        return cls(
            plain=plain,
            saliency=machine.saliency,
            psi_f=flux,
            psi_f_std=otherwise(psi_f_std, machine.magnet_flux_std, PSI_SHARE * flux),
            resistance_std=believed("resistance"),
            inverter_voltage=machine.inverter_voltage or 0.0,
            inverter_std=believed("inverter"),
            inverter_current=machine.inverter_current or SMOOTHING * rated,
            offset_std=otherwise(offset_std, OFFSET_SHARE * rated),
            asymmetry_std=believed("asymmetry"),
            L_d_std=L_d_std,
            L_q_std=L_q_std,
            lag_std=otherwise(lag_std, LAG_STD * sample_time),
            slow_memory=slow_memory,
            projection=projection,
        )

    def learnt(self, state: CompiledState, lane: int = 0) -> Learnt:
        """What `state` (one lane of it) has learnt."""
        found: dict[str, Any] = self._core.learnt(state.raw, lane)
        found["resistance"] = self.resistance + found.pop("resistance_error")
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in found.items()
        }
        return Learnt(**values)

    def restart(self, state: CompiledState, *, frozen: bool = False) -> CompiledState:
        """Initial state that keeps what `state` has learnt, as after a power cycle.

        With `frozen` the parameters and their standard deviations stay as they are.
        """
        return CompiledState(self._core.restart(state.raw, frozen), state.batch)

    def restarts(self, state: CompiledState, lane: int = 0) -> int:
        """How often the filter's guard restarted it in `state` (one lane of it)."""
        return int(self._core.restarts(state.raw, lane))

    def parameters(self) -> dict[str, Any]:
        """Every number a step uses beyond the plain observer's, in the order of fo_adaptive
        (firmware/fluxobs_adaptive.h)."""
        found: dict[str, Any] = self._core.parameters()
        return found

    def _estimate(self, columns: Array, valid: NDArray[np.bool_]) -> AdaptiveEstimate:
        fields = read_columns(_core.adaptive_outputs, columns)
        fields["resistance"] = self.resistance + fields.pop("resistance_error")
        adapting = fields.pop("adapting") > 0
        return AdaptiveEstimate(**fields, valid=valid, adapting=adapting)

    def _seed(
        self, given: dict[str, float], current: Array, state: CompiledState
    ) -> NDArray[np.uint8]:
        raw: NDArray[np.uint8] = self._core.seed(given, current, state.raw)
        return raw
