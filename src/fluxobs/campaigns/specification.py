"""The specification of a campaign: drives, varying quantities, observers and limits."""

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
from .distributions import Distribution, DistributionField, correlator
from .quantities import PARAMETERS, QUANTITIES, TOGETHER

#: Names of the compiled observers; all other names are those of the comparison.
PLAIN, ADAPTIVE = "plain", "adaptive"
#: Name of the estimate of every row from the record before and behind it.
WHOLE_LOG = "whole-log"
#: Observers that `fluxobs estimate` runs, with reports.
REPORTED = (PLAIN, ADAPTIVE, WHOLE_LOG)
#: Largest number of scenarios per machine: numbers have seven digits.
MOST = 10_000_000


class DriveTable(Table):
    """Drive ratings that the machine file lacks; shipped machines have default ratings.

    Parameters
    ----------
    sample_time : float
        Sample time [s].
    speed_e : float
        Rated electrical speed [rad/s].
    torque : float
        Rated torque [N m].
    J : float
        Inertia with the load [kg m²].
    dc_link : float
        DC-link voltage [V].
    """

    sample_time: Positive | None = None
    speed_e: Positive | None = None
    torque: Positive | None = None
    J: Positive | None = None
    dc_link: Positive | None = None


def _course(value: Any, validate: Any) -> Any:
    try:
        return validate(value)
    except ValidationError:
        raise ValueError(
            f'give "random", or [[time in s, share of the rated value], …], got {value!r}'
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
        Start of the scored part [s].
    speed, load : list of [time, share], or "random"
        Piecewise linear; equal times make a jump. "random": segments of random length.
    speeds : [least, most]
        Magnitude of the speed in a random segment, uniform in the logarithm.
    loads : [least, most]
        Load in a random segment, uniform.
    segment : [shortest, longest]
        Length of a random segment [s].
    stops, reversals : float
        Share of the random segments at standstill; share of the segments with a reversal.
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
                f"score_from = {self.score_from:g} s must be below duration = {self.duration:g} s"
            )
        for name in ("speeds", "segment"):
            lower, upper = getattr(self, name)
            if not 0 < lower <= upper:
                raise ValueError(f"{name} = [least, most] must be positive and ascending")
        if not self.loads[0] <= self.loads[1]:
            raise ValueError("loads = [least, most] must be ascending")
        for name in ("stops", "reversals"):
            if getattr(self, name) > 1:
                raise ValueError(f"{name} is a share, at most 1")
        for name in ("speed", "load"):
            knots = getattr(self, name)
            if knots != "random" and (np.diff([t for t, _ in knots]) < 0).any():
                raise ValueError(f"{name}: times must not decrease")
        return self


def _as_observer_table(value: Any) -> Any:
    """Return the table of an observer for a bare name."""
    if not isinstance(value, str | dict | ObserverTable):
        raise ValueError(f"give a name, or a table with kind = NAME, got {value!r}")
    return {"kind": value} if isinstance(value, str) else value


class ObserverTable(Table):
    """One observer.

    Parameters
    ----------
    kind : str
        "plain", "adaptive", an observer of `fluxobs compare`, or "whole-log": the estimate of every
        row, as by `fluxobs estimate`, in open loop.
    name : str, optional
        Name in rows and reports; default the kind.
    memory : float, optional
        Memory of plain and adaptive, the time constant of forgetting [s].
    unknowns : list of str, optional
        For adaptive: drift, resistance, inverter, asymmetry; default the first three.
    gains : mapping, optional
        Gains of the other observers; default the recommended gains. The other observers have no
        validity flag; their position counts as valid above 5 % of the rated speed.
    machine : mapping
        Factors on the parameters that this observer assumes: R, L, psi.
    file : str
        Shipped machine that this observer assumes, for example one without the saturation of the
        drive's machine; default the drive's machine.
    """

    kind: str
    name: str = ""
    memory: Positive | None = None
    unknowns: tuple[str, ...] | None = None
    gains: dict[str, Number] | None = None
    machine: dict[str, Positive] = {}
    file: str = ""

    @model_validator(mode="after")
    def _check_settings(self) -> ObserverTable:
        compiled = self.kind in (PLAIN, ADAPTIVE)
        if compiled and self.gains:
            raise ValueError(f"{self.kind} has no gains; set its memory")
        if not compiled and self.memory is not None:
            raise ValueError(f"memory applies only to plain and adaptive; {self.kind} has gains")
        if self.kind != ADAPTIVE and self.unknowns is not None:
            raise ValueError(f"unknowns applies only to adaptive, not to {self.kind}")
        for key in self.machine:
            if key not in ("R", "L", "psi"):
                raise ValueError(f"machine: give factors on R, L, psi; got {key!r}")
        if self.kind == WHOLE_LOG and self.gains:
            raise ValueError(f"{WHOLE_LOG} has no gains")
        if self.file and self.file not in example_names():
            raise ValueError(
                f"file: no shipped machine {self.file!r}{nearest(self.file, example_names())}"
            )
        if not self.name:
            object.__setattr__(self, "name", self.kind)
        return self


Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class GoodTable(Table):
    """Criterion of a good scenario: all given conditions must hold.

    Parameters
    ----------
    rms, worst : float
        Upper limits of the rms and the largest position error on the scored valid rows [°].
    valid : float
        Smallest share of the scored rows that are valid.
    first_valid : float
        Upper limit of the time until the position is first valid [s].
    losses : int
        Largest number of losses of the position in the loop, trips included.
    """

    rms: Positive | None = 2.0
    worst: Positive | None = None
    valid: Share | None = None
    first_valid: Positive | None = None
    losses: Annotated[int, Field(ge=0)] | None = None


class LimitTable(Table):
    """A requirement on the campaign.

    Parameters
    ----------
    good : float
        Smallest share of good scenarios.
    observer, machine : str, optional
        The observer and the machine to which the requirement applies; default all.
    """

    good: Share
    observer: str | None = None
    machine: str | None = None


Observers = Annotated[
    list[Annotated[ObserverTable, BeforeValidator(_as_observer_table)]], Field(min_length=1)
]


class Specification(Table):
    """Definition of a campaign.

    Parameters
    ----------
    name : str
    machines : list of str
        Shipped machines, or machine files (beside or below the file of the specification).
    scenarios : int
        Number of scenarios per machine.
    seed : int
    loop : {"open", "closed"}
        "open": all observers run on the same record of a drive with an encoder. "closed": each
        observer is in the loop of its own drive; all use the same draws.
    sampling : {"random", "sobol"}
        How the points of the unit cube are drawn; the points are combined with the grids.
    drive, course, vary, correlation, observers, good, limits
        See the classes of these tables.
    """

    name: str = "campaign"
    machines: Annotated[list[str], Field(min_length=1)]
    scenarios: Annotated[int, Field(ge=1, le=MOST)]
    seed: Annotated[int, Field(ge=0)] = 0
    loop: Literal["open", "closed"] = "open"
    sampling: Literal["random", "sobol"] = "random"
    drive: DriveTable = DriveTable()
    course: CourseTable = CourseTable()
    vary: dict[str, DistributionField] = {}
    correlation: dict[str, Number] = {}
    observers: Observers
    good: GoodTable = GoodTable()
    limits: list[LimitTable] = []

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise UsageError(complaints(error, type(self).model_fields, "a campaign")) from None

    @model_validator(mode="after")
    def _check_quantities(self) -> Specification:
        vary = {}
        for name, distribution in self.vary.items():
            choices = (*QUANTITIES, *TOGETHER, *PARAMETERS)
            if name not in choices:
                raise ValueError(f"vary: unknown quantity {name!r}{nearest(name, choices)}")
            for quantity in TOGETHER.get(name, (name,)):
                if quantity in vary:
                    raise ValueError(f"vary: {quantity} is given twice")
                lower = QUANTITIES[quantity].least if quantity in QUANTITIES else -np.inf
                if distribution.fixed is not None and not distribution.fixed > lower:
                    raise ValueError(
                        f"vary: {name} = {distribution.fixed:g} is impossible for a drive"
                    )
                vary[quantity] = distribution
        # The angle of the rotor at the start is unknown.
        vary.setdefault("theta_e", Distribution(uniform=[-np.pi, np.pi]))
        # Sorted by name as in the JSON, so that the axes of the unit cube never change.
        object.__setattr__(self, "vary", dict(sorted(vary.items())))
        names = [table.name for table in self.observers]
        if len(set(names)) != len(names):
            raise ValueError(f"observers need different names (name = …), got {names}")
        if len(set(self.machines)) != len(self.machines):
            raise ValueError(f"machines: each machine may be given only once, got {self.machines}")
        if self.loop == "closed":
            if any(table.kind == WHOLE_LOG for table in self.observers):
                raise ValueError(f'{WHOLE_LOG} needs all samples of a log: use loop = "open"')
            if "lost" in self.vary:
                raise ValueError('vary: lost applies only with loop = "open"')
        if "lost" in self.vary:
            for table in self.observers:
                if table.kind not in REPORTED:
                    raise ValueError(f"vary: {table.kind} cannot run with lost samples")
        if self.good.losses is not None and self.loop == "open":
            raise ValueError('good.losses applies only with loop = "closed"')
        return self

    @model_validator(mode="after")
    def _check_limits(self) -> Specification:
        names = [table.name for table in self.observers]
        for limit in self.limits:
            for field, value, choices in (
                ("observer", limit.observer, names),
                ("machine", limit.machine, self.machines),
            ):
                if value is not None and value not in choices:
                    raise ValueError(f"limits: no {field} {value!r}{nearest(value, choices)}")
        return self

    @model_validator(mode="after")
    def _check_even_sampling(self) -> Specification:
        per_place, remainder = divmod(self.scenarios, self.places)
        if remainder:
            lower = per_place * self.places
            raise ValueError(
                f"scenarios = {self.scenarios}: the grid of {', '.join(self.grids)} has "
                f"{self.places} places; "
                f"take {f'{lower} or ' if lower else ''}{lower + self.places}"
            )
        if self.sampling == "sobol" and per_place & (per_place - 1):
            lower = self.places * 2 ** int(np.log2(per_place))
            raise ValueError(
                f"scenarios = {self.scenarios}: Sobol' points need a power of two"
                f"{' at each place of the grid' if self.grids else ''}; take {lower} or {2 * lower}"
            )
        return self

    @property
    def varied(self) -> tuple[str, ...]:
        """Quantities with a continuous draw or a choice; they are the axes of the unit cube."""
        return tuple(
            name
            for name, distribution in self.vary.items()
            if distribution.varies and distribution.grid is None
        )

    @property
    def grids(self) -> tuple[str, ...]:
        """Quantities with a grid."""
        return tuple(
            name for name, distribution in self.vary.items() if distribution.grid is not None
        )

    @property
    def places(self) -> int:
        """Number of combinations of all grids; 1 without a grid."""
        return math.prod(len(self.vary[name].grid or ()) for name in self.grids)

    def observer(self, name: str | None = None) -> ObserverTable:
        """Return the observer with this name (None: the first), or raise UsageError."""
        for table in self.observers:
            if name in (None, table.name):
                return table
        names = [table.name for table in self.observers]
        raise UsageError(f"no observer {name!r}{nearest(str(name), names)}")

    def called(self, machine: str) -> str:
        """Return a machine's name in reports: the stem of its file if unique, else its path."""
        stems = [Path(path).stem for path in self.machines]
        stem = Path(machine).stem
        return stem if machine.endswith(".toml") and stems.count(stem) == 1 else machine

    def canonical(self) -> str:
        """Return the campaign as JSON text; equal campaigns have equal texts."""
        return json.dumps(self.model_dump(mode="json"), sort_keys=True, ensure_ascii=False)


def hashed(text: str) -> str:
    """Return a hash of a text: sixteen hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_specification(path: str | Path) -> Specification:
    """Read a specification from a TOML file; machine files must lie beside or below it.

    Raises
    ------
    FluxobsError
        The file cannot be read or is not TOML; an entry is unknown or impossible; a machine file
        lies elsewhere.
    """
    path = Path(path)
    fields = read_toml(path, FluxobsError)
    machines = fields.get("machines")
    limits = fields.get("limits")
    try:
        if isinstance(machines, list):
            fields["machines"] = [
                _resolve_machine(path.parent, machine, "machines") for machine in machines
            ]
        for limit in limits if isinstance(limits, list) else []:
            if isinstance(limit, dict) and "machine" in limit:
                limit["machine"] = _resolve_machine(
                    path.parent, limit["machine"], "limits: machine"
                )
        return Specification(**fields)
    except FluxobsError as error:
        raise FluxobsError(f"{path}: {error}") from None


def _resolve_machine(folder: Path, machine: Any, field: str) -> Any:
    """Return a shipped machine's name unchanged, and a machine file as an absolute path."""
    if not isinstance(machine, str) or machine in example_names():
        return machine
    return str(beside(folder, machine, field).resolve())


def check(specification: Specification) -> None:
    """Raise FluxobsError for impossible correlations or parameters that a machine lacks."""
    correlator(specification.varied, specification.correlation)
    for name in specification.machines:
        machine = rotating(as_machine(name), "a campaign")
        parameters = [symbol for symbol in PARAMETERS if getattr(machine, symbol, None) is not None]
        for quantity in specification.vary:
            if quantity in PARAMETERS and quantity not in parameters:
                raise UsageError(
                    f"vary: {name} ({machine.kind}) has no {quantity}; it has "
                    f"{', '.join(parameters)}"
                )
