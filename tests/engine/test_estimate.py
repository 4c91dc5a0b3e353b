"""Estimates of whole logs: from a poor machine file to the truth, with honest deviations."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.estimates import STRIDE, NoEstimate, changed, degrees, estimate, file_of
from engine.likelihood import (
    ELEMENTS,
    INDEX,
    STATES,
    UNKNOWNS,
    Array,
    Complex,
    Likelihood,
    course_of,
    library,
    likelihood,
    log_of,
    pointer,
    settled,
)
from engine.loop import INTERIOR, SURFACE, Conditions, Record, simulated
from engine.machines import machine_file
from engine.scores import START, parameters_of
from fluxobs.inference.posterior import Posterior
from fluxobs.machines import SurfacePMSM
from fluxobs.simulation.closed_form.demo import SAMPLE_TIME, generate
from support.records import SERVO, steady

H = 1e-4
#: Indices of the angle and of ψ among the states.
ANGLE, PSI = 2, 4
#: Of the likelihood, of the logs below. The algorithm's own bound is larger: 120 for each of six
#: seeds and of four rounds of growth, ten for all rows, five for early voltages.
MOST_EVALUATIONS = 120 + 4 + 40 + 120
#: Drives of a kind. The mean of (error/σ)² over them scatters by about √(2/12) in each drive.
DRIVES = 4
KINDS = {"surface": SURFACE, "interior": INTERIOR}


@cache
def estimated(kind: str) -> tuple[Conditions, Record, list[Posterior]]:
    """Simulate drives, and estimate them with a file that is 10 to 20 % wrong."""
    c = replace(KINDS[kind], duration=0.3)
    record = simulated(c, DRIVES, seed=3)
    file = file_of(1.15 * c.R, 0.85 * c.L_d, 0.85 * c.L_q, 1.1 * c.psi, 12.0)
    done = [
        estimate(record.voltage[:, k], record.current[:, k], H, file, course(record, k))
        for k in range(DRIVES)
    ]
    return c, record, done


def course(record: Record, k: int) -> Array:
    """Return the angle of a drive as a poor estimate has it: up to 11° off."""
    return record.angle[:, k] + 0.1 + 0.1 * np.sin(np.arange(len(record.angle)) / 500)


@pytest.mark.parametrize("kind", KINDS)
def test_position_and_its_deviation_are_right(kind):
    _, record, done = estimated(kind)
    errors = [degrees(e.rows["angle"], record.angle[:, k]) for k, e in enumerate(done)]
    squares = [
        np.mean((error / np.degrees(e.rows["angle_std"])) ** 2)
        for error, e in zip(errors, done, strict=True)
    ]
    assert np.sqrt(np.mean(np.square(errors))) < 0.5
    assert 0.3 < np.mean(squares) < 2.5


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["speed", "flux_alpha", "psi", "drift_beta", "torque"])
def test_each_quantity_and_its_deviation_are_right(kind, name):
    c, record, done = estimated(kind)
    squares = []
    for k, e in enumerate(done):
        true = {
            "psi": c.psi,
            "drift_beta": record.drift[k].imag,
            "flux_alpha": record.flux[:, k].real,
            "speed": record.speed[:, k],
            "torque": record.torque[:, k],
        }
        error = e.rows[name] - true[name]
        squares.append(np.mean((error / e.rows[f"{name}_std"]) ** 2))
    assert 0.15 < np.mean(squares) < 3


def test_shares_add_up_to_the_variance():
    """And the parameter that the log tells least has the largest one."""
    for e in estimated("interior")[2]:
        rows = {name: values[::STRIDE] for name, values in e.rows.items()}
        flux = (rows["flux_alpha_std"] ** 2 + rows["flux_beta_std"] ** 2) / 2
        wanted = [rows["angle_std"] ** 2, rows["speed_std"] ** 2, flux, rows["torque_std"] ** 2]
        assert e.shares.sum(axis=2) == pytest.approx(np.stack(wanted, axis=1), rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_are_those_of_the_drive(kind):
    """Within 3.5 standard deviations, which are smaller than the errors of the file."""
    c, _, done = estimated(kind)
    true = {"resistance": c.R, "L_d": c.L_d, "L_q": c.L_q, "psi_f": c.psi, "noise": c.noise}
    for e in done:
        assert e.about["converged"]
        for name, value in true.items():
            assert abs(e.value(name) - np.log(value)) < 3.5 * e.std(name), name
        assert e.std("L_q") < 0.05
        assert abs(e.value("lag")) < 3.5 * e.std("lag")
        assert 0.97 < e.about["mean_square"] < 1.03


def test_what_nothing_informs_keeps_its_prior():
    """There is no loss, so its knee is nearly as uncertain as before: 0.7."""
    _, _, done = estimated("surface")
    assert done[0].std("knee") > 0.3


def test_a_long_log_is_learnt_on_windows():
    """25,000 rows: three windows tell the parameters first, then a few evaluations of all rows."""
    c = replace(SURFACE, duration=2.5)
    record = simulated(c, 1, seed=3)
    file = file_of(0.4, 5.5e-4, 5.5e-4, 0.012, 12.0)
    e = estimate(record.voltage[:, 0], record.current[:, 0], H, file, course(record, 0))
    error = degrees(e.rows["angle"], record.angle[:, 0])
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert np.mean((error / np.degrees(e.rows["angle_std"])) ** 2) < 1.5
    for name, true in (("resistance", c.R), ("L_d", c.L_d), ("psi_f", c.psi)):
        assert abs(e.value(name) - np.log(true)) < 3 * e.std(name) < 0.06, name


def test_one_inductance_stays_one():
    for e in estimated("surface")[2]:
        assert e.value("L_d") == e.value("L_q")
        assert e.std("L_d") == e.std("L_q")


def settled_drive(duration: float) -> tuple[Complex, Complex, Array, NDArray[np.void], Likelihood]:
    """Return voltages, currents and parameters of a drive, its course and its likelihood."""
    record, p = simulated(replace(SURFACE, duration=duration), 1), parameters_of(SURFACE)
    u, i = record.voltage[:, 0], record.current[:, 0]
    got, about = settled(u, i, H, p, course_of(i, record.angle[:, 0], p), START)
    return u, i, p, about, got


def test_smoothing_is_the_sum_over_all_innovations():
    """x_s = x + Σ C S⁻¹ e and P_s = P − Σ C S⁻¹ Cᵀ with C = cov(x, e), row by row."""
    got = settled_drive(0.03)[-1]
    rows = got.rows
    own = got.smoothed
    pattern = np.array((ctypes.c_ubyte * (2 * ELEMENTS)).in_dll(library(), "fo_pattern")).reshape(
        -1, 2
    )
    for first in (5, 17, 150, 299):
        P = rows["P"][first]
        angle, variance = rows["own"][first, ANGLE], P[ANGLE, ANGLE]
        chain = P[ANGLE]
        for k in range(first + 1, len(rows)):
            F = np.zeros((STATES, STATES))
            np.add.at(F, (pattern[:, 0], pattern[:, 1]), rows["F"][k - 1])
            chain = F @ chain
            measurement = np.zeros((2, STATES))
            measurement[:, [0, 1, ANGLE, PSI]] = rows["H"][k]
            measurement[:, -2:] = np.eye(2)
            C, V = measurement @ chain, rows["V"][k]
            angle += C @ V @ rows["error"][k]
            variance -= C @ V @ C
            chain = chain - rows["K"][k] @ C
        assert own["angle"][first] == pytest.approx(angle, abs=1e-9)
        assert own["angle_std"][first] ** 2 == pytest.approx(variance, rel=1e-3)


def test_the_course_is_the_smoothed_angle():
    *_, about, got = settled_drive(0.05)
    assert got.smoothed["angle"] == pytest.approx(about["angle"], abs=1e-6)


def test_parameters_widen_the_band():
    """By their covariance through the derivatives of the estimates (finite differences)."""
    u, i, p, about, _ = settled_drive(0.1)
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    covariance[INDEX["psi_f"], INDEX["psi_f"]] = 1e-4
    alone, wide = (
        likelihood(u, i, H, p, about, START, covariance=c).smoothed for c in (None, covariance)
    )
    step = 1e-4 * np.eye(len(p))[INDEX["psi_f"]]
    above, below = (settled(u, i, H, p + s * step, about, START)[0].smoothed for s in (1, -1))
    for name in ("angle", "speed", "flux_alpha", "psi", "drift_beta", "torque"):
        std = f"{name}_std"
        added = np.sqrt(np.maximum(wide[std] ** 2 - alone[std] ** 2, 0)) / 1e-2
        slope = np.abs(above[name] - below[name]) / 2e-4
        if name == "angle":
            assert added == pytest.approx(slope, rel=0.2, abs=0.02)
        else:  # while the filter settles, the course of the torque changes with the parameter too
            settling = 100
            known = pytest.approx(slope[settling:], rel=0.2, abs=0.02 * slope.max())
            assert added[settling:] == known, name


def test_old_currents_turn_the_angle():
    """The angle is that of the row: a delay of half a sample is half a sample's turn."""
    u, i, p, about, got = settled_drive(0.05)
    p[INDEX["lag"]], p[INDEX["delay"]] = -0.5, 0.5  # voltage and current remain together
    turned = likelihood(u, i, H, p, about, START).smoothed["angle"] - got.smoothed["angle"]
    assert turned == pytest.approx(0.5 * H * got.rows["own"][:, 3], rel=1e-9)


@cache
def prescribed() -> tuple[Posterior, Array]:
    """Estimate the demonstration log up to its strongest load, and return its true angle too.

    Its voltages turn with the rotor within a row, by up to 10°, and load steps change no speed.
    """
    columns, rows = generate(), slice(0, 5000)
    u, i = (columns[f"{x}_alpha"] + 1j * columns[f"{x}_beta"] for x in "ui")
    angle = np.unwrap(columns["theta_e"])[rows]
    file = file_of(0.36, 6e-4, 6e-4, 0.0125, 12.0, lag=(0.0, 0.2), voltage=10.0)
    return estimate(
        u[rows],
        i[rows],
        SAMPLE_TIME,
        changed(file, rotation=0.5, rotation_std=0.5),
        angle + 0.05,
    ), angle


def test_a_voltage_that_turns_within_a_row():
    """If it were constant, the current between two rows would be another."""
    e, angle = prescribed()
    assert abs(e.value("rotation") - 1) < 3 * e.std("rotation")
    assert abs(e.value("loss") - np.log(0.15)) < 3 * e.std("loss")
    assert np.sqrt(np.mean(degrees(e.rows["angle"], angle) ** 2)) < 0.3


def test_a_wrong_first_inductance_does_not_hide_in_the_unrest():
    """With too large an inductance, each load step looks like a jump of the acceleration."""
    e, _ = prescribed()
    assert abs(e.value("L_q") - np.log(6e-4)) < 3 * e.std("L_q")
    assert e.std("L_q") < 0.02


def test_a_steady_log_hardly_tells_the_resistance():
    """At one speed and one current, voltages tell R i + ωψ only: the priors tell R from ψ.

    Errors of the filter times derivatives of its transition are no information about them.
    """
    e = of_steady(SERVO)
    assert e.std("resistance") > 0.1
    for name, true in (("resistance", SERVO.R_s), ("psi_f", SERVO.magnet_flux)):
        assert abs(e.value(name) - np.log(true)) < 4 * e.std(name)


def test_what_a_log_hardly_tells_stays_as_in_the_file():
    e = of_steady(SERVO)
    for name, true in (("resistance", SERVO.R_s), ("L_d", SERVO.L_s), ("psi_f", SERVO.psi_f)):
        assert e.value(name) == np.log(true)


def test_a_wrong_value_does_not_stay_although_the_others_are_hardly_told():
    e = of_steady(SERVO.scaled(["psi_f"], 1.5))
    assert abs(e.value("psi_f") - np.log(SERVO.psi_f)) < 4 * e.std("psi_f")


def of_steady(machine: SurfacePMSM) -> Posterior:
    """Estimate a log of the servo at constant speed and current, with the file of `machine`."""
    s = steady(SERVO, H, 500.0, 2500, 6j, 0.1, -0.1, noise=0.02)
    file = machine_file(machine, H, current=12.0, voltage=8.0)
    return estimate(s.voltage @ [1, 1j], s.current @ [1, 1j], H, file, np.unwrap(s.theta))


def test_a_load_step_does_not_spoil_the_inductance():
    """The acceleration jumps with the load; the unrest of these rows leaves the others calm."""
    calm = replace(SURFACE, acceleration=1.0, duration=0.3)
    record = simulated(calm, 1)
    jump = np.zeros(3000)
    jump[1000:1020], jump[2000:2020] = 2e5, -2e5
    theirs = simulated(calm, 1, jumps=jump)
    file = file_of(0.36, 5e-4, 5e-4, 0.0125, 12.0)
    for r in (record, theirs):
        e = estimate(r.voltage[:, 0], r.current[:, 0], H, file, course(r, 0))
        assert abs(e.value("L_q") - np.log(6e-4)) < 4 * e.std("L_q")
        assert e.std("L_q") < 0.02
        assert np.abs(degrees(e.rows["angle"], r.angle[:, 0])).max() < 1.5


@cache
def clipped() -> tuple[Record, Complex, float]:
    """Return a drive, its currents by three sensors with a limit, and this limit [A]."""
    record = simulated(replace(SURFACE, duration=0.42, acceleration=300.0), 1, seed=2)
    limit = 7.0
    axes = np.exp(2j * np.pi / 3 * np.arange(3))
    phases = (record.current[:, :1] * np.conj(axes)).real
    return record, 2 / 3 * np.clip(phases, -limit, limit) @ axes, limit


def test_sensors_at_their_limit():
    """A load step beyond the range of the current sensors: the range is learnt."""
    record, current, limit = clipped()
    assert np.mean(np.abs(current - record.current[:, 0]) > 0.1) > 0.01
    file = file_of(0.4, 5e-4, 5e-4, 0.0115, 12.0)
    e = estimate(record.voltage[:, 0], current, H, file, course(record, 0))
    error = degrees(e.rows["angle"], record.angle[:, 0])
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert abs(e.value("range") - limit) < 3.5 * e.std("range") + 0.02


def test_outliers_count_for_nothing():
    """Rows that cannot be right: their noise has Student's distribution."""
    record = simulated(replace(SURFACE, duration=0.3), 1, seed=3)
    current, rng = record.current[:, 0].copy(), np.random.default_rng(0)
    at = rng.choice(len(current), 60, replace=False)
    current[at] += rng.normal(0, 3.0, (60, 2)) @ [1, 1j]
    file = file_of(0.4, 5e-4, 5e-4, 0.0115, 12.0)
    e = estimate(record.voltage[:, 0], current, H, file, course(record, 0))
    error = degrees(e.rows["angle"], record.angle[:, 0])
    assert np.sqrt(np.mean(error**2)) < 0.3
    assert abs(e.value("L_q") - np.log(6e-4)) < 3.5 * e.std("L_q")
    assert abs(e.value("noise") - np.log(0.03)) < 0.1


def rounding_of(current: Complex) -> Array:
    """Return the variance that rounding adds to each row."""
    variances = np.zeros(len(current))
    with log_of(current, current, H) as log:
        library().fo_rounding_of(ctypes.byref(log), pointer(variances))
    return variances


def test_a_run_of_equal_readings_tells_as_much_as_one():
    """n readings of a uniform error over the step at their ends: n times its variance, step²/12."""
    held = np.array([0.0, 1.0, 2.0, 2.0, 2.0, 5.0, 5.0, 6.0], complex)
    steps = {2: (1.0 + 9.0) / 2, 5: (9.0 + 1.0) / 2}
    expected = np.zeros(8)
    expected[2:5], expected[5:7] = 3 * steps[2] / 12, 2 * steps[5] / 12
    assert rounding_of(held) == pytest.approx(expected)
    assert (rounding_of(np.ones(9, complex)) == 0).all()  # it never ends


def test_readings_that_hardly_change_do_not_make_the_estimate_sure():
    """A coarse converter without noise while hardly any current flows: its error is no noise."""
    calm = replace(SURFACE, noise=1e-4, acceleration=5.0, duration=0.3)
    calm = replace(calm, loss=0.4, knee=0.1)
    step, squares = 0.05, []
    for seed in range(2):
        r = simulated(calm, 1, seed=seed, loads=((0.0, 1.0), (0.0, 0.3)))
        current = step * (np.round(r.current.real / step) + 1j * np.round(r.current.imag / step))
        file = file_of(0.4, 5.5e-4, 5.5e-4, 0.012, 12.0)
        e = estimate(r.voltage[:, 0], current[:, 0], H, file, course(r, 0))
        error = degrees(e.rows["angle"], r.angle[:, 0]) / np.degrees(e.rows["angle_std"])
        squares.append(np.mean(error**2))
    assert np.mean(squares) < 1.5


def grown(
    record: Record,
    voltage: Complex | None = None,
    angle: Array | None = None,
    sure: bool = True,
) -> tuple[Posterior, Array]:
    """Estimate a surface machine with a poor file; return this and the errors of the angle [°]."""
    c, u = SURFACE, record.voltage[:, 0] if voltage is None else voltage
    file = file_of(1.15 * c.R, 0.85 * c.L_d, 0.85 * c.L_q, 1.1 * c.psi, 12.0)
    hint = course(record, 0) if angle is None else angle
    e = estimate(u, record.current[:, 0], H, file, hint, sure=sure)
    return e, degrees(e.rows["angle"], record.angle[:, 0])


def test_the_course_grows_beyond_the_rows_with_hints():
    """An observer knows the angle of every twentieth of the rows only, and is 11° off."""
    record = simulated(replace(SURFACE, duration=0.4), 1, seed=4)
    hint = np.full(len(record.angle), np.nan)
    hint[2000:2200] = course(record, 0)[2000:2200]
    e, error = grown(record, angle=hint)
    assert np.isfinite(error).mean() > 0.98
    assert np.nanmax(np.abs(error)) < 1.5
    assert np.nanmean((error / np.degrees(e.rows["angle_std"])) ** 2) < 4


def test_a_hint_that_is_wrong_does_not_hold_the_course():
    """A second run of hints, within what a sure filter would confirm, is 14° off."""
    record = simulated(replace(SURFACE, duration=0.4), 1, seed=4)
    hint, right = np.full(len(record.angle), np.nan), record.angle[:, 0]
    hint[1000:1300] = right[1000:1300]
    hint[2500:2800] = right[2500:2800] + 0.25
    _, error = grown(record, angle=hint)
    assert np.isfinite(error).mean() > 0.98
    assert np.nanmax(np.abs(error)) < 1.5


def test_hints_that_no_machine_explains_are_forgotten():
    """A long run of hints is half a turn off. A shorter run is right."""
    record = simulated(replace(SURFACE, duration=0.4), 1, seed=4)
    hint, right = np.full(len(record.angle), np.nan), record.angle[:, 0]
    hint[2000:3500] = right[2000:3500] + np.pi
    with pytest.raises(NoEstimate):
        grown(record, angle=hint)
    hint[800:1300] = right[800:1300]
    e, error = grown(record, angle=hint)
    assert np.isfinite(error).mean() > 0.98
    assert np.nanmax(np.abs(error)) < 1.5
    assert e.about["conflict"] < 20


def test_conflict_is_that_of_the_priors():
    """d standard deviations count d²; those of the file less, beyond what one tolerates."""
    record = simulated(replace(SURFACE, duration=0.3), 1, seed=2)
    c, conflicts = SURFACE, []
    for factor in (1.0, 2.0):
        file = file_of(c.R, factor * c.L_d, factor * c.L_q, c.psi, 12.0, (0.3, 0.15, 0.15))
        e = estimate(record.voltage[:, 0], record.current[:, 0], H, file, course(record, 0))
        d = (e.value("L_d") - np.log(factor * c.L_d)) / 0.15
        near, far = 0.95 * np.exp(-(d**2) / 2), 0.01 * np.exp(-((d / 5) ** 2) / 2)
        conflicts.append(e.about["conflict"] + 2 * np.log((near + far) / 0.96))
    assert 0 < conflicts[0] < 10
    assert abs(conflicts[1] - conflicts[0]) < 1
    assert far / near > 100


def test_hints_that_are_not_sure_must_explain_other_rows():
    """Voltages that were not applied on both sides of the hints: nothing else confirms them."""
    record = simulated(replace(SURFACE, duration=0.4), 1, seed=4)
    voltage, hint = record.voltage[:, 0].copy(), course(record, 0)
    voltage[:1500] *= 0.5
    voltage[2300:] *= 0.5
    hint[:1500] = hint[2300:] = np.nan
    _, error = grown(record, voltage, hint)
    known = np.isfinite(error)
    assert known[1600:2200].all()
    assert not known[:1400].any()
    assert not known[2400:].any()
    with pytest.raises(NoEstimate):
        grown(record, voltage, hint, sure=False)


def test_a_gap_ends_a_part():
    """The log lacks 200 rows, in which the rotor turns by several radians."""
    record = simulated(replace(SURFACE, duration=0.4), 1, seed=4)
    record.current[1900:2100], record.voltage[1900:2100] = np.nan, np.nan
    hint = course(record, 0)
    hint[1900:2100] = np.nan
    e, error = grown(record, angle=hint)
    known = np.isfinite(error)
    assert not known[1915:2095].any()
    assert known[:1895].all()
    assert known[2105:].all()
    assert np.nanmax(np.abs(error)) < 1.5
    assert np.nanmean((error / np.degrees(e.rows["angle_std"])) ** 2) < 4


def test_rows_whose_voltages_were_not_applied_have_no_angle():
    """From row 1500 to 2100, the log has a voltage that is 0.6 of that which was applied."""
    record = simulated(replace(SURFACE, duration=0.4), 1, seed=4)
    voltage = record.voltage[:, 0].copy()
    voltage[1500:2100] *= 0.6
    hint = course(record, 0)
    hint[1500:2100] = np.nan
    e, error = grown(record, voltage, hint)
    known = np.isfinite(error)
    assert (np.isfinite(e.rows["angle_std"]) == known).all()
    assert not known[1600:2000].any()
    assert known[:1400].all()
    assert known[2200:].all()
    assert np.nanmax(np.abs(error)) < 2


@pytest.mark.slow
def test_a_long_log_grows_from_a_part():
    """The first stage sees 4096 rows of 20,000."""
    c = replace(SURFACE, duration=2.0)
    record = simulated(c, 1, seed=5)
    file = file_of(1.15 * c.R, 0.85 * c.L_d, 0.85 * c.L_q, 1.1 * c.psi, 12.0)
    e = estimate(record.voltage[:, 0], record.current[:, 0], H, file, course(record, 0))
    error = degrees(e.rows["angle"], record.angle[:, 0])
    assert np.sqrt(np.mean(error**2)) < 0.3
    assert np.mean((error / np.degrees(e.rows["angle_std"])) ** 2) < 3
    assert abs(e.value("L_q") - np.log(c.L_q)) < 3.5 * e.std("L_q")


def attempt(u: Complex, i: Complex) -> Posterior | None:
    """Return the estimate, or None if the log contradicts the start."""
    with suppress(NoEstimate):
        return estimate(u, i, H, file_of(0.36, 6e-4, 6e-4, 0.0125, 12.0), np.zeros(len(i)))
    return None


@pytest.mark.parametrize("rows", [1, 2, 9, 50])
def test_few_rows_are_an_answer_or_a_reason(rows):
    record = simulated(replace(SURFACE, duration=0.02), 1)
    u, i = record.voltage[:rows, 0], record.current[:rows, 0]
    got = attempt(u, i)
    assert got is None or np.isfinite(got.rows["angle"]).all()


@pytest.mark.parametrize("kind", ["flat", "missing", "noise", "huge"])
def test_a_log_without_a_motor_ends(kind):
    """An answer with a wide band, or a reason; a bound on evaluations in any case."""
    rng = np.random.default_rng(0)
    u, i = (np.ones(300, complex) for _ in range(2))
    if kind == "missing":
        i[:] = np.nan
    elif kind == "noise":
        u, i = (rng.standard_normal((300, 2)) @ [1, 1j] for _ in range(2))
    elif kind == "huge":
        u = u * 1e12
    got = attempt(u, i)
    assert got is None or got.about["evaluations"] <= MOST_EVALUATIONS
    if got is not None:
        known = np.isfinite(got.rows["angle"])
        assert (np.isfinite(got.rows["angle_std"]) == known).all()


@pytest.mark.parametrize(("current", "least"), [(0.0, 1.5), (1.0, 0.5)])
def test_a_log_at_rest_knows_nothing_of_the_angle(current, least):
    """That a rotor stays where it is although there is a current tells little [rad]."""
    got = attempt(np.full(400, 0.36 * current + 0j), np.full(400, current + 0j))
    assert got is not None
    assert (got.rows["angle_std"] > least).all()


def test_the_same_log_gives_the_same_bits():
    record = simulated(replace(SURFACE, duration=0.1), 1)
    file = file_of(0.36, 6e-4, 6e-4, 0.0125, 12.0)
    once, again = (
        estimate(record.voltage[:, 0], record.current[:, 0], H, file, course(record, 0))
        for _ in range(2)
    )
    assert all(
        once.rows[name] is not again.rows[name]
        and np.array_equal(once.rows[name], again.rows[name])
        for name in once.rows
    )
    assert (once.parameters == again.parameters).all()
