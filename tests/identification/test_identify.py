"""identify: the parameters that a log identifies, and the parameters that a log cannot identify."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from fluxobs import FluxobsError, estimate, identify, read_log
from fluxobs.identification.fit import UNCERTAIN, _make_prior_rows, evaluate
from fluxobs.identification.identify import read_free
from fluxobs.identification.relations import SATURATION, Saturating
from fluxobs.identification.segments import cut_segments
from fluxobs.machines import AlgebraicSaturation, example, example_text, read_machine
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
    for p in identified.parameters:
        assert abs(p.value - TRUE[p.name]) < 3 * p.std
        assert p.std < (0.2 if p.name == "inverter" else 0.08) * TRUE[p.name]
    assert identified.machine.R_s == pytest.approx(R_S, rel=0.05)
    assert identified.machine.inverter_voltage == pytest.approx(INVERTER, rel=0.15)


def test_the_values_are_those_of_the_estimate(rich, tmp_path):
    """One engine: the same values and deviations, and the same machine file."""
    identified = identify(rich, PMSM)
    estimated = estimate(rich, PMSM)
    assert identified.found == estimated.found
    identified.write(tmp_path / "identified.toml")
    estimated.write(tmp_path / "estimated.toml")
    by_identify, by_estimate = (
        read_machine(tmp_path / f"{name}.toml") for name in ("identified", "estimated")
    )
    assert by_identify == by_estimate


def test_a_steady_log_identifies_only_the_magnet(steady):
    identified = identify(steady, PMSM, free=("R_s", "psi_f", "inverter"))
    assert set(identified.untold) == {"R_s", "inverter"}
    assert identified.machine.R_s == PMSM.R_s
    assert [p.std is None for p in identified.parameters] == [True, False, True]


def test_a_log_that_identifies_nothing_is_an_error(steady):
    with pytest.raises(FluxobsError, match=r"identifies none of lag .*steps of load"):
        identify(steady, PMSM, free=("lag",))


def test_a_log_that_does_not_fit_is_refused(rich, tmp_path):
    """Nothing is written: the machine is another one by far."""
    other = PMSM.with_values(L_s=8 * PMSM.L_s, psi_f=0.2 * PMSM.psi_f)
    with pytest.raises(FluxobsError, match="no parameter can be identified"):
        identify(read_log(rich.table.path, stop=0.8), other)


@pytest.mark.parametrize("late", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_finds_a_lag_and_all_others(late, rich, tmp_path):
    """A row's voltage acts `late` samples later than its row."""
    columns = pl.read_parquet(rich.table.path).to_dict(as_series=False)
    for name in ("u_alpha", "u_beta"):
        values = columns[name]
        columns[name] = [*values[late:], *values[-1:] * late]
    columns = {name: np.array(values) for name, values in columns.items()}
    identified = identify(columns, PMSM, free=("R_s", "L_s", "psi_f", "inverter", "lag"))
    lag = next(p for p in identified.parameters if p.name == "lag")
    assert identified.lag == -late
    assert lag.given is None
    assert lag.std is None or abs(lag.value + late) < 3 * lag.std
    assert identified.machine.R_s == pytest.approx(R_S, rel=0.05)
    assert identified.machine.L_s == pytest.approx(PMSM.L_s, rel=0.1)


@pytest.mark.parametrize("stop", [0.6, 1.0, 2.0])
def test_offsets_and_a_knee_of_the_inverter_do_not_bias_the_others(stop):
    # The demo log has offsets of 1 % of the rated current, which shift the sign changes of the
    # phases, and an unusual knee. Shorter logs must report which parameters they cannot identify.
    true = {"R_s": 0.36, "psi_f": 0.0125, "inverter": 0.15, "lag": 0.0}
    identified = identify(read_log(LOG, stop=stop), "servo-400w", free=tuple(true))
    for parameter in identified.parameters:
        if parameter.std is not None:
            assert abs(parameter.value - true[parameter.name]) < 3 * parameter.std
    assert {p.name for p in identified.parameters if p.std is not None} >= {"R_s", "psi_f"}


def test_a_stated_lag_is_not_learnt(rich):
    log = read_log(rich.table.path, lag=0)
    lag = identify(log, PMSM, free="R_s,lag").parameters[1]
    assert lag.given == 0
    assert lag.std is None or abs(lag.value) < 3 * lag.std


def test_derivatives_are_those_of_the_residual(rich):
    data, _ = cut_segments(rich, PMSM, 0.4)
    segment = data[len(data) // 2]
    a = 1 / PMSM.L_s
    model = AlgebraicSaturation(a_d0=a, a_dd=0.1 * a, a_q0=a, a_qq=0.2 * a, a_dq=0.1 * a, psi_f=0.5)
    values = {"R_s": 4.5, "L_d": 0.03, "L_q": 0.03, "psi_f": 0.5, "inverter": 3.0}
    values |= {name: getattr(model, name) for name in SATURATION}
    values |= {"knee 1": 0.4, "knee 2": -0.2, "offset_alpha": 0.1, "offset_beta": -0.2}
    names = ("R_s", "inverter", *SATURATION, *UNCERTAIN)
    start, drift = segment.start, segment.drift
    relation = Saturating(model)
    _, local, free = evaluate(segment, values, start, drift, names, relation)
    for k, name in enumerate(names):
        step = 1e-6 * (abs(values[name]) + 0.1)
        ends = [
            evaluate(segment, values | {name: values[name] + s}, start, drift, (), relation)[0]
            for s in (step, -step)
        ]
        slope = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(free[:, k], slope, atol=1e-5 * np.abs(slope).max() + 1e-9)
    for k in range(4):
        step = np.eye(4)[k] * 1e-6
        up = evaluate(segment, values, start + step[:2], drift + step[2:], (), relation)[0]
        down = evaluate(segment, values, start - step[:2], drift - step[2:], (), relation)[0]
        slope = (up - down) / 2e-6
        np.testing.assert_allclose(local[:, k], slope, atol=1e-5 * np.abs(slope).max() + 1e-9)


def test_a_machine_without_a_magnet(tmp_path):
    machine = example("synrm-6kw7")
    speed = profile((0, 100), (0.5, 100), (0.9, -200), (1.5, -200))
    load = profile((0, 10), (0.3, 10), (0.31, 15), (0.7, 15), (0.71, 8), (1.5, 8))
    samples = driven(machine, COURSE_TIME, speed, 8 + 1j * load, R_s=1.3 * machine.R_s, noise=0.02)
    log = opened(tmp_path / "log.parquet", samples)
    identified = identify(log, machine)
    assert identified.machine.R_s == pytest.approx(1.3 * machine.R_s, rel=0.03)


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
    assert read_machine(tmp_path / "found.toml").R_s == pytest.approx(R_S, rel=0.05)
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
        (("--to", "0.005"), "x.toml", "no parameter can be identified"),
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
