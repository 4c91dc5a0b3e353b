"""fo_step_for: steps of different durations."""

import subprocess

import numpy as np
import pytest

import fluxobs
from support.compiling import build_program
from support.firmware import HARNESS, STRICT, firmware_objects
from support.records import MACHINES, wrapped_degrees

SAMPLE_TIME, SPEED, ROWS = 1e-4, 600.0, 6000
ADAPTIVE = "drift,resistance,inverter"


@pytest.fixture(scope="module", params=["drift", ADAPTIVE], ids=["plain", "adaptive"])
def program(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("uneven") / "motor"
    # Known, since unidentifiable at constant speed and load.
    small = {"resistance": 0.01, "inverter": 0.01}
    priors = small if request.param == ADAPTIVE else None
    machine = MACHINES["servo-400w"]
    fluxobs.export(machine, SAMPLE_TIME, folder, unknowns=request.param, priors=priors)
    sources = [HARNESS / "uneven.c", *firmware_objects(folder.glob("*obs*.c"))]
    kind = [] if request.param == "drift" else ["-DADAPTIVE"]
    executable = folder.parent / "uneven"
    return build_program(["gcc"], [*STRICT, *kind, f"-I{folder}"], sources, executable)


def record(duration, noise=0.005):
    """Return true angle and rows of a servo at constant speed, with exact interval means."""
    machine = MACHINES["servo-400w"]
    t = np.concatenate([[0.0], np.cumsum(duration)])
    rotor = np.exp(1j * SPEED * t)
    current = 0.3j * machine.rated_current * rotor
    flux = machine.L_s * current + machine.psi_f * rotor
    integral = current / (1j * SPEED)
    voltage = (np.diff(flux) + machine.R_s * np.diff(integral)) / duration
    rng = np.random.default_rng(4)
    white = rng.normal(size=(len(duration), 2)) @ [1, 1j]
    measured = current[1:] + machine.rated_current * (0.01 + noise * white)
    rows = [duration, voltage.real, voltage.imag, measured.real, measured.imag]
    return np.angle(rotor[1:]), np.stack(rows, axis=1)


def replay(program, rows):
    done = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=True)
    return np.frombuffer(done.stdout).reshape(-1, 4).T


def test_jitter_costs_no_accuracy(program):
    rng = np.random.default_rng(7)
    settled = slice(ROWS // 3, None)
    spread = {}
    for name, duration in {
        "even": np.full(ROWS, SAMPLE_TIME),
        "uneven": SAMPLE_TIME * rng.uniform(0.4, 1.6, ROWS),
        "slower": SAMPLE_TIME * rng.uniform(1.5, 2.5, ROWS),
    }.items():
        true, rows = record(duration)
        theta, std, speed, valid = replay(program, rows)
        error = np.abs(wrapped_degrees(theta - true))[settled]
        assert valid[settled].all(), name
        assert (error < np.degrees(3.5 * std[settled])).mean() > 0.99, name
        assert abs(speed[settled] / SPEED - 1).max() < 0.05, name
        spread[name] = np.sqrt(np.mean(error**2))
    assert spread["uneven"] < 1.3 * spread["even"]
    assert spread["slower"] < 2 * spread["even"]


def test_a_gap_restarts(program):
    duration = np.full(ROWS, SAMPLE_TIME)
    duration[ROWS // 2] = 30 * SAMPLE_TIME  # the loop was busy
    duration[ROWS // 2 + 2000] = np.nan
    true, rows = record(np.nan_to_num(duration, nan=SAMPLE_TIME))
    rows[:, 0] = duration
    theta, std, _, valid = replay(program, rows)
    for gap in (ROWS // 2, ROWS // 2 + 2000):
        assert valid[gap - 1]
        assert not valid[gap]
        assert not valid[gap : gap + 50].any()
    error = np.radians(np.abs(wrapped_degrees(theta - true)))
    settled = (valid > 0) & (np.arange(ROWS) > 500)
    assert (error[settled] < 5 * std[settled]).all()
    assert valid[ROWS // 2 + 1500]
