"""identify: the parameters that a log identifies, and the parameters that a log cannot identify."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from fluxobs import FluxobsError, identify, read_log
from fluxobs.identification.fit import UNCERTAIN, _make_prior_rows, evaluate
from fluxobs.identification.identify import read_free
from fluxobs.identification.segments import cut_segments
from fluxobs.machines import example, example_text, read_machine
from fluxobs.simulation.closed_form.demo import LOG
from support.cli import fluxobs
from support.records import COURSE_TIME, PMSM, course, driven, log_columns, profile

R_S, PSI_F, INVERTER = 1.3 * PMSM.R_s, 0.9 * PMSM.psi_f, 4.0
SMOOTHING = 0.05 * PMSM.rated_current
TRUE = {"R_s": R_S, "psi_f": PSI_F, "inverter": INVERTER}


def opened(path, samples, **layout):
    pl.DataFrame(log_columns(samples)).write_parquet(path)
    return read_log(path, **layout)


@pytest.fixture(scope="module")
def rich(tmp_path_factory):
    """A log with steps of load and a reversal; the machine differs from the given machine."""
    samples = course(
        R_s=R_S, psi_f=PSI_F, inverter=INVERTER, smoothing=SMOOTHING, voltage_bias=0.5 - 0.2j
    )
    return opened(tmp_path_factory.mktemp("rich") / "log.parquet", samples)


@pytest.fixture(scope="module")
def steady(tmp_path_factory):
    """A log at constant speed and load."""
    speed = profile((0, 236), (1.5, 236))
    samples = driven(PMSM, COURSE_TIME, speed, np.full(len(speed), 4j), R_s=R_S, noise=0.02)
    return opened(tmp_path_factory.mktemp("steady") / "log.parquet", samples)


def test_finds_resistance_magnet_and_inverter_within_their_deviations(rich):
    identified = identify(rich, PMSM, free=("R_s", "psi_f", "inverter"))
    assert not identified.untold
    assert identified.after.converged
    for p in identified.parameters:
        assert p.std is not None
        assert abs(p.value - TRUE[p.name]) < 4 * p.std + 0.01 * TRUE[p.name]
        # The considered curve of the inverter contributes 4 % of its loss.
        assert p.std < (0.04 if p.name == "inverter" else 0.02) * TRUE[p.name]
    assert identified.after.rms() < 0.1 * identified.before.rms()
    assert identified.machine.R_s == pytest.approx(R_S, rel=0.01)
    assert identified.machine.inverter_voltage == pytest.approx(INVERTER, rel=0.03)


def test_a_steady_log_identifies_only_the_magnet(steady):
    identified = identify(steady, PMSM, free=("R_s", "psi_f", "inverter"))
    assert set(identified.untold) == {"R_s", "inverter"}
    assert identified.machine.R_s == PMSM.R_s
    assert [p.std is None for p in identified.parameters] == [True, False, True]


def test_a_log_that_identifies_nothing_is_an_error(steady):
    with pytest.raises(FluxobsError, match=r"identifies none of lag .*steps of load"):
        identify(steady, PMSM, free=("lag",))


def test_finds_a_lag(tmp_path):
    # A row's voltage acts one sample later than the layout says.
    speed = profile((0, 0), (0.3, 400), (1.2, 400))
    samples = driven(PMSM, COURSE_TIME, speed, 4j * np.ones(len(speed)), noise=0.02)
    columns = log_columns(samples)
    for name in ("u_alpha", "u_beta"):
        columns[name] = np.concatenate([columns[name][1:], columns[name][-1:]])
    pl.DataFrame(columns).write_parquet(tmp_path / "log.parquet")
    log = read_log(tmp_path / "log.parquet")
    # With the default standard deviation of R_s, which is half of R_s, psi_f and lag are ambiguous.
    assert "lag" in identify(log, PMSM, free=("psi_f", "lag")).untold
    certain = PMSM.with_values(R_s_std=0.002, inverter_voltage=0.0, inverter_voltage_std=0.01)
    identified = identify(log, certain, free=("psi_f", "lag"))
    assert identified.lag == pytest.approx(-1, abs=0.05)


def test_finds_a_lag_and_all_others_from_a_distant_start(rich):
    identified = identify(rich, PMSM, free=("R_s", "L_s", "psi_f", "inverter", "lag"))
    # At half speed a lag is visible, but under load inductance and lag both rotate the vector.
    assert identified.after.converged
    assert identified.lag == pytest.approx(0, abs=0.1)
    assert identified.machine.R_s == pytest.approx(R_S, rel=0.01)


@pytest.mark.parametrize("stop", [0.4, 0.6, 1.0, 2.0])
@pytest.mark.parametrize("lag", [False, True])
def test_offsets_and_a_knee_of_the_inverter_do_not_bias_the_others(stop, lag):
    # The demo log has offsets of 1 % of the rated current, which shift the sign changes of the
    # phases, and an unusual knee. Shorter logs must report which parameters they cannot identify.
    true = {"R_s": 0.36, "psi_f": 0.0125, "inverter": 0.15, "lag": 0.0}
    free = tuple(true) if lag else tuple(true)[:3]
    identified = identify(read_log(LOG, stop=stop), "servo-400w", free=free)
    assert identified.after.converged
    for parameter in identified.parameters:
        if parameter.std is not None:
            assert abs(parameter.value - true[parameter.name]) < 4 * parameter.std
    if stop > 0.5:
        assert not {"R_s", "psi_f", "inverter"} & set(identified.untold)
        assert next(p.std for p in identified.parameters if p.name == "psi_f") < 1e-3 * 0.0125
        assert identified.after.rms() < 0.003 * 0.0125


def test_derivatives_are_those_of_the_residual(rich):
    data, _ = cut_segments(rich, PMSM, (-2, -1, 0, 1, 2))
    segment = data[len(data) // 2]
    values = {"R_s": 3.0, "L_d": 0.04, "L_q": 0.05, "L_s": 0.05, "psi_f": 0.5, "inverter": 1.0}
    values |= {"lag": 0.3, "knee 1": 0.4, "knee 2": -0.2, "offset_alpha": 0.1, "offset_beta": -0.2}
    names = ("R_s", "L_d", "L_q", "psi_f", "inverter", "lag", *UNCERTAIN)
    start, drift = segment.start, segment.drift
    _, local, free = evaluate(segment, values, start, drift, names)
    for k, name in enumerate(names):
        step = 1e-6 * (abs(values[name]) + 0.1)
        ends = [
            evaluate(segment, values | {name: values[name] + s}, start, drift, ())[0]
            for s in (step, -step)
        ]
        slope = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(free[:, k], slope, atol=1e-6 * np.abs(slope).max() + 1e-9)
    for k in range(4):
        step = np.eye(4)[k] * 1e-6
        up = evaluate(segment, values, start + step[:2], drift + step[2:], ())[0]
        down = evaluate(segment, values, start - step[:2], drift - step[2:], ())[0]
        slope = (up - down) / 2e-6
        np.testing.assert_allclose(local[:, k], slope, atol=1e-6 * np.abs(slope).max() + 1e-9)


def test_a_machine_without_a_magnet(tmp_path):
    machine = example("synrm-6kw7")
    speed = profile((0, 100), (0.5, 100), (0.9, -200), (1.5, -200))
    load = profile((0, 10), (0.3, 10), (0.31, 15), (0.7, 15), (0.71, 8), (1.5, 8))
    samples = driven(machine, COURSE_TIME, speed, 8 + 1j * load, R_s=1.3 * machine.R_s, noise=0.02)
    log = opened(tmp_path / "log.parquet", samples)
    identified = identify(log, machine)
    assert identified.before.free == ()
    assert identified.machine.R_s == pytest.approx(1.3 * machine.R_s, rel=0.02)


def test_names_of_free_parameters():
    assert read_free(None, PMSM) == ("R_s", "psi_f", "inverter")
    assert read_free("lag, R_s", PMSM) == ("R_s", "lag")
    assert read_free("inverter_voltage", PMSM) == ("inverter",)
    with pytest.raises(FluxobsError, match=r"no 'L_d'; did you mean"):
        read_free("L_d", PMSM)
    with pytest.raises(FluxobsError, match="give some of"):
        read_free(" , ", PMSM)


def test_command_line(rich, tmp_path):
    (tmp_path / "log.parquet").write_bytes(rich.table.path.read_bytes())
    (tmp_path / "guess.toml").write_text(example_text("pmsm-2kw2"))

    def run(*more, out="found.toml"):
        arguments = ("log.parquet", "--machine", "guess.toml", "--out", out, *more)
        return fluxobs("identify", *arguments, folder=tmp_path)

    done = run("--report", "fit.png")
    assert done.returncode == 0, done.stderr
    assert "R_s = " in done.stdout
    assert " V (not given), its sign smoothed at" in done.stdout
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert read_machine(tmp_path / "found.toml").R_s == pytest.approx(R_S, rel=0.01)
    again = fluxobs(
        *("estimate", "log.parquet", "--machine", "found.toml", "--out", "e.parquet"),
        folder=tmp_path,
    )
    assert again.returncode == 0, again.stderr
    assert "Warning" not in again.stdout
    written = (tmp_path / "found.toml").read_text()
    for more, out, words in (
        ((), "found.toml", "exists"),
        (("--force",), "found.txt", "must end in .toml"),
        (("--force",), "log.parquet", "this is one of the inputs"),
        ((), "none/found.toml", "does not exist"),
        (("--report", "none/fit.png"), "x.toml", "does not exist"),
        (("--free", "R"), "x.toml", "did you mean 'R_s'"),
        (("--to", "0.005"), "x.toml", "never known"),
    ):
        failed = run(*more, out=out)
        assert failed.returncode == 2
        assert words in failed.stderr
    assert (tmp_path / "found.toml").read_text() == written
    assert not (tmp_path / "x.toml").exists()


def test_twenty_rows_count_as_one_against_the_prior():
    """Errors of rows repeat, so the row of the prior has a factor of √20."""
    rows = _make_prior_rows({"R_s": (0.4, 0.05), "L_q": (1.0, 0.1)}, ["psi_f", "R_s"])
    matrix = rows({"psi_f": 1.0, "R_s": 0.5})
    np.testing.assert_allclose(matrix, np.sqrt(20) * np.array([[0.0, 1 / 0.05, 2.0]]))
