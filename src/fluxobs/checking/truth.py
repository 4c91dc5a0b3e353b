"""Mistakes with the true angle, and those that only a true angle shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..machines import RotatingMachine
from ..machines.model.frames import wrap
from .findings import Finding
from .relation import RelationFit
from .segments import Stretches

#: A turn of the truth within this share of what a mistake explains is explained by it.
CLOSE = 0.1
#: Mean errors beyond this show a zero that is off, or a delay that is [rad]; the rest has to be
#: a third of them.
SHOWN = np.radians(4.0)
CLEAR = 3.0
#: Errors that scatter by more have no mean [rad].
SCATTER = np.radians(40.0)
#: Another lag has to make the error so much smaller, and that has to be worth it [rad].
BETTER, WORTH = 2.0, np.radians(1.0)


def truth(
    channel: str,
    machine: RotatingMachine,
    data: Stretches,
    fits: dict[int, RelationFit],
    at: NDArray[np.intp],
    lag: float,
) -> list[Finding]:
    """Findings on the truth channel, from fits with other lags of the voltage added to `lag`; their
    position vectors are at the rows `at` of each stretch."""
    assert data.truth is not None
    factor = machine.n_p if channel == "theta_mech" else 1
    fit = fits[0]
    good = np.isfinite(data.truth).all(axis=1) & np.isfinite(fit.position).all(axis=1)
    if not good.any():
        return []
    true = factor * np.unwrap(data.truth[good], axis=1)[:, at]
    found = np.unwrap(np.angle(fit.position[good]), axis=1)
    moved, truly = found[:, -1] - found[:, 0], true[:, -1] - true[:, 0]
    if not (moved**2).sum() > 1:
        return []
    ratio = float(truly @ moved / (moved @ moved))
    if not abs(truly - ratio * moved).max() < CLOSE * np.abs(moved).max() + 0.5:
        return [Finding("truth", "the true angle does not follow the rotor", False)]
    if not np.abs(truly).max() > 0:
        return [Finding("truth", "the true angle stands still while the flux turns", False)]
    if abs(ratio - 1) > CLOSE:
        return [Finding("truth", _turns(ratio, channel, machine), False)]

    def error(fit: RelationFit) -> Array:
        off = wrap(np.angle(fit.position[good]) - true)
        return wrap(2 * off) / 2 if machine.half_turn_ambiguous else off

    def rms(fit: RelationFit) -> float:
        return float(np.sqrt(np.mean(error(fit) ** 2)))

    best = min((n for n in fits if np.isfinite(fits[n].share)), key=lambda n: rms(fits[n]))
    if best != 0 and rms(fit) > max(BETTER * rms(fits[best]), WORTH):
        return [
            Finding(
                "truth",
                f"with --lag {lag + best:+g} the true angle fits to "
                f"{np.degrees(rms(fits[best])):.1f}° rms, as given to "
                f"{np.degrees(rms(fit)):.1f}°",
                False,
            )
        ]
    speed = moved / (data.sample_time * (at[-1] - at[0]))
    return _offset(error(fit), speed, channel, factor, data.sample_time)


def _turns(ratio: float, channel: str, machine: RotatingMachine) -> str:
    n_p, size = machine.n_p, abs(ratio)
    backwards = (
        "the true angle turns against the estimated one: two phases are exchanged in currents "
        "and voltages alike, or the angle counts backwards (scale it by -1)"
    )
    if abs(size - 1) < CLOSE:
        return backwards
    tail = f"; also, {backwards}" if ratio < 0 else ""
    for unit, scale in (("degrees", np.pi / 180), ("turns", 2 * np.pi)):
        for pairs in (1, n_p):
            if abs(size * scale * pairs - 1) < CLOSE / 10:
                name = channel if pairs == 1 else "theta_mech"
                return f"the true angle is in {unit} (--scale {name}={scale:.7g}){tail}"
    if channel == "theta_mech" and abs(size / n_p - 1) < CLOSE:
        return f"theta_mech turns as fast as the flux: it is electrical, --truth theta_e=…{tail}"
    if channel == "theta_e" and abs(size * n_p - 1) < CLOSE:
        return f"theta_e turns {n_p} times more slowly than the flux: give it as theta_mech{tail}"
    if channel == "theta_mech":
        likely = n_p / size
        words = f"the true angle turns {size:.3g} times as fast as the flux: n_p is {n_p}, and "
        words += f"{likely:.3g} would fit"
        return words + (" (poles, not pole pairs?)" if abs(size - 2) < 2 * CLOSE else "") + tail
    return f"theta_e turns {size:.3g} times as fast as the flux: is it in radians?{tail}"


def _offset(
    error: Array, speed: Array, channel: str, factor: int, sample_time: float
) -> list[Finding]:
    """A zero that is off, or a delay: what of the error is constant, or follows the speed."""
    mean = float(np.angle(np.exp(1j * error).mean()))
    each = wrap(np.angle(np.exp(1j * error).mean(axis=1)) - mean)
    columns = np.stack([np.ones_like(speed), speed], axis=1)
    varied = np.ptp(speed) > 0.5 * np.abs(speed).max()
    used = columns if varied else columns[:, :1]
    solved = np.linalg.lstsq(used, each, rcond=None)[0]
    rest = wrap(error - mean - (used @ solved)[:, None])
    scatter = float(np.sqrt(np.mean(rest**2)))
    if scatter > SCATTER:
        return [Finding("truth", "the true angle turns with the flux but does not fit it", False)]
    zero = wrap(np.array([mean + solved[0]]))[0]
    out = []
    if abs(zero) > max(SHOWN, CLEAR * scatter):
        unit = "" if factor == 1 else f", {np.degrees(zero) / factor:.2f}° of the shaft"
        offset = zero / factor
        out.append(
            Finding(
                "truth",
                f"the zero of {channel} is off by {np.degrees(zero):.1f}° electrical{unit}: d has "
                f"to lie along α there (--offset {channel}={offset:.4g})",
                False,
            )
        )
    if varied:
        samples = solved[1] / sample_time
        most = abs(solved[1]) * np.abs(speed).max()
        if most > max(SHOWN, CLEAR * scatter):
            out.append(
                Finding(
                    "truth",
                    f"the error grows with the speed, as of {abs(samples):.2f} samples: another "
                    f"--lag, or a true angle that comes {'late' if samples > 0 else 'early'}",
                    False,
                )
            )
    if not out:
        words = f"the true angle fits to {np.degrees(np.sqrt(np.mean(error**2))):.1f}° rms"
        return [Finding("truth", words, True)]
    return out
