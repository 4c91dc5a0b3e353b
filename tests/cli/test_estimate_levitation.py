"""`fluxobs estimate` for levitated bodies and current bias: exit codes, output and files."""

import subprocess
import sys

import numpy as np
import polars as pl
import pytest

from fluxobs.machines import example, example_text
from fluxobs.research.paper.levitation import SCENARIOS, record
from support.cli import fluxobs
from support.records import steady


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return logs of a levitation (12 s at 500 Hz, noise 0.1 mA, 1 mV) and a reluctance motor."""
    path = tmp_path_factory.mktemp("logs")
    scenario, machine = record(SCENARIOS["S5"], quick=True), example("maglev-knospe")
    decimation, rows = 2, 6000
    indices = np.arange(rows + 1) * decimation
    sums = np.cumsum(scenario.volt_seconds, axis=0)[indices]
    h, current = decimation * scenario.h, scenario.current
    # Mean voltage from each row to the next row, as a drive commands.
    mean = np.array([current[a : a + decimation + 1].mean(axis=0) for a in indices[:-1]])
    voltage = (np.diff(sums, axis=0) / h + mean @ machine.R.T) @ np.linalg.inv(machine.B.T)
    noise = np.random.default_rng(1).standard_normal((2, rows, 2))
    voltage, measured = voltage + 1e-3 * noise[0], current[indices[:-1]] + 1e-4 * noise[1]
    columns = {
        "t": scenario.t[indices[:-1]],
        "u_1": voltage[:, 0],
        "u_2": voltage[:, 1],
        "i_1": measured[:, 0],
        "i_2": measured[:, 1],
        "y": scenario.trajectory.position[indices[:-1], 0],
    }
    pl.DataFrame(columns).write_csv(path / "maglev.csv")
    samples = steady(
        example("synrm-6kw7"),
        1e-4,
        300 + 100 * np.sin(np.arange(4000) / 300),
        4000,
        9 + 9j,
        current_bias=0.3,
    )
    columns = {
        "t": np.arange(4000) * 1e-4,
        "u_alpha": np.roll(samples.voltage[:, 0], -1),
        "u_beta": np.roll(samples.voltage[:, 1], -1),
        "i_alpha": samples.current[:, 0],
        "i_beta": samples.current[:, 1],
        "theta": samples.theta,
    }
    pl.DataFrame(columns).write_parquet(path / "synrm.parquet")
    return path


def test_levitation_from_a_log(folder):
    done = fluxobs(
        *("estimate", "maglev.csv", "--machine", "maglev-knospe", "--out", "out.parquet"),
        *("--truth", "position=y", "--report", "report.png"),
        folder=folder,
    )
    assert done.returncode == 0, done.stderr
    assert "drift; memory 0.15 s" in done.stdout
    assert "µm rms" in done.stdout
    estimates = pl.read_parquet(folder / "out.parquet")
    assert estimates.columns == [
        *("t", "flux_1", "flux_2", "flux_1_std", "flux_2_std", "position", "position_std"),
        *("drift_1", "drift_2", "noise_share", "valid", "position_error"),
    ]
    assert len(estimates) == 6000
    valid = estimates.filter("valid")
    assert len(valid) > 0.8 * len(estimates)
    # The gap is 330 µm; current biases alone cause an error of some µm.
    assert np.sqrt((valid["position_error"] ** 2).mean()) < 8e-6
    assert (folder / "report.png").stat().st_size > 10_000


def test_current_bias_of_a_levitation(folder):
    done = fluxobs(
        *("estimate", "maglev.csv", "--machine", "maglev-knospe", "--out", "bias.csv"),
        *("--unknowns", "drift,current-bias"),
        folder=folder,
    )
    assert done.returncode == 0, done.stderr
    # The bias moves the position by 8 µm in a gap of 330 µm: too little to identify.
    assert "current bias  the log does not determine it" in done.stdout
    assert "use --unknowns drift, which ignores the bias" in done.stdout
    names = pl.read_csv(folder / "bias.csv").columns
    assert {"current_bias_1", "current_bias_2", "current_bias_1_std"} <= set(names)


def test_current_bias_of_a_reluctance_machine(folder):
    done = fluxobs(
        *("estimate", "synrm.parquet", "--machine", "synrm-6kw7", "--out", "synrm-out.parquet"),
        *("--unknowns", "drift,current-bias", "--truth", "theta_e=theta"),
        folder=folder,
    )
    assert done.returncode == 3, done.stderr  # no row is valid
    estimates = pl.read_parquet(folder / "synrm-out.parquet")
    assert {"theta_e", "theta_e_std", "current_bias_alpha", "theta_e_error"} <= set(
        estimates.columns
    )
    assert np.abs(estimates["theta_e_error"][-500:]).max() < np.radians(3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["maglev.csv", "--machine", "servo-400w", "--unknowns", "drift,current-bias"],
            "maglev.csv: currents and voltages are not found",
        ),
        (["maglev.csv", "--machine", "maglev-knospe", "--unknowns", "bias"], "unknown 'bias'"),
        (["maglev.csv", "--machine", "maglev-knospe", "--unknowns", ","], "one or more of drift"),
        (["maglev.csv", "--machine", "maglev-knospe", "--frame", "abc"], "does not fit kind magl"),
        (["maglev.csv", "--machine", "servo-400w", "--frame", "ports"], "does not fit kind surf"),
        (
            ["maglev.csv", "--machine", "maglev-knospe", "--truth", "theta_e=y"],
            "does not fit kind maglev-2dof; use position",
        ),
        (
            ["maglev.csv", "--machine", "maglev-knospe", "--memory", "0.01"],
            "memory 0.01 s is too short",
        ),
        (
            ["synrm.parquet", "--machine", "synrm-6kw7", "--truth", "position=t"],
            "theta_mech or theta_e",
        ),
    ],
)
def test_bad_options_end_with_2_and_leave_nothing(folder, arguments, message):
    done = fluxobs("estimate", *arguments, "--out", "bad.parquet", folder=folder)
    assert done.returncode == 2
    assert message in done.stderr
    assert not (folder / "bad.parquet").exists()


def test_unidentifiable_unknowns_are_refused_with_their_direction(folder):
    done = fluxobs(
        *("estimate", "synrm.parquet", "--machine", "servo-400w", "--out", "bad.parquet"),
        *("--unknowns", "drift,current-bias"),
        folder=folder,
    )
    assert done.returncode == 2
    assert "cannot both be estimated for kind surface-pmsm" in done.stderr
    assert "(0.0006, 0) Wb in the flux with (1, 0) A in the current" in done.stderr
    assert "position and speed have no error" in done.stderr


def test_machine_file_of_a_levitation(tmp_path):
    (tmp_path / "bad.toml").write_text(example_text("maglev-knospe").replace("k_2", "k2"))
    (tmp_path / "log.csv").write_text("t,u_1\n")
    done = fluxobs(
        *("estimate", "log.csv", "--machine", "bad.toml", "--out", "out.csv"), folder=tmp_path
    )
    assert done.returncode == 2
    assert "unknown field 'k2'; did you mean 'k_2'?" in done.stderr
    assert "R is missing" not in done.stderr


def test_without_jax_reproduce_says_what_to_install(tmp_path):
    """Without JAX, `fluxobs reproduce` names the extra to install."""
    script = (
        "import sys, importlib.util as u\n"
        "find = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'jax' else find(name, *a)\n"
        "sys.argv = ['fluxobs', 'reproduce', '--quick']\n"
        "from fluxobs.cli import main\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "jax not installed: install the extra with pip install 'fluxobs[design]'" in done.stderr
    assert not (tmp_path / "fluxobs-paper").exists()


def test_levitation_estimates_never_load_jax(folder):
    script = (
        "import sys\n"
        "sys.argv = ['fluxobs', 'estimate', 'maglev.csv', '--machine', 'maglev-knospe', '--out',"
        " 'out.csv', '--to', '1']\n"
        "from fluxobs.cli import main\n"
        "main()\n"
        "assert not {'jax', 'equinox', 'matplotlib', 'scipy'} & set(sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
