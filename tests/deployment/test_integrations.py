"""Examples for other firmwares, compiled for a Cortex-M4F and run in a simulated drive."""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import fluxobs
from support.compiling import compiled
from support.records import MACHINES

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "firmware"
HARNESSES = Path(__file__).parent / "integrations"
WARNINGS = ["-Wall", "-Wextra", "-Werror"]


@dataclass(frozen=True)
class Host:
    """A firmware with one of its configurations."""

    name: str
    sample_time: float
    defines: tuple[str, ...] = ()

    @property
    def shims(self) -> list[Path]:
        return sorted((EXAMPLES / self.name).glob("*_fluxobs.c*"))

    @property
    def harness(self) -> Path:
        return next(HARNESSES.glob(f"{self.name}.c*"))

    def __str__(self) -> str:
        return "-".join((self.name, *self.defines))


HOSTS = [
    Host("vesc", 1e-4),
    Host("vesc", 1e-4, ("HW_HAS_PHASE_SHUNTS",)),  # V0_V7
    Host("odrive", 1.25e-4),
    Host("moteus", 1 / 30000),
    Host("moteus", 1 / 30000, ("FLUXOBS_ACTS_AFTER=0.5f",)),
    Host("mesc", 5e-5),
    Host("mcsdk", 1e-4),
    Host("zephyr", 1e-4),
    Host("zephyr", 1e-4, ("ACTS_AFTER=1.0f",)),
]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Return the exported folder for a sample time; each is exported once."""
    folders: dict[tuple[float, bool], Path] = {}

    def folder(sample_time: float, adaptive: bool = False) -> Path:
        key = (sample_time, adaptive)
        if key not in folders:
            folders[key] = tmp_path_factory.mktemp("exports") / "motor"
            # priors as after an identification, since both are unidentifiable at constant speed and
            # load
            options: dict[str, Any] = {
                "unknowns": "drift,resistance,inverter",
                "priors": {"resistance": 0.02, "inverter": 0.05},
            }
            machine = MACHINES["servo-400w"]
            fluxobs.export(
                machine,
                sample_time,
                folders[key],
                **(options if adaptive else {"unknowns": "drift"}),
            )
        return folders[key]

    return folder


def as_adaptive(source):
    """Return a shim for the adaptive observer, changed as the shim's first lines instruct."""
    source = re.sub(r"\bfo_(state|estimate|reset|step)\b", r"fo_adaptive_\1", source)
    source = re.sub(r"\bestimate\.", "estimate.position.", source)
    return source.replace("motor_observer.sample_time", "motor_observer.plain.sample_time")


def compile_object(source, out, folder, compilers, flags):
    """Compile a C or C++ source to an object file."""
    c, cpp = compilers
    compiler = [cpp, "-std=c++17"] if source.suffix == ".cpp" else [c, "-std=c99"]
    includes = [f"-I{folder}", *(f"-I{path}" for path in EXAMPLES.iterdir()), f"-I{HARNESSES}"]
    shutil.copyfile(compiled(compiler, [*flags, *includes], source), out)
    return out


def has_header(compiler, name):
    """Whether the C++ library of this compiler has a header."""
    command = [compiler, "-std=c++17", "-fsyntax-only", "-x", "c++", "-"]
    done = subprocess.run(
        command, input=f"#include <{name}>\n", text=True, stderr=subprocess.DEVNULL
    )
    return done.returncode == 0


@pytest.mark.parametrize("host", HOSTS, ids=str)
def test_it_compiles_for_a_cortex_m4f(host, exported, tmp_path):
    compilers = ("arm-none-eabi-gcc", "arm-none-eabi-g++")
    for compiler in compilers:
        if not shutil.which(compiler):
            pytest.skip(f"no cross compiler: {compiler}")
    if host.name == "odrive" and not has_header(compilers[1], "optional"):
        pytest.skip("no cross compiler: libstdc++-arm-none-eabi-newlib")
    cpu = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
    flags = [*cpu, "-O2", *WARNINGS, *(f"-D{define}" for define in host.defines)]
    folder = exported(host.sample_time)
    shims = host.shims
    if not shims:  # the shim is a header
        shims = [tmp_path / "shim.cpp"]
        shims[0].write_text(f'#include "{host.name}_fluxobs.h"\n{host.name}::Fluxobs fluxobs;\n')
    for source in (*shims, *folder.glob("f*.c"), folder / "motor_observer.c"):
        compile_object(source, tmp_path / f"{source.stem}.o", folder, compilers, flags)


@pytest.fixture(scope="module")
def drive(exported, tmp_path_factory):
    """Return a function that runs a host's drive and returns the values of the report, by name."""
    programs: dict[tuple[Host, bool], Path] = {}

    def program(host: Host, adaptive: bool) -> Path:
        scratch = tmp_path_factory.mktemp("drive")
        folder = exported(host.sample_time, adaptive)
        flags = ["-O1", *WARNINGS, *(f"-D{define}" for define in host.defines)]
        shims = host.shims
        if adaptive:
            for path in (EXAMPLES / host.name).glob("*_fluxobs.*"):
                (scratch / path.name).write_text(as_adaptive(path.read_text()))
            shims = [scratch / path.name for path in shims]
            flags.append(f"-I{scratch}")
        sources = [*folder.glob("f*.c"), folder / "motor_observer.c", *shims, host.harness]
        objects = [
            compile_object(source, scratch / f"{n}.o", folder, ("gcc", "g++"), flags)
            for n, source in enumerate(sources)
        ]
        subprocess.run(["g++", *objects, "-lm", "-o", scratch / "program"], check=True)
        return scratch / "program"

    def run(
        host: Host, direction: int, fault: str = "", adaptive: bool = False
    ) -> dict[str, float]:
        key = (host, adaptive)
        if key not in programs:
            programs[key] = program(*key)
        command = [programs[key], str(direction), fault]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        words = done.stdout.split()
        print(host, direction, fault, adaptive, *words)
        return {name: float(value) for name, value in zip(words[::2], words[1::2], strict=True)}

    return run


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("host", HOSTS, ids=str)
def test_the_host_gets_the_true_angle_and_speed(host, direction, drive):
    """The host gets its own units, signs and timing, and never trusts the angle with gates off."""
    report = drive(host, direction)
    assert report["trusted"] == 1.0  # share of the last tenth of the run
    assert report["off"] == 0  # samples trusted with the gates off
    assert abs(report["mean"]) < 0.1  # degrees
    assert report["rms"] < 0.2
    assert report["worst"] < 3.0  # degrees, from the first trusted sample on
    assert report["speed"] < 0.01  # relative to the speed


@pytest.mark.slow
@pytest.mark.parametrize("host", HOSTS, ids=str)
def test_the_adaptive_observer_in_a_changed_shim(host, drive):
    report = drive(host, 1, adaptive=True)
    assert report["trusted"] == 1.0
    assert report["off"] == 0
    assert report["rms"] < 0.2
    assert report["speed"] < 0.01


@pytest.mark.parametrize("fault", ["later", "reversed", "swapped"])
@pytest.mark.parametrize("host", HOSTS, ids=str)
def test_a_wrong_delay_or_sign_is_detected(host, fault, drive):
    """A delay of half a period turns the voltage by 2.3 degrees."""
    report = drive(host, 1, fault)
    assert report["trusted"] < 1.0 or abs(report["mean"]) > 1.0
