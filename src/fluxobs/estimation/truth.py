"""The truth of a log, fitted to the estimate: what an encoder, a speed or Hall sensors are off by.

An encoder's zero, direction and delay are seldom known, its disc is never centred, and the count of
pole pairs may be another. All that is fitted to the estimated angle, with standard deviations, so
that what is left is the error of the estimate in the drive's own operation. What is constant is
ambiguous: a constant error of the estimate is in the zero, whose standard deviation allows for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.arrays import Array
from ..machines import RotatingMachine
from ..machines.model.frames import wrap
from .columns import EstimateRows

#: Rows that are kept for a fit, evenly spread; Hall edges that are kept.
KEPT, EDGES = 40_000, 200_000
#: Rows over which turns are counted.
SPAN = 32
#: Blocks of rows whose errors are taken as independent of one another.
BLOCKS = 40
#: Errors beyond this many standard deviations count linearly (Huber's constant).
HUBER = 1.345
#: A ratio of turns this close to a whole number of pole pairs is it.
WHOLE = 0.02
#: Speeds must differ by this share of the largest to tell a delay from a zero.
VARIED = 0.3
#: A parameter is reported if it exceeds this many standard deviations.
TOLD = 3.0
#: Share of the shaft's circle that eccentricity needs.
COVERED = 0.9
#: An error of the angle in a block of rows that no estimate explains [rad].
LOST = np.radians(5.0)
#: A step of the zero explains it, if less than this share of the squared error is left.
SLIPPED = 0.1
#: The same of a speed, as a share of the largest.
LOST_SPEED = 0.1


@dataclass(frozen=True)
class TruthParameter:
    """One parameter of a truth: value and standard deviation."""

    name: str
    value: float
    std: float
    unit: str

    @property
    def told(self) -> bool:
        return abs(self.value) > TOLD * self.std


@dataclass
class TruthSamples:
    """What a run keeps of its truth; its size is bounded."""

    total: int
    channel: str
    rows: int = 0
    known: int = 0  # valid rows on which the channel has a value
    parts: list[dict[str, Array]] = field(default_factory=list)
    product: float = 0.0  # Σ of turned angles, estimated by true
    square: float = 0.0
    turned: float = 0.0  # by the channel, to and fro [rad]
    edges: list[Array] = field(default_factory=list)
    edge_count: int = 0
    before: dict[str, float] = field(default_factory=dict)

    def add(self, rows: EstimateRows) -> None:
        """Take in the next rows."""
        columns, raw = rows.columns, rows.more["raw"]
        count, good = len(raw), rows.valid & np.isfinite(raw)
        stride = max(1, self.total // KEPT)
        pick = np.arange(-self.rows % stride, count, stride)
        pick = pick[good[pick]]
        kept = {"raw": raw[pick], "row": (self.rows + pick).astype(float)}
        for name in ("t", "theta_e", "theta_e_std", "speed_e", "speed_mech"):
            if name in columns:
                kept[name] = np.array(columns[name][pick], float)
        self.parts.append(kept)
        self.known += int(good.sum())
        if self.channel == "hall":
            self._add_edges(columns["theta_e"], raw, good)
        elif self.channel.startswith("theta"):
            self._count_turns(columns["theta_e"], raw, good)
        self.rows += count

    def _count_turns(self, theta: Array, raw: Array, good: NDArray[np.bool_]) -> None:
        whole = len(raw) // SPAN * SPAN
        if not whole:
            return
        inside = good[:whole].reshape(-1, SPAN).all(axis=1)
        est = wrap(np.diff(theta[:whole].reshape(-1, SPAN)[inside], axis=1)).sum(axis=1)
        true = wrap(np.diff(raw[:whole].reshape(-1, SPAN)[inside], axis=1)).sum(axis=1)
        self.product += float(est @ true)
        self.square += float(true @ true)
        self.turned += float(np.abs(true).sum())

    def _add_edges(self, theta: Array, raw: Array, good: NDArray[np.bool_]) -> None:
        if self.before:
            theta = np.concatenate([[self.before["theta"]], theta])
            raw = np.concatenate([[self.before["raw"]], raw])
            good = np.concatenate([[self.before["good"] > 0], good])
        at = np.flatnonzero((raw[1:] != raw[:-1]) & good[1:] & good[:-1])
        if self.edge_count < EDGES and len(at):
            moved = wrap(theta[at + 1] - theta[at])
            middle = wrap(theta[at] + moved / 2)
            self.edges.append(np.stack([raw[at], raw[at + 1], middle, np.sign(moved)]))
            self.edge_count += len(at)
        self.before = {"theta": theta[-1], "raw": raw[-1], "good": float(good[-1])}

    def columns(self) -> dict[str, Array]:
        if not self.parts:
            return {}
        return {name: np.concatenate([part[name] for part in self.parts]) for name in self.parts[0]}


@dataclass(frozen=True, eq=False)
class TruthFit:
    """What was fitted to the truth, and what is left.

    Attributes
    ----------
    channel : str
    parameters : tuple of TruthParameter
    pole_pairs : int
        Of the truth, with the sign of its direction against the estimate's.
    words : tuple of str
        Clauses on what was found.
    rms, most : float
        Position error that is left [rad], or error of the speed [rad/s].
    half_turn : bool
        Whether the position is known up to half a turn.
    known : mapping
        What the fit subtracts: name in the design → value.
    wrong_turns : bool
        Whether pole pairs or direction are not as given.
    lost : str, optional
        Where the channel does not follow the flux, though it does elsewhere.
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
        """Whether there is something to be said."""
        wrong = self.wrong_turns or self.lost is not None or not self.parameters
        return wrong or any(p.told for p in self.parameters)

    def __getitem__(self, name: str) -> TruthParameter:
        """A parameter by its name."""
        return next(one for one in self.parameters if one.name == name)

    def error(self, theta: Array, raw: Array, speed: Array) -> Array:
        """Estimated less true angle, less what was fitted [rad]."""
        e = _difference(theta, raw, self.pole_pairs, self.half_turn)
        X, names = _design(raw, speed, tuple(self.known))
        return _wrapped(e - X @ np.array([self.known[n] for n in names]), self.half_turn)


def fit_truth(samples: TruthSamples, machine: RotatingMachine) -> TruthFit | None:
    """Fit what the channel may be off by; None if there are too few rows for it."""
    columns = samples.columns()
    if not columns or len(columns["raw"]) < 10 * BLOCKS:
        return None
    if samples.channel == "hall":
        return _fit_hall(samples)
    if samples.channel.startswith("speed"):
        return _fit_speed(samples.channel, columns, machine)
    return _fit_angle(samples, columns, machine)


# ---- an encoder ------------------------------------------------------------------------------


def _difference(theta: Array, raw: Array, pairs: int, half_turn: bool) -> Array:
    return _wrapped(theta - pairs * raw, half_turn)


def _wrapped(e: Array, half_turn: bool) -> Array:
    return wrap(2 * e) / 2 if half_turn else wrap(e)


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
    given = machine.n_p if samples.channel == "theta_mech" else 1
    if not samples.square > 1.0:
        still = "the angle hardly turns, though the flux does"
        return TruthFit(samples.channel, (), given, (still,), np.nan, np.nan, wrong_turns=True)
    ratio = samples.product / samples.square
    pairs = round(ratio)
    words: list[str] = []
    if pairs == 0 or abs(ratio / pairs - 1) > WHOLE:
        words.append(
            f"the flux turns {ratio:.3g} times for a turn of the channel, which is no whole "
            f"number of pole pairs: its unit is wrong, or it is no angle of this rotor"
        )
        return TruthFit(samples.channel, (), given, tuple(words), np.nan, np.nan, wrong_turns=True)
    half = machine.half_turn_ambiguous
    e = _difference(theta, raw, pairs, half)
    turn = 2 if half else 1
    centre = float(np.angle(np.exp(1j * turn * e).mean())) / turn
    e = _wrapped(e - centre, half)
    names = ["zero"]
    if np.ptp(speed) > VARIED * float(np.abs(speed).max()):
        names.append("delay")
    covered = np.unique(np.floor(np.remainder(raw, 2 * np.pi) * 16 / np.pi)).size / 32
    if samples.channel == "theta_mech" and covered >= COVERED:
        names += ["cos 1", "sin 1", "cos 2", "sin 2"]
    X, found = _design(raw, speed, tuple(names))
    value, covariance, left = _robust(X, e, columns["row"])
    left = _wrapped(left, half)
    lost = _lost(columns, left)
    if lost is not None and (slip := _slip(X, e, columns, left)) is not None:
        value, covariance, left, lost = slip
        left = _wrapped(left, half)
    known = dict(zip(found, value, strict=True))
    known["zero"] = float(known["zero"] + centre)
    own = float(np.median(columns["theta_e_std"]))
    # Errors of the estimate repeat within a turn of the shaft, and may follow the speed.
    square = float(np.mean(left**2))
    alike = dict.fromkeys(names, square / max(samples.turned / (2 * np.pi), 1.0))
    alike["zero"] = 0.0
    if "delay" in alike:
        alike["delay"] = square / float(np.ptp(speed)) ** 2
    covariance = covariance + np.diag([alike[name] for name in found])
    parameters = _angle_parameters(known, covariance, list(found), own, pairs)
    words += _angle_words(samples.channel, parameters, pairs, given, "delay" in known)
    words += [] if lost is None else [lost]
    return TruthFit(
        samples.channel,
        tuple(parameters),
        pairs,
        tuple(words),
        float(np.sqrt(np.mean(left**2))),
        float(np.abs(left).max()),
        half,
        known,
        pairs != given,
        lost,
    )


def _slip(
    X: Array, e: Array, columns: Mapping[str, Array], left: Array
) -> tuple[Array, Array, Array, str] | None:
    """The fit with a step of the zero where it helps most; None if it does not explain the rest."""
    row, best = columns["row"], (np.inf, 0.0)
    for at in np.linspace(row[0], row[-1], 4 * BLOCKS + 1)[1:-1]:
        A = np.concatenate([X, (row > at)[:, None]], axis=1)
        size = np.linalg.norm(A, axis=0) + 1e-300
        solved = np.linalg.lstsq((A / size).T @ (A / size), (A / size).T @ e, rcond=1e-12)[0]
        best = min(best, (float(np.sum((e - (A / size) @ solved) ** 2)), float(at)))
    A = np.concatenate([X, (row > best[1])[:, None]], axis=1)
    value, covariance, rest = _robust(A, e, row)
    if not np.mean(rest**2) < SLIPPED * np.mean(left**2):
        return None
    step, std = np.degrees([value[-1], np.sqrt(covariance[-1, -1])])
    t = float(columns["t"][np.searchsorted(row, best[1])])
    words = f"at about {t:.3g} s its zero steps by {step:+.3g}° ± {std:.1g}° electrical: it slips"
    return value[:-1], covariance[:-1, :-1], rest, words


def _lost(columns: Mapping[str, Array], left: Array) -> str | None:
    """Words on where an angle does not follow the flux; None if it does everywhere."""
    edges = np.linspace(columns["row"][0], columns["row"][-1] + 1, BLOCKS + 1)
    at = np.searchsorted(edges, columns["row"], side="right") - 1
    count = np.bincount(at, minlength=BLOCKS)
    level = np.sqrt(np.bincount(at, left**2, minlength=BLOCKS) / np.maximum(count, 1))
    usual = float(np.quantile(level[count > 0], 0.25))  # most of the log may be lost
    if usual > LOST:
        return f"it does not follow the flux: off by {np.degrees(usual):.3g}° rms"
    bad = level > max(LOST, 4 * usual)
    if not bad.any():
        return None
    first = int(np.argmax(bad))
    last = first + int(np.argmin(np.append(bad[first:], False)))
    inside = (at >= first) & (at < last)
    within = (at >= min(first + 1, last - 1)) & (at < last)
    turned = np.abs(wrap(np.diff(columns["raw"][within]))).sum()
    what = "stands still" if turned < 0.1 else "does not follow the flux"
    t = columns["t"][inside]
    more = "" if last >= BLOCKS or not bad[last:].any() else ", and further on"
    off = np.degrees(np.sqrt(np.mean(left[inside] ** 2)))
    return f"from {t[0]:.4g} to {t[-1]:.4g} s it {what}, off by {off:.3g}° rms{more}"


def _robust(X: Array, y: Array, row: Array) -> tuple[Array, Array, Array]:
    """Huber's fit; its covariance allows for errors that are alike within blocks of rows."""
    scale = np.abs(X).max(axis=0) + 1e-300
    A = X / scale
    weight = np.ones(len(y))
    for _ in range(6):
        B = A * weight[:, None]
        value = np.linalg.lstsq(B.T @ A, B.T @ y, rcond=1e-12)[0]
        left = y - A @ value
        size = 1.4826 * float(np.median(np.abs(left))) + 1e-12
        weight = np.minimum(1.0, HUBER * size / (np.abs(left) + 1e-300))
    inverse = np.linalg.pinv((A * weight[:, None]).T @ A, rcond=1e-12)
    edges = np.linspace(row[0], row[-1] + 1, BLOCKS + 1)
    block = np.searchsorted(edges, row, side="right") - 1
    score = np.zeros((BLOCKS, A.shape[1]))
    np.add.at(score, block, A * (weight * left)[:, None])
    used = len(np.unique(block))
    factor = used / max(used - A.shape[1], 1)
    covariance = factor * inverse @ (score.T @ score) @ inverse
    return value / scale, covariance / np.outer(scale, scale), left


def _angle_parameters(
    known: Mapping[str, float], covariance: Array, names: list[str], own: float, pairs: int
) -> list[TruthParameter]:
    std = np.sqrt(np.diag(covariance))
    zero = float(wrap(np.array([known["zero"]]))[0])
    out = [TruthParameter("zero", zero, float(np.hypot(std[0], own)), "rad")]
    if "delay" in known:
        out.append(TruthParameter("delay", known["delay"], float(std[names.index("delay")]), "s"))
    for order in (1, 2):
        if f"cos {order}" not in known:
            continue
        at = [names.index(f"cos {order}"), names.index(f"sin {order}")]
        vector = np.array([known[f"cos {order}"], known[f"sin {order}"]])
        size = float(np.hypot(*vector))
        direction = vector / (size + 1e-300)
        spread = float(np.sqrt(direction @ covariance[np.ix_(at, at)] @ direction))
        # of the shaft, as an encoder is off by
        out.append(
            TruthParameter(f"eccentricity {order}", size / abs(pairs), spread / abs(pairs), "rad")
        )
    return out


def _angle_words(
    channel: str, parameters: list[TruthParameter], pairs: int, given: int, delayed: bool
) -> list[str]:
    out = []
    if abs(pairs) != given:
        what = f"{abs(pairs)} pole pairs fit, not {given}"
        if channel == "theta_mech" and abs(pairs) == 1:
            what += ": the channel is electrical (--truth theta_e=…)"
        if channel == "theta_e":
            what = f"the channel is mechanical, with {abs(pairs)} pole pairs (--truth theta_mech=…)"
        out.append(what)
    if pairs < 0:
        out.append("it counts against the estimated angle")
    for one in parameters:
        value, std = np.degrees(one.value), np.degrees(one.std)
        if one.name == "zero":
            shaft = f", {value / abs(pairs):.2f}° of the shaft" if abs(pairs) > 1 else ""
            out.append(f"zero {value:+.2f}° ± {std:.2g}° electrical{shaft}")
        elif one.name == "delay" and one.told:
            when = "late" if one.value > 0 else "early"
            out.append(f"{1e6 * abs(one.value):.3g} ± {1e6 * one.std:.2g} µs {when}")
        elif one.name.startswith("eccentricity") and one.told:
            often = "once" if one.name.endswith("1") else "twice"
            out.append(f"eccentricity {value:.2g}° ± {std:.1g}° of the shaft, {often} a turn")
    if not delayed:
        out.append("a delay cannot be told from the zero, for the speed hardly varies")
    return out


# ---- speed and Hall sensors ------------------------------------------------------------------


def _fit_speed(
    channel: str, columns: Mapping[str, Array], machine: RotatingMachine
) -> TruthFit | None:
    raw = columns["raw"]
    if not np.abs(raw).max() > 0:
        still = "the speed is zero throughout"
        return TruthFit(channel, (), 1, (still,), np.nan, np.nan, wrong_turns=True)
    if channel == "speed_e":
        own = columns["speed_e"]
    else:
        own = columns.get("speed_mech", columns["speed_e"] / machine.n_p)
    X = np.stack([raw, np.ones_like(raw)], axis=1)
    if not np.ptp(raw) > VARIED * float(np.abs(raw).max()):
        X = X[:, :1]
    value, covariance, _ = _robust(X, own, columns["row"])
    gain = TruthParameter("gain", float(value[0]), float(np.sqrt(covariance[0, 0])), "1")
    error = own - raw
    words = [f"estimated over given speed {gain.value:.4f} ± {gain.std:.1g}"]
    likely = machine.n_p * gain.value
    if (
        channel == "speed_mech"
        and abs(gain.value - 1) > 0.1
        and abs(likely / max(round(likely), 1) - 1) < (WHOLE)
    ):
        words.append(f"{round(likely)} pole pairs would fit, not {machine.n_p}")
    rms, most = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    left = float(np.sqrt(np.mean((own - X @ value) ** 2)))
    share = left / float(np.abs(raw).max())
    lost = None
    if share > LOST_SPEED:
        lost = f"beyond its gain it differs by {share:.0%} of the largest speed, rms"
        words.append(lost)
    return TruthFit(channel, (gain,), 1, tuple(words), rms, most, lost=lost)


#: Codes of three Hall sensors, 120° apart, in the order of a rotor that turns forward; a is bit 0.
FORWARD = (1, 3, 2, 6, 4, 5)


def _fit_hall(samples: TruthSamples) -> TruthFit | None:
    if not samples.edges:
        return None
    start, end, angle, turned = np.concatenate(samples.edges, axis=1)
    codes = set(map(int, np.unique(np.concatenate([start, end]))))
    words = []
    if codes & {0, 7}:
        words.append(
            "codes 0 or 7 occur: a wire is broken, one sensor is inverted, or they are 60° apart"
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
        words.append(f"{1 - neighbours.mean():.0%} of the edges jump over a state")
    direction = np.where(step == 1, 1.0, -1.0) * turned
    if np.mean(direction[neighbours]) < 0:
        words.append("the code turns against the estimate: two Hall wires are exchanged")
    # an edge between two states, whichever way it is crossed
    pairs = [tuple(sorted((int(a), int(b)))) for a, b in zip(start, end, strict=True)]
    places: dict[Any, tuple[float, float]] = {}
    left = []
    for pair in sorted({pair for pair, ok in zip(pairs, neighbours, strict=True) if ok}):
        mine = np.array([one == pair for one in pairs]) & neighbours
        ways = [angle[mine & (turned == way)] for way in (1.0, -1.0)]
        means = [np.exp(1j * way).mean() for way in ways if len(way) >= 3]
        if not means:
            continue
        centre = float(np.angle(sum(means)))
        scatter = wrap(angle[mine] - centre)
        places[pair] = (centre, float(np.std(scatter) / np.sqrt(max(mine.sum(), 1))))
        left.append(scatter)
    if len(places) < 6:
        words.append(f"only {len(places)} of six edges were seen")
        if not places:
            return TruthFit("hall", (), 1, tuple(words), np.nan, np.nan)
    centres = np.array([place for place, _ in places.values()])
    zero = float(np.angle(np.exp(6j * centres).mean())) / 6
    off = wrap(6 * (centres - zero)) / 6
    parameters = [
        TruthParameter(f"edge {a}-{b}", centre, std, "rad")
        for (a, b), (centre, std) in places.items()
    ]
    listed = ", ".join(
        f"{one.name[5:]} at {np.degrees(one.value):+.1f}° ± {np.degrees(one.std):.1g}°"
        for one in parameters
    )
    worst = int(np.argmax(np.abs(off)))
    words.append(f"Hall edges: {listed}")
    words.append(f"against a spacing of 60° the worst is off by {np.degrees(off[worst]):+.1f}°")
    errors = np.concatenate(left)
    rms = float(np.sqrt(np.mean(errors**2)))
    return TruthFit("hall", tuple(parameters), 1, tuple(words), rms, float(np.abs(errors).max()))
