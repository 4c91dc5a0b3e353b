"""Units for co-simulation, FMI 3.0 and 2.0: sources, and binaries for common systems.

The standards are at https://fmi-standard.org, versions 3.0 and 2.0.4.
"""

from __future__ import annotations

import importlib.util
import io
import sys
import uuid
import zipfile
from collections.abc import Mapping
from xml.etree import ElementTree

from ...errors import FluxobsError
from ..certificate import certificate
from ..core import Core, in_double
from ..folder import joined
from ..templating import fill
from ..variables import (
    INPUTS,
    Variable,
    c_values,
    check_every_step,
    output_variables,
    record_csv,
)
from . import build

#: Target of zig and suffix of the library, by the folder of the binary in FMI 3.0 and FMI 2.0.
TARGETS = {
    ("x86_64-linux", "linux64"): ("x86_64-linux-gnu.2.17", ".so"),
    ("aarch64-linux", None): ("aarch64-linux-gnu.2.17", ".so"),
    ("x86_64-windows", "win64"): ("x86_64-windows-gnu", ".dll"),
    ("x86_64-darwin", "darwin64"): ("x86_64-macos", ".dylib"),
    ("aarch64-darwin", None): ("aarch64-macos", ".dylib"),
}
#: Each unit as a product of the base units of FMI.
UNITS = {
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
    "A": {"A": 1},
    "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
    "ohm": {"kg": 1, "m": 2, "s": -3, "A": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
}
UNIT_SOURCES = ("unit.h", "unit.c")
#: The oldest date that a zip file allows; constant, so that the same call writes the same bytes.
DATE = (1980, 1, 1, 0, 0, 0)


def files(core: Core) -> dict[str, str | bytes]:
    """Return the contents of the files, by relative path.

    Raises
    ------
    FluxobsError
        The observer steps only every few interrupts, or a compiler fails.
    """
    check_every_step(core, "a simulation unit")
    if not build.has_zig() and not build.local_compiler():
        raise FluxobsError(
            "no C compiler for the binaries: run `pip install ziglang`, which compiles for Linux, "
            "Windows and macOS"
        )
    core = in_double(core)
    identifier = f"fluxobs_{core.prefix}"
    units: dict[str, bytes] = {}
    built: set[str] = set()
    for version in (3, 2):
        sources = _sources(core, version)
        binaries = _binaries(identifier, sources, version)
        built |= binaries.keys()
        units[f"{core.prefix}.fmi{version}.fmu"] = _packed(
            joined(
                {"modelDescription.xml": _description(core, identifier, version, sources)},
                _described_sources(identifier, sources, version),
                binaries,
                {
                    "resources/certificate.json": certificate(
                        core, "fmu", "see the export's README"
                    ),
                    "documentation/index.html": _page(core),
                },
            )
        )
    placeholders = {
        "identifier": identifier,
        "binaries": ", ".join(sorted(_systems(built))) or "none",
    }
    tests = {
        "test/record.csv": record_csv(core),
        "test/check.py": fill(core, "fmu/check.py", placeholders),
    }
    command = [sys.executable, "test/check.py", "--json"]
    installed = importlib.util.find_spec("fmpy") is not None
    compared = build.compared(joined(units, tests), command) if installed else []
    check = "python test/check.py (needs PyPI's fmpy) replays the record with both units"
    about = {
        "README.md": fill(core, "fmu/README.md", placeholders),
        "LICENSE": core.licence,
        "certificate.json": certificate(core, "fmu", check, compared),
    }
    return joined(units, tests, about)


def _systems(paths: set[str]) -> set[str]:
    names = {fmi2: fmi3 for fmi3, fmi2 in TARGETS}
    folders = [path.split("/")[1] for path in paths]
    return {names.get(folder, folder) or folder for folder in folders}


def _token(core: Core) -> str:
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, f"fluxobs:{core.content}")) + "}"


def _sources(core: Core, version: int) -> dict[str, str]:
    """Return all C files of a unit."""
    variables = output_variables(core)
    values = c_values(core, "double")
    placeholders = {"outputs": str(len(variables)), "values": values, "token": _token(core)}
    names = (*UNIT_SOURCES, f"fmi{version}.c")
    return joined(core.code, {name: fill(core, f"fmu/{name}", placeholders) for name in names})


def _binaries(identifier: str, sources: Mapping[str, str], version: int) -> dict[str, bytes]:
    """Return the library for each system with a compiler here, by its path within the unit."""
    binaries = {}
    here = "-".join(build.host())
    for (fmi3_name, fmi2_name), (target, suffix) in TARGETS.items():
        folder = fmi3_name if version == 3 else fmi2_name
        if folder is None:
            continue
        if build.has_zig():
            compiler = build.zig(target)
        elif fmi3_name == here and (local := build.local_compiler()):
            compiler = [*local, "-fPIC"]
        else:
            continue
        libraries = [] if "windows" in target else ["-lm"]
        library = build.compile_shared(compiler, sources, libraries)
        binaries[f"binaries/{folder}/{identifier}{suffix}"] = library
    return binaries


def _described_sources(identifier: str, sources: Mapping[str, str], version: int) -> dict[str, str]:
    """Return the sources of the unit; FMI 3.0 requires a build description."""
    packed = {f"sources/{name}": text for name, text in sources.items()}
    if version == 2:
        return packed
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    group = ElementTree.SubElement(
        configuration, "SourceFileSet", language="C99", compilerOptions="-ffp-contract=off"
    )
    for name in sorted(sources):
        if name.endswith(".c"):
            ElementTree.SubElement(group, "SourceFile", name=name)
    ElementTree.SubElement(group, "PreprocessorDefinition", name="FO_SINGLE", value="0")
    ElementTree.SubElement(configuration, "Library", name="m", external="true")
    return packed | {"sources/buildDescription.xml": _text(root)}


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, "unicode") + "\n"


def _description(core: Core, identifier: str, version: int, sources: Mapping[str, str]) -> str:
    """Return the text of modelDescription.xml."""
    token = "instantiationToken" if version == 3 else "guid"
    root = ElementTree.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": f"fluxobs observer for {core.prefix}",
            token: _token(core),
            "description": f"Flux, position and speed of an electrical machine; content "
            f"{core.content}. A step uses the voltage of the last interval and the current at the "
            f"end of that interval. Outputs belong to the instant at which the inputs were set "
            f"and are read one communication step later.",
            "generationTool": f"fluxobs {core.version}",
            "license": "MIT",
            "variableNamingConvention": "flat",
        }
        | ({"numberOfEventIndicators": "0"} if version == 2 else {}),
    )
    period = repr(core.plain.sample_time)
    state = "FMUState" if version == 3 else "FMUstate"
    simulation = ElementTree.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": identifier,
            "canHandleVariableCommunicationStepSize": "false",
            f"canGetAndSet{state}": "true",
            f"canSerialize{state}": "true",
        }
        | ({"fixedInternalStepSize": period} if version == 3 else {}),
    )
    if version == 2:
        listed = ElementTree.SubElement(simulation, "SourceFiles")
        for name in sorted(sources):
            if name.endswith(".c"):
                ElementTree.SubElement(listed, "File", name=name)
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in ("s", *UNITS):
        element = ElementTree.SubElement(units, "Unit", name=unit)
        base = {name: str(power) for name, power in UNITS.get(unit, {"s": 1}).items()}
        ElementTree.SubElement(element, "BaseUnit", base)
    ElementTree.SubElement(root, "DefaultExperiment", stepSize=period)
    variables = ElementTree.SubElement(root, "ModelVariables")
    outputs = output_variables(core)
    structure = ElementTree.SubElement(root, "ModelStructure")
    numbers = [str(number) for number, _ in enumerate(outputs, 1 + len(INPUTS))]
    if version == 3:
        clock = {"name": "time", "valueReference": "0", "causality": "independent"}
        ElementTree.SubElement(
            variables, "Float64", clock | {"variability": "continuous", "unit": "s"}
        )
        for number, variable in enumerate((*INPUTS, *outputs), 1):
            kind = "Boolean" if variable.boolean else "Float64"
            ElementTree.SubElement(variables, kind, _attributes(variable, number, version))
        for kind in ("Output", "InitialUnknown"):
            for n in numbers:
                ElementTree.SubElement(structure, kind, valueReference=n, dependencies="")
    else:
        for number, variable in enumerate((*INPUTS, *outputs), 1):
            attributes = _attributes(variable, number, version)
            inner: dict[str, str] = {
                key: attributes.pop(key) for key in ("start", "unit") if key in attributes
            }
            element = ElementTree.SubElement(variables, "ScalarVariable", attributes)
            ElementTree.SubElement(element, "Boolean" if variable.boolean else "Real", inner)
        for kind in ("Outputs", "InitialUnknowns"):
            listed = ElementTree.SubElement(structure, kind)
            for n in numbers:
                ElementTree.SubElement(listed, "Unknown", index=n, dependencies="")
    return _text(root)


def _attributes(variable: Variable, number: int, version: int) -> dict[str, str]:
    is_input = not variable.member
    attributes = {"name": variable.name, "valueReference": str(number)}
    attributes["description"] = variable.about
    attributes["causality"] = "input" if is_input else "output"
    attributes["variability"] = "discrete"
    if is_input:
        attributes["start"] = "0"
    elif version == 2:
        attributes["initial"] = "calculated"
    if variable.unit:
        attributes["unit"] = variable.unit
    return attributes


def _packed(content: Mapping[str, str | bytes]) -> bytes:
    """Return a zip file, with the same bytes for the same content."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            entry = zipfile.ZipInfo(name, DATE)
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def _page(core: Core) -> str:
    return (
        f"<!DOCTYPE html><title>fluxobs: {core.prefix}</title><p>Observer of flux, position and "
        f"speed, content {core.content}. modelDescription.xml describes inputs and outputs; "
        f"certificate.json beside the unit lists the comparisons made.</p>\n"
    )
