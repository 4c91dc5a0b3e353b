"""An exported folder: the host test detects changes, and no file of a user is lost."""

import hashlib
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

import fluxobs
from fluxobs import FluxobsError
from fluxobs.core.output import claimed
from fluxobs.deployment.c_source import hex_float
from fluxobs.deployment.folder import check_folder, write_folder
from fluxobs.deployment.vectors import COLUMNS
from support.compiling import build_program
from support.firmware import COMPILERS, CPP_COMPILERS, HARNESS, STRICT, firmware_objects, make_test
from support.records import MACHINES

ADAPTIVE = ("drift", "resistance", "inverter")
#: A machine with a table of splines.
MAPPED = fluxobs.SynchronousReluctance(
    R_s=0.63,
    n_p=2,
    rated_current=22.0,
    flux_map={"a_d0": 17.4, "a_dd": 373, "a_q0": 52.1, "a_qq": 658, "a_dq": 1120},
)


@pytest.mark.parametrize(
    "compiler",
    [COMPILERS[0], pytest.param(COMPILERS[1].values[0], id="clang", marks=pytest.mark.slow)],
)
def test_make_test_in_the_folder(tmp_path, compiler):
    fluxobs.export(
        MACHINES["servo-400w"], 1e-4, tmp_path / "servo", prefix="servo", unknowns="drift"
    )
    done = make_test(tmp_path / "servo", f"CC={' '.join(compiler)}", "CFLAGS=-O2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "single: 171 of 171 rows as expected" in done.stdout
    assert "double: 171 of 171 rows as expected" in done.stdout


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("test/vectors.h", r"expected\[171\].*?\{(0x1\.[0-9a-f]{3})"),  # an expected flux
        (
            "test/vectors.h",
            r"expected\[171\].*?\{(?:[^,{]*, ){5}(-?0x1\.[0-9a-f]{3})",
        ),  # an expected speed
        ("test/vectors.h", r"samples\[SAMPLES\].*?FO_\((0x1\.[0-9a-f]{3})"),  # a measured voltage
        ("motor_observer.c", r"FO_SINGLE.*?(0\.003)\d*f, /\* sample time"),
    ],
    ids=["flux", "speed", "sample", "parameter"],
)
def test_one_changed_value_fails(tmp_path, folders, name, pattern):
    shutil.copytree(folders["servo-400w"], tmp_path / "motor")
    path = tmp_path / "motor" / name
    text = path.read_text()
    end = re.search(pattern, text, re.DOTALL).end(1)
    digit = text[end - 1]
    path.write_text(text[: end - 1] + ("1" if digit != "1" else "2") + text[end:])
    done = make_test(tmp_path / "motor")
    assert done.returncode != 0
    assert "FAILED" in done.stdout


def test_the_last_digit_of_an_expected_angle_is_guarded(tmp_path, folders):
    shutil.copytree(folders["servo-400w"], tmp_path / "motor")
    path = tmp_path / "motor" / "test" / "vectors.h"
    lines = path.read_text().split("\n")
    row = next(n for n, line in enumerate(lines) if "expected[171]" in line) + 60
    cells = lines[row].split(", ")
    value = float.fromhex(cells[COLUMNS.index("theta_e")].removesuffix("f"))
    cells[COLUMNS.index("theta_e")] = hex_float(
        float(np.nextafter(np.float32(value), np.float32(9))), "single"
    )
    lines[row] = ", ".join(cells)
    path.write_text("\n".join(lines))
    done = make_test(tmp_path / "motor")
    assert done.returncode != 0
    assert "not those that were written" in done.stdout


@pytest.mark.parametrize(
    ("code", "changed"),
    [
        ("if (e->valid && bad) {", "if (e->valid && bad && !bad) {"),
        ("FO_MAX_CONSECUTIVE_BAD)) {", "FO_MAX_CONSECUTIVE_BAD / 3U)) {"),
        ("TRACKER_SETTLED ((fo_real)0.1)", "TRACKER_SETTLED ((fo_real)0.11)"),
        ("VOLTAGE_LIMIT (PI / (fo_real)22.5)", "VOLTAGE_LIMIT (PI / (fo_real)22)"),
        (" STEP_LIMIT ((fo_real)0.15)", " STEP_LIMIT ((fo_real)15)"),
        (" SETTLED ((fo_real)3 * PI)", " SETTLED ((fo_real)4 * PI)"),
    ],
)
def test_a_change_of_the_observer_is_detected(tmp_path, code, changed):
    fluxobs.export(MACHINES["servo-400w"], 1e-4, tmp_path / "motor", memory=0.01, unknowns="drift")
    sources = (tmp_path / "motor").glob("fluxobs*")
    (source,) = (path for path in sources if path.read_text().count(code) == 1)
    source.write_text(source.read_text().replace(code, changed))
    done = make_test(tmp_path / "motor", "CFLAGS=-O0 -Wno-error")
    assert done.returncode != 0
    assert "FAILED" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("every", [2, 5])
def test_make_test_where_volt_seconds_are_gathered(tmp_path, every):
    fluxobs.export(
        MACHINES["servo-400w"], 5e-5, tmp_path / "motor", update_every=every, unknowns="drift"
    )
    done = make_test(tmp_path / "motor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "fo_gather" in (tmp_path / "motor" / "README.md").read_text()
    source = tmp_path / "motor" / "fluxobs.c"
    source.write_text(source.read_text().replace("(fo_real)12 *", "(fo_real)13 *"))
    assert make_test(tmp_path / "motor").returncode != 0


@pytest.mark.parametrize(
    ("name", "unknowns"),
    [
        ("servo-400w", ADAPTIVE),
        pytest.param("ipm-2kw2", ("drift", "resistance"), marks=pytest.mark.slow),
        pytest.param("synrm-6kw7", ADAPTIVE, marks=pytest.mark.slow),
    ],
)
def test_the_adaptive_observer_in_the_folder(tmp_path, name, unknowns):
    done = fluxobs.export(MACHINES[name], 1e-4, tmp_path / "motor", unknowns=unknowns)
    assert isinstance(done.observer, fluxobs.AdaptiveObserver)
    assert {path.name for path in done.folder.glob("*.[ch]")} == {
        "example_isr.c",
        "telemetry.c",
        "telemetry.h",
        "fluxobs.c",
        "fluxobs.h",
        "fluxobs_adaptive.c",
        "fluxobs_adaptive.h",
        "fluxobs_algebra.h",
        "fluxobs_candidates.c",
        "fluxobs_candidates.h",
        "fluxobs_fast.c",
        "fluxobs_internal.h",
        "fluxobs_learning.c",
        "fluxobs_learning.h",
        "fluxobs_real.h",
        "fluxobs_relation.c",
        "fluxobs_relation.h",
        "fluxobs_triangle.c",
        "fluxobs_triangle.h",
        "motor_observer.c",
        "motor_observer.h",
    }
    run = make_test(done.folder, "CFLAGS=-O2")
    assert run.returncode == 0, run.stdout + run.stderr
    for precision in ("single", "double"):
        assert f"{precision}: 171 of 171 rows as expected" in run.stdout
    strict = [*STRICT, f"-I{done.folder}", "-c", done.folder / "example_isr.c"]
    subprocess.run(["gcc", *strict, "-o", tmp_path / "isr.o"], check=True)


@pytest.mark.parametrize(
    ("file", "code", "changed"),
    [
        ("learning", "MODEL = (fo_real)0.002", "MODEL = (fo_real)0.004"),
        ("fast", "q->theta_e = s->theta", "q->theta_e = (fo_real)0.01 + s->theta"),
    ],
)
def test_a_change_of_the_adaptive_observer_is_detected(tmp_path, file, code, changed):
    fluxobs.export(MACHINES["servo-400w"], 1e-4, tmp_path / "motor", unknowns=ADAPTIVE)
    source = tmp_path / "motor" / f"fluxobs_{file}.c"
    assert code in source.read_text()
    source.write_text(source.read_text().replace(code, changed))
    done = make_test(tmp_path / "motor", "CFLAGS=-O0 -Wno-error")
    assert done.returncode != 0
    assert "FAILED" in done.stdout


def test_precisions_do_not_mix(tmp_path, folders):
    folder = folders["servo-400w"]
    main = tmp_path / "main.c"
    main.write_text(
        '#include "motor_observer.h"\n'
        "int main(void) { fo_state s; fo_reset(&motor_observer, &s); return 0; }\n"
    )
    objects = []
    for source, flags in ((main, []), (folder / "fluxobs.c", ["-DFO_SINGLE=0"])):
        objects.append(tmp_path / f"{source.stem}.o")
        command = ["gcc", *flags, f"-I{folder}", "-c", source, "-o", objects[-1]]
        subprocess.run(command, check=True)
    linked = subprocess.run(
        ["gcc", *objects, "-lm", "-o", tmp_path / "mixed"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert linked.returncode != 0
    assert "fo_reset_single" in linked.stderr


def test_two_machines_in_one_firmware(tmp_path):
    for prefix, name in (("pump", "ipm-2kw2"), ("fan", "servo-400w")):
        fluxobs.export(MACHINES[name], 1e-4, tmp_path / prefix, prefix=prefix, unknowns="drift")
    main = tmp_path / "main.c"
    main.write_text(
        '#include "fan_observer.h"\n#include "pump_observer.h"\n'
        "int main(void)\n{\n    fo_state a, b;\n"
        "    fo_reset(&fan_observer, &a);\n    fo_reset(&pump_observer, &b);\n"
        "    return fan_observer.flux_base > pump_observer.flux_base;\n}\n"
    )
    pump, fan = tmp_path / "pump", tmp_path / "fan"
    for kind in "hc":
        shutil.copy(fan / f"fan_observer.{kind}", pump)

    def build(folder):
        sources = [main, *pump.glob("*_observer.c"), *folder.glob("fluxobs*.c")]
        command = ["gcc", *STRICT, f"-I{pump}", *sources, "-lm"]
        command += ["-o", tmp_path / "two"]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    assert build(pump).stderr == ""
    assert subprocess.run([tmp_path / "two"], check=False).returncode == 0

    # The exported sources of the fan contain no flux maps.
    assert "fo_reset_single_mapped" in build(fan).stderr
    shutil.copy(fan / "fluxobs_real.h", pump)
    assert "they have FO_MAPPED 1" in build(pump).stderr


#: Each compiler with the oldest and the newest standard, each kind once; the others are slow.
HEADERS = (("g++", "c++11", "plain"), ("g++", "c++20", "adaptive"), ("clang++", "c++11", "map"))


@pytest.mark.parametrize(
    ("compiler", "standard", "kind"),
    [
        pytest.param(
            compiler.values[0],
            standard,
            kind,
            id=f"{compiler.id}-{standard}-{kind}",
            marks=() if (compiler.id, standard, kind) in HEADERS else pytest.mark.slow,
        )
        for compiler in CPP_COMPILERS
        for standard in ("c++11", "c++14", "c++17", "c++20")
        for kind in ("plain", "adaptive", "map")
    ],
)
def test_headers_in_cpp(tmp_path_factory, compiler, standard, kind):
    folder = tmp_path_factory.mktemp("cpp") / "motor"
    machine = "ipm-5kw6" if kind == "map" else "servo-400w"
    unknowns = ADAPTIVE if kind == "adaptive" else "drift"
    fluxobs.export(machine, 1e-4, folder, unknowns=unknowns)
    source = folder.parent / "main.cpp"
    member = "plain.h" if kind == "adaptive" else "h"
    source.write_text(
        '#include "motor_observer.h"\n#include "telemetry.h"\n'
        f"int main() {{ return motor_observer.{member} > 1; }}\n"
    )
    options = [f"-std={standard}", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    for precision in ("-DFO_SINGLE=1", "-DFO_SINGLE=0"):
        command = [*compiler, *options, precision, f"-I{folder}", "-c", source]
        subprocess.run([*command, "-o", folder.parent / "main.o"], check=True)


def test_fast_math_is_refused(folders, tmp_path):
    source = folders["servo-400w"] / "fluxobs.c"
    done = subprocess.run(
        ["gcc", "-O2", "-ffast-math", "-c", source, "-o", tmp_path / "x.o"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "-ffast-math" in done.stderr


def test_nothing_is_overwritten_unasked(tmp_path, monkeypatch):
    machine = MACHINES["servo-400w"]
    fluxobs.export(machine, 1e-4, tmp_path / "motor", unknowns="drift")
    (tmp_path / "motor" / "notes.txt").write_text("mine")
    with pytest.raises(FluxobsError, match="force"):
        fluxobs.export(machine, 1e-4, tmp_path / "motor", memory=0.05, unknowns="drift")
    second = fluxobs.export(
        machine, 1e-4, tmp_path / "motor", memory=0.05, force=True, unknowns="drift"
    )
    assert second.content in (tmp_path / "motor" / "motor_observer.h").read_text()
    assert (tmp_path / "motor" / "notes.txt").read_text() == "mine"

    fluxobs.export(machine, 1e-4, tmp_path / "motor", prefix="pump", force=True, unknowns="drift")
    assert not (tmp_path / "motor" / "motor_observer.h").exists()
    assert make_test(tmp_path / "motor").returncode == 0

    example = tmp_path / "motor" / "example_isr.c"
    example.write_text(example.read_text() + "/* mine */\n")
    with pytest.raises(FluxobsError, match=r"example_isr\.c: changed since"):
        fluxobs.export(machine, 1e-4, tmp_path / "motor", force=True, unknowns="drift")
    assert "mine" in example.read_text()
    example.unlink()
    (tmp_path / "motor" / "axis_observer.h").write_text("mine")
    with pytest.raises(FluxobsError, match=r"axis_observer\.h: is not part"):
        fluxobs.export(
            machine, 1e-4, tmp_path / "motor", prefix="axis", force=True, unknowns="drift"
        )
    assert (tmp_path / "motor" / "pump_observer.h").exists()

    victim = tmp_path / "victim"
    victim.write_text("mine")
    digest = hashlib.sha256(b"mine").hexdigest()
    manifest = tmp_path / "motor" / "MANIFEST"
    listing = manifest.read_text()
    manifest.write_text(f"{listing}{digest}  ../victim\n")
    (tmp_path / "motor" / "axis_observer.h").unlink()
    with pytest.raises(FluxobsError, match="not a path within the folder"):
        fluxobs.export(machine, 1e-4, tmp_path / "motor", force=True, unknowns="drift")
    assert victim.read_text() == "mine"
    manifest.write_text(listing)

    # After an interrupted export the next one succeeds.
    replace_file, calls = os.replace, []

    def full(source, target):
        calls.append(target)
        if len(calls) == 5:
            raise OSError(28, "No space left on device")
        replace_file(source, target)

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", full)
        with pytest.raises(FluxobsError, match="No space left"):
            fluxobs.export(
                machine, 1e-4, tmp_path / "motor", memory=0.02, force=True, unknowns="drift"
            )
    fluxobs.export(machine, 1e-4, tmp_path / "motor", memory=0.02, force=True, unknowns="drift")
    assert make_test(tmp_path / "motor").returncode == 0

    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "fluxobs.h").write_text("vendored")
    with pytest.raises(FluxobsError, match="is not an earlier export"):
        fluxobs.export(machine, 1e-4, tmp_path / "home", force=True, unknowns="drift")
    assert (tmp_path / "home" / "fluxobs.h").read_text() == "vendored"

    (tmp_path / "file").write_text("mine")
    with pytest.raises(FluxobsError, match="is not a folder"):
        fluxobs.export(machine, 1e-4, tmp_path / "file", force=True, unknowns="drift")
    with pytest.raises(FluxobsError, match="cannot be written"):
        fluxobs.export(machine, 1e-4, tmp_path / "file" / "motor", unknowns="drift")
    (tmp_path / "empty").mkdir()
    fluxobs.export(machine, 1e-4, tmp_path / "empty", unknowns="drift")
    assert make_test(tmp_path / "empty").returncode == 0


@pytest.mark.parametrize("force", [True, False])
def test_a_listing_that_is_a_link_is_not_followed(tmp_path, force):
    victim = tmp_path / "victim"
    victim.write_text("")
    (tmp_path / "motor").mkdir()
    (tmp_path / "motor" / "MANIFEST").symlink_to("../victim")
    with pytest.raises(FluxobsError, match="MANIFEST: is a link" if force else "force"):
        write(tmp_path / "motor", {"a": "1"}, force)
    assert victim.read_text() == ""


def test_a_folder_that_is_a_link_is_not_followed(tmp_path):
    """Listed files behind the link are neither deleted nor written."""
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "file.txt").write_text("mine")
    folder = tmp_path / "motor"
    write(folder, {"a": "1", "sub/file.txt": "mine"})
    shutil.rmtree(folder / "sub")
    (folder / "sub").symlink_to("../victim")
    for files in ({"a": "2"}, {"sub/file.txt": "2"}):
        with pytest.raises(FluxobsError, match="sub: is a link"):
            write(folder, files, force=True)
        with pytest.raises(FluxobsError, match="sub: is a link"):
            write_folder(folder, files)  # as if the link came after the check
    assert (victim / "file.txt").read_text() == "mine"
    assert (folder / "a").read_text() == "1"


def test_a_hard_link_to_the_listing_keeps_its_content(tmp_path):
    folder = tmp_path / "motor"
    write(folder, {"a": "1"})
    os.link(folder / "MANIFEST", tmp_path / "other")
    before = (tmp_path / "other").read_text()
    write(folder, {"a": "2"}, force=True)
    assert (tmp_path / "other").read_text() == before


def test_remains_of_a_killed_export_are_removed_by_the_next(tmp_path):
    program = (
        "import os, sys\n"
        "from unittest import mock\n"
        "import fluxobs\n"
        "with mock.patch('os.replace', lambda *arguments: os._exit(9)):\n"
        "    fluxobs.export('servo-400w', 1e-4, sys.argv[1])\n"
    )
    done = subprocess.run([sys.executable, "-c", program, tmp_path / "motor"], check=False)
    assert done.returncode == 9
    assert not (tmp_path / "motor").exists()
    assert list(tmp_path.iterdir())
    fluxobs.export("servo-400w", 1e-4, tmp_path / "motor", unknowns="drift")
    assert [path.name for path in tmp_path.iterdir()] == ["motor"]


def test_two_concurrent_exports_into_one_folder_are_refused(tmp_path):
    victim = tmp_path / "victim"
    victim.mkdir()
    (tmp_path / ".motor.unfinished").symlink_to("victim")
    with claimed(tmp_path / "motor"), pytest.raises(FluxobsError, match="another run is writing"):
        fluxobs.export("servo-400w", 1e-4, tmp_path / "motor", unknowns="drift")
    fluxobs.export("servo-400w", 1e-4, tmp_path / "motor", unknowns="drift")
    assert not list(victim.iterdir())


def test_no_empty_folder_is_left(tmp_path):
    folder = tmp_path / "motor"
    write(folder, {"a": "1", "runtime/x/b": "2", "test/c": "3"})
    (folder / "test" / "notes").write_text("mine")
    write(folder, {"examples/SelfTest/a": "1"}, force=True)
    paths = {str(path.relative_to(folder)) for path in folder.rglob("*")}
    assert paths == {
        *("MANIFEST", "examples", "examples/SelfTest", "examples/SelfTest/a"),
        *("test", "test/notes"),
    }


def write(folder, files, force=False):
    check_folder(folder, force)
    write_folder(folder, files)


@pytest.mark.parametrize(
    ("name", "unknowns"),
    [
        ("table", "drift"),
        pytest.param("table", "drift,resistance,inverter", marks=pytest.mark.slow),
        pytest.param("induction-2kw2", "drift", marks=pytest.mark.slow),
        pytest.param("induction-2kw2", "drift,resistance,inverter", marks=pytest.mark.slow),
        pytest.param("ipm-2kw2", "drift", marks=pytest.mark.slow),
    ],
)
def test_a_flux_map_in_the_folder(tmp_path, name, unknowns):
    """With splines, a cage or a salient machine, the folder returns the library's numbers."""
    machine = MAPPED if name == "table" else fluxobs.example(name)
    done = fluxobs.export(machine, 1e-4, tmp_path / "motor", unknowns=unknowns)
    assert (done.folder / "fluxobs_map.c").exists()
    parameters = (done.folder / "motor_observer.c").read_text()
    assert "&motor_map" in parameters
    assert str(tmp_path) not in parameters
    run = make_test(done.folder)
    assert run.returncode == 0, run.stdout + run.stderr
    strict = [*STRICT, f"-I{done.folder}", "-c", done.folder / "example_isr.c"]
    subprocess.run(["gcc", *strict, "-o", tmp_path / "isr.o"], check=True)


@pytest.mark.parametrize("unknowns", ["drift", ADAPTIVE])
def test_a_state_of_zeros_resets_itself_and_is_counted(tmp_path, unknowns):
    folder = tmp_path / "motor"
    fluxobs.export(MACHINES["servo-400w"], 1e-4, folder, unknowns=unknowns)
    kind = [] if unknowns == "drift" else ["-DADAPTIVE"]
    sources = [HARNESS / "zeros.c", *firmware_objects(folder.glob("*obs*.c"))]
    options = ["-std=c99", "-O1", *kind, f"-I{folder}", f"-I{folder}/test"]
    build_program(["gcc"], options, sources, tmp_path / "zeros")
    assert subprocess.run([tmp_path / "zeros"], check=False).returncode == 0
