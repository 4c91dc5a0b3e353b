"""Identification of one machine from many logs, and the logs that disagree."""

from __future__ import annotations

import json
import shutil
from functools import partial

import numpy as np
import polars as pl
import pytest

from fluxobs import FluxobsError, read_log, read_machine
from fluxobs.identification.identify import combine
from fluxobs.identification.pooled import identify_many
from fluxobs.machines.file_text import machine_text
from support.cli import fluxobs
from support.records import COURSE_TIME, PMSM, course, driven, log_columns, profile

R_S, PSI_F = 1.1 * PMSM.R_s, 0.97 * PMSM.psi_f


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pooled")


def day(k):
    R = R_S * (1.2 if k == 5 else 1 + 0.004 * (k - 2))
    bias = 0.3 * np.exp(1j * k)
    return course(R_s=R, psi_f=PSI_F, inverter=4.0, voltage_bias=bias, seed=k)


SPEED = profile((0, 236), (1.5, 236))
FLAT = np.full(len(SPEED), 4j)
#: Logs: six of one motor (once hot), one steady, one of another motor, one at rest.
LOGS = {
    **{f"day{k}": partial(day, k) for k in range(6)},
    "steady": lambda: driven(PMSM, COURSE_TIME, SPEED, FLAT, R_s=R_S, psi_f=PSI_F, noise=0.02),
    "other": lambda: course(R_s=R_S, psi_f=0.8 * PMSM.psi_f, inverter=4.0),
    "still": lambda: driven(PMSM, COURSE_TIME, 0 * SPEED, FLAT, R_s=R_S, noise=0.02),
}


def write(folder, *names):
    for name in names:
        if name in LOGS and not (folder / f"{name}.parquet").exists():
            pl.DataFrame(log_columns(LOGS[name]())).write_parquet(folder / f"{name}.parquet")


def together(folder, *names, **options):
    write(folder, *names)
    paths = [folder / f"{name}.parquet" for name in names]
    return identify_many(paths, PMSM, workers=1, scheduler="pool", **options)


@pytest.mark.slow
def test_the_machine_of_all_and_the_logs_that_disagree(folder):
    names = [f"day{k}" for k in range(6)]
    pooled = together(folder, *names, "steady", "other", "still")
    values = {parameter.name: parameter for parameter in pooled.together.parameters}
    assert values["R_s"].value == pytest.approx(1.03 * R_S, rel=0.05)  # includes the hot one
    assert {log.log for log in pooled.disagreeing} == {"day5.parquet", "other.parquet"}
    hot, other = pooled.disagreeing
    assert set(hot.apart) == {"R_s"}
    assert hot.apart["R_s"][0] == pytest.approx(0.2 * R_S, rel=0.15)
    assert "copper +5" in hot.words or "copper +4" in hot.words
    assert "psi_f" in other.apart
    assert "another motor" in other.words
    still = pooled.alone[-1]
    assert "still.parquet" in still.words
    assert still.failed


def test_logs_that_agree_are_within_their_deviations(folder):
    pooled = together(folder, "day1", "day2", "day3")
    assert "3 logs agree" in pooled.lines()
    values = {parameter.name: parameter for parameter in pooled.together.parameters}
    for name, true in (("R_s", R_S), ("psi_f", PSI_F), ("inverter", 4.0)):
        assert abs(values[name].value - true) < 4 * values[name].std + 0.005 * true
        assert values[name].std < (0.2 if name == "inverter" else 0.09) * true


def test_an_error_counts_the_logs():
    """No log identifies the parameter, so all logs together do not identify it either."""
    columns = dict.fromkeys(("u_alpha", "u_beta", "i_alpha", "i_beta"), np.arange(50.0))
    logs = 3 * [read_log(columns, sample_time=1e-4, lag=0)]
    with pytest.raises(FluxobsError, match="and 2 more: this log identifies none of R_s"):
        combine(logs, PMSM, ["R_s"], [{}, {}, {}])


def test_no_usable_log_is_an_error(folder):
    with pytest.raises(FluxobsError, match="none of 2 logs identifies a parameter"):
        together(folder, "still", "gone")


@pytest.mark.slow
def test_a_single_usable_log_is_not_compared(folder, tmp_path):
    pooled = together(folder, "day1", "still")
    assert [log.log for log in pooled.failed] == ["still.parquet"]
    assert pooled.lines()[-1] == "Only one log is usable: there is no other to compare it with"
    copy = tmp_path / "copy.parquet"
    shutil.copy(folder / "day1.parquet", copy)
    days = [folder / "day1.parquet", copy]
    with pytest.raises(FluxobsError, match="all other logs are copies of this one"):
        identify_many(days, PMSM, workers=1, scheduler="pool")
    write(folder, "day2")
    days.append(folder / "day2.parquet")
    pooled = identify_many(days, PMSM, workers=1, scheduler="pool")
    assert pooled.twice == {str(copy): str(folder / "day1.parquet")}
    assert [log.log for log in pooled.alone] == ["day1.parquet", "day2.parquet"]
    assert f"{copy} is a copy of {folder}/day1.parquet: it counts once" in pooled.lines()


@pytest.mark.slow
def test_the_command(folder, tmp_path):
    write(folder, *LOGS)
    machine = tmp_path / "motor.toml"
    machine.write_text(machine_text(PMSM, ["A motor."], {}))
    done = fluxobs(
        *("identify", folder / "day*.parquet", "--machine", machine, "--out", "found.toml"),
        *("--workers", "1", "--scheduler", "pool"),
        folder=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert "Disagrees with the others: day5.parquet: R_s = " in done.stdout
    assert read_machine(tmp_path / "found.toml").R_s == pytest.approx(1.03 * R_S, rel=0.05)
    two = (folder / "day1.parquet", folder / "still.parquet", "--machine", machine)
    done = fluxobs(
        *("identify", *two, "--out", "two.toml", "--json", "--scheduler", "pool"), folder=tmp_path
    )
    assert done.returncode == 1  # the second log identifies nothing
    facts = json.loads(done.stdout)
    assert [log["log"] for log in facts["logs"]] == ["day1.parquet", "still.parquet"]
