"""An exported folder compiles into a firmware and does there what the log replay did."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import fluxobs
from fluxobs.deployment import course
from fluxobs.deployment.c_source import hex_float, identifier
from fluxobs.deployment.costs import cost_table, read_costs
from fluxobs.deployment.vectors import expected
from fluxobs.errors import FluxobsError
from records import CURRENTS, MACHINES, rotating, wrapped_degrees

HERE = Path(__file__).parent / "firmware"
STRICT = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion"]
STRICT += ["-Wshadow", "-Wdouble-promotion", "-Werror", "-pedantic"]
SANITIZERS = [
    "-g",
    "-fsanitize=address,undefined,float-divide-by-zero",
    "-fno-sanitize-recover=all",
]
COMPILERS = [
    pytest.param(name, marks=pytest.mark.skipif(not shutil.which(name), reason=f"no {name} here"))
    for name in ("gcc", "clang")
]
SAMPLE_TIME = 1e-4
ADAPTIVE = ("drift", "resistance", "inverter")
CPU = Path("/proc/cpuinfo").read_text().split() if Path("/proc/cpuinfo").exists() else []


def compiled(folder, compiler, precision, extra=()):
    program = folder / f"replay-{compiler}-{precision}{len(extra)}"
    single = ["-DFO_SINGLE"] if precision == "single" else []
    sources = [HERE / "replay.c", folder / "fluxobs.c"]
    command = [compiler, *STRICT, *single, *extra, f"-I{folder}", *sources, "-lm", "-o", program]
    subprocess.run(command, check=True)
    return program


def replayed(program, voltage, current):
    rows = np.ascontiguousarray(np.concatenate([voltage, current], axis=1))
    done = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout).reshape(len(rows), -1)


def all_records(name):
    """Whole records of a machine: biased and noisy, through a stop, and with every bad sample."""
    machine = MACHINES[name]
    rated = machine.rated_current
    biased = {
        "current_bias": 0.02 * rated * (0.6 + 0.8j),
        "voltage_bias": 0.3 * machine.R_s * rated * (0.8 - 0.6j),
        "noise": 0.003 * rated,
        "i_dq": CURRENTS[name],
    }
    rows = 6000
    stop = np.interp(np.arange(rows), [0, 1500, 2000, 4000, 4500], [500.0, 500.0, 0.0, 0.0, -500.0])
    plain = rotating(machine, SAMPLE_TIME, 500.0, rows, **biased)
    stopped = rotating(machine, SAMPLE_TIME, stop, rows, **biased)
    u, i = plain.voltage.copy(), plain.current.copy()
    rng = np.random.default_rng(3)
    for values, worst in ((u, 1e12), (i, 1e9)):
        spoilt = rng.choice(rows, 300)
        values[spoilt, rng.integers(0, 2, 300)] = rng.choice(
            [np.nan, np.inf, -np.inf, worst, 0.0, 3 * rated], 300
        )
    yield plain.voltage, plain.current
    yield stopped.voltage, stopped.current
    yield u, i


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    made = {}
    for name, machine in MACHINES.items():
        made[name] = tmp_path_factory.mktemp("exports") / name
        fluxobs.export(machine, SAMPLE_TIME, made[name])
    return made


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("precision", ["single", "double"])
def test_software_in_the_loop(folders, name, compiler, precision):
    program = compiled(folders[name], compiler, precision)
    observer = fluxobs.LeastSquaresObserver.for_machine(
        MACHINES[name], sample_time=SAMPLE_TIME, precision=precision
    )
    for voltage, current in all_records(name):
        found = replayed(program, voltage, current)
        np.testing.assert_array_equal(found, expected(observer.run(voltage, current)))


@pytest.mark.parametrize("name", MACHINES)
def test_single_precision_within_the_documented_bound(folders, name):
    observer = fluxobs.LeastSquaresObserver.for_machine(MACHINES[name], sample_time=SAMPLE_TIME)
    for voltage, current in list(all_records(name))[:2]:
        double = observer.run(voltage, current)
        single = replace(observer, precision="single").run(voltage, current)
        both = single.valid & double.valid
        assert both.sum() > 1000
        assert np.abs(single.flux - double.flux)[both].max() < 1e-4 * observer.flux_base
        assert np.abs(wrapped_degrees(single.theta_e - double.theta_e))[both].max() < 0.05


@pytest.mark.skipif("fma" not in CPU, reason="this processor has no fused multiply-add")
@pytest.mark.parametrize("name", MACHINES)
def test_fused_multiply_adds_stay_within_the_documented_bound(folders, name):
    program = compiled(folders[name], "gcc", "single", ["-ffp-contract=fast", "-mfma"])
    observer = fluxobs.LeastSquaresObserver.for_machine(MACHINES[name], sample_time=SAMPLE_TIME)
    for voltage, current in list(all_records(name))[:2]:
        fused, double = replayed(program, voltage, current), observer.run(voltage, current)
        both = (fused[:, 8] > 0) & double.valid
        assert both.sum() > 1000
        assert np.abs(fused[:, :2] - double.flux)[both].max() < 1e-4 * observer.flux_base
        assert np.abs(wrapped_degrees(fused[:, 9] - double.theta_e))[both].max() < 0.05


@pytest.mark.parametrize("precision", ["single", "double"])
def test_sanitizers_over_all_records(folders, precision):
    for name in MACHINES:
        program = compiled(folders[name], "gcc", precision, SANITIZERS)
        for voltage, current in all_records(name):
            assert np.isfinite(replayed(program, voltage, current)).all()


def test_what_estimate_does_with_a_log_the_firmware_does(tmp_path):
    """The options that `fluxobs estimate` prints give its numbers bit for bit."""
    log = resources.files("fluxobs") / "demo_data" / "log.csv"
    said = fluxobs_command(
        ["estimate", log, "--machine", "servo-400w", "--out", tmp_path / "e.parquet"]
    )
    options = re.search(r"fluxobs export (.*) --out", said).group(1).split()
    fluxobs_command(["export", *options, "--out", tmp_path / "motor"])
    table = pl.read_csv(str(log))
    voltage = table.select("u_alpha", "u_beta").to_numpy()
    current = table.select("i_alpha", "i_beta").to_numpy()
    late = np.concatenate([[[np.nan, np.nan]], voltage[:-1]])  # lag 0: from its row to the next
    found = replayed(compiled(tmp_path / "motor", "gcc", "double"), late, current)
    estimate = pl.read_parquet(tmp_path / "e.parquet")
    for column, name in ((0, "flux_alpha"), (2, "psi_f"), (9, "theta_e"), (11, "speed_e")):
        np.testing.assert_array_equal(found[:, column], estimate[name].to_numpy())


def fluxobs_command(arguments, code=0):
    done = subprocess.run(
        [sys.executable, "-m", "fluxobs.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout if code == 0 else done.stderr


@pytest.mark.parametrize("every", [1, 4])
def test_the_example_interrupt_follows_a_drive(tmp_path, every):
    """The example as exported, in a drive: commands act from the next interrupt on."""
    machine, h, rows = MACHINES["servo-400w"], 5e-5, 8000
    folder = tmp_path / "motor"
    fluxobs.export(machine, h, folder, update_every=every)
    data = rotating(machine, h, 700.0, rows, noise=0.02)
    alpha, beta = data.current.T
    abc = np.stack([alpha, -alpha / 2 + beta * np.sqrt(0.75), -alpha / 2 - beta * np.sqrt(0.75)])
    commanded = np.zeros((rows, 2))
    commanded[:-2] = data.voltage[2:]  # acts over the interval that ends two interrupts later
    program = tmp_path / "drive"
    sources = [HERE / "drive.c", folder / "example_isr.c", folder / "fluxobs.c"]
    command = ["gcc", *STRICT, "-DFO_SINGLE", f"-I{folder}", *sources, "-lm", "-o", program]
    subprocess.run(command, check=True)
    gates = np.ones((rows, 1))
    gates[5000:5500] = 0  # the command is zero then, and the rotor coasts
    commanded[5000:5500] = 0
    fed = np.concatenate([abc.T, commanded, gates], axis=1).astype(np.float32)
    done = subprocess.run([program], input=fed.tobytes(), capture_output=True, check=True)
    angle = np.frombuffer(done.stdout, np.float32).astype(float)
    known = angle < 99
    assert known[4000:5000].all()
    assert known[7000:-2].all()
    assert not known[5000 + 8 * every : 5500].any()
    error = wrapped_degrees(angle - data.theta)
    assert np.sqrt(np.mean(error[4000:5000] ** 2)) < 0.05
    assert np.abs(error[:-2][known[:-2]]).max() < 3.5


# ---- the folder ----------------------------------------------------------------------------


def make(folder, *arguments):
    return subprocess.run(
        ["make", "-C", folder, "test", *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("compiler", COMPILERS)
def test_make_test_in_the_folder(tmp_path, compiler):
    fluxobs.export(MACHINES["servo-400w"], 5e-5, tmp_path / "servo", prefix="servo")
    done = make(tmp_path / "servo", f"CC={compiler}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "single: 171 of 171 rows as expected" in done.stdout
    assert "double: 171 of 171 rows as expected" in done.stdout


@pytest.mark.parametrize(
    ("name", "pattern"),
    [
        ("test/vectors.h", r"expected\[171\].*?\{(0x1\.[0-9a-f]{3})"),  # an expected flux
        ("test/vectors.h", r"expected\[171\].*?, (0x1\.[0-9a-f]{3})[^,]*\},"),  # … or speed
        ("test/vectors.h", r"samples\[SAMPLES\].*?FO_\((0x1\.[0-9a-f]{3})"),  # a measured voltage
        ("motor_observer.h", r"FO_SINGLE.*?(0x1\.[0-9a-f]{3})[0-9a-f]*p-?\d+f, /\* sample time"),
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
    done = make(tmp_path / "motor")
    assert done.returncode != 0
    assert "FAILED" in done.stdout


def test_the_last_digit_of_an_expected_angle_is_guarded(tmp_path, folders):
    shutil.copytree(folders["servo-400w"], tmp_path / "motor")
    path = tmp_path / "motor" / "test" / "vectors.h"
    lines = path.read_text().split("\n")
    row = next(n for n, line in enumerate(lines) if "expected[171]" in line) + 60
    cells = lines[row].split(", ")
    value = float.fromhex(cells[9].removesuffix("f"))
    cells[9] = hex_float(float(np.nextafter(np.float32(value), np.float32(9))), "single")
    lines[row] = ", ".join(cells)
    path.write_text("\n".join(lines))
    done = make(tmp_path / "motor")
    assert done.returncode != 0
    assert "not those that were written" in done.stdout


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        ("e->valid = e->valid && !bad;", "e->valid = e->valid || bad;"),
        ("FO_MAX_CONSECUTIVE_BAD)) {", "FO_MAX_CONSECUTIVE_BAD / 3U)) {"),
        ("TRACKER_SETTLED ((fo_real)0.1)", "TRACKER_SETTLED ((fo_real)0.11)"),
        ("VOLTAGE_LIMIT = PI / (fo_real)22.5", "VOLTAGE_LIMIT = PI / (fo_real)22"),
        ("STEP_LIMIT = (fo_real)0.15", "STEP_LIMIT = (fo_real)15"),
        ("SETTLED = (fo_real)3 * PI", "SETTLED = (fo_real)4 * PI"),
    ],
)
def test_a_change_of_the_observer_shows(tmp_path, was, becomes):
    fluxobs.export(MACHINES["servo-400w"], 1e-4, tmp_path / "motor", memory=0.01)
    sources = (tmp_path / "motor").glob("fluxobs*")
    (source,) = (path for path in sources if path.read_text().count(was) == 1)
    source.write_text(source.read_text().replace(was, becomes))
    done = make(tmp_path / "motor", "CFLAGS=-O2 -Wno-error")
    assert done.returncode != 0
    assert "FAILED" in done.stdout


@pytest.mark.parametrize("every", [2, 5])
def test_make_test_where_volt_seconds_are_gathered(tmp_path, every):
    fluxobs.export(MACHINES["servo-400w"], 5e-5, tmp_path / "motor", update_every=every)
    done = make(tmp_path / "motor")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "fo_gather" in (tmp_path / "motor" / "README.md").read_text()
    source = tmp_path / "motor" / "fluxobs.c"
    source.write_text(source.read_text().replace("(fo_real)12 *", "(fo_real)13 *"))
    assert make(tmp_path / "motor").returncode != 0


def test_precisions_do_not_mix(tmp_path, folders):
    folder = folders["servo-400w"]
    main = tmp_path / "main.c"
    main.write_text(
        '#include "motor_observer.h"\n'
        "int main(void) { fo_state s; fo_reset(&motor_observer, &s); return 0; }\n"
    )
    made = []
    for source, flags in ((main, ["-DFO_SINGLE"]), (folder / "fluxobs.c", [])):
        made.append(tmp_path / f"{source.stem}.o")
        command = ["gcc", *flags, f"-I{folder}", "-c", source, "-o", made[-1]]
        subprocess.run(command, check=True)
    linked = subprocess.run(
        ["gcc", *made, "-lm", "-o", tmp_path / "mixed"], capture_output=True, text=True, check=False
    )
    assert linked.returncode != 0
    assert "fo_reset_single" in linked.stderr


@pytest.mark.parametrize(
    ("name", "unknowns"),
    [
        ("servo-400w", ADAPTIVE),
        ("ipm-2kw2", ("drift", "resistance")),
        ("synrm-6kw7", ADAPTIVE),
    ],
)
def test_the_adaptive_observer_in_the_folder(tmp_path, name, unknowns):
    done = fluxobs.export(MACHINES[name], 1e-4, tmp_path / "motor", unknowns=unknowns)
    assert isinstance(done.observer, fluxobs.AdaptiveObserver)
    assert {path.name for path in done.folder.glob("*.[ch]")} == {
        "example_isr.c",
        "fluxobs.c",
        "fluxobs.h",
        "fluxobs_adaptive.c",
        "fluxobs_adaptive.h",
        "fluxobs_candidates.c",
        "fluxobs_candidates.h",
        "fluxobs_internal.h",
        "motor_observer.h",
    }
    said = make(done.folder)
    assert said.returncode == 0, said.stdout + said.stderr
    for precision in ("single", "double"):
        assert f"{precision}: 171 of 171 rows as expected" in said.stdout
    strict = [*STRICT, f"-I{done.folder}", "-c", done.folder / "example_isr.c"]
    subprocess.run(["gcc", *strict, "-DFO_SINGLE", "-o", tmp_path / "isr.o"], check=True)


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        ("UNMODELLED = (fo_real)0.05", "UNMODELLED = (fo_real)0.5"),
        ("s->theta = ", "s->theta = (fo_real)0.01 + "),
    ],
)
def test_a_change_of_the_adaptive_observer_shows(tmp_path, was, becomes):
    fluxobs.export(MACHINES["servo-400w"], 1e-4, tmp_path / "motor", unknowns=ADAPTIVE)
    source = tmp_path / "motor" / "fluxobs_adaptive.c"
    assert was in source.read_text()
    source.write_text(source.read_text().replace(was, becomes))
    done = make(tmp_path / "motor", "CFLAGS=-O2 -Wno-error")
    assert done.returncode != 0
    assert "FAILED" in done.stdout


def test_standard_deviations_reach_the_firmware(tmp_path):
    priors = {"resistance": 0.1, "inverter": 0.2, "psi_f": 0.001}
    done = fluxobs.export(
        MACHINES["servo-400w"], 1e-4, tmp_path / "motor", unknowns=ADAPTIVE, priors=priors
    )
    assert done.observer.resistance_std == 0.1
    assert done.observer.inverter_std == 0.2
    assert done.observer.psi_f_std == 0.001


def test_the_same_call_writes_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        fluxobs.export(MACHINES["servo-400w"], 1e-4, tmp_path / name)
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert len(files) == 10  # and LICENSE, Makefile
    for path in files:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()
    assert not any(path.name.startswith(".") for path in tmp_path.iterdir())


def test_content_changes_with_what_matters(tmp_path):
    machine = MACHINES["servo-400w"]
    first = fluxobs.export(machine, 1e-4, tmp_path / "a")
    other = fluxobs.export(machine, 1e-4, tmp_path / "b", memory=0.05)
    assert first.content != other.content
    assert first.content in (tmp_path / "a" / "motor_observer.h").read_text()
    assert first.observer.memory == 0.03


def test_every_word_of_the_templates_is_filled(folders, tmp_path):
    adaptive = tmp_path / "adaptive"
    fluxobs.export(MACHINES["servo-400w"], SAMPLE_TIME, adaptive, unknowns=ADAPTIVE)
    for folder in (*folders.values(), adaptive):
        for path in folder.rglob("*.*"):
            assert not re.search(r"@\w+@|@when", path.read_text()), path
    for folder, kind in ((folders["servo-400w"], "plain"), (adaptive, "adaptive")):
        assert cost_table(read_costs()[kind]) in (folder / "README.md").read_text()


def test_two_machines_in_one_firmware(tmp_path):
    for prefix, name in (("pump", "synrm-6kw7"), ("fan", "servo-400w")):
        fluxobs.export(MACHINES[name], 1e-4, tmp_path / prefix, prefix=prefix)
    main = tmp_path / "main.c"
    main.write_text(
        '#include "fan_observer.h"\n#include "pump_observer.h"\n'
        "int main(void)\n{\n    fo_state a, b;\n"
        "    fo_reset(&fan_observer, &a);\n    fo_reset(&pump_observer, &b);\n"
        "    return fan_observer.flux_base > pump_observer.flux_base;\n}\n"
    )
    includes = [f"-I{tmp_path / prefix}" for prefix in ("pump", "fan")]
    sources = [main, tmp_path / "fan" / "fluxobs.c"]
    command = ["gcc", *STRICT, *includes, *sources, "-lm", "-o", tmp_path / "two"]
    subprocess.run(command, check=True)
    assert subprocess.run([tmp_path / "two"], check=False).returncode == 0


def test_header_in_cpp(tmp_path, folders):
    source = tmp_path / "main.cpp"
    source.write_text('#include "motor_observer.h"\nint main() { return motor_observer.h > 1; }\n')
    command = ["g++", "-std=c++17", "-Wall", "-Wextra", "-pedantic", "-Werror", "-DFO_SINGLE"]
    folder = folders["servo-400w"]
    subprocess.run([*command, f"-I{folder}", "-c", source, "-o", tmp_path / "main.o"], check=True)


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


@pytest.mark.parametrize("name", MACHINES)
def test_the_vectors_are_a_drive_that_is_followed(name):
    """The record is no noise: where the observer says that it knows the position, it does."""
    machine = MACHINES[name]
    observer = fluxobs.LeastSquaresObserver.for_machine(machine, sample_time=1e-4)
    record = course.course(machine, observer)
    found = observer.run(record.voltage, record.current)
    error = wrapped_degrees(found.theta_e - record.theta_e)
    if machine.half_turn_ambiguous:
        error = wrapped_degrees(2 * (found.theta_e - record.theta_e)) / 2
    assert found.valid.sum() > 500
    # The quadrature of so quick a turn costs degrees where L / R is short.
    assert np.abs(error[found.valid]).max() < 5
    state, _ = observer.resume(observer.init(), record.voltage, record.current)
    counts = observer.counts(state)
    assert counts.bad_currents == counts.absurd == counts.outliers == 1
    assert counts.bad_voltages == 2


# ---- what is refused -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sample_time": 0.0}, ["sample time 0 s", "1e-4 s"]),
        ({"sample_time": -1e-4}, ["sample time -0.0001 s", "0.0001 s would do"]),
        ({"sample_time": float("nan")}, ["sample time nan"]),
        ({"sample_time": 20000.0}, ["20000 Hz is 5e-05 s"]),
        ({"sample_time": 0.05}, ["0.05 ms is 5e-05 s"]),
        ({"sample_time": 50.0}, ["50 µs is 5e-05 s", "50 kHz is 2e-05 s"]),
        ({"sample_time": 1e9}, ["in seconds"]),
        ({"current_noise": 100.0}, ["never known", "current noise 100 A"]),
        ({"memory": 5e-4}, ["memory 0.0005 s", "ten steps", "0.001 s"]),
        ({"sample_time": 0.01}, ["memory 0.03 s", "0.1 s"]),
        ({"update_every": 0}, ["update_every 0", "at least 1"]),
        ({"update_every": 50}, ["memory 0.03 s", "step every 0.005 s", "0.05 s"]),
        ({"memory": 1.0}, ["memory 1 s", "4000 steps", "0.4 s", "update_every 3"]),
        ({"unknowns": ("drift", "current-bias")}, ["find the drift", "use drift"]),
        ({"unknowns": ("current-bias",)}, ["find the drift", "use drift"]),
        ({"unknowns": ("resistance",)}, ["without the drift", "drift,resistance"]),
        ({"unknowns": ADAPTIVE, "priors": {"resistance": 1e6}}, ["resistance_std", "SI units"]),
        ({"unknowns": ADAPTIVE, "priors": {"R": 1.0}}, ["'R'", "resistance"]),
        ({"priors": {"psi_f": 0.001}}, ["needs", "drift,resistance"]),
        ({"unknowns": ("drft",)}, ["drft", "drift, current-bias"]),
        ({"unknowns": ()}, ["drift serves"]),
        ({"current_noise": 0.0}, ["current_noise must be positive"]),
        ({"drift_prior": float("inf")}, ["drift_prior must be positive and finite"]),
        ({"prefix": "2nd motor"}, ["'2nd motor'", "'motor_2nd_motor'"]),
        ({"prefix": "fo"}, ["'fo'", "'motor'"]),
    ],
)
def test_bad_settings_name_the_nearest_good_one(tmp_path, options, words):
    given = {"sample_time": 1e-4, "out": tmp_path / "motor"} | options
    with pytest.raises(FluxobsError) as error:
        fluxobs.export(MACHINES["servo-400w"], **given)
    for word in words:
        assert word in str(error.value)
    assert not list(tmp_path.iterdir())


def test_machines_that_cannot_be_exported(tmp_path):
    with pytest.raises(FluxobsError, match="machines that turn"):
        fluxobs.export(fluxobs.read_machine("maglev-knospe"), 1e-4, tmp_path / "x")
    bare = MACHINES["servo-400w"].model_copy(update={"psi_f": None, "rated_current": None})
    with pytest.raises(FluxobsError, match="lacks psi_f and rated_current"):
        fluxobs.export(bare, 1e-4, tmp_path / "x")
    wrong = MACHINES["servo-400w"].model_copy(update={"psi_f": 1e-9})
    with pytest.raises(FluxobsError, match="units"):
        fluxobs.export(wrong, 1e-4, tmp_path / "x")
    synrm = fluxobs.read_machine("synrm-6kw7")
    with pytest.raises(FluxobsError, match="find the drift"):
        fluxobs.export(synrm, 1e-4, tmp_path / "x", unknowns=("drift", "current-bias"))
    dropping = MACHINES["servo-400w"].model_copy(update={"inverter_voltage": 0.5})
    with pytest.raises(FluxobsError, match="with unknowns drift,inverter"):
        fluxobs.export(dropping, 1e-4, tmp_path / "x")


def test_nothing_is_overwritten_unasked(tmp_path, monkeypatch):
    machine = MACHINES["servo-400w"]
    fluxobs.export(machine, 1e-4, tmp_path / "motor")
    (tmp_path / "motor" / "notes.txt").write_text("mine")
    with pytest.raises(FluxobsError, match="--force"):
        fluxobs.export(machine, 1e-4, tmp_path / "motor", memory=0.05)
    again = fluxobs.export(machine, 1e-4, tmp_path / "motor", memory=0.05, force=True)
    assert again.content in (tmp_path / "motor" / "motor_observer.h").read_text()
    assert (tmp_path / "motor" / "notes.txt").read_text() == "mine"

    fluxobs.export(machine, 1e-4, tmp_path / "motor", prefix="pump", force=True)
    assert not (tmp_path / "motor" / "motor_observer.h").exists()
    assert make(tmp_path / "motor").returncode == 0

    example = tmp_path / "motor" / "example_isr.c"
    example.write_text(example.read_text() + "/* mine */\n")
    with pytest.raises(FluxobsError, match=r"example_isr\.c: changed since"):
        fluxobs.export(machine, 1e-4, tmp_path / "motor", force=True)
    assert "mine" in example.read_text()
    example.unlink()
    (tmp_path / "motor" / "axis_observer.h").write_text("mine")
    with pytest.raises(FluxobsError, match=r"axis_observer\.h: is no part"):
        fluxobs.export(machine, 1e-4, tmp_path / "motor", prefix="axis", force=True)
    assert (tmp_path / "motor" / "pump_observer.h").exists()

    victim = tmp_path / "victim"
    victim.write_text("mine")
    digest = hashlib.sha256(b"mine").hexdigest()
    manifest = tmp_path / "motor" / "MANIFEST"
    kept = manifest.read_text()
    manifest.write_text(f"{kept}{digest}  ../victim\n")
    (tmp_path / "motor" / "axis_observer.h").unlink()
    with pytest.raises(FluxobsError, match="no name within the folder"):
        fluxobs.export(machine, 1e-4, tmp_path / "motor", force=True)
    assert victim.read_text() == "mine"
    manifest.write_text(kept)

    # Interrupted half-way, the next one goes through.
    replace_file, calls = os.replace, []

    def full(source, target):
        calls.append(target)
        if len(calls) == 5:
            raise OSError(28, "No space left on device")
        replace_file(source, target)

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", full)
        with pytest.raises(FluxobsError, match="No space left"):
            fluxobs.export(machine, 1e-4, tmp_path / "motor", memory=0.02, force=True)
    fluxobs.export(machine, 1e-4, tmp_path / "motor", memory=0.02, force=True)
    assert make(tmp_path / "motor").returncode == 0

    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "fluxobs.h").write_text("vendored")
    with pytest.raises(FluxobsError, match="no earlier export"):
        fluxobs.export(machine, 1e-4, tmp_path / "home", force=True)
    assert (tmp_path / "home" / "fluxobs.h").read_text() == "vendored"

    (tmp_path / "file").write_text("mine")
    with pytest.raises(FluxobsError, match="no folder"):
        fluxobs.export(machine, 1e-4, tmp_path / "file", force=True)
    with pytest.raises(FluxobsError, match="cannot be written"):
        fluxobs.export(machine, 1e-4, tmp_path / "file" / "motor")
    (tmp_path / "empty").mkdir()
    fluxobs.export(machine, 1e-4, tmp_path / "empty")
    assert make(tmp_path / "empty").returncode == 0


def test_command_line(tmp_path):
    options = ["export", "--machine", "servo-400w", "--out", tmp_path / "motor"]
    said = fluxobs_command([*options, "--sample-time", "1e-4", "--prefix", "axis_1"])
    assert "make -C" in said
    assert (tmp_path / "motor" / "axis_1_observer.h").exists()
    assert "--force" in fluxobs_command([*options, "--sample-time", "1e-4"], code=2)
    other = ["export", "--machine", "servo-400w", "--out", tmp_path / "other"]
    assert "10 kHz" in fluxobs_command([*other, "--sample-time", "0"], code=2)
    wrong = [*other, "--sample-time", "1e-4", "--unknowns", "drft"]
    assert "drift" in fluxobs_command(wrong, code=2)
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, -1.5, 0.1, 1e-300, 5e-324, 1.7e308, 3e38])
def test_hex_floats_lose_nothing(value):
    assert float.fromhex(hex_float(value)) == value
    if abs(value) < 3.4e38:
        single = float(np.float32(value))
        assert float.fromhex(hex_float(single, "single").removesuffix("f")) == single


def test_identifiers():
    assert identifier("servo-400w") == "servo_400w"
    assert identifier("2kW2 pump!") == "motor_2kW2_pump"
    assert identifier("") == "motor"
