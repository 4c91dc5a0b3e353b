"""The Arduino library: its sketches on this computer, its sensor in a simulated SimpleFOC drive."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import fluxobs
from fluxobs import FluxobsError
from support.compiling import compiled
from support.records import MACHINES

STUBS = Path(__file__).parent / "arduino"
ADAPTIVE = "drift,resistance,inverter"
CPP = ["g++", "-std=c++11", "-O1", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]


@pytest.fixture(scope="module", params=["drift", ADAPTIVE], ids=["plain", "adaptive"])
def library(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("arduino") / "motor"
    # priors as after an identification, since both are unidentifiable at constant speed and load
    priors = {"resistance": 0.02, "inverter": 0.05} if request.param == ADAPTIVE else None
    fluxobs.export(
        MACHINES["servo-400w"],
        1e-4,
        folder,
        unknowns=request.param,
        priors=priors,
        form="arduino",
    )
    return folder


def built(library, scratch, *sources):
    """Compile C++ sources or sketches with the library's C sources; return the program."""
    example = library / "examples" / "SelfTest"
    options = ["-std=c99", "-O1", "-ffp-contract=off", f"-I{library}/src"]
    c_sources = [*library.glob("src/*.c"), example / "check.c"]
    objects = [compiled(["gcc"], options, source) for source in c_sources]
    command = [*CPP, f"-I{STUBS}", f"-I{library}/src", f"-I{example}", "-include", "Arduino.h"]
    program = scratch / "program"
    as_cpp = [argument for source in sources for argument in ("-x", "c++", source)]
    subprocess.run([*command, *as_cpp, "-x", "none", *objects, "-lm", "-o", program], check=True)
    return program


def test_the_self_test_replays_the_record(library, tmp_path):
    main = tmp_path / "main.cpp"
    main.write_text("uint32_t now_us = 0;\nSerialPort Serial;\nint main() { setup(); return 0; }\n")
    sketch = library / "examples" / "SelfTest" / "SelfTest.ino"
    program = built(library, tmp_path, sketch, main)
    output = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    assert "Every output is equal bit for bit." in output
    assert re.match(r"(\d+) of \1 rows", output)

    source = library / "src" / "motor_observer.c"
    changed = re.sub(r"(0\.003)(\d*)f, (/\* sample time)", r"0.0031\2f, \3", source.read_text())
    copy = tmp_path / "changed"
    shutil.copytree(library, copy)
    (copy / "src" / "motor_observer.c").write_text(changed)
    output = subprocess.run(
        [built(copy, tmp_path, sketch, main)], capture_output=True, text=True, check=True
    ).stdout
    assert "FAILED" in output


def test_the_simplefoc_sketch_compiles(library, tmp_path):
    sketch = library / "examples" / "SimpleFOC" / "SimpleFOC.ino"
    main = tmp_path / "main.cpp"
    main.write_text("uint32_t now_us = 0;\nSerialPort Serial;\nint main() { setup(); loop(); }\n")
    built(library, tmp_path, sketch, main)


def test_a_simplefoc_drive_closes_its_loop_and_opens_it_again(library, tmp_path):
    program = built(library, tmp_path, STUBS / "drive.cpp")
    output = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    pairs = re.findall(r"([a-z ]+?) (-?[\d.e+-]+)", output)
    report = {name.strip(): float(value) for name, value in pairs}
    assert 0.02 < report["handed over"] < 1.0
    assert 1.8 < report["lost"] < 1.95  # the gates are off
    assert report["closed"] > 0.4
    assert report["worst"] < 0.08  # [rad], while the angle is valid
    assert report["turns"] > 10


def test_metadata_for_arduino_and_platformio(library):
    properties = dict(
        line.split("=", 1) for line in (library / "library.properties").read_text().splitlines()
    )
    assert properties["includes"] == "motor_observer.h"
    assert not {"*", "avr", "megaavr"} & {*properties["architectures"].split(",")}
    manifest = json.loads((library / "library.json").read_text())
    assert manifest["version"] == properties["version"] == fluxobs.__version__
    assert not {"*", "atmelavr", "atmelmegaavr"} & {*manifest["platforms"]}
    for header in manifest["headers"]:
        assert (library / "src" / header).exists()
    assert re.fullmatch(r"[\w .-]+", properties["name"])


def test_steps_every_few_interrupts_are_refused(tmp_path):
    with pytest.raises(FluxobsError, match="update_every 4"):
        fluxobs.export(
            "servo-400w", 5e-5, tmp_path / "x", update_every=4, form="arduino", unknowns="drift"
        )
    with pytest.raises(FluxobsError, match="choose one of c, arduino"):
        fluxobs.export("servo-400w", 5e-5, tmp_path / "x", form="sketch", unknowns="drift")


@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="no cross compiler: avr-gcc")
def test_the_self_test_refuses_an_avr_with_a_reason(library):
    """The observer compiles for an AVR; the record does not fit."""
    example = library / "examples" / "SelfTest"
    command = ["avr-gcc", "-mmcu=atmega2560", "-std=c99", f"-I{library}/src", "-fsyntax-only"]
    sources = [library / "src" / "fluxobs.c", library / "src" / "motor_observer.c"]
    subprocess.run([*command, *sources], check=True, capture_output=True)
    done = subprocess.run(
        [*command, example / "check.c"], capture_output=True, text=True, check=False
    )
    assert "larger than an array can be on an AVR" in done.stderr.split("error:")[1]
    assert "too slow" in (library / "README.md").read_text()
