"""Records of a salient machine that stops while its i_d ripples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fluxobs import AdaptiveObserver
from fluxobs.core.arrays import Array
from fluxobs.machines import InteriorPMSM, RotatingMachine
from fluxobs.observers import AdaptiveEstimate

from .records import Samples, driven, wrapped_degrees

H, RATED_SPEED = 1e-4, 474.0


def interior(ratio: float) -> InteriorPMSM:
    """Return a 2.2 kW machine with this ratio of L_q to L_d."""
    L_d = 36e-3
    return InteriorPMSM(R_s=3.6, L_d=L_d, L_q=ratio * L_d, psi_f=0.545, n_p=3, rated_current=7.0)


class RecordAtRest(NamedTuple):
    """A record at rest, and the machine that an observer assumes."""

    samples: Samples
    current: Array  # with offsets [A]
    assumed: RotatingMachine

    def errors(self, theta_e: Array) -> Array:
        """Return the errors of a position [°]."""
        return np.abs(wrapped_degrees(theta_e - self.samples.theta))


def record_at_rest(
    machine: RotatingMachine,
    speed: Array,
    seed: int,
    *,
    ripple: float | Array = 0.02,
    noise: float = 0.002,
    i_d: float = 0.0,
    resistance: float = 1.2,
    loss: float = 3.0,
    wave: Sequence[complex] = (1, -1),
) -> RecordAtRest:
    """Return a record.

    The load alternates between 10 and 70 % of the rated current every half second. Offsets are
    1 % (currents) and 0.3 % (voltages).

    Parameters
    ----------
    speed : (rows,) ndarray
        Share of the rated speed.
    ripple, noise, i_d : float
        Amplitude of the wave, noise, mean of i_d: shares of the rated current. The ripple may be an
        array of shape (rows,).
    resistance : float
        Assumed resistance over the true one.
    loss : float
        Voltage that the inverter loses per phase [V].
    wave : sequence of complex
        A period of the wave, i_d + j i_q.
    """
    rng = np.random.default_rng(seed)
    rows, rated = len(speed), machine.rated_current
    t = H * np.arange(rows)
    load = np.where(t % 1.0 > 0.5, 0.7, 0.1)
    load = np.convolve(np.pad(load, (20, 19), mode="edge"), np.ones(40) / 40, "valid")
    injected = ripple * np.resize(np.array(wave), rows)
    samples = driven(
        machine,
        H,
        RATED_SPEED * speed,
        rated * (i_d + injected + 1j * load),
        inverter=loss,
        smoothing=0.03 * rated,
        voltage_bias=complex(*rng.normal(0, 0.003, 2)) * RATED_SPEED * machine.flux_base(rated),
        noise=noise * rated,
        theta0=rng.uniform(-3, 3),
        seed=seed,
    )
    current = samples.current + rng.normal(0, 0.01 * rated, 2)
    return RecordAtRest(samples, current, machine.with_values(R_s=resistance * machine.R_s))


def estimate_at_rest(record: RecordAtRest) -> AdaptiveEstimate:
    """Return the estimate of the adaptive observer."""
    observer = AdaptiveObserver.for_machine(
        record.assumed, sample_time=H, unknowns=("drift", "resistance", "inverter")
    )
    return observer.run(record.samples.voltage, record.current)


def columns_at_rest(record: RecordAtRest) -> dict[str, Array]:
    """Return the record as a log whose voltages act from each row to the next."""
    voltage = np.roll(record.samples.voltage, -1, axis=0)
    voltage[-1] = voltage[-2]
    columns = np.column_stack([H * np.arange(len(voltage)), record.current, voltage])
    return dict(zip(("t", "i_alpha", "i_beta", "u_alpha", "u_beta"), columns.T, strict=True))
