"""Features of the firmware at run time: configuration, changes, blobs, snapshots, C++ header."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

import fluxobs
from fluxobs import _core
from fluxobs.machines import InductionMachine, SynchronousReluctance, example
from fluxobs.observers import AdaptiveObserver, LeastSquaresObserver
from support.compiling import build_program, compiled
from support.firmware import (
    CPP_COMPILERS,
    FIRMWARE,
    HARNESS,
    ROOT,
    STRICT,
    cross_compiler,
    firmware_objects,
    make_test,
)
from support.records import MACHINES

RUNTIME = HARNESS / "runtime"
ADAPTIVE = "drift,resistance,inverter"
ALL = ("drift", "resistance", "inverter", "asymmetry")


def built(folder: Path, source: str, *flags: object) -> Path:
    """Compile a harness with all sources of the firmware."""
    program = folder / Path(source).stem
    sources = [RUNTIME / source, *firmware_objects(FIRMWARE.glob("*.c"), *flags)]
    return build_program(["gcc"], [*STRICT, *flags, f"-I{FIRMWARE}"], sources, program)


@pytest.fixture(scope="module")
def configure(tmp_path_factory):
    return built(tmp_path_factory.mktemp("configure"), "configure.c")


def kind_of(machine):
    if isinstance(machine, SynchronousReluctance):
        return 2
    if isinstance(machine, InductionMachine):
        return 3
    return 0 if machine.L_dq[0] == machine.L_dq[1] else 1


def printed(program, machine, sample_time, dc_link):
    L_d, L_q = machine.L_dq
    speed = machine.n_p * machine.rated_speed if machine.rated_speed else 0.0
    psi = machine.psi_R if kind_of(machine) == 3 else machine.magnet_flux
    given = [machine.R_s, L_d, L_q, psi or 0.0, getattr(machine, "R_R", 0.0)]
    given += [getattr(machine, "L_M", 0.0), machine.rated_current, speed, sample_time, dc_link]
    command = [str(program), str(kind_of(machine)), *map(repr, given)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    return {name: [float.fromhex(x) for x in numbers] for name, *numbers in lines}


UNSATURATED = ["servo-400w", "drone-900kv", "pmsm-2kw2", "ipm-2kw2", "synrm-6kw7", "induction-2kw2"]


@pytest.mark.parametrize("sample_time", [2e-5, 1e-4, 2e-4])
@pytest.mark.parametrize("name", UNSATURATED)
def test_a_machine_in_c_is_the_one_in_python(configure, name, sample_time):
    """Settings, map and the adaptive observer's standard deviations have the same bits."""
    machine, dc_link = example(name), 300.0
    assert machine.saturation is None
    found = printed(configure, machine, sample_time, dc_link)
    plain = LeastSquaresObserver.for_machine(machine, sample_time=sample_time)
    adaptive = AdaptiveObserver.for_machine(
        machine, sample_time=sample_time, unknowns=ALL, dc_link=dc_link
    )
    expected = adaptive.plain.parameters() | adaptive.parameters()
    expected.pop("projection")
    shares = expected.pop("std")  # Python converts to shares and back: one unit in the last place
    assert found.pop("std") == pytest.approx(shares, rel=1e-15)
    for field, value in expected.items():
        assert found.pop(field) == np.ravel(value).tolist(), field
    fields = {} if plain.flux_map is None else plain.flux_map.core()
    kept = {f"map_{field}": value for field, value in fields.items()}
    assert found.keys() <= kept.keys()
    assert bool(found) == (plain.flux_map is not None)
    for field, value in found.items():
        assert value == pytest.approx([kept[field]], rel=1e-15), field


@pytest.mark.parametrize("precision", [0, 1])
@pytest.mark.parametrize("source", ["wrong.c", "machines.c"])
def test_the_wrong_field_is_named(tmp_path, source, precision):
    program = built(tmp_path, source, f"-DFO_SINGLE={precision}")
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_library_names_the_wrong_field():
    observer = LeastSquaresObserver.for_machine(MACHINES["servo-400w"], sample_time=1e-4)
    with pytest.raises(fluxobs.FluxobsError, match="R: sizes do not fit"):
        LeastSquaresObserver(
            **{
                name: getattr(observer, name)
                for name in observer.__dataclass_fields__
                if name not in ("_core", "R")
            },
            R=1e9 * observer.R,
        )


@pytest.fixture(
    scope="module",
    params=[
        "drift",
        pytest.param(ADAPTIVE, marks=pytest.mark.slow),
        f"{ADAPTIVE},asymmetry",
    ],
)
def folder(request, tmp_path_factory):
    made = tmp_path_factory.mktemp("runtime") / "motor"
    fluxobs.export(MACHINES["servo-400w"], 1e-4, made, unknowns=request.param)
    return made


def run_in(folder: Path, source: str, *arguments: object, flags: tuple[str, ...] = ()) -> str:
    """Compile a harness with everything in an exported folder, and run it."""
    program = folder.parent / Path(source).stem
    sources = [*folder.glob("*obs*.c"), *(folder / "runtime").glob("*.c")]
    common = [flag for flag in flags if flag.startswith(("-O", "-fsanitize", "-fno-sanitize"))]
    objects = firmware_objects(sources, *common, includes=[folder, folder / "runtime"])
    includes = [f"-I{folder}", f"-I{folder / 'runtime'}", f"-I{folder / 'test'}"]
    kind = ["-DADAPTIVE"] if (folder / "fluxobs_adaptive.h").exists() else []
    options = [*STRICT, *kind, *flags, *includes, "-pthread"]
    build_program(["gcc"], options, [RUNTIME / source, *objects], program)
    command = [str(program), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_blobs_come_back_and_damage_is_seen(folder):
    run_in(folder, "keep.c", folder / "motor_parameters.bin")


def test_another_configuration_in_the_drive(folder):
    machine = MACHINES["servo-400w"]
    numbers = {
        "MOTOR_R": machine.R_s,
        "MOTOR_L": machine.L_s,
        "MOTOR_PSI": machine.psi_f,
        "MOTOR_I": machine.rated_current,
    }
    run_in(folder, "retune.c", flags=tuple(f"-D{name}={x!r}" for name, x in numbers.items()))


@pytest.mark.parametrize("unknowns", ["drift", ADAPTIVE])
@pytest.mark.parametrize(
    "name",
    [
        "ipm-2kw2",
        pytest.param("servo-400w", marks=pytest.mark.slow),
        pytest.param("induction-2kw2", marks=pytest.mark.slow),
    ],
)
def test_a_seed_that_cannot_be_resets(tmp_path, name, unknowns):
    made = tmp_path / "motor"
    fluxobs.export(name, 1e-4, made, unknowns=unknowns)
    run_in(made, "seed.c", flags=("-fsanitize=undefined", "-fno-sanitize-recover=all"))


def test_the_adaptive_observer_stays_within_its_arrays(tmp_path):
    fluxobs.export("ipm-2kw2", 1e-4, tmp_path / "motor", unknowns=f"{ADAPTIVE},asymmetry")
    done = make_test(
        tmp_path / "motor", "CFLAGS=-O1 -fsanitize=undefined -fno-sanitize-recover=all"
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_an_estimate_is_read_whole(folder):
    run_in(folder, "snapshot.c", flags=("-O2",))


@pytest.mark.parametrize("compiler", ["gcc", cross_compiler("arm-none-eabi-gcc")])
@pytest.mark.parametrize("folder", [f"{ADAPTIVE},asymmetry"], indirect=True)
def test_the_example_compiles(folder, compiler):
    source = ROOT / "examples" / "firmware" / "at_run_time" / "at_run_time.c"
    compiled([compiler], [*STRICT, f"-I{folder}", f"-I{folder / 'runtime'}"], source)


def test_sources_refuse_what_they_leave_out(folder):
    """Sources refuse held voltages and matrices that are not multiples of the identity."""
    run_in(folder, "lacking.c")


def test_the_layout_has_a_number_of_its_own():
    """If you add a field to an observer, change FO_LAYOUT in fluxobs_keep.h and the names here.
    Blobs of earlier versions are then refused."""
    plain = list(_core.meanings)
    more = list(_core.adaptive_meanings)
    assert (_core.layout, len(plain), len(more)) == (3, 24, 18)
    assert plain[:4] == ["Q1x2", "E", "row_Q2", "row_Q3"]
    assert plain[-3:] == ["position_noise", "sample_time", "track"]
    assert more[-3:] == ["guard_reinject", "guard_track", "projection"]


@pytest.mark.parametrize("compiler", CPP_COMPILERS)
@pytest.mark.parametrize("standard", ["gnu++11", pytest.param("c++20", marks=pytest.mark.slow)])
def test_the_cpp_header_steps_the_same_observer(folder, compiler, standard):
    program = folder.parent / f"{Path(compiler[-1]).name}-{standard}"
    c_sources = [*folder.glob("*obs*.c"), *(folder / "runtime").glob("*.c")]
    includes = [f"-I{folder}", f"-I{folder / 'runtime'}", f"-I{folder / 'test'}"]
    kind = ["-DADAPTIVE"] if (folder / "fluxobs_adaptive.h").exists() else []
    objects = firmware_objects(c_sources, includes=[folder, folder / "runtime"])
    flags = [f"-std={standard}", "-O1", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    flags += ["-fno-exceptions", "-fno-rtti", *kind, *includes]
    build_program(compiler, flags, [RUNTIME / "wrapper.cpp", *objects], program)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_injector_takes_any_input(tmp_path):
    """Samples that are not finite start nothing, and the search goes on; bad settings: refused."""
    machine = fluxobs.read_machine("ipm-2kw2")
    fluxobs.export(machine, 1e-4, tmp_path / "motor", unknowns=ADAPTIVE)
    run_in(tmp_path / "motor", "inject.c")
