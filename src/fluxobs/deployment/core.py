"""Contents common to all forms of an export: sources, parameters, a record and its estimates."""

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
#: Sources needed only for a machine with a flux map.
MAP_SOURCES = ("fluxobs_map.h", "fluxobs_map.c")
ADAPTIVE_SOURCES = (
    *SOURCES,
    *(
        f"fluxobs_{name}.{kind}"
        for name in ("adaptive", "learning", "relation", "candidates", "triangle")
        for kind in ("h", "c")
    ),
    "fluxobs_fast.c",
)
#: Sources for use at run time: configuration, seeds, changed parameters, snapshots over a power
#: cycle, injection at rest.
RUNTIME_SOURCES = (
    "fluxobs_observers.h",
    *(
        f"fluxobs_{name}.{kind}"
        for name in ("config", "seed", "retune", "keep", "inject")
        for kind in ("h", "c")
    ),
    "fluxobs.hpp",
)
#: Set to 0 if an export contains only the plain observer.
ADAPTIVE = "#define FO_ADAPTIVE 1"
#: Set to 0 if the asymmetry is not an unknown, to save memory and time; no number changes.
ASYMMETRIC = "#define FO_ASYMMETRIC 1"
#: To save memory and time, changed if the machine's matrices are multiples of the identity, or if
#: no voltage is held.
ISOTROPIC, HELD = "#define FO_ISOTROPIC 0", "#define FO_HELD 1"
#: Set to 0 if the machine needs no flux map, to save memory and time.
MAPPED = "#define FO_MAPPED 1"
#: Set to 1 so that the sources themselves choose single precision, because build systems such as
#: the Arduino IDE have no compiler options for a library.
DOUBLE = "#define FO_SINGLE 0"


@dataclass(frozen=True)
class Core:
    """Observer of one machine in C, with a record and the library's estimates for it.

    Attributes
    ----------
    prefix : str
        Prefix of the generated names.
    machine : RotatingMachine
    observers : mapping of precision to observer
    update_every : int
        Interrupts per step of the observer.
    version : str
        Version of the library.
    sources, runtime, parameters : dict of str
        Texts of C files, by file name: sources common to all machines, sources for firmware only,
        and the parameters of this machine.
    licence : str
    content : str
        Hash of sources and parameters.
    record : FirmwareRecord
    estimates : mapping of precision to Estimate
        Expected outputs for the record.
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
        """The observer in single precision, as firmware runs it."""
        return self.observers["single"]

    @property
    def plain(self) -> LeastSquaresObserver:
        """The plain observer, which may be inside the adaptive observer."""
        return plain(self.single)

    @property
    def adaptive(self) -> bool:
        """Whether the observer is adaptive."""
        return isinstance(self.single, AdaptiveObserver)

    @property
    def code(self) -> dict[str, str]:
        """Texts of sources and parameters in C, by file name."""
        return joined(self.sources, self.parameters)


def in_double(core: Core) -> Core:
    """Return a core whose sources choose double precision without a compiler option.

    A host's build may not support compiler definitions; FMI 2.0 has no place for them.
    """
    sources = dict(core.sources)
    name, text = "fluxobs_real.h", sources["fluxobs_real.h"]
    single = f"{DOUBLE[:-1]}1"
    assert text.count(single) == 1
    return replace(core, sources=sources | {name: text.replace(single, DOUBLE)})


def make_core(
    prefix: str,
    machine: RotatingMachine,
    observers: Mapping[Precision, Exported],
    update_every: int,
) -> Core:
    """Read the sources, generate the parameters, and run the record.

    Raises
    ------
    FluxobsError
        The position never becomes valid with these settings.
    """
    version = metadata.version("fluxobs")
    installed = resources.files("fluxobs") / "firmware"
    single = observers["single"]
    adaptive = isinstance(single, AdaptiveObserver)
    inner = plain(single)
    mapped = inner.flux_map is not None
    names = (ADAPTIVE_SOURCES if adaptive else SOURCES) + (MAP_SOURCES if mapped else ())
    sources = {name: (installed / name).read_text(encoding="utf-8") for name in names}
    _define(sources, DOUBLE, 1)
    if isinstance(single, AdaptiveObserver) and not single.asymmetry_std > 0:
        _define(sources, ASYMMETRIC, 0)
    if not adaptive:
        _define(sources, ADAPTIVE, 0)
    if not mapped:
        _define(sources, MAPPED, 0)
    if isotropic(inner):
        _define(sources, ISOTROPIC, 1)
    if not inner.held:
        _define(sources, HELD, 0)
    runtime = {name: (installed / name).read_text(encoding="utf-8") for name in RUNTIME_SOURCES}
    texts = tuple(sources.values())
    content, parameters = parameter_files(prefix, observers, machine, version, texts, update_every)
    record = firmware_record(machine, inner, _voltage_uncertainty(single, machine))
    estimates = {p: run(observer, record, update_every) for p, observer in observers.items()}
    if not estimates["single"].valid.any():
        raise FluxobsError(
            f"the position never becomes valid with these settings, not even at full speed: memory "
            f"{inner.memory:g} s, current noise {inner.current_noise:g} A, drift prior "
            f"{inner.drift_prior:g} V; check the units of R_s, inductance and rated_current"
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
        parameters,
        licence,
        content,
        record,
        estimates,
    )


def _define(sources: dict[str, str], line: str, value: int) -> None:
    """Replace the value in a line ``#define NAME value`` of fluxobs_real.h."""
    text = sources["fluxobs_real.h"]
    assert text.count(line) == 1
    sources["fluxobs_real.h"] = text.replace(line, f"{line[:-1]}{value}")


def _voltage_uncertainty(observer: Exported, machine: RotatingMachine) -> float:
    """Return the voltage uncertainty from resistance and inverter at the rated current [V]."""
    if not isinstance(observer, AdaptiveObserver):
        return 0.0
    resistance = observer.resistance_std * (machine.rated_current or 0.0)
    return math.hypot(resistance, 2 * observer.inverter_std)
