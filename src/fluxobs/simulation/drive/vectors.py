"""Space vectors as complex numbers (αβ, amplitude-invariant), and unit conversions."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

ROOT3 = np.sqrt(3.0)


def rpm(speed: Any) -> Any:
    """Convert revolutions per minute to rad/s."""
    return speed * (2 * np.pi / 60)


def to_rpm(speed: Any) -> Any:
    """Convert rad/s to revolutions per minute."""
    return speed * (60 / (2 * np.pi))


def rms(amplitude: Any) -> Any:
    """Convert the RMS of a phase quantity to its peak, the internal unit (A rms to A)."""
    return amplitude * np.sqrt(2.0)


def to_rms(peak: Any) -> Any:
    """Convert the peak of a phase quantity to its RMS."""
    return peak / np.sqrt(2.0)


def pair(z: Array) -> Array:
    """Convert complex numbers to arrays (..., 2)."""
    return jnp.stack([z.real, z.imag], axis=-1)


def vector(xy: Array) -> Array:
    """Convert arrays (..., 2) to complex numbers."""
    return jax.lax.complex(xy[..., 0], xy[..., 1])


def phases(z: Array) -> Array:
    """Return the phase quantities (..., 3) of a space vector, without zero sequence."""
    half, root = -z.real / 2, ROOT3 / 2 * z.imag
    return jnp.stack([z.real, half + root, half - root], axis=-1)


def from_phases(abc: Array) -> Array:
    """Return the space vector of phase quantities (..., 3); the zero sequence has no effect."""
    a, b, c = abc[..., 0], abc[..., 1], abc[..., 2]
    return jax.lax.complex((2 * a - b - c) / 3, (b - c) / ROOT3)


def turn(angle: Array) -> Array:
    """Return exp(j angle)."""
    return jax.lax.complex(jnp.cos(angle), jnp.sin(angle))


def length(z: Array) -> Array:
    """Return the length of a vector; faster than jnp.abs, but without its overflow guard."""
    return jnp.sqrt(z.real**2 + z.imag**2)


def unit(z: Array) -> Array:
    """Return the unit vector in the direction of `z`; zero for a zero vector."""
    return z / jnp.maximum(length(z), 1e-300)


def wrap(angle: Array) -> Array:
    """Wrap an angle into (-π, π]."""
    return angle - 2 * np.pi * jnp.ceil((angle - np.pi) / (2 * np.pi))


def limit(z: Array, largest: Array) -> Array:
    """Limit the length of a vector; keep its direction."""
    return z * jnp.minimum(1.0, largest / jnp.maximum(length(z), 1e-300))
