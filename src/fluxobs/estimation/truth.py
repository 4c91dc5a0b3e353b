"""Fit the truth of a log to the estimate: errors of an encoder, a speed signal or Hall sensors.

An encoder's zero, direction and delay are seldom known, its disc is never centred, and the number
of pole pairs may be wrong. These errors are fitted to the estimated angle, with standard
deviations; the remaining difference is the error of the estimate. A constant error of the estimate
cannot be separated from the zero; the standard deviation of the zero includes this error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..core.robust import huber_weight
from ..machines import RotatingMachine
from ..machines.model.frames import wrap
from .columns import EstimateRows

#: Largest numbers of evenly spread rows, and of Hall edges, in a fit.
MAX_ROWS, MAX_EDGES = 40_000, 200_000
#: Turns are counted over spans of this many rows.
SPAN = 32
#: Number of blocks of rows whose errors are assumed to be independent.
BLOCKS = 40
#: If the ratio of turns is this close (relative) to an integer, the integer is the number of pole
#: pairs.
WHOLE = 0.02
#: Speeds must differ by this share of the largest speed to separate a delay from the zero.
VARIED = 0.3
#: A parameter is reported if its value exceeds this many standard deviations.
SIGNIFICANT = 3.0
#: Share of a shaft turn that the rows must cover for a fit of the eccentricity.
COVERED = 0.9
#: A larger rms error of the angle in a block of rows is an error of the channel [rad].
LOST = np.radians(5.0)
#: A step of the zero explains the error if less than this share of the squared error remains.
SLIPPED = 0.1
#: A larger rms error of a speed, over the largest speed, is an error of the channel.
LOST_SPEED = 0.1


@dataclass(frozen=True)
class TruthParameter:
    """One error parameter of a truth channel: value and standard deviation."""

    name: str
    value: float
    std: float
    unit: str

    @property
    def told(self) -> bool:
        """Whether the value differs significantly from zero."""
        return abs(self.value) > SIGNIFICANT * self.std


@dataclass
class TruthSamples:
    """Samples of a run's truth for the fit; their number is bounded."""

    total: int
    channel: str
    rows: int = 0
    known: int = 0  # valid rows on which the channel has a value
    batches: list[dict[str, Array]] = field(default_factory=list)
    product: float = 0.0  # Σ over spans: estimated times true turned angle
    square: float = 0.0  # Σ over spans: true turned angle squared
    turned: float = 0.0  # angle turned by the channel, in both directions [rad]
    edges: list[Array] = field(default_factory=list)
    edge_count: int = 0
    before: dict[str, float] = field(default_factory=dict)  # last row of the previous batch

    def add(self, rows: EstimateRows) -> None:
        """Add the next rows."""
        columns, raw = rows.columns, rows.more["raw"]
        count, usable = len(raw), rows.valid & np.isfinite(raw)
        stride = max(1, self.total // MAX_ROWS)
        kept_rows = np.arange(-self.rows % stride, count, stride)
        kept_rows = kept_rows[usable[kept_rows]]
        thinned = {"raw": raw[kept_rows], "row": (self.rows + kept_rows).astype(float)}
        for name in ("t", "theta_e", "theta_e_std", "speed_e", "speed_mech"):
            if name in columns:
                thinned[name] = np.array(columns[name][kept_rows], float)
        self.batches.append(thinned)
        self.known += int(usable.sum())
        if self.channel == "hall":
            self._add_edges(columns["theta_e"], raw, usable)
        elif self.channel.startswith("theta"):
            self._count_turns(columns["theta_e"], raw, usable)
        self.rows += count

    def _count_turns(self, theta: Array, raw: Array, usable: NDArray[np.bool_]) -> None:
        length = len(raw) // SPAN * SPAN
        if not length:
            return
        complete = usable[:length].reshape(-1, SPAN).all(axis=1)
        estimated = wrap(np.diff(theta[:length].reshape(-1, SPAN)[complete], axis=1)).sum(axis=1)
        true = wrap(np.diff(raw[:length].reshape(-1, SPAN)[complete], axis=1)).sum(axis=1)
        self.product += float(estimated @ true)
        self.square += float(true @ true)
        self.turned += float(np.abs(true).sum())

    def _add_edges(self, theta: Array, raw: Array, usable: NDArray[np.bool_]) -> None:
        if self.before:
            theta = np.concatenate([[self.before["theta"]], theta])
            raw = np.concatenate([[self.before["raw"]], raw])
            usable = np.concatenate([[self.before["good"] > 0], usable])
        edge = np.flatnonzero((raw[1:] != raw[:-1]) & usable[1:] & usable[:-1])
        if self.edge_count < MAX_EDGES and len(edge):
            moved = wrap(theta[edge + 1] - theta[edge])
            middle = wrap(theta[edge] + moved / 2)
            self.edges.append(np.stack([raw[edge], raw[edge + 1], middle, np.sign(moved)]))
            self.edge_count += len(edge)
        self.before = {"theta": theta[-1], "raw": raw[-1], "good": float(usable[-1])}

    def columns(self) -> dict[str, Array]:
        if not self.batches:
            return {}
        return {
            name: np.concatenate([batch[name] for batch in self.batches])
            for name in self.batches[0]
        }


@dataclass(frozen=True, eq=False)
class TruthFit:
    """Fitted errors of a truth channel, and the remaining error.

    Attributes
    ----------
    channel : str
    parameters : tuple of TruthParameter
    pole_pairs : int
        Pole pairs of the truth; negative if the truth counts opposite to the estimate.
    words : tuple of str
        Results as text, one clause per result.
    rms, most : float
        Rms and maximum of the remaining position error [rad], or of the speed error [rad/s].
    half_turn : bool
        Whether the position is ambiguous by half a turn.
    known : mapping
        Errors that the fit subtracts: name of the regressor → coefficient.
    wrong_turns : bool
        Whether pole pairs or direction differ from the given values.
    lost : str, optional
        Text that says where the channel does not follow the flux.
    """

    channel: str
    parameters: tuple[TruthParameter, ...]
    pole_pairs: int
    words: tuple[str, ...]
    rms: float
    most: float
    half_turn: bool = False
    known: Mapping[str, float] = field(default_factory=dict)
    wrong_turns: bool = False
    lost: str | None = None

    @property
    def angular(self) -> bool:
        """Whether an angle was fitted."""
        return bool(self.known)

    @property
    def told(self) -> bool:
        """Whether the channel has an error to report."""
        failed = self.wrong_turns or self.lost is not None or not self.parameters
        return failed or any(parameter.told for parameter in self.parameters)

    def __getitem__(self, name: str) -> TruthParameter:
        """Return the parameter named `name`."""
        return next(parameter for parameter in self.parameters if parameter.name == name)

    def error(self, theta: Array, raw: Array, speed: Array) -> Array:
        """Return estimated angle minus true angle, minus the channel's fitted errors [rad]."""
        error = _difference(theta, raw, self.pole_pairs, self.half_turn)
        X, names = _design(raw, speed, tuple(self.known))
        return _wrapped(error - X @ np.array([self.known[name] for name in names]), self.half_turn)


def fit_truth(samples: TruthSamples, machine: RotatingMachine) -> TruthFit | None:
    """Fit the errors of the truth channel; None if there are too few rows."""
    columns = samples.columns()
    if not columns or len(columns["raw"]) < 10 * BLOCKS:
        return None
    if samples.channel == "hall":
        return _fit_hall(samples)
    if samples.channel.startswith("speed"):
        return _fit_speed(samples.channel, columns, machine)
    return _fit_angle(samples, columns, machine)


# ---- encoder ---------------------------------------------------------------------------------


def _difference(theta: Array, raw: Array, pole_pairs: int, half_turn: bool) -> Array:
    return _wrapped(theta - pole_pairs * raw, half_turn)


def _wrapped(angle: Array, half_turn: bool) -> Array:
    return wrap(2 * angle) / 2 if half_turn else wrap(angle)


def _design(raw: Array, speed: Array, names: tuple[str, ...]) -> tuple[Array, tuple[str, ...]]:
    columns = {
        "zero": np.ones_like(raw),
        "delay": speed,
        "cos 1": np.cos(raw),
        "sin 1": np.sin(raw),
        "cos 2": np.cos(2 * raw),
        "sin 2": np.sin(2 * raw),
    }
    return np.stack([columns[name] for name in names], axis=1), names


def _fit_angle(
    samples: TruthSamples, columns: Mapping[str, Array], machine: RotatingMachine
) -> TruthFit | None:
    theta, raw, speed = columns["theta_e"], columns["raw"], columns["speed_e"]
    given_pole_pairs = machine.n_p if samples.channel == "theta_mech" else 1
    if not samples.square > 1.0:
        message = "the angle hardly turns, but the flux turns"
        return TruthFit(
            samples.channel, (), given_pole_pairs, (message,), np.nan, np.nan, wrong_turns=True
        )
    ratio = samples.product / samples.square
    pole_pairs = round(ratio)
    clauses: list[str] = []
    if pole_pairs == 0 or abs(ratio / pole_pairs - 1) > WHOLE:
        clauses.append(
            f"the flux turns {ratio:.3g} times per turn of the channel, not a whole "
            f"number of pole pairs: the channel's unit is wrong, or the angle is not this rotor's"
        )
        return TruthFit(
            samples.channel, (), given_pole_pairs, tuple(clauses), np.nan, np.nan, wrong_turns=True
        )
    half_turn = machine.half_turn_ambiguous
    error = _difference(theta, raw, pole_pairs, half_turn)
    turn = 2 if half_turn else 1
    centre = float(np.angle(np.exp(1j * turn * error).mean())) / turn
    error = _wrapped(error - centre, half_turn)
    names = ["zero"]
    if np.ptp(speed) > VARIED * float(np.abs(speed).max()):
        names.append("delay")
    covered = np.unique(np.floor(np.remainder(raw, 2 * np.pi) * 16 / np.pi)).size / 32
    if samples.channel == "theta_mech" and covered >= COVERED:
        names += ["cos 1", "sin 1", "cos 2", "sin 2"]
    X, _ = _design(raw, speed, tuple(names))
    values, covariance, residual = _robust(X, error, columns["row"])
    residual = _wrapped(residual, half_turn)
    lost = _lost(columns, residual)
    if lost is not None and (fit_with_slip := _slip(X, error, columns, residual)) is not None:
        values, covariance, residual, lost = fit_with_slip
        residual = _wrapped(residual, half_turn)
    fitted = dict(zip(names, values, strict=True))
    fitted["zero"] = float(fitted["zero"] + centre)
    estimate_std = float(np.median(columns["theta_e_std"]))
    # Errors of the estimate repeat each turn of the shaft and may be proportional to speed.
    variance = float(np.mean(residual**2))
    systematic = dict.fromkeys(names, variance / max(samples.turned / (2 * np.pi), 1.0))
    systematic["zero"] = 0.0
    if "delay" in systematic:
        systematic["delay"] = variance / float(np.ptp(speed)) ** 2
    covariance = covariance + np.diag([systematic[name] for name in names])
    parameters = _angle_parameters(fitted, covariance, names, estimate_std, pole_pairs)
    clauses += _angle_clauses(
        samples.channel, parameters, pole_pairs, given_pole_pairs, "delay" in fitted
    )
    clauses += [] if lost is None else [lost]
    return TruthFit(
        samples.channel,
        tuple(parameters),
        pole_pairs,
        tuple(clauses),
        float(np.sqrt(np.mean(residual**2))),
        float(np.abs(residual).max()),
        half_turn,
        fitted,
        pole_pairs != given_pole_pairs,
        lost,
    )


def _slip(
    X: Array, error: Array, columns: Mapping[str, Array], residual: Array
) -> tuple[Array, Array, Array, str] | None:
    """Add the best step of the zero to the fit; None if the step does not explain the residual."""
    row, best = columns["row"], (np.inf, 0.0)
    for step_row in np.linspace(row[0], row[-1], 4 * BLOCKS + 1)[1:-1]:
        A = np.concatenate([X, (row > step_row)[:, None]], axis=1)
        scale = np.linalg.norm(A, axis=0) + 1e-300
        fit = np.linalg.lstsq((A / scale).T @ (A / scale), (A / scale).T @ error, rcond=1e-12)[0]
        best = min(best, (float(np.sum((error - (A / scale) @ fit) ** 2)), float(step_row)))
    A = np.concatenate([X, (row > best[1])[:, None]], axis=1)
    value, covariance, slip_residual = _robust(A, error, row)
    if not np.mean(slip_residual**2) < SLIPPED * np.mean(residual**2):
        return None
    step, std = np.degrees([value[-1], np.sqrt(covariance[-1, -1])])
    time = float(columns["t"][np.searchsorted(row, best[1])])
    clause = (
        f"at about {time:.3g} s the zero steps by {step:+.3g}° ± {std:.1g}° electrical: "
        f"the encoder has slipped"
    )
    return value[:-1], covariance[:-1, :-1], slip_residual, clause


def _lost(columns: Mapping[str, Array], residual: Array) -> str | None:
    """Describe where the angle does not follow the flux; None if it follows the flux everywhere."""
    edges = np.linspace(columns["row"][0], columns["row"][-1] + 1, BLOCKS + 1)
    block = np.searchsorted(edges, columns["row"], side="right") - 1
    count = np.bincount(block, minlength=BLOCKS)
    block_rms = np.sqrt(np.bincount(block, residual**2, minlength=BLOCKS) / np.maximum(count, 1))
    typical = float(np.quantile(block_rms[count > 0], 0.25))  # most blocks may be bad
    if typical > LOST:
        return f"the channel does not follow the flux: error {np.degrees(typical):.3g}° rms"
    lost = block_rms > max(LOST, 4 * typical)
    if not lost.any():
        return None
    start = int(np.argmax(lost))
    end = start + int(np.argmin(np.append(lost[start:], False)))
    inside = (block >= start) & (block < end)
    interior = (block >= min(start + 1, end - 1)) & (block < end)
    turned = np.abs(wrap(np.diff(columns["raw"][interior]))).sum()
    behaviour = "stands still" if turned < 0.1 else "does not follow the flux"
    t = columns["t"][inside]
    ending = "" if end >= BLOCKS or not lost[end:].any() else ", and again later"
    rms = np.degrees(np.sqrt(np.mean(residual[inside] ** 2)))
    return f"from {t[0]:.4g} to {t[-1]:.4g} s the channel {behaviour}, error {rms:.3g}° rms{ending}"


def _robust(X: Array, y: Array, row: Array) -> tuple[Array, Array, Array]:
    """Fit with Huber's weights; the covariance includes correlated errors within blocks of rows."""
    scale = np.abs(X).max(axis=0) + 1e-300
    A = X / scale
    weight = np.ones(len(y))
    for _ in range(6):
        B = A * weight[:, None]
        value = np.linalg.lstsq(B.T @ A, B.T @ y, rcond=1e-12)[0]
        residual = y - A @ value
        sigma = 1.4826 * float(np.median(np.abs(residual))) + 1e-12
        weight = huber_weight(residual, sigma)
    inverse = np.linalg.pinv((A * weight[:, None]).T @ A, rcond=1e-12)
    edges = np.linspace(row[0], row[-1] + 1, BLOCKS + 1)
    block = np.searchsorted(edges, row, side="right") - 1
    score = np.zeros((BLOCKS, A.shape[1]))
    np.add.at(score, block, A * (weight * residual)[:, None])
    blocks = len(np.unique(block))
    factor = blocks / max(blocks - A.shape[1], 1)
    covariance = factor * inverse @ (score.T @ score) @ inverse
    return value / scale, covariance / np.outer(scale, scale), residual


def _angle_parameters(
    fitted: Mapping[str, float],
    covariance: Array,
    names: list[str],
    estimate_std: float,
    pole_pairs: int,
) -> list[TruthParameter]:
    std = np.sqrt(np.diag(covariance))
    zero = float(wrap(np.array([fitted["zero"]]))[0])
    parameters = [TruthParameter("zero", zero, float(np.hypot(std[0], estimate_std)), "rad")]
    if "delay" in fitted:
        parameters.append(
            TruthParameter("delay", fitted["delay"], float(std[names.index("delay")]), "s")
        )
    for order in (1, 2):
        if f"cos {order}" not in fitted:
            continue
        pair = [names.index(f"cos {order}"), names.index(f"sin {order}")]
        vector = np.array([fitted[f"cos {order}"], fitted[f"sin {order}"]])
        size = float(np.hypot(*vector))
        direction = vector / (size + 1e-300)
        spread = float(np.sqrt(direction @ covariance[np.ix_(pair, pair)] @ direction))
        # Convert to an angle of the shaft, since encoder errors are specified so.
        parameters.append(
            TruthParameter(
                f"eccentricity {order}", size / abs(pole_pairs), spread / abs(pole_pairs), "rad"
            )
        )
    return parameters


def _angle_clauses(
    channel: str,
    parameters: list[TruthParameter],
    pole_pairs: int,
    given_pole_pairs: int,
    delayed: bool,
) -> list[str]:
    clauses = []
    if abs(pole_pairs) != given_pole_pairs:
        clause = f"{abs(pole_pairs)} pole pairs fit, not {given_pole_pairs}"
        if channel == "theta_mech" and abs(pole_pairs) == 1:
            clause += ": the channel is electrical (--truth theta_e=…)"
        if channel == "theta_e":
            clause = (
                f"the channel is mechanical, with {abs(pole_pairs)} pole pairs "
                f"(--truth theta_mech=…)"
            )
        clauses.append(clause)
    if pole_pairs < 0:
        clauses.append("the channel counts opposite to the estimated angle")
    for parameter in parameters:
        value, std = np.degrees(parameter.value), np.degrees(parameter.std)
        if parameter.name == "zero":
            shaft = f", {value / abs(pole_pairs):.2f}° of the shaft" if abs(pole_pairs) > 1 else ""
            clauses.append(f"zero {value:+.2f}° ± {std:.2g}° electrical{shaft}")
        elif parameter.name == "delay" and parameter.told:
            timing = "late" if parameter.value > 0 else "early"
            size, uncertainty = 1e6 * abs(parameter.value), 1e6 * parameter.std
            clauses.append(f"{size:.3g} ± {uncertainty:.2g} µs {timing}")
        elif parameter.name.startswith("eccentricity") and parameter.told:
            frequency = "once" if parameter.name.endswith("1") else "twice"
            clauses.append(
                f"eccentricity {value:.2g}° ± {std:.1g}° of the shaft, {frequency} a turn"
            )
    if not delayed:
        clauses.append("delay and zero cannot be separated, since the speed hardly varies")
    return clauses


# ---- speed and Hall sensors ------------------------------------------------------------------


def _fit_speed(
    channel: str, columns: Mapping[str, Array], machine: RotatingMachine
) -> TruthFit | None:
    raw = columns["raw"]
    if not np.abs(raw).max() > 0:
        message = "the speed is zero throughout"
        return TruthFit(channel, (), 1, (message,), np.nan, np.nan, wrong_turns=True)
    if channel == "speed_e":
        estimated = columns["speed_e"]
    else:
        estimated = columns.get("speed_mech", columns["speed_e"] / machine.n_p)
    X = np.stack([raw, np.ones_like(raw)], axis=1)
    if not np.ptp(raw) > VARIED * float(np.abs(raw).max()):
        X = X[:, :1]
    values, covariance, _ = _robust(X, estimated, columns["row"])
    gain = TruthParameter("gain", float(values[0]), float(np.sqrt(covariance[0, 0])), "1")
    error = estimated - raw
    clauses = [f"ratio of estimated to given speed {gain.value:.4f} ± {gain.std:.1g}"]
    likely = machine.n_p * gain.value
    if (
        channel == "speed_mech"
        and abs(gain.value - 1) > 0.1
        and abs(likely / max(round(likely), 1) - 1) < WHOLE
    ):
        clauses.append(f"{round(likely)} pole pairs would fit, not {machine.n_p}")
    rms, largest = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    residual_rms = float(np.sqrt(np.mean((estimated - X @ values) ** 2)))
    share = residual_rms / float(np.abs(raw).max())
    lost = None
    if share > LOST_SPEED:
        lost = f"with the gain corrected, the rms difference is {share:.0%} of the largest speed"
        clauses.append(lost)
    return TruthFit(channel, (gain,), 1, tuple(clauses), rms, largest, lost=lost)


#: Codes of three Hall sensors 120° apart, in the order of forward rotation; sensor a is bit 0.
FORWARD = (1, 3, 2, 6, 4, 5)


def _fit_hall(samples: TruthSamples) -> TruthFit | None:
    if not samples.edges:
        return None
    start, end, angle, turned = np.concatenate(samples.edges, axis=1)
    codes = set(map(int, np.unique(np.concatenate([start, end]))))
    clauses = []
    if codes & {0, 7}:
        clauses.append(
            "codes 0 or 7 occur: a wire is broken, one sensor is inverted, or the sensors are "
            "60° apart"
        )
    order = {code: n for n, code in enumerate(FORWARD)}
    step = np.array(
        [
            (order.get(int(b), 99) - order.get(int(a), 99)) % 6
            if {int(a), int(b)} <= set(order)
            else 3
            for a, b in zip(start, end, strict=True)
        ]
    )
    neighbours = (step == 1) | (step == 5)
    if neighbours.mean() < 0.9:
        clauses.append(f"{1 - neighbours.mean():.0%} of the edges skip a state")
    direction = np.where(step == 1, 1.0, -1.0) * turned
    if np.mean(direction[neighbours]) < 0:
        clauses.append("the code turns opposite to the estimate: two Hall wires are exchanged")
    # An edge lies between the same two states in both directions.
    edge_pairs = [tuple(sorted((int(a), int(b)))) for a, b in zip(start, end, strict=True)]
    edges: dict[Any, tuple[float, float]] = {}
    scatters = []
    for pair in sorted({pair for pair, ok in zip(edge_pairs, neighbours, strict=True) if ok}):
        of_pair = np.array([candidate == pair for candidate in edge_pairs]) & neighbours
        angles = [angle[of_pair & (turned == sign)] for sign in (1.0, -1.0)]
        means = [np.exp(1j * crossings).mean() for crossings in angles if len(crossings) >= 3]
        if not means:
            continue
        centre = float(np.angle(sum(means)))
        scatter = wrap(angle[of_pair] - centre)
        edges[pair] = (centre, float(np.std(scatter) / np.sqrt(max(of_pair.sum(), 1))))
        scatters.append(scatter)
    if len(edges) < 6:
        clauses.append(f"only {len(edges)} of six edges were seen")
        if not edges:
            return TruthFit("hall", (), 1, tuple(clauses), np.nan, np.nan)
    centres = np.array([place for place, _ in edges.values()])
    zero = float(np.angle(np.exp(6j * centres).mean())) / 6
    deviation = wrap(6 * (centres - zero)) / 6
    parameters = [
        TruthParameter(f"edge {a}-{b}", centre, std, "rad")
        for (a, b), (centre, std) in edges.items()
    ]
    edge_list = ", ".join(
        f"{parameter.name[5:]} at {np.degrees(parameter.value):+.1f}° "
        f"± {np.degrees(parameter.std):.1g}°"
        for parameter in parameters
    )
    worst = int(np.argmax(np.abs(deviation)))
    clauses.append(f"Hall edges: {edge_list}")
    clauses.append(
        f"the largest deviation from a spacing of 60° is {np.degrees(deviation[worst]):+.1f}°"
    )
    errors = np.concatenate(scatters)
    rms = float(np.sqrt(np.mean(errors**2)))
    return TruthFit("hall", tuple(parameters), 1, tuple(clauses), rms, float(np.abs(errors).max()))
