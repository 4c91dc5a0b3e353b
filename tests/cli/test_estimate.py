"""`fluxobs estimate`: exit codes, output and files."""

import importlib
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from fluxobs.machines import example_text
from fluxobs.observers.for_log import prepare
from support.cli import SMOOTHED, fluxobs
from support.records import SERVO, log_columns, steady

H, ROWS = 1e-4, 2500


@pytest.fixture
def folder(tmp_path):
    samples = steady(SERVO, H, 500.0, ROWS, 6j, 0.15 - 0.1j, -0.1 + 0.05j, 0.02)
    columns = log_columns(samples) | {"angle": samples.theta / SERVO.n_p}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    pl.DataFrame(columns).write_parquet(tmp_path / "log.parquet")
    (tmp_path / "motor.toml").write_text(example_text("servo-400w"))
    return tmp_path


def estimate(folder, *more, log="log.csv", out="out.parquet", lag=("--lag", "0")):
    arguments = ("estimate", log, "--machine", "motor.toml", "--out", out, "--force", *lag)
    return fluxobs(*arguments, *more, folder=folder)


def test_help_is_shown(tmp_path):
    for arguments in ((), ("estimate",), ("demo",), ("machines",)):
        done = fluxobs(*arguments, "--help", folder=tmp_path)
        assert done.returncode == 0
        assert "Usage: fluxobs" in done.stdout
    text = " ".join(fluxobs("estimate", "--help", folder=tmp_path).stdout.split())
    assert "electrical radians" in text


def test_estimate_writes_rows_summary_and_picture(folder):
    done = estimate(folder, "--truth", "theta_mech=angle", "--report", "report.png")
    assert done.returncode == 0, done.stderr
    estimates = pl.read_parquet(folder / "out.parquet")
    assert estimates.columns == [*SMOOTHED, "theta_e_error"]
    assert estimates.height == ROWS
    assert estimates["valid"][-1000:].all()
    assert estimates["theta_e_error"][-1000:].abs().max() < np.radians(2)
    assert "valid on 100.0%" in done.stdout
    assert "a voltage acts from its row on" in done.stdout
    assert "° rms on valid rows, mostly " in done.stdout
    assert "valid rows with a true value" in done.stdout
    assert "Warning" not in done.stdout
    assert (folder / "report.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in folder.iterdir() if "part" in path.name) == []


def test_csv_out_and_several_values_after_one_option(folder):
    log = pl.read_csv(folder / "log.csv").rename({"i_alpha": "ia", "i_beta": "ib"})
    log.with_columns(pl.col("ia") * 256).drop("t").write_csv(folder / "log.csv")
    done = estimate(
        folder,
        *("--frame", "alphabeta", "--sample-time", H, "--lag", "0"),
        *("--column", "i_alpha=ia", "i_beta=ib", "--scale", "i_alpha=0.00390625"),
        *("--from", "0.1", "--to", "0.2", "--truth", "none"),
        out="out.csv",
    )
    assert done.returncode == 0, done.stderr
    estimates = pl.read_csv(folder / "out.csv")
    assert estimates.columns == SMOOTHED
    assert estimates.height == 1001
    assert estimates["t"][0] == pytest.approx(0.1)
    assert estimates["valid"][-100:].all()


def test_record_file_and_override(folder):
    (folder / "record.toml").write_text(
        'lag = -1\nsample_time = 1e-4\n[truth]\ntheta_mech = "angle"\n[columns]\nt = "t"\n'
    )
    done = estimate(folder, "--record", "record.toml", lag=())
    assert "1 sample later than its row" in done.stdout
    assert "theta_e_error" in pl.read_parquet(folder / "out.parquet").columns
    assert "0, stated" in estimate(folder, "--record", "record.toml", "--lag", "0").stdout


def test_batch_size_and_format_change_nothing(folder, monkeypatch):
    """Another batch size and another file format give the same numbers."""
    estimate(folder, out="text.parquet")
    batches = []

    def in_small_batches(*arguments):
        run = replace(prepare(*arguments), batch=137)
        batches.append(run.batch)
        return run

    module = importlib.import_module("fluxobs.estimation.passes")
    monkeypatch.setattr(module, "prepare", in_small_batches)
    assert estimate(folder, log="log.parquet", out="cut.parquet").returncode == 0
    assert set(batches) == {137}
    from_text, from_batches = (pl.read_parquet(folder / f"{n}.parquet") for n in ("text", "cut"))
    assert from_text.equals(from_batches)


def test_missing_machine_values_come_from_the_log(folder):
    done = estimate(folder, out="full.parquet")
    lines = (folder / "motor.toml").read_text().splitlines()
    kept = [line for line in lines if not line.startswith(("psi_f", "rated_current"))]
    (folder / "motor.toml").write_text("\n".join(kept))
    done = estimate(folder, out="bare.parquet")
    assert done.returncode == 0, done.stderr
    full, bare = (pl.read_parquet(folder / f"{n}.parquet") for n in ("full", "bare"))
    assert bare["valid"][-1500:].all()
    difference = np.angle(np.exp(1j * (full["theta_e"] - bare["theta_e"]).to_numpy()))
    assert np.abs(difference[-1500:]).max() < np.radians(0.1)


@pytest.mark.mistakes
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_wrong_magnet_flux_is_noticed_and_harmless(folder, factor):
    text = (folder / "motor.toml").read_text()
    (folder / "motor.toml").write_text(text.replace("psi_f = 0.0125", f"psi_f = {factor * 0.0125}"))
    done = estimate(folder, "--truth", "theta_mech=angle")
    assert "psi_f in the machine file is wrong: 0.012" in done.stdout
    estimates = pl.read_parquet(folder / "out.parquet")
    assert estimates["valid"][-1500:].all()
    assert estimates["theta_e_error"][-1500:].abs().max() < np.radians(2)


def test_slow_sampling_is_warned_about(folder):
    decimated = pl.read_csv(folder / "log.csv").gather_every(20)  # 6.3 samples a period
    decimated.write_csv(folder / "log.csv")
    done = estimate(folder)
    assert "samples per electrical period" in done.stdout
    assert "Hz or more" in done.stdout


def test_missing_values_are_counted(folder):
    log = pl.read_csv(folder / "log.csv")
    gaps = (
        pl.when(pl.int_range(pl.len()).is_in([1000, 2000])).then(None).otherwise(pl.col("i_beta"))
    )
    log.with_columns(gaps.alias("i_beta")).write_csv(folder / "log.csv")
    done = estimate(folder)
    assert "2 missing (0.1 s, 0.2 s)" in done.stdout
    assert pl.read_parquet(folder / "out.parquet")["theta_e"].is_finite().all()


def test_a_long_gap_is_counted_in_full(folder):
    log = pl.read_csv(folder / "log.csv")
    gap = pl.int_range(pl.len()).is_between(1000, 1499)
    log = log.with_columns(pl.when(gap).then(None).otherwise(pl.col("u_beta")).alias("u_beta"))
    log.write_csv(folder / "log.csv")
    assert "500 missing (" in estimate(folder).stdout


def test_truth_in_degrees_is_noticed(folder):
    log = pl.read_csv(folder / "log.csv").with_columns(pl.col("angle") * 180 / np.pi)
    log.write_csv(folder / "log.csv")
    assert "angle is in degrees" in estimate(folder, "--truth", "theta_mech=angle").stdout
    scaled = estimate(folder, "--truth", "theta_mech=angle", "--scale", "theta_mech=0.0174532925")
    assert "Warning" not in scaled.stdout


def test_a_rounded_time_column_is_read_and_reported(folder):
    log = pl.read_csv(folder / "log.csv").with_columns(pl.col("t").round(3))
    log.write_csv(folder / "log.csv")
    done = estimate(folder)
    assert done.returncode == 0, done.stderr
    assert "t is rounded to 0.001 s" in done.stdout
    assert "250 ms at 10000 Hz" in done.stdout


def test_a_short_log_is_reported(folder):
    done = estimate(folder, "--to", "0.003")
    assert done.returncode == 3  # no row is valid
    assert "too short to settle" in done.stdout
    assert "NOT as given" not in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupted_run_leaves_no_file(folder, name):
    log = pl.read_parquet(folder / "log.parquet")
    long = pl.concat([log] * 800).with_columns(t=pl.int_range(pl.len()) * H)
    long.write_parquet(folder / "log.parquet")
    before = sorted(folder.iterdir())
    command = [sys.executable, "-m", "fluxobs", "estimate", "log.parquet"]
    command += ["--machine", "motor.toml", "--out", "out.parquet"]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE) as running:
        deadline = time.monotonic() + 60
        while sorted(folder.iterdir()) == before and time.monotonic() < deadline:
            time.sleep(0.02)
        time.sleep(0.5)
        running.send_signal(getattr(signal, name))
        # Learning from a segment is not interrupted; a slow computer needs minutes for all of them.
        assert running.wait(400) != 0
    assert sorted(folder.iterdir()) == before


@pytest.mark.mistakes
def test_exchanged_phases_are_suspected(folder):
    log = pl.read_csv(folder / "log.csv")
    log.with_columns(-pl.col("i_beta")).write_csv(folder / "log.csv")
    done = estimate(folder)
    assert done.returncode == 3  # no row is valid
    assert "NOT as given: the current's phases b and c are exchanged" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--lag", "5000"], "outside the record of 2500 rows"),
        (["--frame", "xyz"], "frame"),
        (["--column", "i_alpha=ia"], "no column 'ia' for the channel i_alpha; nearest: i_"),
        (["--column", "i_alfa=x"], "unknown channel 'i_alfa'; did you mean 'i_alpha'"),
        (["--column", "i_alpha"], "expected NAME=VALUE, got 'i_alpha'"),
        (["--scale", "i_alpha=big"], "'big' is not a number"),
        (["--sample-time", "1e-3"], "t advances by 0.0001 s"),
        (["--from", "9"], "the log runs from 0 s to 0.2499 s"),
        (["--memory", "1e-4"], "too short: give at least ten samples"),
        (["--report", "report.gif"], "must end in .html, .png, .pdf, .svg"),
        (["--report", "nowhere/report.png"], "the folder nowhere does not exist"),
        (["--record", "none.toml"], "none.toml: cannot be read"),
        (["--from", "nan"], "start: input should be a finite number, got nan"),
        (["--to", "inf"], "stop: input should be a finite number, got inf"),
        (["--scale", "t=1000"], "if t is in ms"),
        (["--scale", "i_alpha=0", "i_beta=0"], "the current is zero in every row"),
        (["--scale", "u_alpha=0", "u_beta=0"], "the voltage is zero in every row"),
        (["--column", "udc=540"], 'udc belongs to frame "duty"'),
        (["--truth", "angle=angle"], "truth must be one of theta_e, theta_mech, position"),
        (["--frame", "abc"], "no column 'u_a'"),
    ],
)
def test_bad_options_end_with_2_and_leave_nothing(folder, arguments, message):
    before = sorted(folder.iterdir())
    done = estimate(folder, *arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("log", "out", "machine", "message"),
    [
        ("none.csv", "out.parquet", "motor.toml", "none.csv: no such file"),
        ("log.csv", "out.xlsx", "motor.toml", "must end in .parquet or .csv"),
        ("log.csv", "nowhere/out.csv", "motor.toml", "the folder nowhere does not exist"),
        ("log.csv", "log.csv", "motor.toml", "--out is the log itself"),
        ("log.csv", "motor.toml", "motor.toml", "this is one of the inputs"),
        (".", "out.csv", "motor.toml", "this is a folder"),
        ("log.csv", "out.csv", "none.toml", "none.toml: no such machine file"),
    ],
)
def test_bad_paths_end_with_2(folder, log, out, machine, message):
    done = fluxobs("estimate", log, "--machine", machine, "--out", out, folder=folder)
    assert done.returncode == 2
    assert message in done.stderr


def test_failure_in_the_middle_leaves_the_old_file(folder):
    estimate(folder)
    before = (folder / "out.parquet").read_bytes()
    log = pl.read_csv(folder / "log.csv").with_columns(pl.col("i_beta").cast(pl.String))
    rows = log["i_beta"].to_list()
    rows[2000] = "oops"
    log.with_columns(pl.Series("i_beta", rows)).write_csv(folder / "log.csv")
    done = estimate(folder)
    assert done.returncode == 2
    assert "line 2002, column 'i_beta': 'oops' is not a number" in done.stderr
    assert (folder / "out.parquet").read_bytes() == before
    assert not list(folder.glob(".*"))


def test_machines_lists_the_shipped_machines(tmp_path):
    done = fluxobs("machines", folder=tmp_path)
    assert done.returncode == 0
    assert "servo-400w" in done.stdout
    assert "synchronous-reluctance" in done.stdout


def test_heavy_modules_are_loaded_only_when_needed(folder):
    script = (
        "import sys, fluxobs\n"
        "assert not {'jax', 'matplotlib', 'polars', 'typer'} & set(sys.modules)\n"
        "from fluxobs.cli import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code\n"
        "assert not {'jax', 'matplotlib', 'scipy'} & set(sys.modules), 'estimate'\n"
    )
    arguments = ["estimate", "log.csv", "--machine", "motor.toml", "--lag", "0", "--out", "out.csv"]
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
