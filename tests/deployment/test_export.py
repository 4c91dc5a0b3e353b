"""Files of an export, and the command `fluxobs export`."""

import re
import shlex

import numpy as np
import polars as pl
import pytest

import fluxobs
from fluxobs.deployment.costs import cost_table, read_costs
from fluxobs.machines import RotatingMachine, example, example_names
from support.cli import fluxobs as command
from support.records import MACHINES

SAMPLE_TIME = 1e-4
ADAPTIVE = ("drift", "resistance", "inverter")


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
        fluxobs.export(MACHINES["servo-400w"], 1e-4, tmp_path / name, unknowns="drift")
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert len(files) == 31  # and LICENSE, Makefile
    for path in files:
        assert (tmp_path / "a" / path).read_bytes() == (tmp_path / "b" / path).read_bytes()
    assert not any(path.name.startswith(".") for path in tmp_path.iterdir())


def test_content_changes_with_the_settings(tmp_path):
    machine = MACHINES["servo-400w"]
    first = fluxobs.export(machine, 1e-4, tmp_path / "a", unknowns="drift")
    other = fluxobs.export(machine, 1e-4, tmp_path / "b", memory=0.05, unknowns="drift")
    assert first.content != other.content
    assert first.content in (tmp_path / "a" / "motor_observer.h").read_text()
    assert first.observer.memory == 0.03


def test_every_placeholder_of_the_templates_is_filled(folders, tmp_path):
    adaptive = tmp_path / "adaptive"
    fluxobs.export(MACHINES["servo-400w"], SAMPLE_TIME, adaptive, unknowns=ADAPTIVE)
    for folder in (*folders.values(), adaptive):
        for path in folder.rglob("*.*"):
            if path.suffix != ".bin":
                assert not re.search(r"@\w+@|@when", path.read_text()), path
    for folder, kind in ((folders["servo-400w"], "plain"), (adaptive, "adaptive")):
        assert cost_table(read_costs()[kind]) in (folder / "README.md").read_text()


def test_command_line(tmp_path):
    def fluxobs_command(arguments, code=0):
        done = command(*arguments, folder=tmp_path)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout if code == 0 else done.stderr

    options = ["export", "--machine", "servo-400w", "--out", tmp_path / "motor"]
    output = fluxobs_command([*options, "--sample-time", "1e-4", "--prefix", "axis_1"])
    assert "make -C" in output
    assert (tmp_path / "motor" / "axis_1_observer.h").exists()
    assert "--force" in fluxobs_command([*options, "--sample-time", "1e-4"], code=2)
    other = ["export", "--machine", "servo-400w", "--out", tmp_path / "other"]
    assert "10 kHz" in fluxobs_command([*other, "--sample-time", "0"], code=2)
    wrong = [*other, "--sample-time", "1e-4", "--unknowns", "drft"]
    assert "drift" in fluxobs_command(wrong, code=2)
    assert not (tmp_path / "other").exists()


#: Pairs that differ in code path; the others are slow.
QUICK = {(1e-4, 1, ADAPTIVE), (2e-5, 4, "drift")}
RATES = [(1e-4, 1), (2e-5, 4), (2e-5, 1), (5e-5, 1), (2e-4, 1), (5e-5, 4), (1e-4, 4)]


@pytest.mark.parametrize(
    ("sample_time", "every", "unknowns"),
    [
        pytest.param(*rates, u, marks=() if (*rates, u) in QUICK else pytest.mark.slow)
        for rates in RATES
        for u in ("drift", ADAPTIVE)
    ],
)
def test_a_record_for_any_sample_time(tmp_path, sample_time, every, unknowns):
    """For each shipped machine the record has enough rows for a valid position."""
    for name in example_names():
        if isinstance(example(name), RotatingMachine):
            folder = tmp_path / name
            done = fluxobs.export(name, sample_time, folder, unknowns=unknowns, update_every=every)
            steps = done.observer.memory / (every * sample_time)
            text = (folder / "test" / "vectors.h").read_text()
            rows = int(re.search(r"SAMPLES = (\d+)", text).group(1))
            assert rows >= min(3.5 * steps, 1540)


def test_the_command_that_estimate_prints_exports_that_observer(tmp_path):
    """The export command that estimate recommends for a log at 20 kHz works."""
    t = 5e-5 * np.arange(20_000)
    demo = pl.read_csv(fluxobs.demo_log().path)[:5000]  # as if the drive ran four times as fast
    columns = {name: demo[name].to_numpy() for name in demo.columns}
    old = columns.pop("t")
    columns = {name: np.interp(t, old, values) for name, values in columns.items()}
    columns.pop("theta_e")
    pl.DataFrame({"t": t} | columns).write_csv(tmp_path / "log.csv")
    output = command("estimate", "log.csv", "--machine", "servo-400w", folder=tmp_path).stdout
    line = next(line for line in output.splitlines() if "fluxobs export" in line)
    arguments = shlex.split(line[line.index("fluxobs export") :])[1:]
    assert "--unknowns" in arguments
    done = command(*arguments[:-1], "motor", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "motor" / "motor_observer.h").exists()
