"""What an export writes, and the command."""

import re

import fluxobs
from fluxobs.deployment.costs import cost_table, read_costs
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
        fluxobs.export(MACHINES["servo-400w"], 1e-4, tmp_path / name)
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert len(files) == 13  # and LICENSE, Makefile
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


def test_command_line(tmp_path):
    def fluxobs_command(arguments, code=0):
        done = command(*arguments, folder=tmp_path)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout if code == 0 else done.stderr

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
