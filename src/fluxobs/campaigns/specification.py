"""The specification of a campaign: what is simulated, what varies, which observers, what passes."""

# ruff: noqa: RUF012 (pydantic copies the defaults)

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, WrapValidator, model_validator

from ..core.input_files import read_toml
from ..core.references import beside
from ..core.validation import NotNegative, Number, Positive, Table, complaints, nearest
from ..errors import FluxobsError, UsageError
from ..machines import as_machine, example_names, rotating
from .distributions import Distribution, Given, correlator
from .quantities import PARAMETERS, QUANTITIES, TOGETHER

#: Names of the compiled observers; all others are those of the comparison.
PLAIN, ADAPTIVE = "plain", "adaptive"
#: Largest number of scenarios of a machine: their numbers have seven digits.
MOST = 10_000_000


class DriveTable(Table):
    """Ratings of the drive that the machine file does not hold; default those of a shipped machine.

    Parameters
    ----------
    sample_time : float
        [s].
    speed_e : float
        Rated electrical speed [rad/s].
    torque : float
        Rated torque [N m].
    J : float
        Inertia with the load [kg m²].
    dc_link : float
        [V].
    """

    sample_time: Positive | None = None
    speed_e: Positive | None = None
    torque: Positive | None = None
    J: Positive | None = None
    dc_link: Positive | None = None


def _course(given: Any, read: Any) -> Any:
    try:
        return read(given)
    except ValidationError:
        raise ValueError(
            f'give "random", or [[time in s, share of the rated value], …], got {given!r}'
        ) from None


Knots = Annotated[list[tuple[NotNegative, Number]], Field(min_length=1)]
Random = Literal["random"]
Range = Annotated[list[Number], Field(min_length=2, max_length=2)]


class CourseTable(Table):
    """Speed and load over time, as shares of the rated values.

    Parameters
    ----------
    duration : float
        Length of a record [s].
    score_from : float
        The first part is not scored [s].
    speed, load : list of [time, share], or "random"
        Piecewise linear; equal times make a jump. "random": segments of random length.
    speeds : [least, most]
        Size of the speed in a random segment, uniform in the logarithm.
    loads : [least, most]
        Load in a random segment, uniform.
    segment : [shortest, longest]
        Length of a random segment [s].
    stops, reversals : float
        Share of the random segments that stand still; that reverse.
    ramp : float
        Time from zero to rated speed in a random course [s].
    """

    duration: Positive = 2.0
    score_from: NotNegative = 0.3
    speed: Annotated[Knots | Random, WrapValidator(_course)] = "random"
    load: Annotated[Knots | Random, WrapValidator(_course)] = "random"
    speeds: Range = [0.05, 1.0]
    loads: Range = [-0.8, 0.8]
    segment: Range = [0.3, 1.0]
    stops: NotNegative = 0.1
    reversals: NotNegative = 0.3
    ramp: Positive = 0.4

    @model_validator(mode="after")
    def _possible(self) -> CourseTable:
        if not self.score_from < self.duration:
            raise ValueError(
                f"score_from = {self.score_from:g} s: nothing of {self.duration:g} s is left"
            )
        for name in ("speeds", "segment"):
            low, high = getattr(self, name)
            if not 0 < low <= high:
                raise ValueError(f"{name} = [least, most] must be positive and rise")
        if not self.loads[0] <= self.loads[1]:
            raise ValueError("loads = [least, most] must rise")
        for name in ("stops", "reversals"):
            if getattr(self, name) > 1:
                raise ValueError(f"{name} is a share, at most 1")
        for name in ("speed", "load"):
            knots = getattr(self, name)
            if knots != "random" and (np.diff([t for t, _ in knots]) < 0).any():
                raise ValueError(f"{name}: times must not decrease")
        return self


def _named(given: Any) -> Any:
    """An observer may be given by its name alone."""
    if not isinstance(given, str | dict | ObserverTable):
        raise ValueError(f"give a name, or a table with kind = NAME, got {given!r}")
    return {"kind": given} if isinstance(given, str) else given


class ObserverTable(Table):
    """One observer.

    Parameters
    ----------
    kind : str
        "plain", "adaptive", or a name of `fluxobs compare`.
    name : str, optional
        What rows and reports call it; default its kind.
    memory : float, optional
        Of plain and adaptive [s].
    unknowns : list of str, optional
        Of the adaptive one: drift, resistance, inverter, asymmetry; default the first three.
    gains : mapping, optional
        Of the others; default their usual ones. They do not judge themselves: their position counts
        as valid above 5 % of the rated speed.
    machine : mapping
        Factors on what this observer believes: R, L, psi.
    """

    kind: str
    name: str = ""
    memory: Positive | None = None
    unknowns: tuple[str, ...] | None = None
    gains: dict[str, Number] | None = None
    machine: dict[str, Positive] = {}

    @model_validator(mode="after")
    def _own(self) -> ObserverTable:
        compiled = self.kind in (PLAIN, ADAPTIVE)
        if compiled and self.gains:
            raise ValueError(f"{self.kind} has no gains; its one setting is memory")
        if not compiled and self.memory is not None:
            raise ValueError(f"memory is for plain and adaptive; {self.kind} has gains")
        if self.kind != ADAPTIVE and self.unknowns is not None:
            raise ValueError(f"unknowns is for adaptive, not for {self.kind}")
        for key in self.machine:
            if key not in ("R", "L", "psi"):
                raise ValueError(f"machine: factors on R, L, psi; got {key!r}")
        if not self.name:
            object.__setattr__(self, "name", self.kind)
        return self


Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class GoodTable(Table):
    """When a scenario counts as good: all that is given must hold.

    Parameters
    ----------
    rms, worst : float
        Rms and largest position error on the scored valid rows [°].
    valid : float
        Share of the scored rows that are valid, at least.
    first_valid : float
        Time until the position is first valid, at most [s].
    losses : int
        Losses of the position, trips included, in the loop.
    """

    rms: Positive | None = 2.0
    worst: Positive | None = None
    valid: Share | None = None
    first_valid: Positive | None = None
    losses: Annotated[int, Field(ge=0)] | None = None


class LimitTable(Table):
    """What the campaign must reach.

    Parameters
    ----------
    good : float
        Share of good scenarios, at least.
    observer, machine : str, optional
        Of this observer, on this machine; default every one.
    """

    good: Share
    observer: str | None = None
    machine: str | None = None


Observers = Annotated[list[Annotated[ObserverTable, BeforeValidator(_named)]], Field(min_length=1)]


class Specification(Table):
    """All of a campaign.

    Parameters
    ----------
    name : str
    machines : list of str
        Shipped machines, or machine files (in a specification's file: beside it, or below).
    scenarios : int
        Of each machine.
    seed : int
    loop : {"open", "closed"}
        "open": a drive with an encoder makes the record, all observers see the same one. "closed":
        each observer is in the loop of its own drive, on the same draws.
    sampling : {"random", "sobol"}
        How the unit cube is filled; grids are taken in either.
    drive, course, vary, correlation, observers, good, limits
        See the tables.
    """

    name: str = "campaign"
    machines: Annotated[list[str], Field(min_length=1)]
    scenarios: Annotated[int, Field(ge=1, le=MOST)]
    seed: Annotated[int, Field(ge=0)] = 0
    loop: Literal["open", "closed"] = "open"
    sampling: Literal["random", "sobol"] = "random"
    drive: DriveTable = DriveTable()
    course: CourseTable = CourseTable()
    vary: dict[str, Given] = {}
    correlation: dict[str, Number] = {}
    observers: Observers
    good: GoodTable = GoodTable()
    limits: list[LimitTable] = []

    def __init__(self, **given: Any) -> None:
        try:
            super().__init__(**given)
        except ValidationError as error:
            raise UsageError(complaints(error, type(self).model_fields, "a campaign")) from None

    @model_validator(mode="after")
    def _together(self) -> Specification:
        vary = {}
        for name, one in self.vary.items():
            if name not in (*QUANTITIES, *TOGETHER, *PARAMETERS):
                known = (*QUANTITIES, *TOGETHER, *PARAMETERS)
                raise ValueError(f"vary: unknown quantity {name!r}{nearest(name, known)}")
            for part in TOGETHER.get(name, (name,)):
                if part in vary:
                    raise ValueError(f"vary: {part} is given twice")
                least = QUANTITIES[part].least if part in QUANTITIES else -np.inf
                if one.fixed is not None and not one.fixed > least:
                    raise ValueError(f"vary: {name} = {one.fixed:g} is impossible for a drive")
                vary[part] = one
        # Nobody knows the angle at which a rotor stands.
        vary.setdefault("theta_e", Distribution(uniform=[-np.pi, np.pi]))
        # By name, as JSON has them: the axes of the unit cube are the same for all.
        object.__setattr__(self, "vary", dict(sorted(vary.items())))
        names = [one.name for one in self.observers]
        if len(set(names)) != len(names):
            raise ValueError(f"observers need names of their own (name = …), got {names}")
        if len(set(self.machines)) != len(self.machines):
            raise ValueError("machines: one is named twice")
        if self.good.losses is not None and self.loop == "open":
            raise ValueError('good.losses: only with loop = "closed" can an observer be lost')
        return self

    @model_validator(mode="after")
    def _limits_known(self) -> Specification:
        names = [one.name for one in self.observers]
        for limit in self.limits:
            for what, word, there in (
                ("observer", limit.observer, names),
                ("machine", limit.machine, self.machines),
            ):
                if word is not None and word not in there:
                    raise ValueError(f"limits: no {what} {word!r}{nearest(word, there)}")
        return self

    @model_validator(mode="after")
    def _sampled_evenly(self) -> Specification:
        drives, left = divmod(self.scenarios, self.places)
        if left:
            least = drives * self.places
            raise ValueError(
                f"scenarios = {self.scenarios}: the grid of {', '.join(self.grids)} has "
                f"{self.places} places; "
                f"take {f'{least} or ' if least else ''}{least + self.places}"
            )
        if self.sampling == "sobol" and drives & (drives - 1):
            least = self.places * 2 ** int(np.log2(drives))
            raise ValueError(
                f"scenarios = {self.scenarios}: Sobol' points are even only in powers of two"
                f"{' at each place of the grid' if self.grids else ''}; take {least} or {2 * least}"
            )
        return self

    @property
    def varied(self) -> tuple[str, ...]:
        """Quantities that differ from drive to drive, in order: the axes of the unit cube."""
        return tuple(name for name, one in self.vary.items() if one.varies and one.grid is None)

    @property
    def grids(self) -> tuple[str, ...]:
        """Quantities with a grid."""
        return tuple(name for name, one in self.vary.items() if one.grid is not None)

    @property
    def places(self) -> int:
        """Number of places in the product of all grids; 1 without a grid."""
        return math.prod(len(self.vary[name].grid or ()) for name in self.grids)

    def observer(self, name: str | None = None) -> ObserverTable:
        """The observer of a name, or the first; UsageError if there is none."""
        for table in self.observers:
            if name in (None, table.name):
                return table
        names = [table.name for table in self.observers]
        raise UsageError(f"no observer {name!r}{nearest(str(name), names)}")

    def called(self, machine: str) -> str:
        """What reports call a machine: the name of its file, if there is one of that name."""
        stems = [Path(one).stem for one in self.machines]
        short = Path(machine).stem
        return short if machine.endswith(".toml") and stems.count(short) == 1 else machine

    def canonical(self) -> str:
        """JSON that is equal for equal campaigns."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, ensure_ascii=False)


def hashed(text: str) -> str:
    """Sixteen digits that stand for a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_specification(path: str | Path) -> Specification:
    """A specification from a TOML file; its machine files lie beside it, or in folders below.

    Raises
    ------
    FluxobsError
        The file cannot be read, is not TOML, something in it is unknown or impossible, or a machine
        file lies elsewhere.
    """
    path = Path(path)
    given = read_toml(path, FluxobsError)
    machines = given.get("machines")
    limits = given.get("limits")
    try:
        if isinstance(machines, list):
            given["machines"] = [_found(path.parent, one, "machines") for one in machines]
        for limit in limits if isinstance(limits, list) else []:
            if isinstance(limit, dict) and "machine" in limit:
                limit["machine"] = _found(path.parent, limit["machine"], "limits: machine")
        return Specification(**given)
    except FluxobsError as error:
        raise FluxobsError(f"{path}: {error}") from None


def _found(folder: Path, machine: Any, field: str) -> Any:
    """A shipped machine by its name, a machine file by its path."""
    if not isinstance(machine, str) or machine in example_names():
        return machine
    return str(beside(folder, machine, field).resolve())


def check(specification: Specification) -> None:
    """Raises FluxobsError for what only machines and the catalogue of observers can tell."""
    correlator(specification.varied, specification.correlation)
    for name in specification.machines:
        machine = rotating(as_machine(name), "a campaign")
        has = [p for p in PARAMETERS if getattr(machine, p, None) is not None]
        for quantity in specification.vary:
            if quantity in PARAMETERS and quantity not in has:
                raise UsageError(
                    f"vary: {name} ({machine.kind}) has no {quantity}; it has {', '.join(has)}"
                )
