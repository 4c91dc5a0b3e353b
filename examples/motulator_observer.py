"""Observer for the closed loop of motulator, in place of motulator's sensorless observer.

motulator (https://github.com/Aalto-Electric-Drives/motulator) simulates drives with converter and
control. Version 0.18 or newer is required, which needs Python 3.12; install ``fluxobs[motulator]``.
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

from fluxobs import AdaptiveObserver, FluxobsError, LeastSquaresObserver
from fluxobs.machines import InteriorPMSM, RotatingMachine, SurfacePMSM, SynchronousReluctance

#: Two inductances count as equal if they differ by less than this share.
ROUND = 1e-6


def machine_of(par: SynchronousMachinePars, rated_current: float) -> RotatingMachine:
    """Return the machine with motulator's parameters.

    Parameters
    ----------
    par : SynchronousMachinePars
        Parameters with constant inductances.
    rated_current : float
        Peak of the phase current [A].

    Raises
    ------
    FluxobsError
        The inductances are not constant: pass :func:`place` an observer with a flux map.
    """
    if not isinstance(par, SynchronousMachinePars):
        raise FluxobsError(
            f"{type(par).__name__}: the inductances are not constant; create an observer for a "
            f"machine with a flux_map and pass it to place(…, observer=…)"
        )
    common: dict[str, Any] = {"R_s": par.R_s, "n_p": par.n_p, "rated_current": rated_current}
    if not par.psi_f > 0:
        return SynchronousReluctance(L_d=par.L_d, L_q=par.L_q, **common)
    if abs(par.L_d - par.L_q) <= ROUND * par.L_q:
        return SurfacePMSM(L_s=par.L_d, psi_f=par.psi_f, **common)
    return InteriorPMSM(L_d=par.L_d, L_q=par.L_q, psi_f=par.psi_f, **common)


class FluxobsObserver(SpeedFluxObserver):  # type: ignore[misc]  # motulator is not typed
    """motulator's observer, which uses angle, speed and flux of a fluxobs observer if valid.

    If the fluxobs observer is not valid, as at standstill, motulator's observer continues from the
    last valid values.

    Parameters
    ----------
    own : SpeedFluxObserver
        motulator's observer, which is replaced.
    observer : LeastSquaresObserver or AdaptiveObserver
        Observer with the sample time of the control.

    Attributes
    ----------
    estimate : Estimate
        Estimate of the last sample.
    """

    def __init__(
        self, own: SpeedFluxObserver, observer: LeastSquaresObserver | AdaptiveObserver
    ) -> None:
        self.__dict__.update(own.__dict__)
        self.observer = observer
        self.estimate: Any = None
        self._state = observer.init()
        self._applied: complex | None = None  # voltage until the next sample

    def compute_output(
        self,
        u_s_ab: complex | None,
        i_s_ab: complex,
        eps_ext: float = 0.0,
        h: float = 0.0,
    ) -> ObserverOutputs:
        """Return motulator's outputs; `u_s_ab` is the voltage in the period that begins now."""
        ended = complex(nan, nan) if self._applied is None else self._applied
        self._applied = u_s_ab
        self._state, estimate = self.observer.step(
            self._state, [ended.real, ended.imag], [i_s_ab.real, i_s_ab.imag]
        )
        self.estimate = estimate
        if estimate.valid:
            theta = float(estimate.theta_e_tracked)
            self.flux_observer.theta_m = theta
            self.flux_observer.psi_s = exp(-1j * theta) * complex(*estimate.flux)
            self.w_M = float(estimate.speed_e) / self.flux_observer.par.n_p
            eps_ext, h = 0.0, 1.0  # no correction by motulator's observer
        return super().compute_output(u_s_ab, i_s_ab, eps_ext, h)


def place(
    controller: Any,
    *,
    rated_current: float | None = None,
    unknowns: str = "drift",
    observer: LeastSquaresObserver | AdaptiveObserver | None = None,
) -> FluxobsObserver:
    """Put a fluxobs observer into a vector controller of motulator.

    Parameters
    ----------
    controller : CurrentVectorController or FluxVectorController
        Sensorless controller of a synchronous machine.
    rated_current : float, optional
        Peak of the phase current [A]; by default the controller's largest current.
    unknowns : str
        Unknowns, as for :func:`fluxobs.estimate`, if no observer is given.
    observer : LeastSquaresObserver or AdaptiveObserver, optional
        Observer with other settings; its sample time must be the controller's.

    Returns
    -------
    FluxobsObserver
        The controller's new observer; its `estimate` is the latest estimate.

    Raises
    ------
    FluxobsError
        The controller has a sensor, or the sample times differ.
    """
    original = getattr(controller, "observer", None)
    if not isinstance(original, SpeedFluxObserver) or not controller.sensorless:
        raise FluxobsError(
            "the controller must be a sensorless controller of a synchronous machine"
        )
    if observer is None:
        machine = machine_of(controller.par, rated_current or controller.cfg.i_s_max)
        names = tuple(unknowns.split(","))
        settings: dict[str, Any] = {"sample_time": controller.T_s}
        if names == ("drift",):
            observer = LeastSquaresObserver.for_machine(machine, **settings)
        else:
            observer = AdaptiveObserver.for_machine(machine, unknowns=names, **settings)
    if not abs(observer.sample_time - controller.T_s) <= 1e-9 * controller.T_s:
        raise FluxobsError(
            f"the observer steps every {observer.sample_time:g} s, the controller every "
            f"{controller.T_s:g} s; both must be equal"
        )
    controller.observer = FluxobsObserver(original, observer)
    placed: FluxobsObserver = controller.observer
    return placed
