"""Records of a salient machine that stops while its i_d ripples."""

from __future__ import annotations

import numpy as np

from fluxobs import AdaptiveObserver
from fluxobs.core.arrays import Array
from fluxobs.machines import InteriorPMSM, RotatingMachine
from fluxobs.observers import AdaptiveEstimate

from .records import driven, wrapped_degrees

H, RATED_SPEED = 1e-4, 474.0


def interior(ratio: float) -> InteriorPMSM:
    """Return a 2.2 kW machine with this ratio of L_q to L_d."""
    L_d = 36e-3
    return InteriorPMSM(R_s=3.6, L_d=L_d, L_q=ratio * L_d, psi_f=0.545, n_p=3, rated_current=7.0)


def estimate_at_rest(
    machine: RotatingMachine,
    speed: Array,
    seed: int,
    *,
    ripple: float = 0.02,
    noise: float = 0.002,
    i_d: float = 0.0,
    resistance: float = 1.2,
    loss: float = 3.0,
    period: int = 2,
) -> tuple[Array, AdaptiveEstimate]:
    """Return the position errors [°] and the estimate of the adaptive observer.

    The load alternates between 10 and 70 % of the rated current every half second. Offsets are
    1 % (currents) and 0.3 % (voltages).

    Parameters
    ----------
    speed : (rows,) ndarray
        Share of the rated speed.
    ripple, noise, i_d : float
        Amplitude of the square wave of i_d, noise, mean of i_d: shares of the rated current.
    resistance : float
        Assumed resistance over the true one.
    loss : float
        Voltage that the inverter loses per phase [V].
    period : int
        Period of the square wave [samples].
    """
    rng = np.random.default_rng(seed)
    rows, rated = len(speed), machine.rated_current
    t = H * np.arange(rows)
    load = np.where(t % 1.0 > 0.5, 0.7, 0.1)
    load = np.convolve(np.pad(load, (20, 19), mode="edge"), np.ones(40) / 40, "valid")
    square = np.where(np.arange(rows) % period < period / 2, 1.0, -1.0)
    samples = driven(
        machine,
        H,
        RATED_SPEED * speed,
        rated * (i_d + ripple * square + 1j * load),
        inverter=loss,
        smoothing=0.03 * rated,
        voltage_bias=complex(*rng.normal(0, 0.003, 2)) * RATED_SPEED * machine.flux_base(rated),
        noise=noise * rated,
        theta0=rng.uniform(-3, 3),
        seed=seed,
    )
    observer = AdaptiveObserver.for_machine(
        machine.with_values(R_s=resistance * machine.R_s),
        sample_time=H,
        unknowns=("drift", "resistance", "inverter"),
    )
    current = samples.current + rng.normal(0, 0.01 * rated, 2)
    estimate = observer.run(samples.voltage, current)
    return np.abs(wrapped_degrees(estimate.theta_e - samples.theta)), estimate
