"""What a user gets from a command: its exit code, the fields of --json, and the columns of --out.

tests/expected/commands holds names and kinds, not values: another estimator gives other numbers,
but it must not lose a field, a column, a mark or an exit code.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from fluxobs.machines import example
from fluxobs.machines.files import example_text
from fluxobs.simulation.closed_form.demo import LOG
from fluxobs.simulation.closed_form.signals import driven, vectors
from observers.test_maps import reluctance_record
from support.cli import fluxobs
from support.expected import check
from support.records import log_columns

#: Fields whose names depend on the numbers, with the kind of their names.
OPEN = {"lag_weights": "lag [samples]", "not_valid": "reason", "quality": "mark", "untold": "name"}
RELUCTANCE = """
kind = "synchronous-reluctance"
R_s = 0.69
n_p = 2
rated_current = 22.0
inverter_voltage = 0.0
inverter_voltage_std = 0.01
"""
LINEAR = "L_d = 0.047\nL_q = 0.0085\n"
SATURATED = "flux_map = {a_d0 = 17.4, a_dd = 373, a_q0 = 52.1, a_qq = 658, a_dq = 1120}\n"


def shape(value: Any, name: str = "") -> Any:
    """Return a tree with the kinds of its values in place of the values."""
    if isinstance(value, dict):
        if name in OPEN:
            return {OPEN[name]: shape(list(value.values()))}
        return {key: shape(v, key) for key, v in value.items()}
    if name in ("notes", "warnings"):
        return "texts"
    if isinstance(value, list):
        kinds = [shape(v) for v in value]
        return [kind for n, kind in enumerate(kinds) if kind not in kinds[:n]]
    if isinstance(value, bool) or value is None:
        return str(value) if value is None else "true or false"
    return "number" if isinstance(value, int | float) else "text"


def wrong_rows(log: pl.DataFrame) -> pl.DataFrame:
    """A log with three missing samples, and ten samples that repeat the one before."""
    rows = np.arange(len(log))
    rows[600:610] = 599
    spoilt = log[rows].with_columns(log["t"])
    missing = pl.when(pl.int_range(len(log)).is_between(300, 302)).then(None)
    return spoilt.with_columns(missing.otherwise(pl.col("i_alpha")).alias("i_alpha"))


def ramps() -> pl.DataFrame:
    """A servo that turns nothing but its inertia of 6e-5 kg m², in steep ramps."""
    h, parts, machine = 1e-4, 8, example("servo-400w")
    corners = [0, 0.1, 0.14, 0.3, 0.38, 0.55, 0.63, 0.8, 0.88, 1.05, 1.1, 1.2]
    speeds = [60, 60, 250, 250, -250, -250, 250, 250, -250, -250, 100, 100]  # [rad/s]
    t = np.arange(round(1.2 / h) * parts + 1) * h / parts
    speed = np.interp(t, corners, speeds)
    i_q = 6e-5 * np.gradient(speed, t) / (1.5 * machine.n_p * machine.psi_f)
    signals = driven(machine, h, machine.n_p * speed, 1j * i_q, parts, theta0=1.0)
    voltage, current = vectors(signals.voltage), vectors(signals.current)[:-1]
    current = current + 0.02 * np.random.default_rng(3).standard_normal(current.shape)
    columns = dict(zip(("u_alpha", "u_beta"), voltage.T, strict=True))
    columns |= dict(zip(("i_alpha", "i_beta"), current.T, strict=True))
    return pl.DataFrame({"t": h * np.arange(len(voltage))} | columns)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("features")
    ramps().write_parquet(path / "ramps.parquet")
    log = pl.read_csv(LOG)[3000:6000]
    log.write_csv(path / "log.csv")
    log.drop("theta_e").write_csv(path / "no_truth.csv")
    log.with_columns(-pl.col("i_alpha", "i_beta")).write_csv(path / "inverted.csv")
    wrong_rows(log).write_csv(path / "wrong_rows.csv")
    log[:60].write_csv(path / "short.csv")
    (path / "motor.toml").write_text(example_text("servo-400w"))
    columns = {name: np.asarray(c)[:8000] for name, c in log_columns(reluctance_record()).items()}
    pl.DataFrame(columns).write_parquet(path / "reluctance.parquet")
    (path / "linear.toml").write_text(RELUCTANCE + LINEAR)
    (path / "saturated.toml").write_text(RELUCTANCE.replace("0.69", "0.63") + SATURATED)
    return path


SERVO = ("--machine", "motor.toml")
STATED = (*SERVO, "--lag", "0")
OUT = ("--out", "OUT.parquet")
SEARCHES = pytest.mark.mistakes
#: Name → command, with marks.
COMMANDS = {
    "estimate": (("estimate", "log.csv", *SERVO, *OUT), ()),
    "estimate_stated_lag": (("estimate", "log.csv", *STATED, *OUT), ()),
    "estimate_without_truth": (("estimate", "no_truth.csv", *STATED, *OUT), ()),
    "estimate_causal": (("estimate", "log.csv", *SERVO, "--causal", *OUT), ()),
    "estimate_causal_plain": (
        ("estimate", "log.csv", *SERVO, "--causal", "--unknowns", "drift", *OUT),
        (),
    ),
    "estimate_fractional_lag": (("estimate", "log.csv", *SERVO, "--lag", "-0.4", *OUT), ()),
    "estimate_wrong_rows": (("estimate", "wrong_rows.csv", *STATED, *OUT), ()),
    "estimate_inverted": (("estimate", "inverted.csv", *STATED, *OUT), (SEARCHES,)),
    "estimate_short": (("estimate", "short.csv", *STATED, *OUT), ()),
    "estimate_reluctance": (
        ("estimate", "reluctance.parquet", "--machine", "saturated.toml", "--lag", "0", *OUT),
        (),
    ),
    "check": (("check", "log.csv", *SERVO), (SEARCHES,)),
    "check_inverted": (("check", "inverted.csv", *SERVO), (SEARCHES,)),
    "identify": (("identify", "log.csv", *STATED, "--out", "OUT.toml"), ()),
    "identify_inductance": (("identify", "log.csv", *STATED, "--free", "R_s,psi_f,L_s"), ()),
    "identify_inertia": (("identify", "ramps.parquet", *STATED, "--free", "J"), ()),
    "identify_map": (
        (
            *("identify", "reluctance.parquet", "--machine", "linear.toml", "--lag", "0"),
            *("--free", "R_s,map", "--out", "OUT.toml"),
        ),
        (pytest.mark.slow,),
    ),
    "no_file": (("estimate", "none.csv", *SERVO), ()),
    "no_machine": (("estimate", "log.csv", "--machine", "none.toml"), ()),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=marks) for name, (_, marks) in COMMANDS.items()]
)
def test_no_feature_is_lost(folder: Path, name: str) -> None:
    command = [word.replace("OUT", name) for word in COMMANDS[name][0]]
    done = fluxobs(*command, "--json", folder=folder)
    features: dict[str, Any] = {"command": " ".join(command), "exit code": done.returncode}
    if done.stdout:
        features["json"] = shape(json.loads(done.stdout))
    else:
        features["message"] = done.stderr
    table = folder / f"{name}.parquet"
    if table.exists():
        schema = pl.read_parquet_schema(table)
        features["columns"] = {column: str(kind) for column, kind in schema.items()}
    written = folder / f"{name}.toml"
    if written.exists():
        lines = written.read_text().splitlines()
        features["machine file"] = [line.split(" = ")[0] for line in lines if " = " in line]
    check(f"commands/{name}", features)


def test_marks_of_wrong_rows(folder: Path) -> None:
    """Each fault has its mark, in the column and in the summary."""
    command = ("estimate", "wrong_rows.csv", *STATED, "--json", "--out", "marks.parquet")
    done = fluxobs(*command, folder=folder)
    assert {"missing", "repeated"} <= set(json.loads(done.stdout)["quality"])
    table = pl.read_parquet(folder / "marks.parquet")
    bad = [*range(300, 303), *range(601, 609)]
    assert (table["quality"].to_numpy()[bad] > 0).all()
    assert not table["valid"].to_numpy()[bad].any()
    assert table["valid"].to_numpy()[1000:].mean() > 0.9
