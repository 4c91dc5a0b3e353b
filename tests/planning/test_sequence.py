"""Planned tests: set points after which the parameters are known."""

import json
import shutil
import subprocess

import numpy as np
import polars as pl
import pytest

import fluxobs
import fluxobs.planning.sequence as planning
from fluxobs.errors import FluxobsError, UsageError
from fluxobs.machines import example, rotating
from fluxobs.planning.report import write_sequence
from fluxobs.planning.sequence import PARTS, Planner, usual_wants
from fluxobs.planning.setup import Sensors, rating_of
from fluxobs.simulation.closed_form.signals import driven, vectors
from support.cli import fluxobs as command

NAME = "servo-400w"
SCALES = {"voltage_scale": 0.003, "current_scale": 0.003}


def planner(wanted, priors=SCALES, name=NAME, **options):
    machine = rotating(example(name), "a test")
    rated = rating_of(machine, name)
    sensors = Sensors.usual(machine.rated_current, rated)
    return Planner(machine, rated, sensors, wanted, priors, **options)


@pytest.fixture(scope="module", autouse=True)
def fewer_set_points():
    """A ninth of the set points: to evaluate all of them takes most of a plan's time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "SPEEDS", (0.05, 0.2, 0.7))
        patch.setattr(planning, "LENGTHS", (0.35, 0.95))
        patch.setattr(planning, "DIRECTIONS", 4)
        yield


@pytest.fixture(scope="module")
def planned():
    machine = example(NAME)
    wanted = {"R_s": 0.03 * machine.R_s, "psi_f": 0.015 * machine.psi_f, "J": 0.05 * 6e-5}
    return planner(wanted), planner(wanted).plan()


def record(planner, sequence, machine, J):
    """Return the log of a drive that follows the set points."""
    h, n_p = planner.rated.sample_time, machine.n_p
    t = np.arange(round(sequence.duration / h) * PARTS + 1) * h / PARTS
    corners = [knot.t for knot in sequence.knots]
    speed, i_d, i_q, free = (
        np.interp(t, corners, [getattr(knot, name) for knot in sequence.knots])
        for name in ("speed", "i_d", "i_q", "free")
    )
    # The set point of i_q was for the nominal drive; the controller finds that of the true one.
    nominal = planner.machine
    i_q = np.where(free > 0.5, i_q * J / planner.rated.J * nominal.psi_f / machine.psi_f, i_q)
    signals = driven(machine, h, n_p * speed, i_d + 1j * i_q, PARTS, theta0=1.0)
    noise = planner.sensors.noise * np.random.default_rng(3).standard_normal((len(t) // PARTS, 2))
    offset = 0.5 * planner.sensors.offset
    return vectors(signals.voltage), vectors(signals.current)[:-1] + noise + offset


def test_what_a_test_promises_comes_true(planned):
    """Another resistance, flux and inertia: found within two of the promised deviations."""
    plan, sequence = planned
    assert all(sequence.stds[name] <= std for name, std in plan.wanted.items())
    assert sequence.duration < 10
    nominal = plan.machine
    true = nominal.with_values(R_s=1.15 * nominal.R_s, psi_f=0.95 * nominal.psi_f)
    J = 1.2 * plan.rated.J
    log, cut = record(plan, sequence, true, J), round(sequence.ramps_from / plan.rated.sample_time)
    for rows, free in ((slice(None, cut), ["R_s", "psi_f"]), (slice(cut, None), ["J"])):
        found = fluxobs.identify(
            tuple(column[rows] for column in log),
            nominal,
            free=free,
            sample_time=plan.rated.sample_time,
            lag=0,
            priors=SCALES,
        )
        for parameter in found.parameters:
            right = J if parameter.name == "J" else getattr(true, parameter.name)
            promised = sequence.stds[parameter.name]
            # The torque's standard deviation, which limits J, depends on the true drive.
            assert parameter.std < (2 if parameter.name == "J" else 1.5) * promised
            assert abs(parameter.value - right) < 2 * max(promised, parameter.std), parameter.name


@pytest.mark.slow
def test_a_stricter_wish_takes_longer(planned):
    plan, _ = planned
    loose = planner({"R_s": 0.3 * plan.machine.R_s}).plan()
    strict = planner({"R_s": 0.02 * plan.machine.R_s, "L_s": 0.02 * plan.machine.L_s}).plan()
    assert loose.points < strict.points


def test_without_a_load_machine_only_currents_along_d():
    machine = example(NAME)
    sequence = planner({"R_s": 0.1 * machine.R_s}, loaded=False).plan()
    assert all(knot.i_q == 0 for knot in sequence.knots)
    assert any(knot.i_d != 0 for knot in sequence.knots)


def test_wishes_that_no_log_fulfils():
    with pytest.raises(
        UsageError, match=r"psi_f: no log tells it better than ± 0\.000[34].*scales"
    ):
        planner({"psi_f": 0.02 * 0.0125}, priors={})
    with pytest.raises(UsageError, match="L_d: this machine has R_s, L_s, psi_f, inverter, J"):
        planner({"L_d": 1e-5})
    with pytest.raises(UsageError, match="synchronous"):
        planner({"R_s": 0.1}, name="induction-2kw2")
    for std, message in ((0.0, "must be positive"), (4.0, "more than the value, 0.36 Ω")):
        with pytest.raises(UsageError, match=message):
            planner({"R_s": std})
    with pytest.raises(FluxobsError, match="set points do not tell"):
        planner({"R_s": 0.006 * 0.36}, loaded=False).plan()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no cross compiler: cc")
def test_the_header_returns_the_set_points_of_the_table(planned, tmp_path):
    _, sequence = planned
    for ending in ("csv", "h"):
        write_sequence(sequence, tmp_path / f"test.{ending}", force=False)
    table = pl.read_csv(tmp_path / "test.csv")
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "test.h"\n'
        "int main(void)\n{\n    for (int k = 0; k < 700; k++) {\n"
        "        test_point p = test_point_at(0.01f * (float)k);\n"
        '        printf("%.6g %.6g %.6g %d\\n", (double)p.speed, (double)p.i_d, (double)p.i_q, '
        "p.done);\n    }\n    return 0;\n}\n"
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    subprocess.run(["cc", *flags, "main.c", "-o", "main"], cwd=tmp_path, check=True)
    done = subprocess.run(["./main"], cwd=tmp_path, capture_output=True, text=True, check=True)
    rows = np.array([line.split() for line in done.stdout.splitlines()], float)
    t = 0.01 * np.arange(700)
    for column, name in enumerate(("speed_mech", "i_d", "i_q")):
        expected = np.interp(t, table["t"], table[name])
        scale = np.abs(table[name]).max() or 1.0
        # At a step of the slope, rounding of t matters: most points agree to single precision.
        wrong = np.abs(rows[:, column] - expected) > 1e-3 * scale
        assert wrong.mean() < 0.01, name
    assert rows[-1, 3] == (t[-1] >= sequence.duration)
    with pytest.raises(FluxobsError, match="exists"):
        write_sequence(sequence, tmp_path / "test.csv", force=False)


def test_the_commands(tmp_path):
    wants = ("--want", "R_s=10%", "--want", "inverter=0.4")
    done = command("plan-test", NAME, *wants, "--out", "t.csv", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "set points" in done.stdout
    assert "fluxobs identify LOG --machine servo-400w --free R_s,inverter" in done.stdout
    assert (tmp_path / "t.csv").read_text().startswith("t,speed_mech,i_d,i_q,free_shaft\n0.0")
    again = command("plan-test", NAME, *wants, "--out", "t.csv", folder=tmp_path)
    assert again.returncode == 2
    wrong = command("plan-test", NAME, "--want", "R_s=much", folder=tmp_path)
    assert "--want R_s=much: expected 3% or a number" in wrong.stderr
    shares = command("plan-test", NAME, "--want", "J=3%", folder=tmp_path)
    assert "give it in kg m²" in shares.stderr
    named = command("plan-test", NAME, "--want", "Rs=3%", folder=tmp_path)
    assert "--want Rs: unknown; did you mean 'R_s'" in named.stderr
    listed = command("plan-test", NAME, *wants, "--json", folder=tmp_path)
    assert set(json.loads(listed.stdout)["stds"]) >= {"R_s", "inverter"}
    assert usual_wants(example(NAME))["inverter"][0] == pytest.approx(0.1 * 0.36 * 12)
    refused = command("machine", "plan", "motor.toml", folder=tmp_path)
    assert refused.returncode == 2
