"""Logs on the command line: usual mistakes and their messages."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from fluxobs.machines import example_text
from fluxobs.simulation.closed_form.demo import LOG
from support.cli import fluxobs, process

#: Clock ticks in a second of the processor times in /proc.
TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100
#: Half a second of the demo log.
DEMO = pl.read_csv(LOG).head(2500)
MACHINE = ("--machine", "servo-400w")


@pytest.fixture
def folder(tmp_path):
    DEMO.write_csv(tmp_path / "log.csv")
    (tmp_path / "motor.toml").write_text(example_text("servo-400w"))
    return tmp_path


def estimate(folder, *more, log="log.csv"):
    return fluxobs("estimate", log, *MACHINE, "--out", "out.parquet", *more, folder=folder)


def test_channels_lists_the_columns(folder):
    done = fluxobs("channels", "log.csv", folder=folder)
    assert done.returncode == 0
    for word in ("u_alpha", "5000", "truth theta_e"):
        assert word in done.stdout
    facts = json.loads(fluxobs("channels", "log.csv", "--json", folder=folder).stdout)
    assert [one["column"] for one in facts["channels"]] == DEMO.columns
    assert facts["channels"][0]["sample_time"] == pytest.approx(2e-4)


def test_names_are_shown_literally(folder):
    """[mA] is not markup, and control characters do not reach the terminal."""
    names = ["t", "i_alpha [mA]", "[/x]", "x\x1b]0;title\x07"]
    rows = ["0,1,2,3", "0.001,2,3,4", "0.002,3,4,5"]
    (folder / "x.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    done = fluxobs("channels", "x.csv", folder=folder)
    assert done.returncode == 0
    assert "i_alpha [mA]" in done.stdout
    assert "[/x]" in done.stdout
    assert "\x1b" not in done.stdout
    done = fluxobs("estimate", "x.csv", "--machine", "servo-400w", folder=folder)
    assert done.returncode == 2
    assert "\x1b" not in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text there")
def test_any_name_of_a_log_is_read_and_shown(folder):
    """Names contain invalid text, a formula, a terminal escape and a line break."""
    log = os.fsdecode(b"\x1b[31m$\\frac$\ncaf\xe9.csv")
    shown = "\\x1b[31m$\\frac$\ncaf\\xe9.csv"
    (folder / log).write_text(DEMO.write_csv())
    given = (log, "--machine", "servo-400w")
    saved = ("--save-record", f"{log}.toml", "--save-machine", f"{log}-m.toml")
    done = process("estimate", *given, *saved, "--report", "run.png", folder=folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"Written: {shown}.toml" in done.stdout
    assert "\x1b" not in done.stdout
    read = ("--record", f"{log}.toml", "--machine", f"{log}-m.toml", "--out", f"{log}.csv")
    facts = json.loads(fluxobs("estimate", log, *read, "--json", folder=folder).stdout)
    assert facts["rows"] == DEMO.height
    assert facts["written"] == [f"{log}.csv"]
    (folder / log).write_text(DEMO.head(1000).write_csv())  # shorter: these commands are slower
    for arguments in (
        ("check", *given, "--report", "check.svg"),
        ("identify", *given, "--out", "found.toml", "--report", "identify.html"),
        ("channels", log),
    ):
        done = fluxobs(*arguments, folder=folder)
        assert done.returncode in (0, 1)
        assert "\x1b" not in done.stdout
    assert shown in (folder / "identify.html").read_text(encoding="utf-8")
    done = fluxobs("estimate", f"{log}gone", *given[1:], folder=folder)
    assert done.returncode == 2
    assert f"{shown}gone: no such file" in done.stderr


def test_channels_of_a_file_without_telling_names(folder):
    DEMO.rename(dict(zip(DEMO.columns, "ABCDEF", strict=True))).write_csv(folder / "x.csv")
    done = fluxobs("channels", "x.csv", folder=folder)
    assert done.returncode == 0
    assert "--frame abc --column" in " ".join(done.stdout.split())


def test_the_first_command_needs_a_log_and_a_machine(folder):
    shutil.copy(LOG, folder / "log.csv")  # the whole demo log
    before = set(folder.iterdir())
    done = fluxobs("estimate", "log.csv", *MACHINE, folder=folder)
    assert done.returncode == 0
    assert "valid on 100.0% of the rows" in done.stdout
    assert "The estimates are not saved; to save them, add --out FILE.parquet" in done.stdout
    assert set(folder.iterdir()) == before


def test_presets_are_listed_and_printed(folder):
    names = fluxobs("presets", folder=folder).stdout
    assert "vesc-sampled" in names
    text = fluxobs("presets", "vesc-sampled", folder=folder).stdout
    assert 'frame = "abc"' in text
    refused = estimate(folder, "--preset", "px4")
    assert refused.returncode == 2
    assert "only rpm, DC voltage and DC current" in refused.stderr
    unknown = estimate(folder, "--preset", "vesc-sample")
    assert "did you mean 'vesc-sampled'" in unknown.stderr


def test_no_file_is_overwritten_without_force(folder):
    assert estimate(folder).returncode == 0
    before = (folder / "out.parquet").stat().st_mtime_ns
    again = estimate(folder)
    assert again.returncode == 2
    assert "out.parquet: exists; give another name, or --force" in again.stderr
    assert (folder / "out.parquet").stat().st_mtime_ns == before
    assert estimate(folder, "--force").returncode == 0
    (folder / "r.png").write_text("mine")
    report = estimate(folder, "--force", "--report", "r.png")
    assert report.returncode == 0
    (folder / "r.png").write_text("mine")
    for option in ("--report", "--save-record"):
        name = "r.png" if option == "--report" else "r.toml"
        (folder / name).write_text("mine")
        refused = fluxobs(
            *("estimate", "log.csv", *MACHINE, "--out", "new.parquet", option, name), folder=folder
        )
        assert refused.returncode == 2
        assert (folder / name).read_text() == "mine"
        assert not (folder / "new.parquet").exists()


@pytest.mark.parametrize("command", ["estimate", "identify"])
def test_a_file_created_during_a_run_is_kept(folder, monkeypatch, command):
    import fluxobs as library

    run = getattr(library, command)

    def slow(*given, **options):
        (folder / "r.png").write_text("mine")
        return run(*given, **options)

    monkeypatch.setattr(library, command, slow)
    (folder / "log.csv").write_text(DEMO.head(1000).write_csv())
    out = "out.parquet" if command == "estimate" else "found.toml"
    given = (command, "log.csv", *MACHINE, "--out", out, "--report", "r.png")
    refused = fluxobs(*given, folder=folder)
    assert refused.returncode == 2
    assert "r.png: exists" in refused.stderr
    assert (folder / "r.png").read_text() == "mine"


def test_quiet_and_json(folder):
    shutil.copy(LOG, folder / "log.csv")  # the whole demo log
    quiet = estimate(folder, "--quiet")
    assert (quiet.returncode, quiet.stdout) == (0, "")
    done = estimate(folder, "--json", "--force")
    facts = json.loads(done.stdout)
    assert facts["rows"] == 10_000
    assert facts["valid_share"] > 0.85
    assert facts["parameters"]["resistance"]["value"] == pytest.approx(0.36, rel=0.02)
    assert facts["error"]["rms"] < np.radians(0.5)
    assert facts["written"] == ["out.parquet"]
    checked = json.loads(fluxobs("check", "log.csv", *MACHINE, "--json", folder=folder).stdout)
    assert checked["sound"]
    done = fluxobs("identify", "log.csv", *MACHINE, "--out", "m.toml", "--json", folder=folder)
    assert json.loads(done.stdout)["parameters"]["R_s"]["std"] > 0


def test_a_record_is_saved_and_read(folder):
    renamed = DEMO.rename({"i_alpha": "Ialpha [A]", "t": "time [ms]"})
    renamed.with_columns(pl.col("time [ms]") * 1e3).write_csv(folder / "r.csv")
    done = estimate(folder, "--save-record", "r.toml", log="r.csv")
    assert done.returncode == 0, done.stderr
    assert "i_alpha = Ialpha [A]" in " ".join(done.stdout.split())
    again = estimate(folder, "--record", "r.toml", "--force", log="r.csv")
    assert "are taken as" not in again.stdout


def test_machine_new(folder):
    done = fluxobs(
        *("machine", "new", "--out", "new.toml", "--poles", "8", "--set", "R_line=0.72"),
        *("L_line=1.2e-3", "K_t=0.1061", "rated_current_rms=8.5"),
        folder=folder,
    )
    assert done.returncode == 0, done.stderr
    assert "K_t counts as rms" in done.stdout
    estimated = fluxobs(
        *("estimate", "log.csv", "--machine", "new.toml", "--out", "e.parquet"), folder=folder
    )
    assert estimated.returncode == 0, estimated.stderr
    wrong = fluxobs("machine", "new", "--out", "w.toml", "--set", "kvv=900", folder=folder)
    assert wrong.returncode == 2
    assert "did you mean 'kv'" in wrong.stderr


def wait_for_processor_time(running, seconds):
    """Wait until the process has used so much processor time: a busy machine gives it later."""
    stat = Path(f"/proc/{running.pid}/stat")
    if not stat.exists():  # not Linux
        time.sleep(seconds)
        return
    while sum(map(int, stat.read_text().rpartition(")")[2].split()[11:13])) < seconds * TICKS:
        time.sleep(0.05)
        assert running.poll() is None


@pytest.mark.parametrize("command", ["estimate", pytest.param("check", marks=pytest.mark.slow)])
def test_control_c_says_where_it_stopped(folder, command):
    long = pl.concat([DEMO] * 1600).with_columns(t=pl.int_range(pl.len()) * 2e-4)
    long.write_parquet(folder / "long.parquet")
    out = ("--out", "x.parquet") if command == "estimate" else ()
    arguments = [sys.executable, "-m", "fluxobs", command, "long.parquet", *MACHINE, *out]
    with subprocess.Popen(arguments, cwd=folder, stderr=subprocess.PIPE, text=True) as running:
        wait_for_processor_time(running, 8.0)  # of about a minute that learning takes
        running.send_signal(signal.SIGINT)
        _, stderr = running.communicate(timeout=20)
    assert running.returncode == 130
    assert "Stopped by Ctrl-C at " in stderr
    assert "Traceback" not in stderr
    assert not (folder / "x.parquet").exists()


# ---- mistakes of newcomers ---------------------------------------------------------------------

PHASES = {
    f"{letter}_{p}": (
        (DEMO[f"{letter}_alpha"].to_numpy() + 1j * DEMO[f"{letter}_beta"].to_numpy()) * turn
    ).real
    for letter in "ui"
    for p, turn in zip("abc", np.exp(-2j * np.pi / 3 * np.arange(3)), strict=True)
}
T = DEMO["t"].to_numpy()


#: Standstill with direct current: the voltage is the resistive drop.
NOISE = np.random.default_rng(0).standard_normal((3, len(T)))
STANDING = {"t": T}
for n, p in enumerate("abc"):
    STANDING[f"i_{p}"] = 3.0 * np.cos(2 * np.pi / 3 * n) + 0.02 * NOISE[n]
    STANDING[f"u_{p}"] = np.full(len(T), 0.36 * 3.0 * np.cos(2 * np.pi / 3 * n))


def csv(folder, columns, **options):
    pl.DataFrame(columns).write_csv(folder / "new.csv", **options)


MISTAKES = {
    "a folder": (None, ["."], 2, "this is a folder, not a log"),
    "a name mistyped": (None, ["lgo.csv"], 2, "lgo.csv: no such file"),
    "no header": (
        lambda f: csv(f, DEMO, include_header=False),
        ["new.csv"],
        2,
        'Name the columns with --header "t,u_a,…"',
    ),
    "names without meaning": (
        lambda f: csv(f, dict(zip("ABCDEF", DEMO, strict=True))),
        ["new.csv"],
        2,
        "--frame abc --column u_a=…",
    ),
    "only currents": (
        lambda f: csv(f, {"t": T} | {n: PHASES[n] for n in ("i_a", "i_b", "i_c")}),
        ["new.csv"],
        2,
        "no column 'u_a' for the channel u_a",
    ),
    "no time": (
        lambda f: csv(f, PHASES),
        ["new.csv"],
        2,
        "no sample time, and no column t. Give --sample-time",
    ),
    "an unknown unit": (None, ["log.csv", "--unit", "i=amps/s"], 2, "unknown unit"),
    "a unit of another quantity": (
        None,
        ["log.csv", "--unit", "i_alpha=V"],
        2,
        "that is a unit of voltage, not of current",
    ),
    "a probe in volts": (
        lambda f: csv(f, {"t": T} | {f"{n} [V]": v for n, v in PHASES.items()}),
        ["new.csv"],
        2,
        "--scale i_a=AMPERES_PER_VOLT",
    ),
    "raw counts without --adc": (
        lambda f: csv(
            f,
            {"t": T}
            | {n: np.round(2048 + 100 * v) if n[0] == "i" else v for n, v in PHASES.items()},
        ),
        ["new.csv"],
        3,
        "raw converter counts",
    ),
    "counts of a converter mistyped": (None, ["log.csv", "--adc", "i=12"], 2, "BITS,RANGE,ZERO"),
    "line voltages as phase voltages": (
        lambda f: csv(
            f,
            {"t": T}
            | PHASES
            | {
                "u_a": PHASES["u_a"] - PHASES["u_b"],
                "u_b": PHASES["u_b"] - PHASES["u_c"],
                "u_c": PHASES["u_c"] - PHASES["u_a"],
            },
        ),
        ["new.csv"],
        None,
        "line to line",
    ),
    "currents out of the machine": (
        lambda f: csv(f, {"t": T} | {n: -v if n[0] == "i" else v for n, v in PHASES.items()}),
        ["new.csv"],
        None,
        "opposite sign",
    ),
    "phases exchanged": (
        lambda f: csv(f, {"t": T} | PHASES | {"i_b": PHASES["i_c"], "i_c": PHASES["i_b"]}),
        ["new.csv"],
        None,
        "phases b and c are exchanged",
    ),
    "a log at standstill": (
        lambda f: csv(f, STANDING),
        ["new.csv"],
        3,
        "at or near standstill the flux cannot be observed",
    ),
    "too slow a logger": (
        lambda f: csv(f, DEMO.gather_every(10)),
        ["new.csv", "--memory", "0.1"],
        None,
        "samples per electrical period",
    ),
    "a log of ten rows": (lambda f: csv(f, DEMO[:10]), ["new.csv"], 2, "are too few"),
    "two recordings in one file": (
        lambda f: csv(f, pl.concat([DEMO, DEMO])),
        ["new.csv"],
        2,
        "time runs backwards",
    ),
    "a machine mistyped": (None, ["log.csv", "--machine", "servo"], 2, "no such machine file"),
    "files that do not overlap": (
        lambda f: (
            csv(f, {"t": T} | {n: PHASES[n] for n in ("i_a", "i_b")}),
            pl.DataFrame({"t": T + 99.0} | {n: PHASES[n] for n in ("u_a", "u_b", "u_c")}).write_csv(
                f / "u.csv"
            ),
        ),
        ["new.csv", "--join", "u.csv"],
        2,
        "--align auto",
    ),
    "a spreadsheet as CSV": (
        lambda f: (f / "new.csv").write_bytes(b"PK\x03\x04\x00\x00\x00\x00" * 100),
        ["new.csv"],
        2,
        "this is not text",
    ),
    "a pole count for pole pairs": (
        lambda f: (f / "m.toml").write_text(
            example_text("servo-400w").replace("n_p = 4", "n_p = 8")
        ),
        ["log.csv", "--machine", "m.toml", "--truth", "none"],
        0,
        "the direction of rotation and n_p cannot be told",
    ),
}


#: tests/checking tests the search on these logs; one of its findings is enough here.
SEARCHED = ("line voltages as phase voltages", "currents out of the machine")


@pytest.mark.mistakes
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if n in SEARCHED else ()) for n in MISTAKES],
)
def test_a_newcomers_mistake_is_named(folder, name):
    write_log, arguments, code, message = MISTAKES[name]
    if write_log is not None:
        write_log(folder)
    log, *more = arguments
    machine = () if "--machine" in more else MACHINE
    done = fluxobs("estimate", log, *machine, "--out", "o.parquet", *more, folder=folder)
    output = " ".join((done.stdout + done.stderr).split())
    assert message in output, output
    assert code is None or done.returncode == code, output
    assert "Traceback" not in output
    if done.returncode == 2:
        assert not (folder / "o.parquet").exists()
