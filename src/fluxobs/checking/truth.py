"""Mistakes with the true angle, and mistakes that only a true angle reveals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..logs.record import signed
from ..machines import RotatingMachine
from ..machines.model.frames import wrap
from .findings import Finding
from .relation import RelationFit
from .segments import Segments

#: A mistake explains the rotation of the true angle if its prediction errs by less than this share.
CLOSE = 0.1
#: A mean error above SHOWN [rad] and above CLEAR times the scatter reveals a wrong zero or a delay.
SHOWN = np.radians(4.0)
CLEAR = 3.0
#: Errors that scatter by more than this have no meaningful mean [rad].
SCATTER = np.radians(40.0)
#: Report another lag if the rms error exceeds BETTER times the error at that lag, and WORTH [rad].
BETTER, WORTH = 2.0, np.radians(1.0)


def check_truth(
    channel: str,
    machine: RotatingMachine,
    data: Segments,
    fits: dict[int, RelationFit],
    rows: NDArray[np.intp],
    lag: float,
) -> list[Finding]:
    """Return the findings on the truth channel.

    `fits` holds one fit for each change of `lag`. The position vectors of the fits are at the rows
    `rows` of each segment.
    """
    assert data.truth is not None
    factor = machine.n_p if channel == "theta_mech" else 1
    fit = fits[0]
    usable = np.isfinite(data.truth).all(axis=1) & np.isfinite(fit.position).all(axis=1)
    if not usable.any():
        return []
    true = factor * np.unwrap(data.truth[usable], axis=1)[:, rows]
    estimated = np.unwrap(np.angle(fit.position[usable]), axis=1)
    estimated_turn, true_turn = estimated[:, -1] - estimated[:, 0], true[:, -1] - true[:, 0]
    if not (estimated_turn**2).sum() > 1:
        return []
    ratio = float(true_turn @ estimated_turn / (estimated_turn @ estimated_turn))
    if (
        not abs(true_turn - ratio * estimated_turn).max()
        < CLOSE * np.abs(estimated_turn).max() + 0.5
    ):
        return [Finding("truth", "the true angle does not follow the rotor", False)]
    if not np.abs(true_turn).max() > 0:
        return [Finding("truth", "the true angle is constant while the flux turns", False)]
    if abs(ratio - 1) > CLOSE:
        return [Finding("truth", _explain_ratio(ratio, channel, machine), False)]

    def error(fit: RelationFit) -> Array:
        difference = wrap(np.angle(fit.position[usable]) - true)
        return wrap(2 * difference) / 2 if machine.half_turn_ambiguous else difference

    def rms(fit: RelationFit) -> float:
        return float(np.sqrt(np.mean(error(fit) ** 2)))

    best = min(
        (shift for shift in fits if np.isfinite(fits[shift].share)),
        key=lambda shift: rms(fits[shift]),
    )
    if best != 0 and rms(fit) > max(BETTER * rms(fits[best]), WORTH):
        return [
            Finding(
                "truth",
                f"with --lag {signed(lag + best)} the true angle fits to "
                f"{np.degrees(rms(fits[best])):.1f}° rms, with the given lag to "
                f"{np.degrees(rms(fit)):.1f}°",
                False,
            )
        ]
    speed = estimated_turn / (data.sample_time * (rows[-1] - rows[0]))
    return _check_offset(error(fit), speed, channel, factor, data.sample_time)


def _explain_ratio(ratio: float, channel: str, machine: RotatingMachine) -> str:
    n_p, magnitude = machine.n_p, abs(ratio)
    reversed_angle = (
        "the true angle turns against the estimated angle: two phases are exchanged in both "
        "currents and voltages, or the true angle counts backwards (scale it by -1)"
    )
    if abs(magnitude - 1) < CLOSE:
        return reversed_angle
    suffix = f"; also, {reversed_angle}" if ratio < 0 else ""
    for unit, scale in (("degrees", np.pi / 180), ("turns", 2 * np.pi)):
        for pairs in (1, n_p):
            if abs(magnitude * scale * pairs - 1) < CLOSE / 10:
                name = channel if pairs == 1 else "theta_mech"
                return f"the true angle is in {unit} (--scale {name}={scale:.7g}){suffix}"
    if channel == "theta_mech" and abs(magnitude / n_p - 1) < CLOSE:
        return (
            f"theta_mech turns as fast as the flux: it is an electrical angle, use --truth "
            f"theta_e=…{suffix}"
        )
    if channel == "theta_e" and abs(magnitude * n_p - 1) < CLOSE:
        return (
            f"theta_e turns {n_p} times more slowly than the flux: it is a mechanical angle, use "
            f"--truth theta_mech=…{suffix}"
        )
    if channel == "theta_mech":
        likely = n_p / magnitude
        message = (
            f"the true angle turns {magnitude:.3g} times as fast as the flux: n_p is {n_p}, but "
        )
        message += f"{likely:.3g} would fit"
        return (
            message
            + (" (poles instead of pole pairs?)" if abs(magnitude - 2) < 2 * CLOSE else "")
            + suffix
        )
    return f"theta_e turns {magnitude:.3g} times as fast as the flux: is it in radians?{suffix}"


def _check_offset(
    error: Array, speed: Array, channel: str, factor: int, sample_time: float
) -> list[Finding]:
    """Return findings on a wrong zero (constant error) and a delay (error grows with speed)."""
    mean = float(np.angle(np.exp(1j * error).mean()))
    means = wrap(np.angle(np.exp(1j * error).mean(axis=1)) - mean)
    columns = np.stack([np.ones_like(speed), speed], axis=1)
    speed_varies = np.ptp(speed) > 0.5 * np.abs(speed).max()
    regressor = columns if speed_varies else columns[:, :1]
    coefficients = np.linalg.lstsq(regressor, means, rcond=None)[0]
    remainder = wrap(error - mean - (regressor @ coefficients)[:, None])
    scatter = float(np.sqrt(np.mean(remainder**2)))
    if scatter > SCATTER:
        return [Finding("truth", "the true angle turns with the flux but does not fit it", False)]
    zero = wrap(np.array([mean + coefficients[0]]))[0]
    findings = []
    if abs(zero) > max(SHOWN, CLEAR * scatter):
        shaft_text = "" if factor == 1 else f", {np.degrees(zero) / factor:.2f}° of the shaft"
        offset = zero / factor
        findings.append(
            Finding(
                "truth",
                f"the zero of {channel} is off by {np.degrees(zero):.1f}° "
                f"electrical{shaft_text}: at zero, d must lie along α (--offset "
                f"{channel}={offset:.4g})",
                False,
            )
        )
    if speed_varies:
        samples = coefficients[1] / sample_time
        largest = abs(coefficients[1]) * np.abs(speed).max()
        if largest > max(SHOWN, CLEAR * scatter):
            findings.append(
                Finding(
                    "truth",
                    f"the error grows with the speed, like a delay of {abs(samples):.2f} samples: "
                    f"either --lag is wrong, or the true angle is "
                    f"{'late' if samples > 0 else 'early'}",
                    False,
                )
            )
    if not findings:
        message = f"the true angle fits to {np.degrees(np.sqrt(np.mean(error**2))):.1f}° rms"
        return [Finding("truth", message, True)]
    return findings
