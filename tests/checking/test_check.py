"""`check` reports the usual mistakes with a log, and what the log cannot identify."""

from __future__ import annotations

import warnings

import numpy as np
import polars as pl
import pytest

from fluxobs import check
from fluxobs.checking.findings import Check
from fluxobs.checking.mistakes import Linear
from fluxobs.checking.search import check_log
from fluxobs.logs.for_machine import open_for
from fluxobs.machines import example, example_text
from support.cli import fluxobs
from support.records import COURSE_TIME, PMSM, course, driven, log_columns, profile

pytestmark = pytest.mark.mistakes

SQRT2, SQRT3 = np.sqrt(2), np.sqrt(3)
COLUMNS = log_columns(course())


def searched(columns, machine=PMSM, **layout) -> Check:
    """Search the log for mistakes, without the estimate with which `fluxobs.check` compares."""
    return check_log(open_for(columns, machine, **layout), machine)


def scaled(voltage=1.0, current=1.0):
    columns = dict(COLUMNS)
    for name in columns:
        columns[name] = columns[name] * {"u": voltage, "i": current}.get(name[0], 1.0)
    return columns


def turned(mirror, degrees):
    """Return columns whose current phases are exchanged."""
    z = COLUMNS["i_alpha"] + 1j * COLUMNS["i_beta"]
    z = np.exp(1j * np.radians(degrees)) * (z.conj() if mirror else z)
    return COLUMNS | {"i_alpha": z.real, "i_beta": z.imag}


def rarely(*values):
    """Return the parameters of a slow test."""
    return pytest.param(*values, marks=pytest.mark.slow)


def by_kind(checked):
    return {finding.kind: finding for finding in checked.findings}


def test_a_right_log_is_right():
    checked = check(COLUMNS, PMSM)
    assert checked.sound
    assert checked.residual == checked.residual_given < 0.02
    findings = by_kind(checked)
    assert not any(findings[kind].others for kind in ("sign", "phases", "frame"))


@pytest.mark.parametrize(
    ("columns", "kind", "message"),
    [
        (scaled(current=-1), "sign", "opposite sign"),
        # test_corrections.py tests the map of each exchange.
        (turned(True, 120), "phases", "a and b are exchanged"),
        rarely(turned(True, 0), "phases", "b and c are exchanged"),
        rarely(turned(True, -120), "phases", "a and c are exchanged"),
        rarely(turned(False, 120), "phases", "shifted by one (b c a)"),
        rarely(turned(True, 90), "phases", "α and β are exchanged"),
        (scaled(voltage=SQRT3), "scale", "voltages are line to line"),
        (scaled(voltage=1 / SQRT2), "scale", "voltages are rms"),
        (scaled(current=1 / SQRT2), "scale", "currents are rms"),
        (scaled(np.sqrt(1.5), np.sqrt(1.5)), "scale", "power-invariant"),
    ],
)
def test_names_the_mistake(columns, kind, message):
    checked = searched(columns)
    assert not checked.sound
    finding = by_kind(checked)[kind]
    assert not finding.as_given
    assert message in str(finding)
    assert [f.kind for f in checked.findings if not f.as_given] == [kind]


def three_phases(letter):
    x, y = COLUMNS[f"{letter}_alpha"], COLUMNS[f"{letter}_beta"]
    return {f"{letter}_{p}": x * c + y * s for p, c, s in zip("abc", *_AXES, strict=True)}


_AXES = ((1.0, -0.5, -0.5), (0.0, SQRT3 / 2, -SQRT3 / 2))


@pytest.mark.parametrize(
    ("measured", "phase"),
    [
        # test_corrections.py tests each map; here, a log of two and one of three sensors is quick.
        (measured, phase) if (measured, phase) == ("abc", "c") else rarely(measured, phase)
        for measured in ("ab", "bc", "ac", "abc")
        for phase in measured
    ],
)
def test_one_current_sensor_is_inverted(measured, phase):
    currents = {name: values for name, values in three_phases("i").items() if name[-1] in measured}
    currents[f"i_{phase}"] = -currents[f"i_{phase}"]
    columns = {"t": COLUMNS["t"]} | three_phases("u") | currents
    checked = searched(columns)
    (finding,) = checked.mistakes
    assert f"i_{phase} has the opposite sign (--scale i_{phase}=-1)" in str(finding)


def test_voltages_to_neutral_read_as_line_to_line():
    u = three_phases("u")
    columns = COLUMNS | {"u_ab": u["u_a"], "u_bc": u["u_b"]}
    columns = {n: v for n, v in columns.items() if not n.startswith(("u_al", "u_be"))}
    columns |= {n: v for n, v in three_phases("i").items() if n != "i_c"}
    columns = {n: v for n, v in columns.items() if not n.startswith(("i_al", "i_be"))}
    (finding,) = searched(columns, frame="line").mistakes
    assert "voltages are those of phases a and b to neutral (--frame abc" in str(finding)


def test_linear_maps_are_composed():
    rng = np.random.default_rng(0)
    first, second = (Linear(*(rng.standard_normal(2) + 1j * rng.standard_normal(2))) for _ in "ab")
    z = rng.standard_normal(5) + 1j * rng.standard_normal(5)
    np.testing.assert_allclose(second.after(first)(z), second(first(z)))


def test_a_resistance_line_to_line():
    machine = PMSM.model_copy(update={"R_s": 2 * PMSM.R_s})
    finding = by_kind(searched(COLUMNS, machine))["scale"]
    assert finding.words.startswith("R_s in the machine file is wrong: 3.6 Ω fits")
    assert any("line to line (halve it)" in other for other in finding.others)


@pytest.mark.parametrize(
    "lag",
    [pytest.param(lag, marks=() if lag in (-1, 2) else pytest.mark.slow) for lag in (-2, -1, 1, 2)],
)
def test_a_lag(lag):
    # The speed is high, so that the rotor turns visibly within one sample.
    speed = profile((0, 0), (0.3, 471), (1.0, 471), (1.4, -471), (2.0, -471))
    load = profile((0, 2), (0.5, 2), (0.51, 5), (0.8, 5), (0.81, 1), (2, 1))
    columns = log_columns(driven(PMSM, COURSE_TIME, speed, 1j * load, noise=0.01))
    for name in ("u_alpha", "u_beta"):
        columns[name] = np.roll(columns[name], lag)
    inner = {name: values[5:-5] for name, values in columns.items()}
    finding = by_kind(searched(inner))["lag"]
    assert f"{lag:+d}" in (finding.words, *finding.others)
    stated = by_kind(searched(inner, lag=0))["lag"]
    assert f"{lag:+d}" in (stated.words, *stated.others)
    assert not stated.as_given or lag == -1  # with lag -1, the residual is within the model error


def test_a_steady_log_does_not_identify_the_resistance():
    speed = profile((0, 236), (1.5, 236))
    samples = driven(PMSM, COURSE_TIME, speed, np.full(len(speed), 4j), noise=0.02)
    checked = searched(log_columns(samples))
    assert checked.sound
    text = "\n".join(checked.lines())
    assert "steps of load or speed would show R_s" in text
    assert "Fits equally well" in text
    assert "halve it" in text


def test_without_a_magnet_no_magnet_flux_is_mentioned():
    machine = example("synrm-6kw7")
    speed = profile((0, 100), (0.5, 100), (0.9, -200), (1.5, -200))
    load = profile((0, 10), (0.3, 10), (0.31, 15), (0.7, 15), (0.71, 8), (1.5, 8))
    samples = driven(machine, COURSE_TIME, speed, 8 + 1j * load, noise=0.02)
    columns = log_columns(samples)
    assert "psi_f" not in "\n".join(searched(columns, machine).lines())
    columns["i_alpha"], columns["i_beta"] = -columns["i_alpha"], -columns["i_beta"]
    assert not by_kind(searched(columns, machine))["sign"].as_given


def test_impossible_values_are_gaps():
    columns = {name: values.copy() for name, values in COLUMNS.items()}
    columns["i_alpha"][5000:5010] = np.inf
    columns["i_beta"][7000] = 1e200
    columns["u_beta"][9000] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert searched(columns).sound


def test_a_log_of_noise():
    rng = np.random.default_rng(1)
    noise = {name: rng.standard_normal(4000) for name in COLUMNS if name != "t"}
    checked = searched(noise | {"t": COLUMNS["t"][:4000]})
    assert not checked.sound
    assert "no arrangement" in str(checked)


def test_a_log_at_standstill():
    rng = np.random.default_rng(2)
    z = np.exp(0.3j) * (3 + 0.5 * np.sin(np.linspace(0, 40, 8000)))
    i = z + 0.01 * (rng.standard_normal(8000) + 1j * rng.standard_normal(8000))
    u = PMSM.R_s * z + PMSM.L_s * np.gradient(z, COURSE_TIME)
    columns = {"t": COURSE_TIME * np.arange(8000), "u_alpha": u.real, "u_beta": u.imag}
    checked = searched(columns | {"i_alpha": i.real, "i_beta": i.imag})
    assert not checked.sound
    assert "as at standstill" in str(checked)


@pytest.mark.slow  # quick in tests/cli/test_program.py
def test_exit_codes(tmp_path):
    (tmp_path / "motor.toml").write_text(example_text("pmsm-2kw2"))
    for columns, code in ((COLUMNS, 0), (scaled(current=-1), 1)):
        pl.DataFrame(columns).head(8000).write_parquet(tmp_path / "log.parquet")
        done = fluxobs("check", "log.parquet", "--machine", "motor.toml", folder=tmp_path)
        assert done.returncode == code, done.stderr
        assert ("NOT as given" in done.stdout) == (code == 1)
    failed = fluxobs("check", "none.csv", "--machine", "motor.toml", folder=tmp_path)
    assert failed.returncode == 2


def test_progress_grows_to_its_end():
    seen = []
    check_log(open_for(COLUMNS, PMSM), PMSM, lambda done, total: seen.append((done, total)))
    done, total = np.array(seen).T
    assert (np.diff(done) > 0).all()
    assert (done <= total).all()
    assert done[-1] == total[-1]
