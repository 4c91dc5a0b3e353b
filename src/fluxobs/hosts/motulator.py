"""In the closed loop of motulator, in place of its own sensorless observer.

motulator (https://github.com/Aalto-Electric-Drives/motulator) simulates drives with their converter
and control. Version 0.18 or newer, which needs Python 3.12; the extra is ``fluxobs[motulator]``.
"""

from __future__ import annotations

from cmath import exp
from math import nan
from typing import Any

from motulator.drive.control.sm import (
    ObserverOutputs,
    SpeedFluxObserver,
    SynchronousMachinePars,
)

from ..errors import FluxobsError
from ..machines import InteriorPMSM, RotatingMachine, SurfacePMSM, SynchronousReluctance
from ..observers import AdaptiveObserver, LeastSquaresObserver

#: Inductances that differ by less than this share of them are one.
ROUND = 1e-6


def machine_of(par: SynchronousMachinePars, rated_current: float) -> RotatingMachine:
    """The machine with motulator's parameters.

    Parameters
    ----------
    par : SynchronousMachinePars
        Of constant inductances.
    rated_current : float
        Peak of the phase current [A].

    Raises
    ------
    FluxobsError
        Its inductances are not constant: give :func:`place` an observer for a flux map.
    """
    if not isinstance(par, SynchronousMachinePars):
        raise FluxobsError(
            f"{type(par).__name__}: its inductances are not constant; make an observer from a "
            f"machine with a flux_map, and give it to place(…, observer=…)"
        )
    common: dict[str, Any] = {"R_s": par.R_s, "n_p": par.n_p, "rated_current": rated_current}
    if not par.psi_f > 0:
        return SynchronousReluctance(L_d=par.L_d, L_q=par.L_q, **common)
    if abs(par.L_d - par.L_q) <= ROUND * par.L_q:
        return SurfacePMSM(L_s=par.L_d, psi_f=par.psi_f, **common)
    return InteriorPMSM(L_d=par.L_d, L_q=par.L_q, psi_f=par.psi_f, **common)


class FluxobsObserver(SpeedFluxObserver):  # type: ignore[misc]  # motulator is not typed
    """motulator's observer, which takes angle, speed and flux from ours while that is valid.

    Until then, and at standstill, motulator's own observer goes on from the last valid values.

    Parameters
    ----------
    own : SpeedFluxObserver
        The observer to be replaced.
    observer : LeastSquaresObserver or AdaptiveObserver
        Its sample time is the control's.

    Attributes
    ----------
    estimate : Estimate
        Of the last sample.
    """

    def __init__(
        self, own: SpeedFluxObserver, observer: LeastSquaresObserver | AdaptiveObserver
    ) -> None:
        self.__dict__.update(own.__dict__)
        self.observer = observer
        self.estimate: Any = None
        self._state = observer.init()
        self._applied: complex | None = None  # voltage of the period that ends at the next sample

    def compute_output(
        self,
        u_s_ab: complex | None,
        i_s_ab: complex,
        eps_ext: float = 0.0,
        h: float = 0.0,
    ) -> ObserverOutputs:
        """As motulator calls it: `u_s_ab` is the voltage of the period that begins now."""
        ended = complex(nan, nan) if self._applied is None else self._applied
        self._applied = u_s_ab
        self._state, found = self.observer.step(
            self._state, [ended.real, ended.imag], [i_s_ab.real, i_s_ab.imag]
        )
        self.estimate = found
        if found.valid:
            theta = float(found.theta_e_tracked)
            self.flux_observer.theta_m = theta
            self.flux_observer.psi_s = exp(-1j * theta) * complex(*found.flux)
            self.w_M = float(found.speed_e) / self.flux_observer.par.n_p
            eps_ext, h = 0.0, 1.0  # nothing is to be corrected
        return super().compute_output(u_s_ab, i_s_ab, eps_ext, h)


def place(
    controller: Any,
    *,
    rated_current: float | None = None,
    unknowns: str = "drift",
    observer: LeastSquaresObserver | AdaptiveObserver | None = None,
) -> FluxobsObserver:
    """Put our observer into a vector controller of motulator.

    Parameters
    ----------
    controller : CurrentVectorController or FluxVectorController
        Of a synchronous machine, sensorless.
    rated_current : float, optional
        Peak of the phase current [A]; default the controller's largest current.
    unknowns : str
        As for :func:`fluxobs.estimate`; used if no observer is given.
    observer : LeastSquaresObserver or AdaptiveObserver, optional
        With settings of its own; its sample time must be the controller's.

    Returns
    -------
    FluxobsObserver
        Now the controller's; its `estimate` is the last one.

    Raises
    ------
    FluxobsError
        The controller has a sensor, or the sample times differ.
    """
    own = getattr(controller, "observer", None)
    if not isinstance(own, SpeedFluxObserver) or not controller.sensorless:
        raise FluxobsError("the controller is no sensorless one of a synchronous machine")
    if observer is None:
        machine = machine_of(controller.par, rated_current or controller.cfg.i_s_max)
        names = tuple(unknowns.split(","))
        given: dict[str, Any] = {"sample_time": controller.T_s}
        if names == ("drift",):
            observer = LeastSquaresObserver.for_machine(machine, **given)
        else:
            observer = AdaptiveObserver.for_machine(machine, unknowns=names, **given)
    if not abs(observer.sample_time - controller.T_s) <= 1e-9 * controller.T_s:
        raise FluxobsError(
            f"the observer steps every {observer.sample_time:g} s, the controller every "
            f"{controller.T_s:g} s"
        )
    controller.observer = FluxobsObserver(own, observer)
    placed: FluxobsObserver = controller.observer
    return placed
