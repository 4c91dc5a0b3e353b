"""Estimates of whole logs: from a poor machine file to the truth, with honest deviations."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.estimates import Estimate, NoEstimate, degrees, estimate, file_of, smoothed
from engine.likelihood import INDEX, STATES, UNKNOWNS, Array, Complex, likelihood
from engine.loop import INTERIOR, SURFACE, Conditions, Record, simulated
from engine.scores import parameters_of, starts

H = 1e-4
#: Index of the angle among the states.
ANGLE = 2
#: Of the likelihood, for a log that is one part: two stages of sixty.
MOST_EVALUATIONS = 120
#: Drives of a kind. The mean of (error/σ)² over them scatters by about √(2/12) in each drive.
DRIVES = 4
KINDS = {"surface": SURFACE, "interior": INTERIOR}


@cache
def estimated(kind: str) -> tuple[Conditions, Record, list[Estimate]]:
    """Simulate drives, and estimate them with a file that is 10 to 20 % wrong."""
    c = replace(KINDS[kind], duration=0.3)
    record = simulated(c, DRIVES, seed=3)
    file = file_of(1.15 * c.R, 0.85 * c.L_d, 0.85 * c.L_q, 1.1 * c.psi, 12.0)
    done = [estimate(record.voltage[:, k], record.current[:, k], H, file) for k in range(DRIVES)]
    return c, record, done


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
def test_parameters_are_those_of_the_drive(kind):
    """Within 3.5 standard deviations, which are smaller than the errors of the file."""
    c, _, done = estimated(kind)
    true = {"resistance": c.R, "L_d": c.L_d, "L_q": c.L_q, "psi_f": c.psi, "noise": c.noise}
    for e in done:
        assert e.converged
        for name, value in true.items():
            assert abs(e.value(name) - np.log(value)) < 3.5 * e.std(name), name
        assert e.std("L_q") < 0.05
        assert abs(e.value("lag")) < 3.5 * e.std("lag")
        assert 0.97 < e.mean_square < 1.03


def test_what_nothing_informs_keeps_its_prior():
    """There is no loss, so its knee is nearly as uncertain as before: 0.7."""
    _, _, done = estimated("surface")
    assert done[0].std("knee") > 0.3


def test_one_inductance_stays_one():
    for e in estimated("surface")[2]:
        assert e.value("L_d") == e.value("L_q")
        assert e.std("L_d") == e.std("L_q")


def test_smoothing_is_that_of_rauch_tung_and_striebel():
    """Another algorithm on the same rows: with inverses of predicted covariances."""
    record = simulated(replace(SURFACE, duration=0.03), 1)
    p = parameters_of(SURFACE)
    got = likelihood(record.voltage[:, 0], record.current[:, 0], H, p, starts(record, 0.05)[0])
    rows = got.rows
    own = smoothed(rows)
    angle, variance = backwards(rows)
    assert own["angle"] == pytest.approx(angle, abs=1e-9)
    assert own["angle_std"] ** 2 == pytest.approx(variance, rel=1e-4)


def backwards(rows: NDArray[np.void]) -> tuple[Array, Array]:
    """Return angle and variance, from P_s = P + C (P_s⁺ − P⁻) Cᵀ with C = P Fᵀ P⁻⁻¹."""
    angle, P = rows["angle"].copy(), rows["P"].reshape(-1, STATES, STATES)
    correction, smooth = np.zeros(STATES), P[-1]
    variances = [smooth[ANGLE, ANGLE]]
    for k in range(len(rows) - 2, -1, -1):
        K, V = rows["K"][k + 1].reshape(STATES, 2), rows["inverse"][k + 1].reshape(2, 2)
        F = rows["F"][k].reshape(STATES, STATES)
        predicted = P[k + 1] + K @ np.linalg.inv(V) @ K.T
        scale = np.sqrt(np.where(np.diag(predicted) > 0, np.diag(predicted), 1.0))
        inverse = np.linalg.pinv(predicted / np.outer(scale, scale), rcond=1e-13, hermitian=True)
        C = P[k] @ F.T @ (inverse / np.outer(scale, scale))
        correction = C @ (correction + K @ rows["error"][k + 1])
        smooth = P[k] + C @ (smooth - predicted) @ C.T
        angle[k] += correction[ANGLE]
        variances.append(smooth[ANGLE, ANGLE])
    return angle, np.array(variances[::-1])


def test_parameters_widen_the_band():
    """By their covariance through the derivatives of the smoothed angle (finite differences)."""
    record = simulated(replace(SURFACE, duration=0.1), 1)
    u, i, start = record.voltage[:, 0], record.current[:, 0], starts(record, 0.05)[0]
    p = parameters_of(SURFACE)
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    covariance[INDEX["psi_f"], INDEX["psi_f"]] = 1e-4
    rows = likelihood(u, i, H, p, start).rows
    alone, wide = smoothed(rows), smoothed(rows, covariance)
    added = np.sqrt(wide["angle_std"] ** 2 - alone["angle_std"] ** 2) / 1e-2
    step = 1e-4 * np.eye(len(p))[INDEX["psi_f"]]
    above, below = (
        smoothed(likelihood(u, i, H, p + s * step, start).rows)["angle"] for s in (1, -1)
    )
    assert added == pytest.approx(np.abs(above - below) / 2e-4, rel=0.2, abs=0.02)


def attempt(u: Complex, i: Complex) -> Estimate | None:
    """Return the estimate, or None if the log contradicts every start."""
    with suppress(NoEstimate):
        return estimate(u, i, H, file_of(0.36, 6e-4, 6e-4, 0.0125, 12.0))
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
    assert got is None or got.evaluations <= MOST_EVALUATIONS
    assert got is None or np.isfinite(got.rows["angle_std"]).all()


@pytest.mark.parametrize(("current", "least"), [(0.0, 1.8), (1.0, 0.5)])
def test_a_log_at_rest_knows_nothing_of_the_angle(current, least):
    """That a rotor stays where it is although there is a current tells little [rad]."""
    got = attempt(np.full(400, 0.36 * current + 0j), np.full(400, current + 0j))
    assert got is not None
    assert (got.rows["angle_std"] > least).all()


def test_the_same_log_gives_the_same_bits():
    record = simulated(replace(SURFACE, duration=0.1), 1)
    file = file_of(0.36, 6e-4, 6e-4, 0.0125, 12.0)
    once, again = (estimate(record.voltage[:, 0], record.current[:, 0], H, file) for _ in range(2))
    assert (once.rows == again.rows).all()
    assert (once.parameters == again.parameters).all()
