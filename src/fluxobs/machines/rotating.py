"""Rotating machines: three phases in αβ, with or without magnets."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from .. import _core
from ..core.arrays import Array
from ..core.validation import NotNegative, Number, Positive
from ..errors import FluxobsError, MachineError
from .contract import Machine, Position, angle_std
from .datasheet import from_datasheet
from .model.constraint import QuadraticConstraint
from .model.flux_map import FluxMap, LinearMap
from .model.flux_table import FittedTable
from .model.frames import angle_error, wrap
from .model.held import Held, held_share
from .model.inverter import SMOOTHING, InverterError
from .saturation import (
    FallingInductances,
    FluxMapField,
    MapSource,
    chords,
    fitted_table,
    read_source,
)

#: No machine has more than a few hundred.
PolePairs = Annotated[int, Field(ge=1, le=1000)]


class RotatingMachine(Machine):
    """A three-phase machine with per-phase (star) values and amplitude-invariant αβ vectors.

    Current is positive into the machine; the phase sequence at positive speed is a-b-c.

    Parameters
    ----------
    R_s : float
        Phase resistance [Ω], > 0.
    n_p : int
        Pole pairs, >= 1.
    rated_current : float, optional
        Peak phase current [A], > 0. Scale of plausible values; a rough value suffices.
    inverter_voltage : float, optional
        Voltage lost to dead time and device drops per phase [V]; it is subtracted from a log's
        commanded voltages.
    inverter_current : float, optional
        Phase current at which the inverter's smoothed sign reaches three quarters [A], > 0; default
        5 % of rated_current.
    rated_speed : float, optional
        Mechanical speed [rad/s], > 0; for an induction machine, the speed at which field weakening
        begins. This speed sets the memory if L/R is short; a rough value suffices.
    R_s_std, inverter_voltage_std : float, optional
        Standard deviations of these values [Ω], [V], >= 0, for the adaptive observer. L_s_std, or
        L_d_std and L_q_std [H], and psi_f_std [Wb] have the same meaning. Defaults:
        :meth:`AdaptiveObserver.for_machine`.
    """

    position_output = Position(
        "theta_e", ("theta_e", "theta_mech"), 180 / np.pi, "°", "Electrical angle"
    )
    shortest = _core.usual["SHORTEST"]
    #: Whether there are magnets; the parameter psi_f is their flux.
    magnets: ClassVar[bool] = False
    #: Names of the inductances along d and q; the same name twice for a single inductance.
    inductances: ClassVar[tuple[str, str]]
    #: Whether the flux without current changes in operation, as in a cage machine.
    flux_moves: ClassVar[bool] = False
    #: Name of the parameter that is the flux without current.
    flux_name: ClassVar[str] = "psi_f"
    #: Name of |λ - L i| in texts for users.
    length_name: ClassVar[str] = "Magnet flux"

    R_s: Positive
    n_p: PolePairs
    inverter_voltage: Number | None = None
    inverter_current: Positive | None = None
    rated_speed: Positive | None = None
    R_s_std: NotNegative | None = None
    inverter_voltage_std: NotNegative | None = None

    @property
    def inverter(self) -> InverterError | None:
        if not self.inverter_voltage:
            return None
        knee = self.inverter_current or SMOOTHING * (self.rated_current or 0.0)
        if not knee:
            raise MachineError(
                "inverter_voltage needs inverter_current, the phase current below which its sign "
                "is smoothed [A], or rated_current"
            )
        return InverterError(self.inverter_voltage, knee)

    @property
    def R(self) -> Array:
        return self.R_s * np.eye(2)

    @property
    def B(self) -> Array:
        return np.eye(2)

    @property
    def magnet_flux(self) -> float | None:
        """Flux of the magnets [Wb]: 0 without magnets, None if not given."""
        return 0.0

    @property
    def inductance_names(self) -> tuple[str, ...]:
        """Names of this kind's inductances, without repetition."""
        return tuple(dict.fromkeys(self.inductances))

    @property
    def L_dq(self) -> tuple[float, float]:
        """Inductances along d and along q [H]."""
        L_d, L_q = (float(getattr(self, name)) for name in self.inductances)
        return L_d, L_q

    def inductance_stds(self, share: float) -> dict[str, float]:
        """Return the inductances' standard deviations [H]; default: `share` of the inductance."""
        stds = {name: getattr(self, f"{name}_std", None) for name in self.inductance_names}
        return {
            name: share * float(getattr(self, name)) if std is None else std
            for name, std in stds.items()
        }

    @property
    def magnet_flux_std(self) -> float | None:
        """Standard deviation of the magnet flux [Wb]; None if not given."""
        return None

    @property
    def magnetizing_current(self) -> float:
        """Current along d that sustains a cage machine's rotor flux [A]."""
        return 0.0

    @property
    def position_inductance(self) -> float:
        """L [H] of ``λ - L i``, the position vector along the rotor's d axis."""
        return self.L_dq[1]

    @property
    def saturation(self) -> FittedTable | None:
        """Splines of a flux map; None if inductances are constant."""
        return None

    def memory_for(self, sample_time: float, speed_e: float | None = None) -> float:
        """Return the memory of the least squares for a sample time [s].

        Current noise enters the flux directly, as L i, and through the resistive drop, as a random
        walk. The ratio of the random walk to the direct noise is R sqrt(h T) / (2 L) for the memory
        T. If L/R is short, a shorter memory keeps this ratio below one. The memory must still cover
        one turn at a quarter of the speed.

        Parameters
        ----------
        sample_time : float
            [s].
        speed_e : float, optional
            Usual electrical speed [rad/s]; default from rated_speed. If both speeds are missing,
            return :attr:`memory`.
        """
        return _core.choose(self.sizes(1.0, 1.0, speed_e), sample_time)["memory"]

    def sizes(
        self, flux_base: float, rated_current: float, speed_e: float | None = None
    ) -> dict[str, float]:
        """Return the sizes that determine the usual settings: the fields of fo_sizes.

        firmware/fluxobs_config.h describes them.

        Parameters
        ----------
        flux_base : float
            [Wb].
        rated_current : float
            [A].
        speed_e : float, optional
            Usual electrical speed [rad/s]; default from rated_speed.
        """
        if speed_e is None:
            speed_e = self.n_p * self.rated_speed if self.rated_speed else 0.0
        return {
            "resistance": self.R_s,
            "inductance": self.transient_inductance,
            "L_position": self.position_inductance,
            "flux": flux_base,
            "slope": self.constraint_noise(flux_base, 1.0),
            "shortest": self.shortest,
            "rated_current": rated_current,
            "usual_memory": self.memory,
            "speed_e": speed_e,
        }

    def held_share(self, held: Held, sample_time: float) -> float:
        """Return R h/L if voltages are held over a sample [s], else 0; with "auto" also 0 if small.

        See :meth:`LeastSquaresObserver.for_machine`.
        """
        return held_share(held, self.R_s * sample_time / self.transient_inductance)

    @property
    def transient_inductance(self) -> float:
        """Inductance [H] for a voltage step, averaged over the step's direction."""
        L_d, L_q = self.L_dq
        return 2 / (1 / L_d + 1 / L_q)

    @property
    def saliency(self) -> float:
        """L_d - L_q [H]; the position vector's length is ``ψ_f + saliency · i_d``."""
        L_d, L_q = self.L_dq
        return L_d - L_q

    def flux_dq(self, current: Any) -> NDArray[np.complex128]:
        """Return the flux linkage d + j q [Wb] of a current d + j q [A] in rotor coordinates.

        Raises
        ------
        MachineError
            The machine has magnets, but psi_f is not given.
        """
        psi = self.magnet_flux
        if psi is None:
            raise MachineError(f"psi_f is missing in the {self.kind}: its flux cannot be computed")
        L_d, L_q = self.L_dq
        i = np.asarray(current, complex)
        return np.asarray(L_d * i.real + psi + 1j * (L_q * i.imag))

    def map_for(self, sample_time: float, psi_f: float) -> FluxMap | None:
        """Return the flux map; None if one inductance and a magnet flux describe the machine.

        Parameters
        ----------
        sample_time : float
            Sample time [s], for maps that change with time.
        psi_f : float
            Magnet flux [Wb], used if the machine has no psi_f.
        """
        return None

    def position(self, flux: ArrayLike, current: ArrayLike) -> tuple[Array, Array]:
        x = np.asarray(flux, float) - self.position_inductance * np.asarray(current, float)
        return np.arctan2(x[..., 1], x[..., 0]), np.hypot(x[..., 0], x[..., 1])

    def position_std(self, flux: Array, flux_std: Array, current: Array) -> Array:
        return angle_std(flux_std, self.position(flux, current)[1])

    def true_position(self, channel: str, value: Array) -> Array:
        return wrap(value * self.n_p if channel == "theta_mech" else value)

    def position_error(self, estimated: Array, true: Array) -> Array:
        return angle_error(estimated, true, self.half_turn_ambiguous)


class SynchronousMachine(RotatingMachine):
    """A machine with a flux map, which is the flux as a function of current in rotor coordinates.

    Parameters
    ----------
    flux_map : path, mapping, FluxPoints or AlgebraicSaturation, optional
        Saturation: a CSV file with columns i_d, i_q [A], psi_d, psi_q [Wb], or the parameters of
        the algebraic model. Missing inductances and psi_f are computed from this map.
    """

    flux_map: FluxMapField | None = None

    @model_validator(mode="before")
    @classmethod
    def _fill_from_map(cls, fields: Any) -> Any:
        if not isinstance(fields, dict):
            return fields
        values = from_datasheet(fields, cls.inductances, cls.magnets)
        if values.get("flux_map") is None:
            return values
        values = values | {"flux_map": read_source(values["flux_map"])}
        for name in cls._rated_inductances():
            if values.get(name) is not None:
                raise ValueError(f"{name} and flux_map: give one of them")
        missing = [name for name in dict.fromkeys(cls.inductances) if values.get(name) is None]
        if cls.magnets and values.get("psi_f") is None:
            missing.append("psi_f")
        if missing:
            try:
                fit = fitted_table(values["flux_map"], values.get("rated_current"), cls.magnets)
                L_d, L_q, psi_f = chords(fit, values.get("rated_current"))
            except FluxobsError as error:
                raise ValueError(str(error)) from None
            linear = {"L_s": (L_d + L_q) / 2, "L_d": L_d, "L_q": L_q, "psi_f": psi_f}
            values |= {name: float(f"{linear[name]:.6g}") for name in missing}
        return values

    @classmethod
    def _rated_inductances(cls) -> tuple[str, ...]:
        return tuple(f"{name}_rated" for name in dict.fromkeys(cls.inductances))

    @property
    def saturation(self) -> FittedTable | None:
        """Splines of the flux map or of falling inductances; None if inductances are constant.

        Raises
        ------
        MachineError
            The map is implausible, or a parameter that it needs is missing.
        """
        source: MapSource | FallingInductances | None = self.flux_map
        rated = {name: getattr(self, name, None) for name in self._rated_inductances()}
        if source is None and any(value is not None for value in rated.values()):
            L_d, L_q = self.L_dq
            rated_L_d, rated_L_q = (
                rated[f"{name}_rated"] or L
                for name, L in zip(self.inductances, (L_d, L_q), strict=True)
            )
            if self.magnet_flux is None:
                raise MachineError("a rated inductance (L_…_rated) needs psi_f")
            together = len(rated) == 1
            source = FallingInductances(L_d, L_q, rated_L_d, rated_L_q, self.magnet_flux, together)
        if source is None:
            return None
        try:
            return fitted_table(source, self.rated_current, self.magnets)
        except FluxobsError as error:
            raise MachineError(str(error)) from None

    def map_for(self, sample_time: float, psi_f: float) -> FluxMap | None:
        fit = self.saturation
        if fit is not None:
            return fit.table
        if self.magnets and self.saliency != 0.0:
            return LinearMap(self.magnet_flux or psi_f, *self.L_dq)
        return None

    def position(self, flux: ArrayLike, current: ArrayLike) -> tuple[Array, Array]:
        fit = self.saturation
        if fit is None:
            return super().position(flux, current)
        psi, i = (np.asarray(vector, float) @ [1, 1j] for vector in (flux, current))
        x, _, _ = fit.table.position_vector(psi, i, self.position_inductance)
        return np.angle(x), np.abs(x)

    def flux_dq(self, current: Any) -> NDArray[np.complex128]:
        fit = self.saturation
        return super().flux_dq(current) if fit is None else fit.table.flux(current)


class MagnetMachine(SynchronousMachine):
    """A machine whose position vector λ - L i has the constant length of the magnet flux.

    The relation is ``|λ - L i|² = ψ²``: Q1 = I, Q2 = -2L I, Q3 = L² I, d = -ψ².
    """

    magnets = True

    psi_f: Positive | None = None
    psi_f_std: NotNegative | None = None

    @property
    def magnet_flux(self) -> float | None:
        return self.psi_f

    @property
    def magnet_flux_std(self) -> float | None:
        return self.psi_f_std

    @property
    def constraint(self) -> QuadraticConstraint:
        L, eye = self.position_inductance, np.eye(2)
        return QuadraticConstraint(eye, -2 * L * eye, L * L * eye, d=-((self.psi_f or 0.0) ** 2))

    def flux_base(self, rated_current: float, psi_f: float | None = None) -> float | None:
        return self.psi_f if psi_f is None else psi_f

    def constraint_noise(self, flux_base: float, noise: float) -> float:
        return 2 * self.position_inductance * flux_base * noise


def rotating(machine: object, what: str = "this") -> RotatingMachine:
    """Return `machine` if it rotates; `what` names the caller in messages.

    Raises
    ------
    MachineError
        `machine` does not rotate, or is not a machine (for example, a name).
    """
    if isinstance(machine, RotatingMachine):
        return machine
    if isinstance(machine, Machine):
        raise MachineError(f"kind {machine.kind}: {what} is for machines that turn")
    if isinstance(machine, str):
        raise MachineError(
            f"{machine!r} is a name: {what} needs the machine itself, "
            f"fluxobs.read_machine({machine!r})"
        )
    raise MachineError(f"{what} needs a machine, got {type(machine).__name__}")
