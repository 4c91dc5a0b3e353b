"""Block commutation: the phase that floats, and its voltage, which a log of duties does not have.

While a phase is switched off, a log contains 0 or the mean of the other two for its voltage. The
current of the floating phase is zero, so its voltage is its back-EMF. The voltage between the
driven phases shows the back-EMF along their axis; over a turn, all axes occur. A regression over a
turn gives the vector of the back-EMF, and with it the component of the floating phase.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...core.arrays import Array, runs
from ...machines import RotatingMachine
from ..time.aligned import Aligned
from .marks import floating_of

#: Axes of the phases in αβ.
AXES = np.array([[1.0, 0.0], [-0.5, 3**0.5 / 2], [-0.5, -(3**0.5) / 2]])
#: A voltage that is exactly 0 or the mean of the others, as a share of the voltage: text of four
#: digits.
EXACT = 1e-3
#: Fewest rows of a run without current.
LEAST_ROWS = 3
#: Rows on each side of a commutation that belong to it.
AROUND = 3
#: Share of the rows with current in which a phase floats, and number of phases that do.
LEAST_SHARE, LEAST_PHASES = 0.25, 2
#: Turns of the window of the regression.
WINDOW = 1.0
#: The regression takes this share of its trace as prior, so that a window at rest has a solution.
RIDGE = 1e-9
#: Harmonics of the magnet flux in a phase, as multiples of the speed, and their prior standard
#: deviation as a share of the flux: usual EMF waveforms.
HARMONICS, HARMONIC_STD = (-5, 7), 0.015
#: Rounds of the regression; the harmonics follow the angle of the fundamental.
ROUNDS = 4
#: The regressions compare sums over this part of a sector: the noise of single voltages is that of
#: the current's derivative, and errors of the angle within a sector grow with the part.
PART = 8

Phases = NDArray[np.int64]


def floating_phase(current: Array, voltage: Array | None, limit: float) -> Phases:
    """Return the phase that floats in the interval that ends at each row: 1, 2, 3; 0: none.

    Parameters
    ----------
    current : (rows, 2) ndarray
        [A].
    voltage : (rows, 2) ndarray, optional
        [V]. Without it, the phase may have a measured voltage.
    limit : float
        Largest current of a phase without current [A].
    """
    result = np.zeros(len(current), np.int64)
    with np.errstate(invalid="ignore", over="ignore"):
        i = current @ AXES.T
    with np.errstate(invalid="ignore"):
        carries = np.abs(i).max(axis=1) > 2 * limit
        unknown = [np.ones(len(i), bool)] * 3
        if voltage is not None:
            u = voltage @ AXES.T
            size = np.abs(u).max(axis=1)
            unknown = [_undriven(u, n, EXACT * size) & (size > 0) for n in range(3)]
        idle = [(np.abs(i[:, n]) < limit) & carries & unknown[n] for n in range(3)]
    counts = []
    for n in range(3):
        kept = [(start, end) for start, end in runs(idle[n]) if end - start >= LEAST_ROWS]
        counts.append(len(kept))
        for start, end in kept:
            result[start:end] = n + 1
    seen = sum(count > 1 for count in counts)
    if seen < LEAST_PHASES or (result > 0).sum() < LEAST_SHARE * carries.sum():
        return np.zeros(len(current), np.int64)
    for start, end in runs(result == 0):
        # Before a phase is without current, its diode conducts. With a lag that is wrong, the last
        # voltages belong to rows whose current flows already.
        while 0 < end < len(result) and end > start and unknown[result[end] - 1][end - 1]:
            end -= 1
            result[end] = result[end + 1]
        while 0 < start < end and unknown[result[start - 1] - 1][start]:
            result[start] = result[start - 1]
            start += 1
    return result


def commutating(current: Array, phase: Phases, limit: float) -> NDArray[np.bool_]:
    """Return the rows in which the current commutates from one phase to another."""
    between = np.zeros(len(phase), bool)
    at = np.flatnonzero(phase > 0)
    between[at] = np.abs((current[at] * AXES[phase[at] - 1]).sum(axis=1)) > limit
    changes = np.flatnonzero(np.diff(phase) != 0)
    for shift in range(1 - AROUND, 1 + AROUND):
        between[np.clip(changes + shift, 0, len(phase) - 1)] = True
    return between


def _undriven(u: Array, phase: int, tolerance: Array) -> NDArray[np.bool_]:
    """Return whether the voltage of a phase is the mean of the others, or that of another phase."""
    others = [n for n in range(3) if n != phase]
    exact = np.abs(u[:, phase]) < tolerance
    for other in others:
        exact |= np.abs(u[:, phase] - u[:, other]) < tolerance
    return np.asarray(exact)


def with_back_emf(rows: Aligned, machine: RotatingMachine, sample_time: float) -> Aligned:
    """Return marked rows with the back-EMF as the voltage of the floating phase.

    Parameters
    ----------
    rows : Aligned
    machine : RotatingMachine
        Its R_s and the mean of its inductances give the drop between the driven phases.
    sample_time : float
        [s].
    """
    assert rows.marks is not None
    phase = floating_of(rows.marks)
    if not phase.any():
        return rows
    inductance = float(np.mean(machine.L_dq))
    known = (phase > 0) & np.isfinite(rows.voltage).all(axis=1) & np.isfinite(rows.current).all(1)
    turning = _turning(phase, sample_time)
    if turning is None:
        return rows
    turned, speed = turning
    step = np.diff(rows.current, axis=0, prepend=rows.current[:1])
    mean = rows.current - step / 2
    drop = machine.R_s * mean + inductance / sample_time * step
    axis = AXES[phase - 1]
    across = np.stack([-axis[:, 1], axis[:, 0]], axis=1)  # between the driven phases
    emf = ((rows.voltage - drop) * across).sum(axis=1)
    vector = _back_emf(np.where(known, emf, 0.0), across, phase, known, turned, speed)
    wanted = ((vector + drop) * axis).sum(axis=1)
    has = (rows.voltage * axis).sum(axis=1)
    voltage = rows.voltage + np.where(known, wanted - has, 0.0)[:, None] * axis
    return rows._replace(voltage=voltage)


def _back_emf(
    along: Array,
    across: Array,
    phase: NDArray[np.int64],
    known: NDArray[np.bool_],
    turned: Array,
    speed: Array,
) -> Array:
    """Return the vector of the back-EMF (rows, 2) [V] from its component `along` the axes `across`.

    Its fundamental follows from a regression over a turn around each row, in coordinates that turn
    with the floating axis. The harmonics of the magnet flux are constant: one regression over all
    rows gives them. Both alternate.
    """
    axis = across[:, 0] + 1j * across[:, 1]
    turning = 1j * speed * np.exp(1j * turned)
    moving = np.where(speed == 0, 1.0, speed)
    sectors = _Sectors(phase)
    by_re, by_im = (sectors.integral((f * turning * axis.conj()).real) for f in (1.0, 1j))
    weight = np.where(known, 1.0, 0.0)

    def fundamental(integral: Array) -> NDArray[np.complex128]:
        """Return the factor on `turning` whose component fits best within a turn of each row."""
        products = np.stack(
            [by_re * by_re, by_re * by_im, by_im * by_im, by_re * integral, by_im * integral],
            axis=1,
        )
        aa, ab, bb, ae, be = _sums_over_a_turn(weight[:, None] * products, turned).T
        ridge = RIDGE * (aa + bb) + 1e-300
        aa, bb = aa + ridge, bb + ridge
        real, imaginary = bb * ae - ab * be, aa * be - ab * ae
        return np.asarray((real + 1j * imaginary) / (aa * bb - ab * ab))

    def left(integral: Array) -> Array:
        """Return what the fundamental leaves."""
        factor = fundamental(integral)
        return (integral - factor.real * by_re - factor.imag * by_im)[known]

    measured = sectors.integral(along)
    rest = left(measured)
    harmonics = np.zeros(len(along), complex)
    factor = fundamental(measured)
    shares: Array = np.zeros(2 * len(HARMONICS))
    columns: Array = np.zeros((len(rest), len(shares)))
    for _ in range(ROUNDS):
        unit = np.where(speed == 0, 1.0, factor * turning / (1j * moving))
        psi = np.abs(unit)
        rotor = unit / np.maximum(psi, 1e-300)
        # Locked to the fundamental, they would bend the regression: it then stops elsewhere.
        orders = [
            np.asarray(c * n * speed * psi * rotor**n, complex)
            for n in HARMONICS
            for c in (1.0, 1j)
        ]
        integrals = [sectors.integral((order * axis.conj()).real) for order in orders]
        columns = np.stack([left(integral) for integral in integrals], axis=1)
        variance = float(np.mean((rest - columns @ shares) ** 2))
        normal = columns.T @ columns + variance / HARMONIC_STD**2 * np.eye(len(orders))
        shares = np.asarray(np.linalg.lstsq(normal, columns.T @ rest, rcond=None)[0])
        harmonics = np.asarray(shares @ np.stack(orders))
        factor = fundamental(measured - np.asarray(shares @ np.stack(integrals)))
    vector = factor * turning + harmonics
    return np.stack([vector.real, vector.imag], axis=1)


class _Sectors:
    """Runs of rows with the same floating phase."""

    def __init__(self, phase: NDArray[np.int64]) -> None:
        self.starts = np.flatnonzero(np.diff(phase, prepend=-1) != 0)
        counts = np.diff(np.append(self.starts, len(phase)))
        rows = np.arange(len(phase))
        self.before = np.maximum(rows - np.repeat(np.maximum(counts // PART, 1), counts), 0)
        self.inside = self.before >= np.repeat(self.starts, counts)

    def integral(self, values: Array) -> Array:
        """Return the sum over the rows before, a part of the sector; 0 near its begin."""
        total = np.cumsum(values)
        return np.where(self.inside, total - total[self.before], 0.0)


def _turning(phase: NDArray[np.int64], sample_time: float) -> tuple[Array, Array] | None:
    """Return the angle [rad] and speed [rad/s] with which the floating axis turns.

    Returns None with fewer than four changes of the phase.
    """
    at = np.flatnonzero(phase > 0)
    sequence = phase[at]
    starts = np.flatnonzero(np.diff(sequence, prepend=-1) != 0)
    if len(starts) < 5:
        return None
    # The first and the last sector are incomplete.
    edges, axis = at[starts[1:]], np.arctan2(AXES[:, 1], AXES[:, 0])[sequence[starts] - 1]
    turned = np.unwrap(2 * axis)[1:] / 2  # a sixth of a turn more at each edge
    speeds = np.diff(turned) / np.diff(edges)
    middles, rows = (edges[1:] + edges[:-1]) / 2, np.arange(len(phase))
    speed = np.interp(rows, middles, speeds)
    for side, outside in ((0, rows < middles[0]), (-2, rows > middles[-1])):
        slope = (speeds[side + 1] - speeds[side]) / (middles[side + 1] - middles[side])
        end = 0 if side == 0 else -1
        beyond = speeds[end] + slope * (rows - middles[end])
        # It may stop there, but it does not reverse unseen.
        speed = np.where(outside, np.where(beyond * speeds[end] > 0, beyond, 0.0), speed)
    angle = np.cumsum(speed)
    return angle, speed / sample_time


def _sums_over_a_turn(products: Array, turned: Array) -> Array:
    """Return sliding sums over rows whose angle differs by less than half a turn."""
    rows = np.arange(len(turned))
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(turned)))])
    low = np.searchsorted(path, path - WINDOW * np.pi, side="left")
    high = np.searchsorted(path, path + WINDOW * np.pi, side="right")
    low, high = np.minimum(low, rows), np.maximum(high, rows + 1)
    total = np.concatenate([np.zeros((1, products.shape[1])), np.cumsum(products, axis=0)])
    return np.asarray(total[high] - total[low])
