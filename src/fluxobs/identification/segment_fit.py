"""Fit of a flux map, or of a cage's rotor, to segments of logs.

The relation between flux and current is nonlinear in these parameters. They are fitted together
with R_s, the magnet flux and the inverter's loss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from ..errors import FluxobsError
from ..logs.log import Log
from ..logs.scales import Scales
from ..machines import AlgebraicSaturation, RotatingMachine, SynchronousMachine
from ..machines.file_text import with_found
from ..observers.adaptive import INDUCTANCE_SHARE, default_inverter_std, default_resistance_std
from .fit import UNCERTAIN, ParameterFit, fit
from .map_fit import FoundMap, map_of_fit
from .relations import SATURATION, Cage, ResidualFunction, Saturating
from .segments import (
    HARDER,
    Segment,
    cut_segments,
    offset_std,
    smoothing_current,
    typical_length,
)
from .values import ADVICE, UNITS, Parameter, given_value, in_the_file

#: A parameter is not identifiable if similar effects of the other parameters increase its variance
#: by this factor: model errors would decide its value.
ALIKE_LIMIT = 100.0
#: A parameter is also not identifiable if its standard deviation exceeds this share of its value
#: (for the inverter, of the log's voltage).
UNSURE = {"R_s": 0.15, "L_s": 0.2, "L_d": 0.2, "L_q": 0.2, "psi_f": 0.05, "inverter": 0.02}
UNSURE |= {"R_R": 0.15, "L_M": 0.15}
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
HELD_FIRST = ("L_d", "L_q", "L_s", "L_M", "R_R", "inverter", "R_s", "psi_f")
#: Parameters of a cage that only changes of its flux identify, and length of a segment for their
#: fit [s]: a few time constants of the rotor.
ROTOR, ROTOR_SECONDS = ("R_R", "L_M"), 1.0
#: A flux that changes by less than this share does not identify R_R and L_M: noise and offsets
#: change the flux as much.
FLUX_CHANGES = 0.15


#: A larger residual, as a share of the flux, means that the machine or the layout is wrong: right
#: ones leave 0.1 to 1 % (benchmarks/maps.py).
MOST_RESIDUAL = 0.05
#: Names in `free` of parameters that bend the relation: the saturation parameters of a flux map.
MAP = "map"
#: Name in `free` → name that the fit uses for all kinds of machines.
INTERNAL = {"L_sigma": "L_s"}


@dataclass(frozen=True, eq=False)
class SegmentFit:
    """Flux map or rotor identified from segments of logs.

    Attributes
    ----------
    machine : RotatingMachine
        The machine with the identified values.
    parameters : tuple of Parameter
    unidentified : dict
        Name → why these logs cannot identify the parameter.
    before, after : ParameterFit
        The fit with the given values, where only the magnet flux is free, and the final fit.
    segments : list of Segment
    inverter_current : float
        Current at which the inverter's sign is smoothed [A].
    map : FoundMap, optional
    """

    machine: RotatingMachine
    parameters: tuple[Parameter, ...]
    unidentified: dict[str, str]
    before: ParameterFit
    after: ParameterFit
    segments: list[Segment]
    inverter_current: float
    map: FoundMap | None

    @property
    def flux(self) -> float:
        """Flux that residuals refer to: the magnet flux, or the mean initial flux [Wb]."""
        lengths = [np.linalg.norm(segment.start) for segment in self.segments]
        return self.after.values["psi_f"] or float(np.mean(lengths))


class ConstantFlux(FluxobsError):
    """The rotor flux is too constant for the parameters of a rotor; `reasons` by name."""

    def __init__(self, message: str, reasons: dict[str, str]) -> None:
        super().__init__(message)
        self.reasons = reasons


def fit_segments(logs: Sequence[Log], machine: RotatingMachine, free: Sequence[str]) -> SegmentFit:
    """Identify the map, or the rotor, of one machine from segments of open logs.

    Raises
    ------
    FluxobsError
        The lags of the logs differ, a log has no usable segment, nothing is identifiable, or the
        residual is too large for a right machine.
    """
    log = logs[0]
    if len({log.layout.lag for log in logs}) > 1:
        raise FluxobsError("all logs must have the same lag; state it (lag)")
    others = f" and {len(logs) - 1} more" if len(logs) > 1 else ""
    if any(name in ROTOR for name in free):  # a change of the flux identifies both or neither
        free = (*(name for name in free if name not in ROTOR), *ROTOR)
    problem = _pose_problem(logs, machine, tuple(free), f"{log.path}{others}")
    data, given, relation = problem.data, problem.given, problem.relation
    scale = ("psi_f",) if given["psi_f"] > 0 and not isinstance(relation, Cage) else ()
    before = fit(data, given, scale, relation=relation)
    solution = _fit_identifiable(problem)
    flux_map = map_of_fit(relation, solution.fit) if isinstance(relation, Saturating) else None
    parameters, unidentified = _report_parameters(solution, machine, problem.free, flux_map)
    smoothing = smoothing_current(machine, problem.scales) * _equivalent_knee(solution.fit)
    identified = with_found(machine, in_the_file(parameters))
    if flux_map is not None:
        identified = _replace_map(identified, flux_map.model, problem.scales)
    if "inverter" in solution.names:
        identified = identified.with_values(inverter_current=float(f"{smoothing:.6g}"))
    result = SegmentFit(
        identified,
        tuple(parameters),
        unidentified,
        before,
        solution.fit,
        data,
        smoothing,
        flux_map,
    )
    share = solution.fit.rms() / result.flux
    if share > MOST_RESIDUAL:
        raise FluxobsError(
            f"{log.path}{others}: nothing fits: the residual of the machine's relation is "
            f"{share:.0%} of the flux. Check the machine file, the columns with their scales and "
            f"signs, and the lag"
        )
    return result


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least-squares problem of an identification.

    Attributes
    ----------
    free : tuple of str
        The parameters as the user names them.
    names : tuple of str
        The same as the fit names them.
    given, held, prior
        Starting values; standard deviations of parameters; prior means and standard deviations.
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
    where: str


@dataclass(frozen=True, eq=False)
class _Solution:
    """Fit of the identifiable parameters, their names, and why the others are not."""

    fit: ParameterFit
    names: tuple[str, ...]
    unidentified: dict[str, str]


def _pose_problem(
    logs: Sequence[Log],
    machine: RotatingMachine,
    free: tuple[str, ...],
    where: str,
) -> _Problem:
    """Choose segments, relation, starting values and priors for these parameters."""
    rotor = any(name in ROTOR for name in free)
    seconds = ROTOR_SECONDS if rotor else MAP_SECONDS
    data, scales = _gather_segments(logs, machine, seconds)
    given, held = starting_values(machine, data), _held_stds(machine, scales)
    names = _expand_free(free, machine)
    relation: ResidualFunction = Cage(logs[0].sample_time)
    prior: dict[str, tuple[float, float]] = {}
    if MAP in free:
        relation = Saturating(_first_model(machine, given))
        prior = _saturation_prior(relation.model, data)
        given |= {name: getattr(relation.model, name) for name in SATURATION}
    if rotor:
        given |= {name: getattr(machine, name) for name in ROTOR}
        unchanged = _check_constant_flux(data)
        if unchanged:
            raise ConstantFlux(_none_identified(where, ROTOR, unchanged), unchanged)
        if len({log.sample_time for log in logs}) > 1:
            raise FluxobsError(
                f"to identify {' and '.join(ROTOR)}, all logs must have the same sample time"
            )
        held |= {name: INDUCTANCE_SHARE * given[name] for name in ROTOR}
    else:
        held = {name: std for name, std in held.items() if not name.startswith("L_")}
    if "inverter" in names:
        names = (*names, *UNCERTAIN)
        offset = (0.0, offset_std(machine, scales))
        prior = prior | dict(zip(UNCERTAIN, (KNEE, KNEE, offset, offset), strict=True))
    return _Problem(data, scales, free, names, given, held, prior, relation, where)


def _fit_identifiable(problem: _Problem) -> _Solution:
    """Fit, and hold the least identifiable parameter, until all free parameters are identifiable.

    Raises
    ------
    FluxobsError
        No parameter is identifiable.
    """
    data, relation, names = problem.data, problem.relation, problem.names
    given, held = dict(problem.given), dict(problem.held)
    unidentified: dict[str, str] = {}
    error = MODEL_ERROR * _typical_flux(data)
    while True:
        result = fit(
            data,
            given,
            names,
            None,
            held,
            relation=relation,
            prior=problem.prior,
            model_error=error,
        )
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
    flux_map: FoundMap | None,
) -> tuple[list[Parameter], dict[str, str]]:
    """Return the parameters by the user's names, and why some are not identified."""
    fit_names = {name: INTERNAL.get(name, name) for name in free if name != MAP}
    values, names, reasons = solution.fit.values, solution.names, solution.unidentified
    parameters = [
        Parameter(
            name,
            UNITS[fit_name],
            given_value(machine, name),
            values[fit_name],
            solution.fit.std(fit_name) if fit_name in names else None,
        )
        for name, fit_name in fit_names.items()
        if flux_map is None or fit_name not in flux_map.names
    ]
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


def _equivalent_knee(fitted: ParameterFit) -> float:
    """Return the knee with the same loss as the fitted mixture, relative to the usual knee."""
    shares = [fitted.values[name] for name in UNCERTAIN[: len(HARDER)]]
    return float(np.clip(1 - np.dot(shares, 1 - np.array(HARDER)), min(HARDER), 3.0))


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
    seconds: float,
) -> tuple[list[Segment], Scales]:
    """Return segments that are evenly spread over each log, and the largest scales of the logs."""
    largest_number = max(POOLED // len(logs), LEAST_EACH)
    data: list[Segment] = []
    sizes = []
    for log in logs:
        segments, scales = cut_segments(log, machine, seconds)
        sizes.append(astuple(scales))
        if len(logs) > 1 and len(segments) > largest_number:
            segments = [
                segments[k]
                for k in np.linspace(0, len(segments) - 1, largest_number).round().astype(int)
            ]
        data += segments
    return data, Scales(*(max(values) for values in zip(*sizes, strict=True)))


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
        elif std > UNSURE[name] * (voltage if name == "inverter" else abs(value)):
            doubts[name] = f"the standard deviation is too large: {std:.2g} {UNITS[name]}"
    return doubts
