"""Items on the position at rest: the injected signal, and how well it shows the position."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.arrays import Array
from ..logs.log import Log
from ..logs.quality.detect import Detector
from ..logs.quality.injection import Injection, describe_injection
from ..logs.quality.marks import INJECTED
from ..logs.scales import Scales, excerpts
from ..logs.time.aligned import Aligned
from ..machines import RotatingMachine
from ..smoothing.assumptions import shows_direction
from ..smoothing.estimate import VALID_STD
from .item import Item, flag_if

#: Time over which the direction is averaged [s], and the standard deviation that a proposed
#: injection reaches in it [rad].
AVERAGING, WANTED = 0.01, float(np.radians(1.0))
#: The axis is known where an estimated angle is this close: rotation between them [rad].
CLOSE = 0.1
#: An axis within this of d or q is that axis [rad].
ON_AXIS = float(np.radians(10.0))


def rest_items(
    log: Log, machine: RotatingMachine, scales: Scales, series: Mapping[str, Array]
) -> list[Item]:
    """Return items on an injected signal, and on the position at rest.

    Parameters
    ----------
    log : Log
    machine : RotatingMachine
    scales : Scales
        Sizes of the log's signals.
    series : mapping
        Thinned columns of an estimate: t, theta_e, speed_e, valid. May be empty.
    """
    detector = Detector(scales.current, scales.voltage, scales.current_noise)
    marked = [detector.marked(piece) for piece in excerpts(log)]
    injection = describe_injection(marked, log.sample_time)
    items = []
    if injection is not None:
        words = (
            f"amplitude; {injection.kind} of {injection.voltage:.3g} V at "
            f"{injection.frequency:.4g} Hz{_axis(marked, injection, series)}"
        )
        items.append(Item("injection", "fine", words, injection.current, None, "A"))
    return [*items, _position_item(log, machine, scales, injection)]


def _axis(pieces: list[Aligned], injection: Injection, series: Mapping[str, Array]) -> str:
    """Return the axis of the injected current in words; "" if unknown or rotating."""
    valid = series["valid"] > 0 if len(series) else np.zeros(0, bool)
    if injection.period < 2 or injection.kind == "rotating" or not valid.any():
        return ""
    times, angles, speeds = (series[name][valid] for name in ("t", "theta_e", "speed_e"))
    total, power, rows = 0j, 0.0, 2 * injection.period
    for piece in pieces:
        assert piece.marks is not None
        injected = piece.marks & INJECTED > 0
        for start in range(0, len(injected) - rows, max(rows, len(injected) // 64)):
            part = piece.current[start : start + rows]
            middle = float(piece.t[start + rows // 2])
            nearest = int(np.argmin(np.abs(times - middle)))
            turned = float(speeds[nearest]) * (middle - float(times[nearest]))
            if not injected[start : start + rows].all() or abs(turned) > CLOSE:
                continue
            ripple = (part - part.mean(axis=0)) @ np.array([1.0, 1j])
            ripple = ripple * np.exp(-1j * (float(angles[nearest]) + turned))
            total += complex(np.sum(ripple**2))
            power += float(np.sum(np.abs(ripple) ** 2))
    if not abs(total) > 0.5 * power:
        return ""
    axis = float(np.angle(total)) / 2
    if abs(axis) < ON_AXIS:
        return " along d"
    if abs(axis) > np.pi / 2 - ON_AXIS:
        return " along q"
    return f", {np.degrees(axis):.0f}° from d"


def _position_item(
    log: Log, machine: RotatingMachine, scales: Scales, injection: Injection | None
) -> Item:
    name = "position at rest"
    if not shows_direction(machine):
        words = (
            "this machine has no saliency"
            if machine.magnets
            else "the currents of a cage machine do not show its rotor"
        )
        return Item(name, "cannot be told", words)
    L_d, L_q = machine.L_dq
    h = log.sample_time
    # Standard deviation times the amplitude (docs/theory.md, section 13).
    product = L_q * scales.current_noise / (abs(L_d - L_q) * np.sqrt(AVERAGING / h))
    if injection is not None:
        share = 2**0.5 if injection.kind == "pulsating" else 1.0
        std = product * share / injection.current
        words = f"std within {1e3 * AVERAGING:.0f} ms from the injection and the current's noise"
        return Item(name, flag_if(std > VALID_STD), words, float(np.degrees(std)), None, "°")
    current = float(product / WANTED)
    voltage = 2 * L_d * current / h
    loss = 1.5 * machine.R_s * current**2
    words = (
        f"a square wave of {voltage:.3g} V ({current:.2g} A) along d that changes its sign in "
        f"every sample would show it to {np.degrees(WANTED):.0f}° within "
        f"{1e3 * AVERAGING:.0f} ms; it is "
        f"audible at {0.5e-3 / h:.3g} kHz and adds {loss:.2g} W of copper loss, and iron loss"
    )
    return Item(name, "cannot be told", words)
