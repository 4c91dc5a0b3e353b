"""What every form of an export carries: sources, parameters, one record and what it gives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import metadata, resources

from ..errors import FluxobsError
from ..machines import RotatingMachine
from ..observers import AdaptiveObserver, Estimate, LeastSquaresObserver
from ..simulation.closed_form.firmware_record import FirmwareRecord, firmware_record
from .c_source import Precision
from .folder import joined
from .header import Exported, isotropic, parameter_files, plain
from .vectors import run

SOURCES = ("fluxobs_real.h", "fluxobs.h", "fluxobs_internal.h", "fluxobs_algebra.h", "fluxobs.c")
#: Needed only by a machine with a flux map.
MAP_SOURCES = ("fluxobs_map.h", "fluxobs_map.c")
ADAPTIVE_SOURCES = (
    *SOURCES,
    *(
        f"fluxobs_{part}.{kind}"
        for part in ("adaptive", "learning", "candidates", "triangle")
        for kind in ("h", "c")
    ),
)
#: What a firmware may use at run time: configuration, seeds, changes, what outlives a power cycle.
RUNTIME_SOURCES = (
    *(
        f"fluxobs_{part}.{kind}"
        for part in ("config", "seed", "retune", "keep")
        for kind in ("h", "c")
    ),
    "fluxobs.hpp",
)
#: What an export changes if the plain observer is alone.
ADAPTIVE = "#define FO_ADAPTIVE 1"
#: What an export changes in the sources if the asymmetry is not an unknown: it saves memory and
#: time, and changes no number.
ASYMMETRIC = "#define FO_ASYMMETRIC 1"
#: What it changes for a machine whose matrices are numbers times the identity, and where no voltage
#: is held, for the same reasons.
ISOTROPIC, HELD = "#define FO_ISOTROPIC 0", "#define FO_HELD 1"
#: What it changes if the machine needs no flux map, for the same reasons.
MAPPED = "#define FO_MAPPED 1"
#: What it changes so that the folder itself chooses single precision: build systems such as the
#: Arduino IDE have no options for a library.
DOUBLE = "#define FO_SINGLE 0"


@dataclass(frozen=True)
class Core:
    """The observer of one machine in C, with a record and what the library returns for it.

    Attributes
    ----------
    prefix : str
        Prefix of the generated names.
    machine : RotatingMachine
    observers : mapping of precision to observer
    update_every : int
        Interrupts from one step of the observer to the next.
    version : str
        Of the library.
    sources, runtime, parameters : dict of str
        C, file name → text: the same for every machine, what only firmware needs, and this
        machine's.
    licence : str
    content : str
        Hash of sources and parameters.
    record : FirmwareRecord
    estimates : mapping of precision to Estimate
        For the record.
    """

    prefix: str
    machine: RotatingMachine
    observers: Mapping[Precision, Exported]
    update_every: int
    version: str
    sources: dict[str, str]
    runtime: dict[str, str]
    parameters: dict[str, str]
    licence: str
    content: str
    record: FirmwareRecord
    estimates: Mapping[Precision, Estimate]

    @property
    def single(self) -> Exported:
        """The observer as firmware runs it."""
        return self.observers["single"]

    @property
    def plain(self) -> LeastSquaresObserver:
        """The plain observer, or the one inside the adaptive observer."""
        return plain(self.single)

    @property
    def adaptive(self) -> bool:
        """Whether it is the adaptive observer."""
        return isinstance(self.single, AdaptiveObserver)

    @property
    def code(self) -> dict[str, str]:
        """All of C: file name → text."""
        return joined(self.sources, self.parameters)


def in_double(core: Core) -> Core:
    """The same with sources that are double precision without any option of the compiler.

    For a host whose build may know no definitions: FMI 2.0 has no place for them.
    """
    sources = dict(core.sources)
    name, text = "fluxobs_real.h", sources["fluxobs_real.h"]
    chosen = f"{DOUBLE[:-1]}1"
    assert text.count(chosen) == 1
    return replace(core, sources=sources | {name: text.replace(chosen, DOUBLE)})


def make_core(
    prefix: str,
    machine: RotatingMachine,
    observers: Mapping[Precision, Exported],
    update_every: int,
) -> Core:
    """Take the sources, write the parameters, and run the record.

    Raises
    ------
    FluxobsError
        With these settings the position is never known.
    """
    version = metadata.version("fluxobs")
    installed = resources.files("fluxobs") / "firmware"
    single = observers["single"]
    adaptive = isinstance(single, AdaptiveObserver)
    inside = plain(single)
    mapped = inside.flux_map is not None
    names = (ADAPTIVE_SOURCES if adaptive else SOURCES) + (MAP_SOURCES if mapped else ())
    sources = {name: (installed / name).read_text(encoding="utf-8") for name in names}
    _choose(sources, DOUBLE, 1)
    if isinstance(single, AdaptiveObserver) and not single.asymmetry_std > 0:
        _choose(sources, ASYMMETRIC, 0)
    if not adaptive:
        _choose(sources, ADAPTIVE, 0)
    if not mapped:
        _choose(sources, MAPPED, 0)
    if isotropic(inside):
        _choose(sources, ISOTROPIC, 1)
    if not inside.held:
        _choose(sources, HELD, 0)
    runtime = {name: (installed / name).read_text(encoding="utf-8") for name in RUNTIME_SOURCES}
    texts = tuple(sources.values())
    content, made = parameter_files(prefix, observers, machine, version, texts, update_every)
    record = firmware_record(machine, inside, _unsure(single, machine))
    estimates = {p: run(observer, record, update_every) for p, observer in observers.items()}
    if not estimates["single"].valid.any():
        raise FluxobsError(
            f"with these settings the position is never known, not even at full speed: memory "
            f"{inside.memory:g} s, current noise {inside.current_noise:g} A, drift prior "
            f"{inside.drift_prior:g} V; check the units of R_s, inductance and rated_current"
        )
    licence = (installed / "LICENSE").read_text(encoding="utf-8")
    return Core(
        prefix,
        machine,
        observers,
        update_every,
        version,
        sources,
        runtime,
        made,
        licence,
        content,
        record,
        estimates,
    )


def _choose(sources: dict[str, str], line: str, value: int) -> None:
    """Replace the value in a line ``#define NAME value`` of fluxobs_real.h."""
    text = sources["fluxobs_real.h"]
    assert text.count(line) == 1
    sources["fluxobs_real.h"] = text.replace(line, f"{line[:-1]}{value}")


def _unsure(observer: Exported, machine: RotatingMachine) -> float:
    """Voltage by which resistance and inverter may be off at the rated current [V]."""
    if not isinstance(observer, AdaptiveObserver):
        return 0.0
    resistance = observer.resistance_std * (machine.rated_current or 0.0)
    return math.hypot(resistance, 2 * observer.inverter_std)
