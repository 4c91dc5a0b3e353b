"""Simulation units: a record replayed by FMPy, the units' files, and refused calls."""

import io
import json
import shutil
import subprocess
import sys
import zipfile
from ctypes import byref
from xml.etree import ElementTree

import pytest

import fluxobs
from fluxobs import FluxobsError
from fluxobs.deployment.forms import build
from support.compiling import build_program
from support.records import MACHINES

fmpy = pytest.importorskip("fmpy")
fmi2 = pytest.importorskip("fmpy.fmi2")
fmi3 = pytest.importorskip("fmpy.fmi3")
addLoggerProxy = pytest.importorskip("fmpy.logging").addLoggerProxy
ADAPTIVE = "drift,resistance,inverter"
STEP = 1e-4


@pytest.fixture(
    scope="module",
    params=[ADAPTIVE, *(pytest.param(u, marks=pytest.mark.slow) for u in ("drift", "map"))],
)
def units(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu") / "motor"
    machine = "ipm-5kw6" if request.param == "map" else "servo-400w"
    unknowns = ADAPTIVE if request.param == ADAPTIVE else "drift"
    with pytest.MonkeyPatch.context() as patch:  # another test covers cross-compilers
        patch.setattr(build, "has_zig", lambda: False)
        fluxobs.export(MACHINES.get(machine, machine), STEP, folder, unknowns=unknowns, form="fmu")
    return folder


def check(folder):
    command = [sys.executable, folder / "test" / "check.py"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_both_units_return_the_numbers_of_the_library(units):
    done = check(units)
    assert done.returncode == 0, done.stdout + done.stderr
    compared = json.loads((units / "certificate.json").read_text())["compared"]
    assert [result["what"][:10] for result in compared] == ["motor.fmi2", "motor.fmi3"]
    assert all(result["rows"] > 1000 and result["different"] == 0 for result in compared)


def test_a_changed_number_is_detected(units, tmp_path):
    shutil.copytree(units, tmp_path / "motor")
    record = tmp_path / "motor" / "test" / "record.csv"
    lines = record.read_text().splitlines()
    cells = lines[900].split(",")
    cells[7] = repr(float(cells[7]) * (1 + 1e-15))  # theta_e, its last digits
    lines[900] = ",".join(cells)
    record.write_text("\n".join(lines) + "\n")
    done = check(tmp_path / "motor")
    assert done.returncode == 1
    rows = len(lines) - 1
    assert f"{rows - 1} of {rows} rows equal" in done.stdout


def test_each_unit_describes_its_units_and_holds_its_sources(units):
    for version in (2, 3):
        with zipfile.ZipFile(units / f"motor.fmi{version}.fmu") as archive:
            names = archive.namelist()
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        assert {"sources/unit.c", "sources/motor_observer.c", f"sources/fmi{version}.c"} <= {*names}
        assert any(name.startswith("binaries/") for name in names)
        defined = {unit.get("name") for unit in root.iter("Unit")}
        used = {element.get("unit") for element in root.iter() if element.get("unit")}
        assert {"V", "A", "Wb", "rad", "rad/s"} <= used <= defined
        assert "one communication step later" in root.get("description")
        assert ("sources/buildDescription.xml" in names) == (version == 3)


def test_the_sources_in_the_unit_compile_on_their_own(units, tmp_path):
    with zipfile.ZipFile(units / "motor.fmi3.fmu") as archive:
        archive.extractall(tmp_path)
    sources = sorted((tmp_path / "sources").glob("*.c"))
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]
    build_program(["gcc"], strict, sources, tmp_path / "unit.so")


def test_the_sources_are_double_precision_without_any_option(units, tmp_path):
    """Both units compile from their archives; FMI 2.0 has no place for compiler definitions."""
    shutil.copytree(units, tmp_path / "motor")
    for version in (2, 3):
        path = tmp_path / "motor" / f"motor.fmi{version}.fmu"
        with zipfile.ZipFile(path) as archive:
            content = {name: archive.read(name) for name in archive.namelist()}
            archive.extractall(tmp_path / "unit")
        folder = tmp_path / "unit"
        program = next(name for name in content if name.startswith("binaries/"))
        options = ["-shared", "-fPIC", f"-I{folder}/sources"]
        build_program(["gcc"], options, [*(folder / "sources").glob("*.c")], folder / program)
        content[program] = (folder / program).read_bytes()
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in content.items():
                archive.writestr(name, data)
        shutil.rmtree(folder)
    done = check(tmp_path / "motor")
    assert done.returncode == 0, done.stdout + done.stderr


class Instance:
    """A unit of FMI 2.0 or 3.0 behind common methods, with the unit's messages."""

    def __init__(self, path, token=None):
        description = fmpy.read_model_description(path)
        self.three = description.fmiVersion == "3.0"
        self.folder = fmpy.extract(path)
        self.messages = []
        self.unit = (fmi3.FMU3Slave if self.three else fmi2.FMU2Slave)(
            guid=token or description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="x",
        )
        if self.three:
            log = fmi3.fmi3LogMessageCallback(lambda e, s, c, message: self._add(message))
            self.unit.instantiate(logMessage=log)
        else:
            kind = fmi2.fmi2CallbackLoggerTYPE
            log = kind(lambda e, n, s, c, message, *more: self._add(message))
            calls = fmi2.fmi2CallbackFunctions()
            calls.logger = log
            calls.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
            calls.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
            addLoggerProxy(byref(calls))
            self.unit.instantiate(callbacks=calls)

    def _add(self, message):
        self.messages.append(message.decode())

    def begin(self, start=0.0):
        if self.three:
            self.unit.enterInitializationMode(startTime=start)
        else:
            self.unit.setupExperiment(startTime=start)
            self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()

    def step(self, time, size=STEP):
        self.unit.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def save(self):
        if self.three:
            return self.unit.serializeFMUState(self.unit.getFMUState())
        return self.unit.serializeFMUstate(self.unit.getFMUstate())

    def restore(self, saved):
        if self.three:
            self.unit.setFMUState(self.unit.deserializeFMUState(saved))
        else:
            self.unit.setFMUstate(self.unit.deSerializeFMUstate(saved))

    def refuses(self, call, *arguments, message):
        before = len(self.messages)
        with pytest.raises(Exception, match=r"fmi[23]\w+ failed"):
            call(*arguments)
        return message in self.messages[before]


@pytest.fixture(params=[2, 3])
def instance(request, units):
    unit = Instance(units / f"motor.fmi{request.param}.fmu")
    yield unit
    unit.unit.freeInstance()
    shutil.rmtree(unit.folder)


def test_wrong_arguments_are_refused(units, instance):
    """Refuse a wrong step size, another unit's token, a damaged state, and an output as input."""
    with pytest.raises(Exception, match=r"[Ii]nstantiate"):
        Instance(units / "motor.fmi3.fmu", token="{0}")
    instance.begin()
    assert instance.refuses(instance.step, 0.0, 2 * STEP, message="steps every 0.0001 s")
    instance.step(0.0)
    saved = bytearray(instance.save())
    saved[100] ^= 1
    assert instance.refuses(
        instance.restore, bytes(saved), message="not one that this unit has saved"
    )
    put = instance.unit.setFloat64 if instance.three else instance.unit.setReal
    assert instance.refuses(put, [7], [1.0], message="no input")


@pytest.mark.slow
def test_a_state_of_another_machine_is_refused(tmp_path, monkeypatch):
    """The state has the same size and a correct checksum."""
    monkeypatch.setattr(build, "has_zig", lambda: False)
    monkeypatch.setattr(build, "compared", lambda files, command: [])
    for name in ("servo-400w", "pmsm-2kw2"):
        fluxobs.export(name, STEP, tmp_path / name, form="fmu", unknowns="drift")
    for version in (2, 3):
        mine, other = (
            Instance(tmp_path / name / f"motor.fmi{version}.fmu")
            for name in ("servo-400w", "pmsm-2kw2")
        )
        mine.begin()
        other.begin()
        mine.restore(mine.save())
        message = "not one that this unit has saved"
        assert len(mine.save()) == len(other.save())
        assert other.refuses(other.restore, mine.save(), message=message)


def test_calls_out_of_order_are_refused(instance):
    """Steps before initialization or after termination, and wrong mode changes, are refused."""
    unit = instance.unit
    steps = "a step needs an instance that is initialized and not terminated"
    assert instance.refuses(instance.step, 0.0, message=steps)
    assert instance.refuses(unit.exitInitializationMode, message="needs initialization mode")
    assert instance.refuses(unit.terminate, message="Terminate needs")
    instance.begin()
    assert instance.refuses(unit.enterInitializationMode, message="new or reset")
    instance.step(0.0)
    unit.terminate()
    assert instance.refuses(instance.step, STEP, message=steps)
    unit.reset()
    assert instance.refuses(instance.step, 0.0, message=steps)
    instance.begin()
    instance.step(0.0)


def test_no_step_is_left_out_or_repeated(instance):
    """The time begins at the given start, goes back with a restored state, and may be rounded."""
    instance.begin(5.0)
    assert instance.refuses(instance.step, 0.0, message="begins at 5 s")
    instance.step(5.0)
    saved = instance.save()
    instance.step(5.0 + STEP)
    for time in (5.0 + STEP, 5.0 + 3 * STEP, float("nan")):
        assert instance.refuses(instance.step, time, message="none may be left out or repeated")
    instance.step(5.0 + 2 * STEP)
    instance.restore(saved)
    instance.step(5.0 + STEP)
    instance.unit.reset()
    instance.begin(100.0)  # as after 1e6 steps
    total = 100.0
    for n in range(1000):
        instance.step(total if n % 2 else 100.0 + n * STEP)
        total += STEP


@pytest.mark.parametrize("version", [2, 3])
def test_a_simulation(units, version):
    path = units / f"motor.fmi{version}.fmu"
    rows = fmpy.simulate_fmu(str(path), stop_time=0.05, output_interval=STEP)
    assert len(rows) == 501


@pytest.mark.slow
def test_binaries_for_other_systems(tmp_path):
    pytest.importorskip("ziglang")
    for name in ("a", "b"):
        fluxobs.export("servo-400w", STEP, tmp_path / name, form="fmu", unknowns="drift")
    unit = (tmp_path / "a" / "motor.fmi3.fmu").read_bytes()
    assert unit == (tmp_path / "b" / "motor.fmi3.fmu").read_bytes()
    with zipfile.ZipFile(io.BytesIO(unit)) as archive:
        magic = {
            name.split("/")[1]: archive.read(name)[:4]
            for name in archive.namelist()
            if name.startswith("binaries/")
        }
    assert magic["x86_64-linux"] == magic["aarch64-linux"] == b"\x7fELF"
    assert magic["x86_64-windows"][:2] == b"MZ"
    assert magic["x86_64-darwin"] == magic["aarch64-darwin"] == b"\xcf\xfa\xed\xfe"
    assert check(tmp_path / "a").returncode == 0
    assert "x86_64-windows" in (tmp_path / "a" / "README.md").read_text()


def test_a_missing_compiler_is_reported_before_anything_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(build, "has_zig", lambda: False)
    monkeypatch.setattr(build, "local_compiler", lambda: None)
    with pytest.raises(FluxobsError, match="no C compiler"):
        fluxobs.export("servo-400w", STEP, tmp_path / "motor", form="fmu", unknowns="drift")
    assert not (tmp_path / "motor").exists()
