"""The exported C sources return the library's numbers on whole records."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import fluxobs
from fluxobs.deployment.vectors import COLUMNS, expected
from fluxobs.simulation.closed_form.demo import LOG
from support.cli import fluxobs as command
from support.firmware import (
    COMPILERS,
    HARNESS,
    SANITIZERS,
    STRICT,
    Compiled,
    replayed,
)
from support.records import CURRENTS, MACHINES, steady, wrapped_degrees

SAMPLE_TIME = 1e-4
CPU = Path("/proc/cpuinfo").read_text().split() if Path("/proc/cpuinfo").exists() else []


def all_records(name):
    """Yield whole records of a machine: biased and noisy, with a stop, and with all bad samples."""
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
    plain = steady(machine, SAMPLE_TIME, 500.0, rows, **biased)
    stopped = steady(machine, SAMPLE_TIME, stop, rows, **biased)
    u, i = plain.voltage.copy(), plain.current.copy()
    rng = np.random.default_rng(3)
    for values, absurd in ((u, 1e12), (i, 1e9)):
        bad = rng.choice(rows, 300)
        values[bad, rng.integers(0, 2, 300)] = rng.choice(
            [np.nan, np.inf, -np.inf, absurd, 0.0, 3 * rated], 300
        )
    yield plain.voltage, plain.current
    yield stopped.voltage, stopped.current
    yield u, i


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    return Compiled(tmp_path_factory.mktemp("compiled"))


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("precision", ["single", "double"])
def test_software_in_the_loop(folders, compiled, name, compiler, precision):
    program = compiled.program(folders[name], compiler, precision)
    observer = fluxobs.LeastSquaresObserver.for_machine(
        MACHINES[name], sample_time=SAMPLE_TIME, precision=precision
    )
    for voltage, current in all_records(name):
        replay = replayed(program, voltage, current)
        np.testing.assert_array_equal(replay, expected(observer.run(voltage, current)))


@pytest.mark.parametrize("name", MACHINES)
def test_single_precision_within_the_documented_bound(folders, compiled, name):
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
def test_fused_multiply_adds_stay_within_the_documented_bound(folders, compiled, name):
    program = compiled.program(folders[name], ["gcc"], "single", ["-ffp-contract=fast", "-mfma"])
    observer = fluxobs.LeastSquaresObserver.for_machine(MACHINES[name], sample_time=SAMPLE_TIME)
    for voltage, current in list(all_records(name))[:2]:
        fused, double = replayed(program, voltage, current), observer.run(voltage, current)
        both = (fused[:, COLUMNS.index("valid")] > 0) & double.valid
        assert both.sum() > 1000
        assert np.abs(fused[:, :2] - double.flux)[both].max() < 1e-4 * observer.flux_base
        assert (
            np.abs(wrapped_degrees(fused[:, COLUMNS.index("theta_e")] - double.theta_e))[both].max()
            < 0.05
        )


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["single", "double"])
def test_sanitizers_over_all_records(folders, compiled, precision):
    for name in MACHINES:
        program = compiled.program(folders[name], ["gcc"], precision, SANITIZERS)
        for voltage, current in all_records(name):
            assert np.isfinite(replayed(program, voltage, current)).all()


def test_the_firmware_returns_the_estimates_of_a_log(compiled, tmp_path):
    """An export with the options that `fluxobs estimate` prints gives its numbers bit for bit."""
    log = LOG
    done = command(
        *("estimate", log, "--machine", "servo-400w", "--out", "e.parquet"),
        *("--unknowns", "drift", "--causal"),
        folder=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    options = re.search(r"fluxobs export (.*) --out", done.stdout).group(1).split()
    done = command("export", *options, "--out", "motor", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    table = pl.read_csv(str(log))
    voltage = table.select("u_alpha", "u_beta").to_numpy()
    current = table.select("i_alpha", "i_beta").to_numpy()
    late = np.concatenate(
        [[[np.nan, np.nan]], voltage[:-1]]
    )  # lag 0: a voltage acts from its row to the next row
    replay = replayed(compiled.program(tmp_path / "motor", ["gcc"], "double"), late, current)
    estimate = pl.read_parquet(tmp_path / "e.parquet")
    for column, name in ((0, "flux_alpha"), (2, "psi_f"), (3, "theta_e"), (5, "speed_e")):
        np.testing.assert_array_equal(replay[:, column], estimate[name].to_numpy())


@pytest.mark.parametrize("every", [1, 4])
def test_the_example_interrupt_follows_a_drive(tmp_path, every):
    """The exported example runs in a drive whose commands act from the next interrupt on."""
    machine, h, rows = MACHINES["servo-400w"], 5e-5, 8000
    folder = tmp_path / "motor"
    fluxobs.export(machine, h, folder, update_every=every, unknowns="drift")
    data = steady(machine, h, 700.0, rows, noise=0.02)
    alpha, beta = data.current.T
    abc = np.stack([alpha, -alpha / 2 + beta * np.sqrt(0.75), -alpha / 2 - beta * np.sqrt(0.75)])
    commanded = np.zeros((rows, 2))
    commanded[:-2] = data.voltage[2:]  # acts over the interval that ends two interrupts later
    program = tmp_path / "drive"
    sources = [HARNESS / "drive.c", folder / "example_isr.c", folder / "fluxobs.c"]
    sources += [folder / "motor_observer.c"]
    flags = [*STRICT, f"-I{folder}"]
    subprocess.run(["gcc", *flags, *sources, "-lm", "-o", program], check=True)
    gates = np.ones((rows, 1))
    gates[5000:5500] = 0  # the command is zero, and the rotor coasts
    commanded[5000:5500] = 0
    inputs = np.concatenate([abc.T, commanded, gates], axis=1).astype(np.float32)
    done = subprocess.run([program], input=inputs.tobytes(), capture_output=True, check=True)
    angle = np.frombuffer(done.stdout, np.float32).astype(float)
    valid = angle < 99
    assert valid[4000:5000].all()
    assert valid[7000:-2].all()
    assert not valid[5000 + 8 * every : 5500].any()
    error = wrapped_degrees(angle - data.theta)
    assert np.sqrt(np.mean(error[4000:5000] ** 2)) < 0.05
    assert np.abs(error[:-2][valid[:-2]]).max() < 3.5
