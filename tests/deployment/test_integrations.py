"""The examples for other firmwares: compiled for a Cortex-M4F, and run in a simulated drive."""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import fluxobs
from support.records import MACHINES

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "firmware"
HARNESSES = Path(__file__).parent / "integrations"
WARNINGS = ["-Wall", "-Wextra", "-Werror"]


@dataclass(frozen=True)
class Host:
    """A firmware, or a way in which it may be set up."""

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
    """The exported folder of a sample time: made once."""
    made: dict[tuple[float, bool], Path] = {}

    def folder(sample_time: float, adaptive: bool = False) -> Path:
        key = (sample_time, adaptive)
        if key not in made:
            made[key] = tmp_path_factory.mktemp("exports") / "motor"
            # as after an identification: at constant speed and load nothing tells them
            options: dict[str, Any] = {
                "unknowns": "drift,resistance,inverter",
                "priors": {"resistance": 0.02, "inverter": 0.05},
            }
            machine = MACHINES["servo-400w"]
            fluxobs.export(machine, sample_time, made[key], **(options if adaptive else {}))
        return made[key]

    return folder


def as_adaptive(source):
    """A shim changed as its first lines say."""
    source = re.sub(r"\bfo_(state|estimate|reset|step)\b", r"fo_adaptive_\1", source)
    source = re.sub(r"\bestimate\.", "estimate.position.", source)
    return source.replace("motor_observer.sample_time", "motor_observer.plain.sample_time")


def compile_object(source, out, folder, compilers, flags):
    """One object of a C or C++ source."""
    c, cpp = compilers
    chosen = [cpp, "-std=c++17"] if source.suffix == ".cpp" else [c, "-std=c99"]
    includes = [f"-I{folder}", *(f"-I{path}" for path in EXAMPLES.iterdir()), f"-I{HARNESSES}"]
    subprocess.run([*chosen, *flags, *includes, "-c", source, "-o", out], check=True)
    return out


def has_header(compiler, name):
    """Whether this compiler has a header of the C++ library."""
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
    flags = [*cpu, "-O2", *WARNINGS, *(f"-D{word}" for word in host.defines)]
    folder = exported(host.sample_time)
    shims = host.shims
    if not shims:  # a header
        shims = [tmp_path / "shim.cpp"]
        shims[0].write_text(f'#include "{host.name}_fluxobs.h"\n{host.name}::Fluxobs fluxobs;\n')
    for source in (*shims, *folder.glob("f*.c"), folder / "motor_observer.c"):
        compile_object(source, tmp_path / f"{source.stem}.o", folder, compilers, flags)


@pytest.fixture(scope="module")
def drive(exported, tmp_path_factory):
    """Runs a host's drive: what its report says, by name."""
    programs: dict[tuple[Host, bool], Path] = {}

    def program(host: Host, adaptive: bool) -> Path:
        scratch = tmp_path_factory.mktemp("drive")
        folder = exported(host.sample_time, adaptive)
        flags = ["-O1", *WARNINGS, *(f"-D{word}" for word in host.defines)]
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
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        print(host, direction, fault, adaptive, *said)
        return {name: float(value) for name, value in zip(said[::2], said[1::2], strict=True)}

    return run


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("host", HOSTS, ids=str)
def test_the_host_gets_the_true_angle_and_speed(host, direction, drive):
    """In its own units, signs and timing; and never while its gates are off."""
    found = drive(host, direction)
    assert found["trusted"] == 1.0  # of the last tenth of the run
    assert found["off"] == 0  # samples trusted with the gates off
    assert abs(found["mean"]) < 0.1  # degrees
    assert found["rms"] < 0.2
    assert found["worst"] < 3.0  # from the first sample that is trusted on
    assert found["speed"] < 0.01  # of the speed


@pytest.mark.slow
@pytest.mark.parametrize("host", HOSTS, ids=str)
def test_the_adaptive_observer_as_the_first_lines_say(host, drive):
    found = drive(host, 1, adaptive=True)
    assert found["trusted"] == 1.0
    assert found["off"] == 0
    assert found["rms"] < 0.2
    assert found["speed"] < 0.01


@pytest.mark.parametrize("fault", ["later", "reversed", "swapped"])
@pytest.mark.parametrize("host", HOSTS, ids=str)
def test_a_wrong_delay_or_sign_would_be_found(host, fault, drive):
    """Half a period later, which turns the voltage by 2.3 degrees; a current with a wrong sign."""
    found = drive(host, 1, fault)
    assert found["trusted"] < 1.0 or abs(found["mean"]) > 1.0
