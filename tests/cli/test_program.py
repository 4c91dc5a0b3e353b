"""The program as a whole: version, help, option names, exit codes, typed use from Python."""

import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import fluxobs as library
from fluxobs.logs import Layout
from fluxobs.simulation.closed_form.demo import LOG
from support.cli import fluxobs, process

ROOT = Path(__file__).parents[2]
COMMANDS = (
    *("estimate", "check", "channels", "identify", "compare", "export"),
    *("machines", "presets", "demo", "reproduce"),
)


def python(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", *map(str, arguments)], capture_output=True, text=True, **options
    )


def test_version():
    done = python("fluxobs", "--version")
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert done.stdout.strip() == f"fluxobs {pyproject['project']['version']}"
    assert library.__version__ == pyproject["project"]["version"]


def test_the_first_screen_shows_an_example():
    screen = python("fluxobs", "--help", env={"COLUMNS": "80", "PATH": ""}).stdout.split("\n")[:24]
    assert any("fluxobs estimate LOG.csv --machine motor.toml" in line for line in screen)


def test_options_are_named_like_the_fields():
    """Every field of the layout is an option with the same name."""
    text = python("fluxobs", "estimate", "--help", env={"COLUMNS": "200", "PATH": ""}).stdout
    for name in Layout.model_fields:
        if name not in ("udc", "note"):  # --column udc=540
            assert f"--{name.replace('_', '-')}" in text, name


def test_both_names_of_an_option_are_equivalent(tmp_path):
    tables = []
    for names in (("--column", "--from", "--to"), ("--columns", "--start", "--stop")):
        out = tmp_path / f"{len(tables)}.csv"
        column, start, stop = names
        done = fluxobs(
            *("estimate", LOG, "--machine", "servo-400w", "--out", out),
            *(column, "u_alpha=u_alpha", "i_beta=i_beta", start, 0.1, stop, 0.5),
            folder=tmp_path,
        )
        assert done.returncode == 0, done.stderr
        tables.append(out.read_text())
    assert tables[0] == tables[1]
    assert tables[0].count("\n") == 2002


@pytest.mark.parametrize("command", COMMANDS[:6])
def test_help_shows_an_example(tmp_path, command):
    done = fluxobs(command, "--help", folder=tmp_path)
    assert done.returncode == 0
    text = " ".join(done.stdout.split())
    assert f"Example: fluxobs {command} " in text


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(tmp_path, command):
    done = fluxobs(command, "--help", folder=tmp_path)
    assert done.returncode == 0
    assert f"Usage: fluxobs {command}" in done.stdout
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_priors_is_another_name_of_prior(tmp_path):
    tables = []
    for name in ("--prior", "--priors"):
        out = f"{len(tables)}.parquet"
        done = fluxobs(
            *("estimate", LOG, "--machine", "servo-400w", "--out", out, "--to", "0.3"),
            *("--unknowns", "drift,resistance", name, "resistance=0.1", "psi_f=0.001"),
            *("--lag", "0"),
            folder=tmp_path,
        )
        assert done.returncode == 0, done.stderr
        tables.append((tmp_path / out).read_bytes())
    assert tables[0] == tables[1]


def test_the_command_and_the_library_give_the_same(tmp_path):
    arguments = ("estimate", LOG, "--machine", "servo-400w", "--out", "out.parquet", "--lag", "-1")
    assert fluxobs(*arguments, folder=tmp_path).returncode == 0
    result = library.estimate(LOG, "servo-400w", lag=-1)
    assert pl.read_parquet(tmp_path / "out.parquet").equals(result.estimates)


def test_exit_codes_of_the_process(tmp_path):
    log = pl.read_csv(LOG).head(2500).with_columns(-pl.col("i_alpha", "i_beta"))
    log.write_parquet(tmp_path / "wrong.parquet")
    machine = ("--machine", "servo-400w")
    wrong = process("check", "wrong.parquet", *machine, folder=tmp_path)
    assert (wrong.returncode, wrong.stderr) == (1, "")
    assert "NOT as given" in wrong.stdout
    missing = process("check", "none.parquet", *machine, folder=tmp_path)
    assert (missing.returncode, missing.stdout) == (2, "")
    assert missing.stderr == "Error: none.parquet: no such file\n"
    usage = process("check", folder=tmp_path)
    assert usage.returncode == 2
    assert "Missing argument" in usage.stderr


MACHINE = ("--machine", "servo-400w")
#: Commands with a file that they read or write, at NAME.
FILES = {
    "estimate": ("estimate", "NAME", *MACHINE),
    "estimate --machine": ("estimate", LOG, "--machine", "NAME"),
    "estimate --out": ("estimate", LOG, *MACHINE, "--out", "NAME"),
    "check": ("check", "NAME", *MACHINE),
    "channels": ("channels", "NAME"),
    "identify": ("identify", "NAME", *MACHINE),
    "compare": ("compare", "NAME", "servo-400w"),
    "fleet": ("fleet", "NAME"),
    "live": ("live", "NAME", *MACHINE),
    "campaign": ("campaign", "NAME"),
    "plan-test": ("plan-test", "NAME"),
    "machine plan": ("machine", "plan", "NAME"),
}


@pytest.mark.parametrize("command", FILES)
def test_a_name_that_is_too_long_is_an_error_of_the_user(command, tmp_path):
    """Exit code 2 and a sentence; 1 would mean that `check` found a mistake."""
    name = 300 * "a" + ".csv"
    done = fluxobs(*(name if x == "NAME" else x for x in FILES[command]), folder=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("Error: ")
    assert "file name too long" in done.stderr
    assert not list(tmp_path.iterdir())


#: Root may read everything unless its program gives up two capabilities before it starts:
#: PR_CAPBSET_DROP of CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH (Linux, prctl(2)).
WITHOUT_RIGHTS = """
import ctypes, os, sys
if os.geteuid() == 0:
    assert all(ctypes.CDLL(None).prctl(24, capability, 0, 0, 0) == 0 for capability in (1, 2))
os.execv(sys.executable, [sys.executable, "-m", "fluxobs", *sys.argv[1:]])
"""


@pytest.mark.parametrize("command", ["estimate", "check", "channels", "fleet", "campaign"])
def test_a_folder_without_rights_is_an_error_of_the_user(command, tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0)
    name = closed / "log.csv"
    arguments = [name if x == "NAME" else x for x in FILES[command]]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_RIGHTS, *arguments], capture_output=True, text=True
    )
    closed.chmod(0o700)
    assert done.returncode == 2
    assert done.stderr.startswith(f"Error: {name}")
    assert done.stderr.endswith(": permission denied\n")


def test_the_library_is_imported_quickly():
    """With warm caches, the import needs far less than half a second."""
    script = (
        "import time; start = time.perf_counter()\n"
        "import numpy, pydantic; middle = time.perf_counter()\n"
        "import fluxobs; print(time.perf_counter() - middle, middle - start)\n"
    )
    seconds = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        seconds.append(float(done.stdout.split()[0]))
        if min(seconds) < 0.5:
            break
        time.sleep(1)
    assert np.min(seconds) < 0.5  # 0.05 s on a quiet machine


SCRIPT = """
from pathlib import Path

import numpy as np

import fluxobs

machine = fluxobs.read_machine("servo-400w")
log: fluxobs.Log = fluxobs.read_log("log.csv", lag=-1, columns={"i_alpha": "Ia"})
result: fluxobs.Result = fluxobs.estimate(log, machine, unknowns=("drift", "resistance"))
theta = result["theta_e"]
degrees: float = float(np.degrees(theta[-1]))
text: str = result.summary + "".join(result.warnings)
found = fluxobs.identify(log, "motor.toml", free="R_s")
spread: list[float | None] = [parameter.std for parameter in found.parameters]
sound: bool = fluxobs.check(log, Path("motor.toml")).sound
folder: Path = fluxobs.export(machine, 1e-4, "out").folder
record = fluxobs.Record(1e-4, np.zeros((30, 2)), np.zeros((30, 2)), lag=-1)
if isinstance(machine, fluxobs.SurfacePMSM):
    observer = fluxobs.LeastSquaresObserver.for_machine(machine, sample_time=1e-4)
    estimate = observer.run(record)
    first: bool = bool(estimate.valid[0])
    state, now = observer.step(observer.init(), [0.0, 0.0], [0.1, 0.0])
"""


@pytest.mark.slow
def test_a_user_s_script_is_typed(tmp_path):
    """mypy --strict accepts a script that uses the public API (py.typed)."""
    (tmp_path / "script.py").write_text(SCRIPT)
    (tmp_path / "wrong.py").write_text(SCRIPT + "\nresult.summry\nfluxobs.estimate(log)\n")
    for name, expected in (("script.py", 0), ("wrong.py", 1)):
        done = python("mypy", "--strict", "--cache-dir", ROOT / "build" / "mypy", tmp_path / name)
        assert done.returncode == expected, done.stdout
