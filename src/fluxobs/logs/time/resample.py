"""Resampling of held voltages, smooth signals, angles and states."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...core.arrays import Array

#: Course of a channel between its samples: a command is held until the next command, an angle
#: wraps, a state jumps.
Course = Literal["held", "smooth", "angle", "state"]


def course_of(channel: str) -> Course:
    """Return the course of a channel between its samples."""
    if channel.startswith(("u_", "d_")):
        return "held"
    if channel.startswith("theta"):
        return "angle"
    return "state" if channel.startswith("hall") else "smooth"


def resample(course: Course, s: Array, values: Array, t: Array, step: float) -> Array:
    """Resample a signal from the increasing times s to the times t.

    A held signal is averaged over [t, t + step]; smooth signals and angles are interpolated by the
    cubic through the four samples around t. Values are NaN if a needed sample is missing or t is
    outside s. A held signal or a state lasts one sample beyond its last sample.

    Parameters
    ----------
    course : str
    s, values : (m,) ndarray
        At least two samples.
    t : (n,) ndarray
    step : float
        Sample time of the result [s].
    """
    match course:
        case "held":
            return _held_mean(s, values, t, t + step)
        case "angle":
            return np.asarray(np.remainder(_cubic(s, _unwrapped(values), t), 2 * np.pi))
        case "state":
            at = np.clip(np.searchsorted(s, t, side="right") - 1, 0, len(s) - 1)
            return np.where((t < s[0]) | (t > s[-1] + step), np.nan, values[at])
        case "smooth":
            return _cubic(s, values, t)


def _unwrapped(angle: Array) -> Array:
    """Remove the jumps of an angle [rad]; values may be missing."""
    finite = np.isfinite(angle)
    unwrapped = np.full_like(angle, np.nan)
    unwrapped[finite] = np.unwrap(angle[finite])
    return unwrapped


def _held_mean(s: Array, values: Array, start: Array, stop: Array) -> Array:
    """Return the mean over [start, stop] of a signal that holds each value until the next value."""
    end = s[-1] + (s[-1] - s[-2])
    finite = np.isfinite(values)
    edges = np.append(s, end)
    length = np.diff(edges)
    total = np.concatenate([[0.0], np.cumsum(np.where(finite, values, 0.0) * length)])
    gap = np.concatenate([[0.0], np.cumsum(np.where(finite, 0.0, length))])

    def integral(cumulative: Array, at: Array) -> Array:
        return np.asarray(np.interp(at, edges, cumulative))

    mean = (integral(total, stop) - integral(total, start)) / (stop - start)
    incomplete = integral(gap, stop) - integral(gap, start) > 1e-6 * (stop - start)
    slack = 1e-6 * (stop - start)
    outside = (start < edges[0] - slack) | (stop > edges[-1] + slack)
    return np.where(incomplete | outside, np.nan, mean)


def _cubic(s: Array, values: Array, t: Array) -> Array:
    """Return the cubic through the four samples around each time (Lagrange)."""
    if len(s) < 4:
        return np.full(len(t), np.nan)
    right = np.searchsorted(s, t, side="right")
    first = np.clip(right - 2, 0, len(s) - 4)
    at = first[:, None] + np.arange(4)
    x, y = s[at] - t[:, None], values[at]
    interpolated = np.zeros(len(t))
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weight = np.prod(np.stack([-x[:, j] / (x[:, k] - x[:, j]) for j in others]), axis=0)
        interpolated += weight * np.where(np.abs(weight) > 1e-9, y[:, k], 0.0)
    slack = 1e-6 * (s[1] - s[0])
    return np.where((t < s[0] - slack) | (t > s[-1] + slack), np.nan, interpolated)
