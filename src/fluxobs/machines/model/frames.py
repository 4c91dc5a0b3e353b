"""Reference frames: convert logged quantities to amplitude-invariant αβ; coils stay unchanged.

Vectors are (rows, 2) arrays; angles are electrical, in radians.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from ...core.arrays import Array

Frame = Literal["alphabeta", "abc", "line", "duty", "dq", "ports"]
FRAMES: tuple[Frame, ...] = get_args(Frame)

#: Voltage channels of each frame, then the current channels. Two of three phases suffice, since the
#: sum of all three is zero. For phase voltages this is true only if they are measured to neutral.
VOLTAGES: dict[Frame, tuple[str, ...]] = {
    "alphabeta": ("u_alpha", "u_beta"),
    "abc": ("u_a", "u_b", "u_c"),
    "line": ("u_ab", "u_bc", "u_ca"),
    "duty": ("d_a", "d_b", "d_c", "udc"),
    "dq": ("u_d", "u_q"),
    "ports": ("u_1", "u_2"),
}
PHASE_CURRENTS = ("i_a", "i_b", "i_c")
CURRENTS: dict[Frame, tuple[str, ...]] = {
    "alphabeta": ("i_alpha", "i_beta"),
    "abc": PHASE_CURRENTS,
    "line": PHASE_CURRENTS,
    "duty": PHASE_CURRENTS,
    "dq": ("i_d", "i_q"),
    "ports": ("i_1", "i_2"),
}


def clarke(a: Array, b: Array, c: Array) -> Array:
    """Apply the amplitude-invariant Clarke transform; the zero-sequence component drops out."""
    return np.stack([(2 * a - b - c) / 3, (b - c) / np.sqrt(3)], axis=-1)


def three_phases(channels: dict[str, Array], names: tuple[str, ...]) -> list[Array]:
    """Return three phases whose sum is zero, given all three or any two."""
    given = {name: channels[name] for name in names if name in channels}
    return [given[name] if name in given else -np.sum(list(given.values()), 0) for name in names]


def rotate(vector: Array, angle: Array) -> Array:
    """Rotate vectors from a rotor frame at `angle` to αβ; shape (rows, 2)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vector[:, 0], vector[:, 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def wrap(angle: Array) -> Array:
    """Wrap an angle to (-π, π]."""
    return np.asarray(np.pi - np.mod(np.pi - angle, 2 * np.pi))


def angle_error(estimated: Array, true: Array, half_turn: bool = False) -> Array:
    """Return the estimated minus the true angle, wrapped; modulo half a turn if `half_turn`."""
    difference = estimated - true
    return wrap(2 * difference) / 2 if half_turn else wrap(difference)


def native_voltage(frame: Frame, channels: dict[str, Array]) -> Array:
    """Return the voltage vector of each row in αβ; for the frame dq, it remains in dq."""
    names = VOLTAGES[frame]
    match frame:
        case "alphabeta" | "dq" | "ports":
            return np.stack([channels[name] for name in names], axis=-1)
        case "abc":
            return clarke(*three_phases(channels, names))
        case "line":
            ab, bc, _ = three_phases(channels, names)
            return np.stack([(2 * ab + bc) / 3, bc / np.sqrt(3)], axis=-1)
        case "duty":
            return clarke(*(channels[name] for name in names[:3])) * channels["udc"][:, None]


def alphabeta_current(frame: Frame, channels: dict[str, Array]) -> Array:
    """Return the current vector of each row in αβ."""
    names = CURRENTS[frame]
    if names == PHASE_CURRENTS:
        return clarke(*three_phases(channels, names))
    current = np.stack([channels[name] for name in names], axis=-1)
    return rotate(current, channels["theta_e"]) if frame == "dq" else current
