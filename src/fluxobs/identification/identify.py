"""What a log tells about the machine, and what it cannot tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checking.segments import LAGS
from ..core.validation import nearest
from ..errors import FluxobsError
from ..logs.for_machine import open_for
from ..logs.log import Log
from ..logs.read import Source
from ..logs.scales import Scales
from ..machines import (
    AlgebraicSaturation,
    Machine,
    RotatingMachine,
    SynchronousMachine,
    as_machine,
    rotating,
)
from ..machines.file_text import with_found
from ..machines.model.flux_map import TableMap
from ..observers.adaptive import INDUCTANCE_SHARE, default_inverter_std, default_resistance_std
from .fit import UNCERTAIN, ParameterFit, fit
from .fit_result import ADVICE, UNITS, FittedParameters, Parameter, in_the_file
from .map_fit import found_map
from .relations import SATURATION, Cage, Mapped, ResidualFunction, Saturating, linear
from .report import figure, html_of, lines, write
from .rotor_resistance import resistance_from_speed
from .segments import HARDER, SECONDS, Piece, offset_std, pieces, smoothing_current, typical_length

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: If the others imitate a parameter this well (its variance is larger by this factor), what the
#: model leaves out decides its value: the log does not tell it.
ALIKE_LIMIT = 100.0
#: Nor does it if the standard deviation is above this share of the parameter (for the inverter, of
#: the voltage's size; for the lag, in samples).
UNSURE = {"R_s": 0.15, "L_s": 0.2, "L_d": 0.2, "L_q": 0.2, "psi_f": 0.05, "inverter": 0.02}
UNSURE |= {"R_R": 0.15, "L_M": 0.15}
LAG_UNSURE = 0.25
#: Nor is a lag if the held parameters may turn it by more [samples].
LAG_HELD = 1.0
#: L_s and L_d show only through the current along the flux; if that is below this share of the
#: whole (rms), what the model leaves out decides their value.
ALONG_LIMIT = 0.15
#: Standard deviations of a map before the log: of the inverse inductances, over themselves; and of
#: what saturation adds to them.
UNSURE_SLOPE, SATURATES = 0.5, 3.0
#: No machine is the model: so much of the flux may be off, independently in each of the fit's
#: stretches. Without a position the log tells the map's symmetry only weakly, and such errors
#: grow some twentyfold. With this value a machine that is 0.2 % off the model is within three
#: standard deviations (benchmarks/maps.py).
MODEL_ERROR = 0.0003
#: Length of a piece for a map [s]: the drift has to stand for so long, since five parameters of
#: saturation can imitate one that changes.
MAP_SECONDS = 2.0
#: Shares of the harder knees before the log: mean and standard deviation.
KNEE = (0.0, 1.0)
#: No curve of a loss is quite the model: this share of the rest that grows with the current,
#: i (1 - |i| / I) / I, is considered, as the adaptive observer does (docs/theory.md, section 13).
CURVE_SHARE = 0.15
#: Pieces of several logs that are fitted together, and of each at least: the fit takes some ten
#: seconds and 150 megabytes then.
POOLED, LEAST_EACH = 200, 2
#: Order in which parameters are held if they cannot be told apart.
HELD_FIRST = ("lag", "L_d", "L_q", "L_s", "L_M", "R_R", "inverter", "R_s", "psi_f")
#: Parameters of a cage, which only changes of its flux tell; a piece for them lasts this long [s],
#: some time constants of the rotor.
ROTOR, ROTOR_SECONDS = ("R_R", "L_M"), 1.0
#: A flux that changes by less than this share, as noise and offsets make it, tells neither.
FLUX_CHANGES = 0.15


@dataclass(frozen=True, eq=False)
class Identification(FittedParameters):
    """Result of :func:`identify`; its attributes are those of :class:`FittedParameters`."""

    def lines(self) -> list[str]:
        """One parameter per line, then what the log cannot tell, then the residual."""
        return lines(self)

    def plot(self) -> Figure:
        """The residual over time, as given and as found."""
        return figure(self)

    def write(self, path: str | Path, *, force: bool = False) -> None:
        """Write the machine to .toml (over an existing file only with `force`), or the picture.

        Raises
        ------
        FluxobsError
            The path has another ending, the file exists, or it cannot be written.
        """
        write(self, Path(path), force)

    def _repr_html_(self) -> str:
        """What a notebook shows: the parameters, what the log cannot tell, and the picture."""
        return html_of(self)

    def __str__(self) -> str:
        return "\n".join(self.lines())


#: The word for the parameters of the flux map.
MAP = "map"


def free_names(machine: RotatingMachine) -> tuple[str, ...]:
    """Parameters that can be free for this kind of machine."""
    magnet = (machine.flux_name,) if machine.magnets else ()
    saturates = isinstance(machine, SynchronousMachine)
    inductances = () if _table(machine) is not None else machine.inductance_names
    own = (MAP,) if saturates else ROTOR if machine.flux_moves else ()
    return ("R_s", *inductances, *magnet, *own, "inverter", "lag")


def _table(machine: RotatingMachine) -> TableMap | None:
    """The flux map of the machine file."""
    fit = machine.saturation
    return None if fit is None else fit.table


#: Names that the fit uses for every kind.
INTERNAL = {"L_sigma": "L_s", "psi_R": "psi_f"}


def read_free(free: str | Sequence[str] | None, machine: RotatingMachine) -> tuple[str, ...]:
    """Names from ``"R_s,psi_f,inverter"`` or a sequence; default: these, if the machine has them.

    Raises
    ------
    FluxobsError
        This kind of machine does not have a name; the message gives the nearest one it has.
    """
    known = free_names(machine)
    if free is None:
        return tuple(n for n in known if n in ("R_s", machine.flux_name, "inverter"))
    given = free.split(",") if isinstance(free, str) else free
    words = [word.strip() for word in given if word.strip()]
    words = ["inverter" if word == "inverter_voltage" else word for word in words]
    if MAP in words and any(word in machine.inductance_names for word in words):
        raise FluxobsError(f"free: {MAP} has the inductances in it; give it without them")
    if "psi_R" in words and any(word in ROTOR for word in words):
        raise FluxobsError(
            "free: give psi_R, or R_R and L_M: psi_R shows while the rotor flux stands, the others "
            "while it changes"
        )
    for word in words:
        if word not in known:
            raise FluxobsError(f"free: kind {machine.kind} has no {word!r}{nearest(word, known)}")
    if not words:
        raise FluxobsError(f"free: give some of {', '.join(known)}")
    return tuple(name for name in known if name in words)


def identify(
    log: Source,
    machine: Machine | str | Path,
    *,
    free: str | Sequence[str] | None = None,
    **layout: Any,
) -> Identification:
    """Fit the machine's parameters and the inverter's error to a whole log.

    Parameters that the log cannot tell are held, and the report says why.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, or a path, or the name of a shipped machine
        A rotating one; a guess that is right within a factor of two or so.
    free : str or sequence of str, optional
        Some of R_s, L_s (or L_d, L_q; L_sigma), psi_f (psi_R), map, R_R, L_M, inverter, lag;
        default: R_s, psi_f, inverter, if the machine has them. R_R and L_M of a cage show where its
        flux changes; R_R also in the slip, if the log has the speed. "map": how the machine
        saturates, the parameters of :class:`AlgebraicSaturation`; the log has to move i_d and i_q.
    layout : optional
        As for :func:`fluxobs.read_log`. Only one truth is used: speed_mech, of a cage [rad/s].

    Raises
    ------
    FluxobsError
        The position is never known in the log, or the log tells none of the free parameters.
    """
    given = rotating(as_machine(machine), "identification")
    names = read_free(free, given)
    return identify_log(open_for(log, given, **layout), given, names)


def identify_log(log: Log, machine: RotatingMachine, free: Sequence[str]) -> Identification:
    """Identify from a log that is open, with names of free parameters that are checked."""
    return identify_logs([log], machine, free)


def identify_logs(
    logs: Sequence[Log], machine: RotatingMachine, free: Sequence[str]
) -> Identification:
    """Identify one machine from logs that are open: from pieces of all of them.

    Raises
    ------
    FluxobsError
        Their lags differ, one of them has no usable piece, or together they do not tell any of the
        free parameters.
    """
    log = logs[0]
    if len({one.layout.lag for one in logs}) > 1:
        raise FluxobsError("logs that are identified together need one lag: --lag")
    more = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
    source, where = f"{log.path.name}{more}", f"{log.path}{more}"
    lags = LAGS if "lag" in free else (0,)
    rotor = any(name in ROTOR for name in free)
    slip: tuple[float, float] | None = None
    with_speed = [one for one in logs if one.truth is not None and one.truth[0] == "speed_mech"]
    if "R_R" in free and with_speed:
        slip, rotor = _weighted([resistance_from_speed(one, machine) for one in with_speed]), False
        free = tuple(name for name in free if name != "L_M")
    if rotor:  # a change of the flux tells both, or neither
        free = (*(name for name in free if name not in ROTOR), *ROTOR)
    seconds = MAP_SECONDS if MAP in free else ROTOR_SECONDS if rotor else SECONDS
    data, scales = _gathered(logs, machine, lags, seconds, rotor)
    given, relation, prior = starting_values(machine, data), _relation(machine), {}
    names, held = _expanded(free, machine), _held(machine, scales)
    if slip is not None:
        names = tuple(name for name in names if name != "R_R")
    untold: dict[str, str] = {}
    if rotor:
        given |= {name: getattr(machine, name) for name in ROTOR}
        untold = _standing_flux(data)
        names = tuple(name for name in names if name not in untold)
        if not names:
            raise FluxobsError(_told_nothing(where, free, untold))
    if MAP in free:
        relation = Saturating(_first_model(machine, given))
        prior = _saturation_prior(relation.model, data)
        given |= {name: getattr(relation.model, name) for name in SATURATION}
    if rotor and not untold:
        if len({one.sample_time for one in logs}) > 1:
            raise FluxobsError(f"logs that tell {' and '.join(ROTOR)} need one sample time")
        relation = Cage(log.sample_time)
        held |= {name: INDUCTANCE_SHARE * given[name] for name in ROTOR}
    elif relation is not linear:
        held = {name: std for name, std in held.items() if not name.startswith("L_")}
    if "inverter" in names:
        names = (*names, *UNCERTAIN)
        offset = (0.0, offset_std(machine, scales))
        prior = prior | dict(zip(UNCERTAIN, (KNEE, KNEE, offset, offset), strict=True))
    error = MODEL_ERROR * _typical_flux(data)
    scale = ("psi_f",) if given["psi_f"] > 0 and not isinstance(relation, Cage) else ()
    before = fit(data, given, scale, relation=relation)
    nearest = _nearest_lag(data, given, names, relation, prior) if "lag" in names else None
    while True:
        start, local = given, None
        if nearest is not None and "lag" in names:
            start, local = _start(given, nearest, names), nearest.local
        after = fit(data, start, names, local, held, relation, prior, error)
        doubts = _doubts(after, scales.voltage) | _unseen_inductances(after, data)
        if "inverter" in names and after.values["inverter"] < 0 and not doubts:
            value, std = after.values["inverter"], after.std("inverter")
            doubts = {"inverter": f"{value:.2g} ± {std:.2g} V fits, but no inverter adds voltage"}
            given["inverter"], held["inverter"] = 0.0, std
        if not doubts:
            break
        doubtful = next(name for name in HELD_FIRST if name in doubts)
        untold[doubtful] = doubts[doubtful]
        gone = (*untold, *(UNCERTAIN if "inverter" in untold else ()))
        names = tuple(name for name in names if name not in gone)
        if not names:
            raise FluxobsError(_told_nothing(where, free, untold))
    told = found_map(relation, after) if isinstance(relation, Saturating) else None
    internal = {name: INTERNAL.get(name, name) for name in free if name != MAP}
    if slip is not None:
        del internal["R_R"]
    untold = {name: untold[inner] for name, inner in internal.items() if inner in untold}
    found = [
        Parameter(
            name,
            UNITS.get(inner, "samples"),
            _given(machine, name, log.layout.lag),
            after.values[inner] + (log.layout.lag if name == "lag" else 0.0),
            after.std(inner) if inner in names else None,
        )
        for name, inner in internal.items()
        if told is None or inner not in told.names
    ]
    if slip is not None:
        found.append(Parameter("R_R", UNITS["R_R"], _given(machine, "R_R", 0.0), *slip))
    smoothing = smoothing_current(machine, scales) * _hardness(after)
    changed = with_found(machine, in_the_file(found))
    if told is not None:
        changed = _with_map(changed, told.model, scales)
    if "inverter" in names:
        changed = changed.with_values(inverter_current=float(f"{smoothing:.6g}"))
    return Identification(
        changed,
        found,
        untold,
        log.layout.lag + after.values["lag"],
        before,
        after,
        data,
        smoothing,
        sum(map(len, logs)),
        source,
        told,
    )


def _expanded(free: Sequence[str], machine: RotatingMachine) -> tuple[str, ...]:
    """Names as the fit uses them."""
    names = [INTERNAL.get(name, name) for name in free if name != MAP]
    if MAP in free:
        names += SATURATION
        names += ["psi_f"] if machine.magnets and "psi_f" not in names else []
    return tuple(names)


def _relation(machine: RotatingMachine) -> ResidualFunction:
    """The relation of a machine file."""
    table = _table(machine)
    return linear if table is None else Mapped(table, machine.magnet_flux or 0.0)


def _first_model(machine: RotatingMachine, given: Mapping[str, float]) -> AlgebraicSaturation:
    """Where the fit of a map starts: the file's model, else its inductances without saturation."""
    assert isinstance(machine, SynchronousMachine)
    if isinstance(machine.flux_map, AlgebraicSaturation):
        return machine.flux_map
    return AlgebraicSaturation(
        a_d0=1 / given["L_d"], a_q0=1 / given["L_q"], psi_f=given["psi_f"] or 0.0
    )


def _saturation_prior(
    model: AlgebraicSaturation, data: Sequence[Piece]
) -> dict[str, tuple[float, float]]:
    """Means and standard deviations before the log: inductances known to a half of themselves, and
    saturation that may make the currents four times as large at the flux of the log."""
    psi = _typical_flux(data)
    a_d, a_q = SATURATES * model.a_d0, SATURATES * model.a_q0
    stds = {
        "a_d0": UNSURE_SLOPE * model.a_d0,
        "a_q0": UNSURE_SLOPE * model.a_q0,
        "a_dd": a_d / psi**model.S,
        "a_qq": a_q / psi**model.T,
        "a_dq": (model.U + 2) * max(a_d, a_q) / psi ** (model.U + model.V + 2),
    }
    return {name: (getattr(model, name), std) for name, std in stds.items()}


def _typical_flux(data: Sequence[Piece]) -> float:
    """Length of the flux, rms [Wb]."""
    return float(np.sqrt(np.mean([np.sum(piece.start**2) for piece in data])))


def _with_map(
    machine: RotatingMachine, model: AlgebraicSaturation, scales: Scales
) -> RotatingMachine:
    """The machine with a map that was found; its inductances follow from it."""
    rounded = {name: float(f"{value:.6g}") for name, value in model.model_dump().items()}
    values: dict[str, Any] = dict.fromkeys(machine.inductance_names)
    if machine.magnets:
        values["psi_f"] = rounded["psi_f"]
    rated = machine.rated_current or float(f"{scales.current:.3g}")
    return machine.with_values(
        **values, flux_map=AlgebraicSaturation(**rounded), rated_current=rated
    )


def starting_values(machine: RotatingMachine, data: Sequence[Piece]) -> dict[str, float]:
    """Where the fit starts; a missing magnet flux is taken from the length of λ - L i."""
    L_d, L_q = machine.L_dq
    values = {
        "R_s": machine.R_s,
        "L_d": L_d,
        "L_q": L_q,
        "psi_f": 0.0,
        "inverter": machine.inverter_voltage or 0.0,
        "lag": 0.0,
        **dict.fromkeys(UNCERTAIN, 0.0),
    }
    if len(machine.inductance_names) == 1:
        values["L_s"] = L_q
    if machine.magnets:
        psi_f = machine.magnet_flux
        values["psi_f"] = psi_f if psi_f is not None else typical_length(data, L_q)
    return values


def _held(machine: RotatingMachine, scales: Scales) -> dict[str, float]:
    """Standard deviations of what is not free, as the adaptive observer takes them."""
    rated = machine.rated_current or scales.current
    link = float(np.sqrt(3) * scales.voltage)  # at least
    stds = list(machine.inductance_stds(INDUCTANCE_SHARE).values())
    names = ("L_s",) if len(stds) == 1 else ("L_d", "L_q")
    return {
        "R_s": default_resistance_std(machine),
        "inverter": default_inverter_std(machine, rated, link),
        "curve": CURVE_SHARE,
        **dict(zip(names, stds, strict=True)),
    }


def _nearest_lag(
    data: Sequence[Piece],
    given: dict[str, float],
    free: Sequence[str],
    relation: ResidualFunction,
    prior: Mapping[str, tuple[float, float]],
) -> ParameterFit:
    """The fit at the best integer lag: a step from far away would leave the range of lags."""
    names = [name for name in free if name != "lag"]
    fits = [
        fit(data, given | {"lag": float(lag)}, names, relation=relation, prior=prior)
        for lag in LAGS
    ]
    return min(fits, key=lambda found: found.rms())


def _start(given: dict[str, float], found: ParameterFit, names: Sequence[str]) -> dict[str, float]:
    """Free parameters as found, held ones as given."""
    values = given | {name: found.values[name] for name in names}
    if "L_s" in names:
        values["L_d"] = values["L_q"] = values["L_s"]
    return values


def _hardness(found: ParameterFit) -> float:
    """The knee that loses as much as those that were found, over the usual one."""
    shares = [found.values[name] for name in UNCERTAIN[: len(HARDER)]]
    return float(np.clip(1 - np.dot(shares, 1 - np.array(HARDER)), min(HARDER), 3.0))


def _given(machine: RotatingMachine, name: str, lag: float) -> float | None:
    if name == "lag":
        return lag
    value: float | None = getattr(machine, "inverter_voltage" if name == "inverter" else name)
    return value


def _unseen_inductances(found: ParameterFit, data: Sequence[Piece]) -> dict[str, str]:
    """Inductances along the flux, if hardly any current flows along it."""
    current = np.concatenate([piece.current for piece in data])
    share = float(np.sqrt(np.mean(found.current.real**2) / np.mean(np.sum(current**2, axis=1))))
    if share >= ALONG_LIMIT:
        return {}
    why = f"it shows only in i_d, which is {share:.0%} of the current in this log"
    return {name: why for name in ("L_s", "L_d") if name in found.free}


def _gathered(
    logs: Sequence[Log],
    machine: RotatingMachine,
    lags: tuple[int, ...],
    seconds: float,
    rotor: bool,
) -> tuple[list[Piece], Scales]:
    """Pieces of all logs, evenly spread over each if they are many; the largest of their scales."""
    most = max(POOLED // len(logs), LEAST_EACH)
    data: list[Piece] = []
    sizes = []
    for log in logs:
        found, scales = pieces(log, machine, lags, seconds, moving=rotor)
        sizes.append(astuple(scales))
        if len(logs) > 1 and len(found) > most:
            found = [found[k] for k in np.linspace(0, len(found) - 1, most).round().astype(int)]
        data += found
    return data, Scales(*(max(values) for values in zip(*sizes, strict=True)))


def _weighted(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean of values with standard deviations, and its own."""
    weights = [1 / std**2 for _, std in values]
    mean = sum(w * value for w, (value, _) in zip(weights, values, strict=True)) / sum(weights)
    return mean, sum(weights) ** -0.5


def _told_nothing(where: str, free: Sequence[str], untold: Mapping[str, str]) -> str:
    reasons = "; ".join(f"{name}: {why}" for name, why in untold.items())
    return f"{where}: this log tells none of {', '.join(free)} ({reasons}). {ADVICE}."


def _standing_flux(data: Sequence[Piece]) -> dict[str, str]:
    """Why the parameters of a cage are not told, if its flux hardly changes."""
    spread = max(float(np.ptp(piece.lengths)) for piece in data)
    usual = float(np.median([piece.lengths.mean() for piece in data]))
    if spread > FLUX_CHANGES * usual:
        return {}
    why = f"the rotor flux changes by no more than {spread / usual:.0%} in this log"
    return dict.fromkeys(ROTOR, why)


def _doubts(found: ParameterFit, voltage: float) -> dict[str, str]:
    """Parameters that the log does not tell → why."""
    doubts = {}
    mapped = SATURATION[0] in found.free
    for k, name in enumerate(found.free):
        if name in UNCERTAIN:
            continue
        if mapped and (name in SATURATION or name == "psi_f"):
            continue  # its prior decides what the log does not; the map's std says so
        std, value = float(found.own[k]), found.values[name]
        others = [
            (abs(found.covariance[k, j]) / (std * found.std(other) + 1e-300), other)
            for j, other in enumerate(found.free)
            if j != k and other not in UNCERTAIN
        ]
        if found.alike[k] > ALIKE_LIMIT:
            partner = max(others)[1] if others else "the others"
            doubts[name] = f"it acts like {partner} in this log"
            if "lag" in found.free:  # which then helps them to
                which = name if partner == "lag" else f"{name} and {partner} together"
                doubts.setdefault("lag", f"it acts like {which} in this log")
        elif name == "lag":
            at_edge = not LAGS[0] + 0.01 < value < LAGS[-1] - 0.01
            if at_edge or std > LAG_UNSURE or found.std(name) > LAG_HELD:
                doubts[name] = "no lag fits better than another"
        elif std > UNSURE[name] * (voltage if name == "inverter" else abs(value)):
            doubts[name] = f"it is known only to ± {std:.2g} {UNITS[name]}"
    return doubts
