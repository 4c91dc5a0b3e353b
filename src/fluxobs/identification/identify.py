"""Identify a machine's parameters, and report which parameters the logs cannot identify.

The estimate of the whole log identifies R_s, the inductances, the magnet flux, the inverter's loss
and the lag, with the standard deviations of its error budget. A flux map and the rotor of a cage
have their own fit to segments of the logs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.validation import nearest
from ..errors import FluxobsError
from ..estimation.learning import UNSEEN, parameters
from ..logs.for_machine import open_for
from ..logs.log import Log
from ..logs.read import Source
from ..machines import MachineSource, RotatingMachine, SynchronousMachine, as_machine, rotating
from ..machines.file_text import with_found
from ..presentation import Result, estimate
from ..presentation.agreement import explains, fits
from ..presentation.warnings import misfit_warnings
from .fit_result import FittedParameters
from .mechanics import UNITS as MECHANICAL_UNITS
from .mechanics import Mechanics, identify_mechanics
from .report import figure, html_of, lines, write
from .rotor_resistance import resistance_from_speed
from .segment_fit import MAP, ROTOR, ConstantFlux, SegmentFit, fit_segments
from .values import ADVICE, UNITS, Parameter, common_mean, given_value

if TYPE_CHECKING:
    from typing import Unpack

    from matplotlib.figure import Figure

    from ..logs.meaning.options import ReadOptions


#: Prior standard deviation of a free inductance, as a share: its value in the machine file must be
#: right within a factor of about two.
FREE_INDUCTANCE = 0.5
#: Largest standard deviation of an identifiable lag [samples]: half of what is assumed of a stated
#: lag.
LAG_UNSURE = 0.125
#: Names of the mechanical parameters, and the name in `free` of both parts of the friction.
MECHANICS, FRICTION = tuple(MECHANICAL_UNITS), "friction"
#: Name in `free` → name among the parameters of an estimate.
LEARNT = {"R_s": "resistance", "psi_f": "magnet flux", "inverter": "inverter"}


@dataclass(frozen=True, eq=False)
class Identification(FittedParameters):
    """Result of :func:`identify`; it has the attributes of :class:`FittedParameters`."""

    def lines(self) -> list[str]:
        """Return one parameter per line, then what the log cannot identify."""
        return lines(self)

    def plot(self) -> Figure:
        """Draw the parameters over time; of a map or a rotor, the residual of the fit."""
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


def free_names(machine: RotatingMachine) -> tuple[str, ...]:
    """Return the names that `free` may contain for this kind of machine."""
    magnet = (machine.flux_name,) if machine.magnets else ()
    saturates = isinstance(machine, SynchronousMachine)
    fit = machine.saturation
    inductances = () if fit is not None and fit.table is not None else machine.inductance_names
    specific = (MAP,) if saturates else ROTOR if machine.flux_moves else ()
    return ("R_s", *inductances, *magnet, *specific, "inverter", "lag", *MECHANICS)


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
    if FRICTION in names:
        names = [*(name for name in names if name != FRICTION), *MECHANICS[1:]]
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


#: A log of at most this many rows keeps its estimates for the energy balance: 100 MB.
KEPT_ROWS = 500_000


def identify(
    log: Source,
    machine: MachineSource,
    *,
    free: str | Sequence[str] | None = None,
    priors: Mapping[str, float] | None = None,
    progress: Callable[[int, int], Any] | None = None,
    **layout: Unpack[ReadOptions],
) -> Identification:
    """Identify the machine's parameters and the inverter's error from a whole log.

    Parameters that the log cannot identify keep their given values, and the report says why. The
    values and standard deviations are those of :func:`fluxobs.estimate`.

    Parameters
    ----------
    log : path, Log, Record, mapping of str to array, or (voltage, current)
        See :func:`fluxobs.read_log`.
    machine : Machine, path, name of a shipped machine, or mapping of a machine file
        A rotating machine; its values must be right within a factor of about two.
    free : str or sequence of str, optional
        Any of R_s, L_s (or L_d, L_q; L_sigma), psi_f (psi_R), map, R_R, L_M, inverter, lag, J,
        viscous, coulomb; friction means both viscous and Coulomb friction;
        default: R_s, psi_f and inverter, if the machine has these parameters. R_R and L_M of a cage
        need a log in which the rotor flux changes; R_R can also be found from the slip if the log
        has the speed. "map" means the saturation parameters of :class:`AlgebraicSaturation`; the
        log must vary i_d and i_q.
    priors, progress
        See :func:`fluxobs.estimate`.
    layout : optional
        As for :func:`fluxobs.read_log`. The only truth in use is the speed_mech of a cage [rad/s].

    Raises
    ------
    FluxobsError
        The log does not fit the machine, the position is never known in the log, or the log
        identifies none of the free parameters.
    """
    rotating_machine = rotating(as_machine(machine), "identification")
    names = read_free(free, rotating_machine)
    opened = open_for(log, rotating_machine, **layout)
    return identify_log(opened, rotating_machine, names, priors, progress)


def identify_log(
    log: Log,
    machine: RotatingMachine,
    free: Sequence[str],
    priors: Mapping[str, float] | None = None,
    progress: Callable[[int, int], Any] | None = None,
) -> Identification:
    """Identify from an open log; the names of free parameters are already checked."""
    slip, fitted, run = None, None, None
    reasons: dict[str, str] = {}
    if "R_R" in free and _has_speed(log):
        slip = resistance_from_speed(log, machine)
        free = [name for name in free if name != "L_M"]
    elif any(name in (MAP, *ROTOR) for name in free):
        if not log.layout.lag_stated:
            # A saturating machine without its map need not fit: then the lag stays as read.
            run = estimate(log, machine, keep=False, priors=priors, progress=progress)
            log = run.log if explains(run) else log
        try:
            fitted = fit_segments([log], machine, [name for name in free if name != "lag"])
        except ConstantFlux as error:
            if all(name in ROTOR for name in free):
                raise
            reasons = error.reasons
            free = [*(name for name in free if name not in ROTOR), *ROTOR]
    if fitted is not None:
        return _from_segments(fitted, log, machine, free, run)
    if run is None and any(name not in ROTOR for name in free):
        run = _estimated(log, machine, free, priors, progress)
    told = {} if run is None else _learnt(run, machine, free)
    mechanics = None
    if run is not None and any(name in MECHANICS for name in free):
        try:
            mechanics = mechanics_of(run, dict(priors or {}).get("load", np.inf))
        except FluxobsError as error:
            reasons |= dict.fromkeys((name for name in free if name in MECHANICS), str(error))
        else:
            for name in free:
                if name in MECHANICS and mechanics.identifies(name):
                    told[name] = mechanics.values[name], mechanics.stds[name]
                elif name in MECHANICS:
                    reasons[name] = _why_open(name, mechanics)
    if slip is not None:
        told["R_R"] = slip
    if run is not None:
        reasons |= {n: _why_not(run, n) for n in free if n not in told and n not in reasons}
    name, rows = log.path.name, len(log)
    lag = log.layout.lag if log.layout.lag_stated else None
    found = _identification(machine, free, told, reasons, (lag, rows, name), run)
    return replace(found, mechanics=mechanics)


def combine(
    logs: Sequence[Log],
    machine: RotatingMachine,
    free: Sequence[str],
    told: Sequence[Mapping[str, tuple[float, float]]],
) -> Identification:
    """Identify one machine from several open logs and from what each log tells alone.

    Raises
    ------
    FluxobsError
        See :func:`identify`; also if the lags of the logs differ.
    """
    name = f"{logs[0].path.name} and {len(logs) - 1} more"
    if any(name in (MAP, *ROTOR) for name in free) and not ("R_R" in free and _has_speed(logs[0])):
        fitted = fit_segments(logs, machine, [name for name in free if name != "lag"])
        return _from_segments(fitted, logs[0], machine, free, None)
    values = {
        parameter: common_mean([one[parameter] for one in told if parameter in one])
        for parameter in free
        if any(parameter in one for one in told)
    }
    reasons = {name: "no log identifies it" for name in free if name not in values}
    about = (logs[0].layout.lag, sum(map(len, logs)), name)
    return _identification(machine, free, values, reasons, about, None)


def mechanics_of(result: Result, load_std: float = np.inf) -> Mechanics:
    """Identify inertia, friction and load from an estimate that kept its rows.

    `load_std` is the prior standard deviation of the load [N m].

    Raises
    ------
    FluxobsError
        Too few rows are valid, or the torque does not accelerate the drive.
    """
    machine, t, valid = result.rotor, result["t"], result["valid"]
    if machine.flux_moves:  # theta_e is the angle of the rotor's flux
        speed = np.where(valid, result["speed_mech"], 0.0)
        theta = np.concatenate([[0.0], np.cumsum(np.diff(t) * (speed[1:] + speed[:-1]) / 2)])
    else:
        theta = np.unwrap(result["theta_e"]) / machine.n_p
    return identify_mechanics(t, theta, result["torque"], result["torque_std"], valid, load_std)


def _why_open(name: str, mechanics: Mechanics) -> str:
    """Say why a mechanical parameter is open."""
    std, unit = mechanics.stds[name], MECHANICAL_UNITS[name]
    remedy = (
        "record ramps of the speed"
        if name == "J"
        else "record the drive at several speeds in both directions without load, and state "
        "--prior load=0"
    )
    return f"σ would be {std:.2g} {unit}; {remedy}"


def _has_speed(log: Log) -> bool:
    return log.truth is not None and log.truth[0] == "speed_mech"


def _estimated(
    log: Log,
    machine: RotatingMachine,
    free: Sequence[str],
    priors: Mapping[str, float] | None,
    progress: Callable[[int, int], Any] | None,
) -> Result:
    """Estimate the log; free inductances have a wide prior.

    Raises
    ------
    FluxobsError
        Nothing fits.
    """
    names = machine.inductance_names
    axes = ("L_d",) if len(names) == 1 else ("L_d", "L_q")
    wide = {axis: FREE_INDUCTANCE for axis, name in zip(axes, names, strict=True) if name in free}
    keep = any(name in MECHANICS for name in free) or len(log) <= KEPT_ROWS
    result = estimate(log, machine, keep=keep, priors=wide | dict(priors or {}), progress=progress)
    if fits(result):
        return result
    why = [*misfit_warnings(result), *result.warnings, "the position is never known"][0]
    raise FluxobsError(f"{log.path}: no parameter can be identified: {why}")


def _learnt(
    result: Result, machine: RotatingMachine, free: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Return the parameters that the log identifies: name → value and standard deviation."""
    assert result.adaptive is not None
    assert result.learnt is not None
    told: dict[str, tuple[float, float]] = {}
    learnt = {parameter.name: parameter for parameter in parameters(result.adaptive, result.learnt)}
    for name in free:
        parameter = learnt.get(LEARNT.get(name, ""))
        if parameter is not None and parameter.told:
            told[name] = (parameter.value, parameter.std)
        elif name in machine.inductance_names:
            axis = machine.inductance_names.index(name)
            ratio, std = (
                1 + result.learnt.inductance_error[axis],
                result.learnt.inductance_std[axis],
            )
            if 0 < std <= UNSEEN * FREE_INDUCTANCE:
                told[name] = (machine.L_dq[axis] * ratio, machine.L_dq[axis] * std)
        elif name == "psi_R" and result.statistics.valid:
            told[name] = (result.statistics.mean("psi_f"), result.statistics.mean("psi_f_std"))
        elif name == "lag":
            lag = result.fractional_lag
            learnt_whole = result.lag is not None and result.lag.decided
            if lag is not None and (learnt_whole or lag[1] <= LAG_UNSURE):
                told[name] = lag
    return told


def _why_not(result: Result, name: str) -> str:
    """Say why the log does not identify a parameter."""
    if name == "lag" and result.lag is not None and not result.lag.decided:
        return f"{result.lag.alternatives} fit"
    return "the log tells no more than the machine file and usual tolerances"


def _from_segments(
    fitted: SegmentFit,
    log: Log,
    machine: RotatingMachine,
    free: Sequence[str],
    run: Result | None,
) -> Identification:
    values, untold = list(fitted.parameters), dict(fitted.unidentified)
    if "lag" in free:
        lag = None if run is None else run.fractional_lag
        stated = log.layout.lag
        if lag is None:
            untold["lag"] = "it is stated"
        value, std = lag if lag is not None else (stated, None)
        values.append(Parameter("lag", UNITS["lag"], stated, value, std))
    name = log.path.name
    return Identification(
        fitted.machine, tuple(values), untold, log.layout.lag, len(log), name, None, fitted
    )


def _identification(
    machine: RotatingMachine,
    free: Sequence[str],
    told: Mapping[str, tuple[float, float]],
    reasons: Mapping[str, str],
    about: tuple[float | None, int, str],
    run: Result | None,
) -> Identification:
    """Return the result of an estimate.

    Raises
    ------
    FluxobsError
        No parameter is identified.
    """
    lag, rows, source = about
    if not told:
        why = "; ".join(f"{name}: {reason}" for name, reason in reasons.items())
        raise FluxobsError(
            f"{source}: this log identifies none of {', '.join(free)} ({why}). {ADVICE}."
        )
    values = []
    for name in free:
        given = lag if name == "lag" else given_value(machine, name)
        value, std = told.get(name, (given or 0.0, None))
        values.append(Parameter(name, UNITS[name], given, value, std))
    identified = with_found(
        machine,
        {
            "inverter_voltage" if name == "inverter" else name: value
            for name, value in told.items()
            if name not in ("lag", *MECHANICS)
        },
    )
    if "inverter" in told and run is not None and run.adaptive is not None:
        identified = identified.with_values(
            inverter_current=float(f"{run.adaptive.inverter_current:.6g}")
        )
    untold = {name: reasons[name] for name in free if name not in told}
    read_with = run.log.layout.lag if run is not None else lag or 0.0
    return Identification(identified, tuple(values), untold, read_with, rows, source, run, None)
