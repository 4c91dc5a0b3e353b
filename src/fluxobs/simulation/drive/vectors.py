"""Space vectors as complex numbers (αβ, amplitude-invariant), and unit conversions."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

ROOT3 = np.sqrt(3.0)


def rpm(speed: Any) -> Any:
    """Revolutions per minute to rad/s."""
    return speed * (2 * np.pi / 60)


def to_rpm(speed: Any) -> Any:
    """rad/s to revolutions per minute."""
    return speed * (60 / (2 * np.pi))


def rms(amplitude: Any) -> Any:
    """RMS of a phase quantity to its peak, which is used internally: A rms to A."""
    return amplitude * np.sqrt(2.0)


def to_rms(peak: Any) -> Any:
    """Peak of a phase quantity to its RMS."""
    return peak / np.sqrt(2.0)


def pair(z: Array) -> Array:
    """Complex to (..., 2)."""
    return jnp.stack([z.real, z.imag], axis=-1)


def vector(xy: Array) -> Array:
    """(..., 2) to complex."""
    return jax.lax.complex(xy[..., 0], xy[..., 1])


def phases(z: Array) -> Array:
    """Phase quantities (..., 3) of a space vector, without zero sequence."""
    half, root = -z.real / 2, ROOT3 / 2 * z.imag
    return jnp.stack([z.real, half + root, half - root], axis=-1)


def from_phases(abc: Array) -> Array:
    """Space vector of phase quantities (..., 3); the zero sequence drops out."""
    a, b, c = abc[..., 0], abc[..., 1], abc[..., 2]
    return jax.lax.complex((2 * a - b - c) / 3, (b - c) / ROOT3)


def turn(angle: Array) -> Array:
    """exp(j angle)."""
    return jax.lax.complex(jnp.cos(angle), jnp.sin(angle))


def length(z: Array) -> Array:
    """Length of a vector; faster than jnp.abs, without its guard against overflow."""
    return jnp.sqrt(z.real**2 + z.imag**2)


def unit(z: Array) -> Array:
    """Unit vector in the direction of `z`; zero for a zero vector."""
    return z / jnp.maximum(length(z), 1e-300)


def wrap(angle: Array) -> Array:
    """Wrap an angle into (-π, π]."""
    return angle - 2 * np.pi * jnp.ceil((angle - np.pi) / (2 * np.pi))


def limit(z: Array, most: Array) -> Array:
    """Limits the length of a vector; keeps its direction."""
    return z * jnp.minimum(1.0, most / jnp.maximum(length(z), 1e-300))
