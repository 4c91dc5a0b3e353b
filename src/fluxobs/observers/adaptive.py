"""The observer for what is not known of the machine: start, resistance, inverter, magnet, saliency.

The numbers come from firmware/fluxobs_adaptive.c, the same source that runs in a drive.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from .. import _core, _core_single
from ..errors import ObserverError
from ..machines import RotatingMachine, rotating
from ..model.inverter import SMOOTHING
from .base import Estimate
from .compiled import CompiledObserver, read_columns, wrapped
from .outputs import documented, output
from .plain import MEMORY, LeastSquaresObserver

Array = NDArray[np.float64]

#: When the immersion is projected: see :class:`AdaptiveObserver`.
Projection = Literal["never", "start", "always"]
PROJECTIONS: tuple[Projection, ...] = ("never", "start", "always")

#: Default standard deviations: of the resistance and the magnet flux as shares of what the machine
#: file says, of the inverter's voltage as a share of the rated resistive drop.
RESISTANCE_SHARE, PSI_SHARE, INVERTER_SHARE = 0.25, 0.25, 0.25
#: A resistance's standard deviation beyond so many times the resistance is a wrong unit.
RESISTANCE_MOST = 10.0
#: In which resistance, inverter and magnet may have changed by as much as that [s].
SLOW_MEMORY = 100.0


@documented
@dataclass(frozen=True, eq=False)
class AdaptiveEstimate(Estimate):
    """What the adaptive observer returns: see :class:`Estimate`, and more.

    psi_f is the magnet flux here, not the active flux of a salient machine. Until `adapting` first
    holds, it is the length of the position vector, and psi_f_std is what was believed.
    """

    psi_f_std: Array = field(metadata=output("Wb", "Standard deviation of psi_f"))
    drift_std: Array = field(metadata=output("V", "Standard deviation of a component of the drift"))
    resistance: Array = field(metadata=output("Ω", "Phase resistance"))
    resistance_std: Array = field(metadata=output("Ω", "Standard deviation of resistance"))
    inverter_voltage: Array = field(
        metadata=output("V", "What dead time and device drops take of a phase")
    )
    inverter_voltage_std: Array = field(
        metadata=output("V", "Standard deviation of inverter_voltage")
    )
    theta_e_other: Array = field(
        metadata=output(
            "rad", "While two positions are in question, the less likely one", exact=False
        )
    )
    weight_other: Array = field(metadata=output("", "Weight of theta_e_other, up to ½"))
    adapting: NDArray[np.bool_] = field(
        metadata=output(
            "",
            "The filter for all unknowns runs; before, positions are followed that fit so far",
            boolean=True,
            in_files=False,
        )
    )


@dataclass(frozen=True, eq=False)
class AdaptiveObserver(CompiledObserver[AdaptiveEstimate]):
    """Starts within a fraction of a turn, and finds what resistance and inverter are off by.

    The observer of :class:`LeastSquaresObserver` runs in it as ever. Its information is projected
    on the manifold of consistent (flux, drift, magnet flux) until the position is known; then a
    recursive square-root Gauss-Newton on (flux, drift, magnet flux, resistance, inverter) goes on,
    guarded by it. What cannot be seen at the moment (at constant speed and load: resistance,
    inverter and magnet flux apart from each other) keeps its value, and its standard deviation
    grows. A standard deviation of 0 says that something is known.

    Use :meth:`for_machine` unless you know better.

    Parameters
    ----------
    plain : LeastSquaresObserver
        The one that runs in it.
    saliency : float
        L_d - L_q [H]; 0 of a machine with one inductance.
    psi_f, psi_f_std : float
        Magnet flux as believed and its standard deviation [Wb]; 0, 0 without magnets.
    resistance_std : float
        Of the plain observer's resistance [Ω].
    inverter_voltage, inverter_std : float
        Dead time and device drops of a phase as believed, and the standard deviation [V].
    inverter_current : float
        Phase current at which the inverter's sign counts three quarters: it is tanh(i / this) [A].
        Near zero the switches' capacitances decide the voltage, not the dead time.
    slow_memory : float
        In which magnet flux, resistance and inverter may have changed by a standard deviation [s].
    projection : {"start", "always", "never"}
        "never": the start waits for the plain observer's position, about a turn. "always": the
        projection goes on, and guards in place of the plain observer's position.

    Raises
    ------
    ObserverError
        A value is negative or not finite, sizes do not fit each other, a standard deviation is
        far above what it is of, or the slow memory is shorter than the plain observer's.

    References
    ----------
    docs/theory.md, section 13; firmware/fluxobs_adaptive.c. Bierman, Factorization Methods for
    Discrete Sequential Estimation, 1977, for the covariance's form.

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
    slow_memory: float = SLOW_MEMORY
    projection: Projection = "start"
    _core: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("psi_f", "psi_f_std", "resistance_std", "inverter_std"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ObserverError(f"{name} must be finite and not negative, got {value}")
        for name in ("inverter_current", "slow_memory"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ObserverError(f"{name} must be positive and finite, got {value}")
        for name in ("saliency", "inverter_voltage"):
            if not np.isfinite(value := getattr(self, name)):
                raise ObserverError(f"{name} must be finite, got {value}")
        for name, value, of in (
            ("psi_f_std", self.psi_f_std, self.psi_f),
            ("resistance_std", self.resistance_std, RESISTANCE_MOST * self.resistance),
        ):
            if value > of:
                raise ObserverError(
                    f"{name} = {value:g} is more than {of:g}: a standard deviation, in SI units"
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
            raise ObserverError("the adaptive observer is for relations with Q1 = I, E = 0, C = 0")
        object.__setattr__(self, "_core", self._make_core())

    def _make_core(self) -> Any:
        module = _core if self.plain.precision == "double" else _core_single
        names = (
            *("saliency", "psi_f", "psi_f_std", "resistance_std", "inverter_voltage"),
            *("inverter_std", "inverter_current", "slow_memory"),
        )
        config: dict[str, Any] = {name: getattr(self, name) for name in names}
        config["projection"] = PROJECTIONS.index(self.projection)
        return wrapped(module.Adaptive, self.plain._core, config)

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
        """As believed [Ω]."""
        return float(self.plain.R[0, 0])

    @classmethod
    def for_machine(
        cls,
        machine: RotatingMachine,
        *,
        sample_time: float,
        unknowns: tuple[str, ...] = ("drift", "resistance", "inverter"),
        memory: float = MEMORY,
        psi_f: float | None = None,
        psi_f_std: float | None = None,
        resistance_std: float | None = None,
        inverter_std: float | None = None,
        rated_current: float | None = None,
        current_noise: float | None = None,
        drift_prior: float | None = None,
        slow_memory: float = SLOW_MEMORY,
        projection: Projection = "start",
        precision: Literal["double", "single"] = "double",
    ) -> Self:
        """Observer with everything chosen from the machine.

        Parameters
        ----------
        machine : RotatingMachine
            Its inverter_voltage and inverter_current serve as what is believed of the inverter.
        sample_time : float
            [s].
        unknowns : tuple of {"drift", "resistance", "inverter"}
            What is not known; the drift always is.
        psi_f_std, resistance_std, inverter_std : float, optional
            Standard deviations of what is believed [Wb], [Ω], [V]; default a quarter of the
            machine's magnet flux, of its resistance, and of its rated resistive drop. A magnet flux
            known to 1 % quickens the start and shows the resistance at constant speed and load.
        memory, psi_f, rated_current, current_noise, drift_prior, precision
            See :meth:`LeastSquaresObserver.for_machine`.
        slow_memory, projection
            See the class.

        Raises
        ------
        ObserverError
            Neither the machine nor the call gives something that is needed; an unknown that this
            observer does not find; or a standard deviation for what is not among the unknowns.
        """
        for name in unknowns:
            if name not in ("drift", "resistance", "inverter"):
                raise ObserverError(
                    f"unknown {name!r}: this observer finds drift, resistance and inverter"
                )
        for name, std in (("resistance", resistance_std), ("inverter", inverter_std)):
            if std and name not in unknowns:
                raise ObserverError(f"{name}_std is given, but {name} is not among the unknowns")
        machine = rotating(machine, "AdaptiveObserver")
        plain = LeastSquaresObserver.for_machine(
            machine,
            sample_time=sample_time,
            memory=memory,
            psi_f=psi_f,
            rated_current=rated_current,
            current_noise=current_noise,
            drift_prior=drift_prior,
            precision=precision,
        )
        rated = rated_current if rated_current is not None else machine.rated_current
        assert rated is not None  # the plain observer needs it
        if not machine.magnets and psi_f_std:
            raise ObserverError(f"psi_f_std: a {machine.kind} has no magnets")
        flux = plain.flux_base if machine.magnets else 0.0

        def believed(name: str, given: float | None, default: float) -> float:
            return (default if given is None else given) if name in unknowns else 0.0

        return cls(
            plain=plain,
            saliency=machine.saliency,
            psi_f=flux,
            psi_f_std=PSI_SHARE * flux if psi_f_std is None else psi_f_std,
            resistance_std=believed("resistance", resistance_std, RESISTANCE_SHARE * machine.R_s),
            inverter_voltage=machine.inverter_voltage or 0.0,
            inverter_std=believed("inverter", inverter_std, INVERTER_SHARE * machine.R_s * rated),
            inverter_current=machine.inverter_current or SMOOTHING * rated,
            slow_memory=slow_memory,
            projection=projection,
        )

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
