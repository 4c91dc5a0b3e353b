"""motulator's observers as entrants of `fluxobs score`.

Needs motulator 0.18 or newer, which needs Python 3.12: ``pip install 'fluxobs[design,motulator]'``.

    fluxobs score examples/motulator_entrants.py:FluxObserver \\
        examples/motulator_entrants.py:AdaptingFluxObserver --suite suite

The gains are motulator's defaults. Signal injection is not entered: the logs have no injection.
"""

from __future__ import annotations

from cmath import exp, isfinite, phase
from typing import Any

from motulator.drive.control import im, sm

#: PM-flux gain: slope over the magnet flux, and the speed where it begins, over R_s I_n / ψ_f. In
#: motulator's example of a 2.2 kW machine, 0.05 V s from a fifth of the rated speed on.
SLOPE, BEGIN = 0.1, 2.3


class FluxObserver:
    """Flux observer with speed estimation; for induction machines the reduced-order one."""

    adapts = False

    def __init__(self, machine: dict[str, Any], sample_time: float) -> None:
        self.h, self.n_p = sample_time, machine["n_p"]
        self.cage = machine["kind"] == "induction"
        self.last: complex | None = None
        largest = 1.5 * machine["rated_current"]
        if self.cage:
            par = im.InductionMachineInvGammaPars(
                self.n_p, machine["R_s"], machine["R_R"], machine["L_sigma"], machine["L_M"]
            )
            flux = machine["L_M"] * machine["rated_current"] / 2**0.5
            cage = im.CurrentVectorControllerCfg(psi_s_nom=flux, i_s_max=largest, T_s=sample_time)
            self.observer = im.CurrentVectorController(par, cage).observer
            return
        L_d, L_q = (machine.get(name, machine.get("L_s")) for name in ("L_d", "L_q"))
        psi = machine.get("psi_f", 0.0)
        par = sm.SynchronousMachinePars(self.n_p, machine["R_s"], L_d, L_q, psi)
        k_f = None
        if self.adapts and psi > 0:
            slowest = BEGIN * machine["R_s"] * machine["rated_current"] / psi
            k_f = lambda w: max(SLOPE * psi * (abs(w) - slowest), 0.0)  # noqa: E731
        least = None if psi > 0 else 0.3 * L_d * machine["rated_current"]  # of the references
        cfg = sm.CurrentVectorControllerCfg(
            i_s_max=largest, T_s=sample_time, k_f=k_f, psi_s_min=least
        )
        self.observer = sm.CurrentVectorController(par, cfg).observer

    def step(self, voltage: Any, current: Any) -> tuple[float, ...]:
        """Return (theta_e, std, valid, speed_e, torque); `voltage` is that of the last interval."""
        u, i = complex(*voltage), complex(*current)
        if self.last is not None and isfinite(u):
            out = self.observer.compute_output(u, self.last)
            self.observer.update(self.h, out)
        if isfinite(i):
            self.last = i
        flux = self.observer.flux_observer
        nan = float("nan")
        if self.last is None:
            return (nan,) * 5
        if self.cage:
            i_s = exp(-1j * flux.theta_c) * self.last
            theta = flux.theta_c + phase(flux.psi_s - flux.par.L_sgm * i_s)
        else:
            theta = flux.theta_m
            i_s = exp(-1j * theta) * self.last
        torque = 1.5 * self.n_p * (i_s * flux.psi_s.conjugate()).imag
        return theta, nan, nan, self.n_p * self.observer.w_M, torque


class AdaptingFluxObserver(FluxObserver):
    """The same with adaptation of the magnet flux."""

    adapts = True
