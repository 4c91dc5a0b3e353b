"""`fluxobs estimate` with resistance and inverter as unknowns: exit codes, output and files."""

import re

import polars as pl
import pytest

from fluxobs.machines import example_text, read_machine
from support.cli import SMOOTHED, fluxobs
from support.records import PMSM, course, log_columns


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    columns = log_columns(course(R_s=1.3 * PMSM.R_s, inverter=6.0, smoothing=0.2))
    columns = {name: values[:16_000] for name, values in columns.items()}
    pl.DataFrame(columns).write_parquet(folder / "log.parquet")
    (folder / "motor.toml").write_text(example_text("pmsm-2kw2"))
    (folder / "synrm.toml").write_text(example_text("synrm-6kw7"))
    return folder


def estimate(folder, *more, machine="motor.toml"):
    arguments = ("log.parquet", "--machine", machine, "--out", "out.parquet", "--force", *more)
    return fluxobs("estimate", *arguments, folder=folder)


def test_columns_summary_picture_and_export_command(folder):
    options = ("--unknowns", "drift,resistance,inverter", "--prior", "psi_f=0.02")
    done = estimate(folder, *options, "--report", "report.png")
    assert done.returncode == 0, done.stderr
    estimates = pl.read_parquet(folder / "out.parquet")
    assert estimates.columns == SMOOTHED
    last = estimates.row(-1, named=True)
    assert last["resistance"] == pytest.approx(1.3 * PMSM.R_s, rel=0.05)
    assert last["inverter_voltage"] == pytest.approx(6.0, rel=0.2)
    assert abs(last["resistance"] - 1.3 * PMSM.R_s) < 4 * last["resistance_std"]
    assert re.search(r"R_s +4\.\d+ ± 0\.\d+ Ω \(file 3\.6 Ω\)", done.stdout)
    assert "(assumed 0 V)" in done.stdout
    assert (folder / "report.png").read_bytes().startswith(b"\x89PNG")
    assert "--unknowns drift,resistance,inverter --prior psi_f=0.02" in done.stdout


def test_the_plain_observer_warns_and_names_the_option(folder):
    done = estimate(folder, "--unknowns", "drift", "--causal")
    assert done.returncode == 0
    assert "Warning: The residual of the machine's relation is larger than noise" in done.stdout
    assert "R_s fits at 1.29 times" in done.stdout
    assert "--unknowns auto" in done.stdout


def test_by_default_every_unknown_is_learnt(folder):
    done = estimate(folder)
    assert done.returncode == 0
    assert "Warning" not in done.stdout
    assert re.search(r"psi_f +\d+", done.stdout)
    assert "° rms on valid rows, mostly " in done.stdout
    whole = pl.read_parquet(folder / "out.parquet")
    assert whole["resistance"][0] == pytest.approx(1.3 * PMSM.R_s, rel=0.02)
    assert whole["valid"][0]  # known from the rows behind it
    done = estimate(folder, "--causal")
    assert "drift, resistance, inverter, asymmetry" in done.stdout
    assert re.search(r"psi_f +\d+", done.stdout)
    causal = pl.read_parquet(folder / "out.parquet")
    assert causal["resistance"][0] == PMSM.R_s
    assert causal["valid"].sum() < whole["valid"].sum()


@pytest.mark.parametrize(
    ("to", "code", "message"),
    [
        ("0.12", 3, "too short to settle: at least 5 memories"),
        ("0.2", 0, "R_s: the log does not determine it"),
    ],
)
def test_a_short_log_is_reported(folder, to, code, message):
    done = estimate(folder, "--unknowns", "drift,resistance", "--causal", "--to", to)
    assert done.returncode == code
    assert message in done.stdout


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--unknowns", "drift,resistanc"), "did you mean 'resistance'"),
        (("--unknowns", "resistance"), "drift,resistance"),
        (("--unknowns", "drift,inverter,current-bias"), "together with a current bias"),
        (("--unknowns", "drift", "--prior", "resistance=1"), "not among the unknowns"),
        (("--unknowns", "drift", "--prior", "psi_f=0.01"), "requires resistance or inverter"),
        (("--unknowns", "drift,inverter", "--prior", "resistance=1"), "not among the unknowns"),
        (("--unknowns", "drift,inverter", "--prior", "R=1"), "unknown 'R'"),
        (("--unknowns", "drift,inverter", "--prior", "inverter=-1"), "not negative"),
        (("--unknowns", "drift,inverter", "--prior", "inverter=nan"), "must be finite"),
        (("--unknowns", "drift,inverter", "--prior", "inverter=1e9"), "voltage in this log"),
        (("--unknowns", "drift,resistance", "--prior", "resistance=1e6"), "10 times R_s"),
        (("--unknowns", "drift,resistance", "--prior", "psi_f=100"), "magnet flux itself"),
        (("--unknowns", "drift,resistance", "--prior", "psi_f=much"), "not a number"),
    ],
)
def test_unusable_options_are_refused(folder, more, message):
    (folder / "out.parquet").unlink(missing_ok=True)
    failed = estimate(folder, *more)
    assert failed.returncode == 2
    assert message in failed.stderr
    assert not (folder / "out.parquet").exists()


def test_a_machine_without_a_magnet_has_no_magnet_flux(folder):
    options = ("--unknowns", "drift,resistance", "--prior", "psi_f=0.1")
    failed = estimate(folder, *options, machine="synrm.toml")
    assert failed.returncode == 2
    assert "no magnets" in failed.stderr


def test_learnt_parameters_are_saved(folder):
    done = estimate(folder, "--save-machine", "learnt.toml")
    assert done.returncode == 0, done.stderr
    learnt = read_machine(folder / "learnt.toml")
    assert pytest.approx(1.3 * PMSM.R_s, rel=0.02) == learnt.R_s
    assert learnt.R_s_std == pytest.approx(0.15 * learnt.R_s, rel=0.15)  # heat
    assert learnt.inverter_voltage == pytest.approx(6.0, rel=0.1)
    assert "# ± " in (folder / "learnt.toml").read_text()
    again = estimate(folder, machine="learnt.toml")
    assert again.returncode == 0, again.stderr
    assert "Warning" not in again.stdout
    arguments = ("estimate", "log.parquet", "--machine", "motor.toml", "--out", "new.parquet")
    refused = fluxobs(*arguments, "--save-machine", "learnt.toml", folder=folder)
    assert refused.returncode == 2
    assert not (folder / "new.parquet").exists()
    assert "exists" in refused.stderr
    assert estimate(folder, "--save-machine", "learnt.toml", "--force").returncode == 0
    plain = estimate(folder, "--unknowns", "drift", "--save-machine", "none.toml")
    assert plain.returncode == 2
    assert "no parameter is identifiable" in plain.stderr
