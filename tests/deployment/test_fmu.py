"""Simulation units: the record through FMPy, the files in them, and what is refused."""

import io
import json
import shutil
import subprocess
import sys
import zipfile
from xml.etree import ElementTree

import pytest

import fluxobs
from fluxobs import FluxobsError
from fluxobs.deployment.forms import build
from support.records import MACHINES

fmpy = pytest.importorskip("fmpy")
ADAPTIVE = "drift,resistance,inverter"
STEP = 1e-4


@pytest.fixture(scope="module", params=["drift", ADAPTIVE, "map"])
def units(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu") / "motor"
    machine = "ipm-5kw6" if request.param == "map" else "servo-400w"
    unknowns = ADAPTIVE if request.param == ADAPTIVE else "drift"
    with pytest.MonkeyPatch.context() as patch:  # cross-compilers have a test of their own
        patch.setattr(build, "has_zig", lambda: False)
        fluxobs.export(MACHINES.get(machine, machine), STEP, folder, unknowns=unknowns, form="fmu")
    return folder


def check(folder):
    command = [sys.executable, folder / "test" / "check.py"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_both_units_return_the_numbers_of_the_library(units):
    said = check(units)
    assert said.returncode == 0, said.stdout + said.stderr
    compared = json.loads((units / "certificate.json").read_text())["compared"]
    assert [one["what"][:10] for one in compared] == ["motor.fmi2", "motor.fmi3"]
    assert all(one["rows"] > 1000 and one["different"] == 0 for one in compared)


def test_a_changed_number_shows(units, tmp_path):
    shutil.copytree(units, tmp_path / "motor")
    record = tmp_path / "motor" / "test" / "record.csv"
    lines = record.read_text().splitlines()
    cells = lines[900].split(",")
    cells[7] = repr(float(cells[7]) * (1 + 1e-15))  # theta_e, its last digits
    lines[900] = ",".join(cells)
    record.write_text("\n".join(lines) + "\n")
    said = check(tmp_path / "motor")
    assert said.returncode == 1
    rows = len(lines) - 1
    assert f"{rows - 1} of {rows} rows equal" in said.stdout


def test_each_unit_describes_its_units_and_holds_its_sources(units):
    for version in (2, 3):
        with zipfile.ZipFile(units / f"motor.fmi{version}.fmu") as archive:
            names = archive.namelist()
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        assert {"sources/unit.c", "sources/motor_observer.c", f"sources/fmi{version}.c"} <= {*names}
        assert any(name.startswith("binaries/") for name in names)
        defined = {one.get("name") for one in root.iter("Unit")}
        used = {one.get("unit") for one in root.iter() if one.get("unit")}
        assert {"V", "A", "Wb", "rad", "rad/s"} <= used <= defined
        assert "one communication step later" in root.get("description")
        assert ("sources/buildDescription.xml" in names) == (version == 3)


def test_the_sources_in_the_unit_compile_on_their_own(units, tmp_path):
    with zipfile.ZipFile(units / "motor.fmi3.fmu") as archive:
        archive.extractall(tmp_path)
    sources = sorted((tmp_path / "sources").glob("*.c"))
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-DFO_SINGLE=0", "-fPIC", "-shared"]
    subprocess.run(["gcc", *strict, *sources, "-lm", "-o", tmp_path / "unit.so"], check=True)


def test_what_a_unit_refuses(units):
    """Another step size, another unit's token, a state that is damaged or not its own."""
    from fmpy.fmi3 import FMU3Slave

    path = units / "motor.fmi3.fmu"
    description = fmpy.read_model_description(path)
    folder = fmpy.extract(path)
    said = []

    def unit(token):
        made = FMU3Slave(
            guid=token,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="x",
        )
        made.instantiate(logMessage=fmpy.fmi3.fmi3LogMessageCallback(log))
        return made

    def log(environment, status, category, message):
        said.append(message.decode())

    with pytest.raises(Exception, match=r"[Ii]nstantiate"):
        unit("{0}")
    assert "token" in said[-1]
    one = unit(description.guid)
    one.enterInitializationMode()
    one.exitInitializationMode()
    with pytest.raises(Exception, match="fmi3DoStep"):
        one.doStep(currentCommunicationPoint=0.0, communicationStepSize=2 * STEP)
    assert "steps every 0.0001 s" in said[-1]
    one.doStep(currentCommunicationPoint=0.0, communicationStepSize=STEP)
    kept = bytearray(one.serializeFMUState(one.getFMUState()))
    kept[100] ^= 1
    damaged = one.deserializeFMUState(bytes(kept))
    with pytest.raises(Exception, match="fmi3SetFMUState"):
        one.setFMUState(damaged)
    assert "not one that this unit has saved" in said[-1]
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        one.setFloat64([7], [1.0])
    one.freeInstance()
    shutil.rmtree(folder)


def test_binaries_for_other_systems(tmp_path):
    pytest.importorskip("ziglang")
    for name in ("a", "b"):
        fluxobs.export("servo-400w", STEP, tmp_path / name, form="fmu")
    unit = (tmp_path / "a" / "motor.fmi3.fmu").read_bytes()
    assert unit == (tmp_path / "b" / "motor.fmi3.fmu").read_bytes()
    with zipfile.ZipFile(io.BytesIO(unit)) as archive:
        first = {
            name.split("/")[1]: archive.read(name)[:4]
            for name in archive.namelist()
            if name.startswith("binaries/")
        }
    assert first["x86_64-linux"] == first["aarch64-linux"] == b"\x7fELF"
    assert first["x86_64-windows"][:2] == b"MZ"
    assert first["x86_64-darwin"] == first["aarch64-darwin"] == b"\xcf\xfa\xed\xfe"
    assert check(tmp_path / "a").returncode == 0
    assert "x86_64-windows" in (tmp_path / "a" / "README.md").read_text()


def test_no_compiler_is_told_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(build, "has_zig", lambda: False)
    monkeypatch.setattr(build, "local_compiler", lambda: None)
    with pytest.raises(FluxobsError, match="no C compiler"):
        fluxobs.export("servo-400w", STEP, tmp_path / "motor", form="fmu")
    assert not (tmp_path / "motor").exists()
