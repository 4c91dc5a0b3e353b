"""Identify a machine's parameters, and report which parameters the logs cannot identify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.validation import nearest
from ..errors import FluxobsError
from ..logs.for_machine import open_for
from ..logs.log import Log
from ..logs.read import Source
from ..logs.record import LAGS
from ..logs.scales import Scales
from ..machines import (
    AlgebraicSaturation,
    MachineSource,
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
from .map_fit import FoundMap, map_of_fit
from .relations import SATURATION, Cage, Mapped, ResidualFunction, Saturating, linear
from .report import figure, html_of, lines, write
from .rotor_resistance import resistance_from_speed
from .segments import (
    HARDER,
    SECONDS,
    Segment,
    cut_segments,
    offset_std,
    smoothing_current,
    typical_length,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: A parameter is not identifiable if similar effects of the other parameters increase its variance
#: by this factor: model errors would decide its value.
ALIKE_LIMIT = 100.0
#: A parameter is also not identifiable if its standard deviation exceeds this share of its value
#: (for the inverter, of the log's voltage).
UNSURE = {"R_s": 0.15, "L_s": 0.2, "L_d": 0.2, "L_q": 0.2, "psi_f": 0.05, "inverter": 0.02}
UNSURE |= {"R_R": 0.15, "L_M": 0.15}
#: Largest standard deviation of an identifiable lag [samples].
LAG_UNSURE = 0.25
#: Largest standard deviation of an identifiable lag with the effect of held parameters [samples].
LAG_HELD = 1.0
#: L_s and L_d act only through the current along the flux. Neither is identifiable if this
#: component is below this share of the current (rms): model errors would decide their value.
ALONG_LIMIT = 0.15
#: Prior standard deviations of a map, as shares of the inverse inductances: of the inverse
#: inductances, and of their increase by saturation.
UNSURE_SLOPE, SATURATES = 0.5, 3.0
#: Model error as a share of the flux, independent in each block of the fit. Without a position, a
#: log determines the symmetry of the map only weakly and amplifies model errors about twentyfold.
#: With this value, a machine that differs from the model by 0.2 % is within three standard
#: deviations (benchmarks/maps.py).
MODEL_ERROR = 0.0003
#: Length of a segment for a map [s]. The drift must be constant for this time: five parameters of
#: saturation can imitate a changing drift.
MAP_SECONDS = 2.0
#: Prior mean and standard deviation of the shares of the harder knees.
KNEE = (0.0, 1.0)
#: The curve of an inverter's loss differs from the model. The considered parameter "curve" has this
#: standard deviation, as a share of i (1 - |i| / I) / I, like in the adaptive observer
#: (docs/theory.md, section 13).
CURVE_SHARE = 0.15
#: Largest number of segments in a common fit of several logs, and smallest number of segments per
#: log. With the largest number, the fit needs about ten seconds and 150 megabytes.
POOLED, LEAST_EACH = 200, 2
#: Parameters whose effects cannot be separated are held in this order.
HELD_FIRST = ("lag", "L_d", "L_q", "L_s", "L_M", "R_R", "inverter", "R_s", "psi_f")
#: Parameters of a cage that only changes of its flux identify, and length of a segment for their
#: fit [s]: a few time constants of the rotor.
ROTOR, ROTOR_SECONDS = ("R_R", "L_M"), 1.0
#: A flux that changes by less than this share does not identify R_R and L_M: noise and offsets
#: change the flux as much.
FLUX_CHANGES = 0.15


@dataclass(frozen=True, eq=False)
class Identification(FittedParameters):
    """Result of :func:`identify`; it has the attributes of :class:`FittedParameters`."""

    def lines(self) -> list[str]:
        """Return one parameter per line, then unidentified parameters, then the residual."""
        return lines(self)

    def plot(self) -> Figure:
        """Draw the residual over time, with the given and the identified values."""
        return figure(self)

    def write(self, path: str | Path, *, force: bool = False) -> None:
        """Write the machine to .toml (over an existing file only with `force`), or a report.

        Raises
        ------
        FluxobsError
            The ending is not supported, the file exists, or the file cannot be written.
        """
        write(self, Path(path), force)

    def _repr_html_(self) -> str:
        """Return parameters, unidentified parameters and the picture as HTML, for a notebook."""
        return html_of(self)

    def __str__(self) -> str:
        return "\n".join(self.lines())


#: Name in `free` for the parameters of the flux map.
MAP = "map"


def free_names(machine: RotatingMachine) -> tuple[str, ...]:
    """Return the names that `free` may contain for this kind of machine."""
    magnet = (machine.flux_name,) if machine.magnets else ()
    saturates = isinstance(machine, SynchronousMachine)
    inductances = () if _table(machine) is not None else machine.inductance_names
    specific = (MAP,) if saturates else ROTOR if machine.flux_moves else ()
    return ("R_s", *inductances, *magnet, *specific, "inverter", "lag")


def _table(machine: RotatingMachine) -> TableMap | None:
    """Return the flux map of the machine file; None without a map."""
    fit = machine.saturation
    return None if fit is None else fit.table


#: Name in `free` → name that the fit uses for all kinds of machines.
INTERNAL = {"L_sigma": "L_s", "psi_R": "psi_f"}


def read_free(free: str | Sequence[str] | None, machine: RotatingMachine) -> tuple[str, ...]:
    """Return the names in ``"R_s,psi_f,inverter"`` or a sequence.

    The default is R_s, psi_f and inverter, if the machine has these parameters.

    Raises
    ------
    FluxobsError
        This kind of machine has no such parameter; the message names the most similar parameter.
    """
    possible = free_names(machine)
    if free is None:
        return tuple(n for n in possible if n in ("R_s", machine.flux_name, "inverter"))
    requested = free.split(",") if isinstance(free, str) else free
    names = [name.strip() for name in requested if name.strip()]
    names = ["inverter" if name == "inverter_voltage" else name for name in names]
    if MAP in names and any(name in machine.inductance_names for name in names):
        raise FluxobsError(f"free: {MAP} already contains the inductances; leave them out")
    if "psi_R" in names and any(name in ROTOR for name in names):
        raise FluxobsError(
            "free: give either psi_R, or R_R and L_M: psi_R needs a constant rotor flux, R_R and "
            "L_M need a changing rotor flux"
        )
    for name in names:
        if name not in possible:
            raise FluxobsError(
                f"free: kind {machine.kind} has no {name!r}{nearest(name, possible)}"
            )
    if not names:
        raise FluxobsError(f"free: give some of {', '.join(possible)}")
    return tuple(name for name in possible if name in names)


def identify(
    log: Source,
    machine: MachineSource,
    *,
    free: str | Sequence[str] | None = None,
    **layout: Any,
) -> Identification:
    """Fit the machine's parameters and the inverter's error to a whole log.

    Parameters that the log cannot identify keep their given values, and the report says why.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, path, name of a shipped machine, or mapping of a machine file
        A rotating machine; its values must be right within a factor of about two.
    free : str or sequence of str, optional
        Any of R_s, L_s (or L_d, L_q; L_sigma), psi_f (psi_R), map, R_R, L_M, inverter, lag;
        default: R_s, psi_f and inverter, if the machine has these parameters. R_R and L_M of a cage
        need a log in which the rotor flux changes; R_R can also be found from the slip if the log
        has the speed. "map" means the saturation parameters of :class:`AlgebraicSaturation`; the
        log must vary i_d and i_q.
    layout : optional
        As for :func:`fluxobs.read_log`. The only truth in use is the speed_mech of a cage [rad/s].

    Raises
    ------
    FluxobsError
        The position is never known in the log, or the log identifies none of the free parameters.
    """
    rotating_machine = rotating(as_machine(machine), "identification")
    names = read_free(free, rotating_machine)
    return identify_log(open_for(log, rotating_machine, **layout), rotating_machine, names)


def identify_log(log: Log, machine: RotatingMachine, free: Sequence[str]) -> Identification:
    """Identify from an open log; the names of free parameters are already checked."""
    return identify_logs([log], machine, free)


def identify_logs(
    logs: Sequence[Log], machine: RotatingMachine, free: Sequence[str]
) -> Identification:
    """Identify one machine from segments of several open logs.

    Raises
    ------
    FluxobsError
        The lags of the logs differ, a log has no usable segment, or the logs together identify none
        of the free parameters.
    """
    log = logs[0]
    if len({log.layout.lag for log in logs}) > 1:
        raise FluxobsError("all logs must have the same lag; give --lag")
    others = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
    free, slip = _separate_slip(logs, machine, free)
    problem = _pose_problem(logs, machine, free, f"{log.path}{others}", slip is not None)
    data, given, relation = problem.data, problem.given, problem.relation
    scale = ("psi_f",) if given["psi_f"] > 0 and not isinstance(relation, Cage) else ()
    before = fit(data, given, scale, relation=relation)
    solution = _fit_identifiable(problem)
    flux_map = map_of_fit(relation, solution.fit) if isinstance(relation, Saturating) else None
    parameters, unidentified = _report_parameters(
        solution, machine, problem.free, log.layout.lag, flux_map, slip
    )
    smoothing = smoothing_current(machine, problem.scales) * _equivalent_knee(solution.fit)
    identified = with_found(machine, in_the_file(parameters))
    if flux_map is not None:
        identified = _replace_map(identified, flux_map.model, problem.scales)
    if "inverter" in solution.names:
        identified = identified.with_values(inverter_current=float(f"{smoothing:.6g}"))
    return Identification(
        identified,
        parameters,
        unidentified,
        log.layout.lag + solution.fit.values["lag"],
        before,
        solution.fit,
        data,
        smoothing,
        sum(map(len, logs)),
        f"{log.path.name}{others}",
        flux_map,
    )


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least-squares problem of an identification.

    Attributes
    ----------
    free : tuple of str
        The parameters as the user names them.
    names : tuple of str
        The same as the fit names them, without those that `unidentified` excludes.
    given, held, prior
        Starting values; standard deviations of parameters; prior means and standard deviations.
    unidentified : dict of str to str
        Name of a parameter → why this log cannot identify it.
    where : str
        The logs, for errors.
    """

    data: list[Segment]
    scales: Scales
    free: tuple[str, ...]
    names: tuple[str, ...]
    given: dict[str, float]
    held: dict[str, float]
    prior: dict[str, tuple[float, float]]
    relation: ResidualFunction
    unidentified: dict[str, str]
    where: str


@dataclass(frozen=True, eq=False)
class _Solution:
    """Fit of the identifiable parameters, their names, and why the others are not."""

    fit: ParameterFit
    names: tuple[str, ...]
    unidentified: dict[str, str]


def _separate_slip(
    logs: Sequence[Log], machine: RotatingMachine, free: Sequence[str]
) -> tuple[tuple[str, ...], tuple[float, float] | None]:
    """Return the free parameters in order, and R_R with its std if measured speeds give it.

    A change of the flux identifies both parameters of a rotor or neither, so both are free.
    """
    with_speed = [log for log in logs if log.truth is not None and log.truth[0] == "speed_mech"]
    if "R_R" in free and with_speed:
        slip = _weighted_mean([resistance_from_speed(log, machine) for log in with_speed])
        return tuple(name for name in free if name != "L_M"), slip
    if any(name in ROTOR for name in free):
        return (*(name for name in free if name not in ROTOR), *ROTOR), None
    return tuple(free), None


def _pose_problem(
    logs: Sequence[Log],
    machine: RotatingMachine,
    free: tuple[str, ...],
    where: str,
    from_slip: bool,
) -> _Problem:
    """Choose segments, relation, starting values and priors for these parameters."""
    rotor = not from_slip and any(name in ROTOR for name in free)
    seconds = MAP_SECONDS if MAP in free else ROTOR_SECONDS if rotor else SECONDS
    lags = LAGS if "lag" in free else (0,)
    data, scales = _gather_segments(logs, machine, lags, seconds, rotor)
    given, held = starting_values(machine, data), _held_stds(machine, scales)
    names = tuple(n for n in _expand_free(free, machine) if not (from_slip and n == "R_R"))
    relation: ResidualFunction = _relation(machine)
    prior: dict[str, tuple[float, float]] = {}
    unidentified: dict[str, str] = {}
    if rotor:
        given |= {name: getattr(machine, name) for name in ROTOR}
        unidentified = _check_constant_flux(data)
        names = tuple(name for name in names if name not in unidentified)
        if not names:
            raise FluxobsError(_none_identified(where, free, unidentified))
    if MAP in free:
        relation = Saturating(_first_model(machine, given))
        prior = _saturation_prior(relation.model, data)
        given |= {name: getattr(relation.model, name) for name in SATURATION}
    if rotor and not unidentified:
        if len({log.sample_time for log in logs}) > 1:
            raise FluxobsError(
                f"to identify {' and '.join(ROTOR)}, all logs must have the same sample time"
            )
        relation = Cage(logs[0].sample_time)
        held |= {name: INDUCTANCE_SHARE * given[name] for name in ROTOR}
    elif relation is not linear:
        held = {name: std for name, std in held.items() if not name.startswith("L_")}
    if "inverter" in names:
        names = (*names, *UNCERTAIN)
        offset = (0.0, offset_std(machine, scales))
        prior = prior | dict(zip(UNCERTAIN, (KNEE, KNEE, offset, offset), strict=True))
    return _Problem(data, scales, free, names, given, held, prior, relation, unidentified, where)


def _fit_identifiable(problem: _Problem) -> _Solution:
    """Fit, and hold the least identifiable parameter, until all free parameters are identifiable.

    Raises
    ------
    FluxobsError
        No parameter is identifiable.
    """
    data, relation, names = problem.data, problem.relation, problem.names
    given, held = dict(problem.given), dict(problem.held)
    unidentified = dict(problem.unidentified)
    error = MODEL_ERROR * _typical_flux(data)
    best_lag = None
    if "lag" in names:
        best_lag = _fit_best_lag(data, given, names, relation, problem.prior)
    while True:
        start, local = given, None
        if best_lag is not None and "lag" in names:
            start, local = _merge_values(given, best_lag, names), best_lag.local
        result = fit(data, start, names, local, held, relation, problem.prior, error)
        doubts = _find_doubts(result, problem.scales.voltage)
        doubts |= _find_unseen_inductances(result, data)
        if "inverter" in names and result.values["inverter"] < 0 and not doubts:
            value, std = result.values["inverter"], result.std("inverter")
            doubts = {
                "inverter": f"the fit is {value:.2g} ± {std:.2g} V, but inverters add no voltage"
            }
            given["inverter"], held["inverter"] = 0.0, std
        if not doubts:
            return _Solution(result, names, unidentified)
        doubtful = next(name for name in HELD_FIRST if name in doubts)
        unidentified[doubtful] = doubts[doubtful]
        excluded = (*unidentified, *(UNCERTAIN if "inverter" in unidentified else ()))
        names = tuple(name for name in names if name not in excluded)
        if not names:
            raise FluxobsError(_none_identified(problem.where, problem.free, unidentified))


def _report_parameters(
    solution: _Solution,
    machine: RotatingMachine,
    free: Sequence[str],
    lag: float,
    flux_map: FoundMap | None,
    slip: tuple[float, float] | None,
) -> tuple[list[Parameter], dict[str, str]]:
    """Return the parameters by the user's names, and why some are not identified."""
    fit_names = {name: INTERNAL.get(name, name) for name in free if name != MAP}
    if slip is not None:
        del fit_names["R_R"]
    values, names, reasons = solution.fit.values, solution.names, solution.unidentified
    parameters = [
        Parameter(
            name,
            UNITS.get(fit_name, "samples"),
            _given_value(machine, name, lag),
            values[fit_name] + (lag if name == "lag" else 0.0),
            solution.fit.std(fit_name) if fit_name in names else None,
        )
        for name, fit_name in fit_names.items()
        if flux_map is None or fit_name not in flux_map.names
    ]
    if slip is not None:
        parameters.append(Parameter("R_R", UNITS["R_R"], _given_value(machine, "R_R", 0.0), *slip))
    unidentified = {
        name: reasons[fit_name] for name, fit_name in fit_names.items() if fit_name in reasons
    }
    return parameters, unidentified


def _expand_free(free: Sequence[str], machine: RotatingMachine) -> tuple[str, ...]:
    """Return the names that the fit uses."""
    names = [INTERNAL.get(name, name) for name in free if name != MAP]
    if MAP in free:
        names += SATURATION
        names += ["psi_f"] if machine.magnets and "psi_f" not in names else []
    return tuple(names)


def _relation(machine: RotatingMachine) -> ResidualFunction:
    """Return the relation of a machine file."""
    table = _table(machine)
    return linear if table is None else Mapped(table, machine.magnet_flux or 0.0)


def _first_model(machine: RotatingMachine, given: Mapping[str, float]) -> AlgebraicSaturation:
    """Return the initial map: the file's model, or the file's inductances without saturation."""
    assert isinstance(machine, SynchronousMachine)
    if isinstance(machine.flux_map, AlgebraicSaturation):
        return machine.flux_map
    return AlgebraicSaturation(
        a_d0=1 / given["L_d"], a_q0=1 / given["L_q"], psi_f=given["psi_f"] or 0.0
    )


def _saturation_prior(
    model: AlgebraicSaturation, data: Sequence[Segment]
) -> dict[str, tuple[float, float]]:
    """Return prior means and standard deviations of the map.

    The standard deviation of an inverse inductance is half its value. Saturation of one standard
    deviation makes the current four times larger at the flux of the log.
    """
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


def _typical_flux(data: Sequence[Segment]) -> float:
    """Return the rms length of the flux [Wb]."""
    return float(np.sqrt(np.mean([np.sum(segment.start**2) for segment in data])))


def _replace_map(
    machine: RotatingMachine, model: AlgebraicSaturation, scales: Scales
) -> RotatingMachine:
    """Return the machine with an identified map instead of its inductances."""
    rounded = {name: float(f"{value:.6g}") for name, value in model.model_dump().items()}
    values: dict[str, Any] = dict.fromkeys(machine.inductance_names)
    if machine.magnets:
        values["psi_f"] = rounded["psi_f"]
    rated = machine.rated_current or float(f"{scales.current:.3g}")
    return machine.with_values(
        **values, flux_map=AlgebraicSaturation(**rounded), rated_current=rated
    )


def starting_values(machine: RotatingMachine, data: Sequence[Segment]) -> dict[str, float]:
    """Return the initial values; a missing magnet flux is set to the length of λ - L i."""
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


def _held_stds(machine: RotatingMachine, scales: Scales) -> dict[str, float]:
    """Return the adaptive observer's standard deviations for the held parameters."""
    rated = machine.rated_current or scales.current
    link = float(np.sqrt(3) * scales.voltage)  # lower bound of the DC link
    stds = list(machine.inductance_stds(INDUCTANCE_SHARE).values())
    names = ("L_s",) if len(stds) == 1 else ("L_d", "L_q")
    return {
        "R_s": default_resistance_std(machine),
        "inverter": default_inverter_std(machine, rated, link),
        "curve": CURVE_SHARE,
        **dict(zip(names, stds, strict=True)),
    }


def _fit_best_lag(
    data: Sequence[Segment],
    given: dict[str, float],
    free: Sequence[str],
    relation: ResidualFunction,
    prior: Mapping[str, tuple[float, float]],
) -> ParameterFit:
    """Return the fit at the best integer lag: a start far from it would leave the range."""
    names = [name for name in free if name != "lag"]
    fits = [
        fit(data, given | {"lag": float(lag)}, names, relation=relation, prior=prior)
        for lag in LAGS
    ]
    return min(fits, key=lambda candidate: candidate.rms())


def _merge_values(
    given: dict[str, float], fitted: ParameterFit, names: Sequence[str]
) -> dict[str, float]:
    """Return fitted values of the free parameters and given values of all other parameters."""
    values = given | {name: fitted.values[name] for name in names}
    if "L_s" in names:
        values["L_d"] = values["L_q"] = values["L_s"]
    return values


def _equivalent_knee(fitted: ParameterFit) -> float:
    """Return the knee with the same loss as the fitted mixture, relative to the usual knee."""
    shares = [fitted.values[name] for name in UNCERTAIN[: len(HARDER)]]
    return float(np.clip(1 - np.dot(shares, 1 - np.array(HARDER)), min(HARDER), 3.0))


def _given_value(machine: RotatingMachine, name: str, lag: float) -> float | None:
    if name == "lag":
        return lag
    value: float | None = getattr(machine, "inverter_voltage" if name == "inverter" else name)
    return value


def _find_unseen_inductances(fitted: ParameterFit, data: Sequence[Segment]) -> dict[str, str]:
    """Return L_s and L_d, each with the reason, if hardly any current flows along the flux."""
    current = np.concatenate([segment.current for segment in data])
    share = float(np.sqrt(np.mean(fitted.current.real**2) / np.mean(np.sum(current**2, axis=1))))
    if share >= ALONG_LIMIT:
        return {}
    reason = (
        f"this inductance acts only through i_d, which is {share:.0%} of the current in this log"
    )
    return {name: reason for name in ("L_s", "L_d") if name in fitted.free}


def _gather_segments(
    logs: Sequence[Log],
    machine: RotatingMachine,
    lags: tuple[int, ...],
    seconds: float,
    rotor: bool,
) -> tuple[list[Segment], Scales]:
    """Return segments that are evenly spread over each log, and the largest scales of the logs."""
    largest_number = max(POOLED // len(logs), LEAST_EACH)
    data: list[Segment] = []
    sizes = []
    for log in logs:
        segments, scales = cut_segments(log, machine, lags, seconds, moving=rotor)
        sizes.append(astuple(scales))
        if len(logs) > 1 and len(segments) > largest_number:
            segments = [
                segments[k]
                for k in np.linspace(0, len(segments) - 1, largest_number).round().astype(int)
            ]
        data += segments
    return data, Scales(*(max(values) for values in zip(*sizes, strict=True)))


def _weighted_mean(values: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the weighted mean of values with standard deviations, and the mean's deviation."""
    weights = [1 / std**2 for _, std in values]
    products = (weight * value for weight, (value, _) in zip(weights, values, strict=True))
    return sum(products) / sum(weights), sum(weights) ** -0.5


def _none_identified(where: str, free: Sequence[str], untold: Mapping[str, str]) -> str:
    """Return the message that no parameter can be identified."""
    reasons = "; ".join(f"{name}: {reason}" for name, reason in untold.items())
    return f"{where}: this log identifies none of {', '.join(free)} ({reasons}). {ADVICE}."


def _check_constant_flux(data: Sequence[Segment]) -> dict[str, str]:
    """Return the cage's parameters, each with the reason, if its flux hardly changes."""
    spread = max(float(np.ptp(segment.lengths)) for segment in data)
    typical = float(np.median([segment.lengths.mean() for segment in data]))
    if spread > FLUX_CHANGES * typical:
        return {}
    reason = f"the rotor flux changes by no more than {spread / typical:.0%} in this log"
    return dict.fromkeys(ROTOR, reason)


def _find_doubts(fitted: ParameterFit, voltage: float) -> dict[str, str]:
    """Return why parameters are not identifiable: name → reason."""
    doubts = {}
    mapped = SATURATION[0] in fitted.free
    for k, name in enumerate(fitted.free):
        if name in UNCERTAIN:
            continue
        if mapped and (name in SATURATION or name == "psi_f"):
            continue  # the prior completes the log; the standard deviations of the map show it
        std, value = float(fitted.own[k]), fitted.values[name]
        others = [
            (abs(fitted.covariance[k, j]) / (std * fitted.std(other) + 1e-300), other)
            for j, other in enumerate(fitted.free)
            if j != k and other not in UNCERTAIN
        ]
        if fitted.alike[k] > ALIKE_LIMIT:
            partner = max(others)[1] if others else "the others"
            doubts[name] = f"cannot be distinguished from {partner} in this log"
            if "lag" in fitted.free:  # the lag may cause the similarity
                imitated = name if partner == "lag" else f"{name} and {partner} together"
                doubts.setdefault("lag", f"cannot be distinguished from {imitated} in this log")
        elif name == "lag":
            at_edge = not LAGS[0] + 0.01 < value < LAGS[-1] - 0.01
            if at_edge or std > LAG_UNSURE or fitted.std(name) > LAG_HELD:
                doubts[name] = "all lags fit equally well"
        elif std > UNSURE[name] * (voltage if name == "inverter" else abs(value)):
            doubts[name] = f"the standard deviation is too large: {std:.2g} {UNITS[name]}"
    return doubts
