"""Seeds: a known angle speeds up the start and is propagated; a wrong angle is never valid."""

import numpy as np
import pytest

from fluxobs import UsageError
from fluxobs.machines import example
from fluxobs.observers import AdaptiveObserver, LeastSquaresObserver
from fluxobs.simulation.closed_form.signals import driven, vectors

H, ROWS, SUBSTEPS, START = 1e-4, 3500, 8, 0.7
TOP = 2 * np.pi * 60


def record(name):
    """Return a run-up from rest under load: machine, angle, voltage, current, active flux."""
    machine = example(name)
    rated = machine.rated_current
    along = 0.0 if machine.magnets else 0.5 * rated
    rows = np.arange(ROWS * SUBSTEPS + 1) / SUBSTEPS
    speed = np.interp(rows, (0, 200, 1500), (0, 0, TOP))
    i_dq = np.full(rows.shape, along + 0.4j * rated)
    true = driven(machine, H, speed, i_dq, SUBSTEPS, START)
    noise = 0.002 * rated * np.random.default_rng(2).standard_normal((ROWS + 1, 2))
    current = vectors(true.current) + noise + 0.01 * rated * np.array([1, -0.5])
    active = 0.0 if machine.magnets else machine.saliency * along
    return machine, true.theta_e, vectors(true.voltage), current, active


def position_error(estimated, theta, machine):
    degrees = np.degrees(np.angle(np.exp(1j * (estimated - theta))))
    return (degrees + 90) % 180 - 90 if machine.half_turn_ambiguous else degrees


def turned(valid, theta):
    """Return the rotation until the first valid row [degrees]."""
    assert valid.any()
    return np.degrees(theta_sum(theta)[np.argmax(valid)])


def theta_sum(theta):
    return np.cumsum(np.abs(np.angle(np.exp(1j * np.diff(theta)))))


@pytest.mark.parametrize("kind", [LeastSquaresObserver, AdaptiveObserver])
@pytest.mark.parametrize("name", ["ipm-2kw2", "synrm-6kw7"])
def test_a_known_angle_is_propagated_and_makes_rows_valid_earlier(name, kind):
    machine, theta, u, i, active = record(name)
    observer = kind.for_machine(machine, sample_time=H)
    unseeded = observer.run(u, i[1:])
    state = observer.seed(START + 0.04, i[0], theta_e_std=0.05, psi_f=active)
    seeded = observer.resume(state, u, i[1:])[1]
    assert np.abs(position_error(seeded.theta_e[:400], theta[1:401], machine)).max() < 8
    assert seeded.theta_e_std[0] < 0.06
    assert turned(seeded.valid, theta) < turned(unseeded.valid, theta) - 10
    error = np.abs(position_error(seeded.theta_e, theta[1:], machine))
    assert (error < np.maximum(3, 4 * np.degrees(seeded.theta_e_std)))[seeded.valid].all()


@pytest.mark.parametrize("kind", [LeastSquaresObserver, AdaptiveObserver])
@pytest.mark.parametrize("name", ["servo-400w", "ipm-2kw2", "synrm-6kw7"])
def test_a_wrong_angle_is_never_valid(name, kind):
    """The error is 90 degrees, the stated standard deviation six degrees."""
    machine, theta, u, i, active = record(name)
    observer = kind.for_machine(machine, sample_time=H)
    state = observer.seed(START + np.pi / 2, i[0], theta_e_std=0.1, psi_f=active)
    estimate = observer.resume(state, u, i[1:])[1]
    error = np.abs(position_error(estimate.theta_e, theta[1:], machine))
    assert error[0] > 80
    assert not (estimate.valid & (error > 10)).any()
    if kind is LeastSquaresObserver:
        assert estimate.valid[-1]


def test_the_filter_starts_if_the_angle_is_known_well_enough():
    machine, _, u, i, _ = record("ipm-2kw2")
    observer = AdaptiveObserver.for_machine(machine, sample_time=H)
    for std, runs in ((0.05, True), (0.3, False)):
        state = observer.seed(START, i[0], theta_e_std=std)
        assert bool(observer.step(state, u[0], i[1])[1].adapting) is runs


def test_a_seed_keeps_the_learnt_parameters():
    machine, theta, u, i, _ = record("ipm-2kw2")
    observer = AdaptiveObserver.for_machine(machine, sample_time=H)
    state = observer.resume(observer.init(), u, i[1:])[0]
    learnt = observer.learnt(state)
    assert learnt.resistance_std < observer.resistance_std
    after_seed = observer.learnt(observer.seed(theta[-1], i[-1], theta_e_std=0.05, state=state))
    assert after_seed.resistance == learnt.resistance
    assert after_seed.inverter_voltage == learnt.inverter_voltage
    assert after_seed.psi_f == pytest.approx(learnt.psi_f, rel=1e-12)


def test_a_seed_from_an_estimate():
    machine, _, u, i, _ = record("ipm-2kw2")
    observer = LeastSquaresObserver.for_machine(machine, sample_time=H)
    _, estimate = observer.step(observer.init(), u[0], i[1])
    seeded = observer.seed(np.asarray(estimate.theta_e), i[1], theta_e_std=0.1)
    assert seeded == observer.seed(float(estimate.theta_e), i[1], theta_e_std=0.1)


def test_invalid_seeds_are_refused():
    observer = LeastSquaresObserver.for_machine(example("servo-400w"), sample_time=H)
    with pytest.raises(UsageError, match="theta_e_std must be positive"):
        observer.seed(0.0, [0.0, 0.0], theta_e_std=0.0)
    with pytest.raises(UsageError, match="finite"):
        observer.seed(np.nan, [0.0, 0.0], theta_e_std=0.1)
    with pytest.raises(UsageError, match="shape"):
        observer.seed(0.0, [0.0, 0.0, 0.0], theta_e_std=0.1)
    with pytest.raises(UsageError, match="current must be finite"):
        observer.seed(0.0, [0.0, np.inf], theta_e_std=0.1)
    with pytest.raises(UsageError, match="theta_e must be a number"):
        observer.seed("north", [0.0, 0.0], theta_e_std=0.1)
    with pytest.raises(UsageError, match="psi_f_std must not be negative"):
        observer.seed(0.0, [0.0, 0.0], theta_e_std=0.1, psi_f_std=-0.01)
    with pytest.raises(UsageError, match="batch of shape"):
        observer.seed(0.0, [0.0, 0.0], theta_e_std=0.1, state=observer.init((3,)))


SERVO, CURRENT = example("servo-400w"), np.array([3.0, -4.0])


def first_estimate(observer, theta, current=CURRENT, **given):
    """Return the estimate one sample after a seed; the voltage keeps the current constant."""
    state = observer.seed(theta, current, **{"theta_e_std": 0.1} | given)
    return observer.step(state, SERVO.R_s * np.asarray(current), current)[1]


@pytest.mark.parametrize("psi_f", [0.0, 0.02, -0.02])
@pytest.mark.parametrize("theta", [-6.2, -3.1, -1.0, 0.0, 0.4, 2.0, 3.1, 4.0, 6.2])
def test_the_flux_follows_from_the_angle(theta, psi_f):
    observer = LeastSquaresObserver.for_machine(SERVO, sample_time=H)
    estimate = first_estimate(observer, theta, psi_f=psi_f)
    vector = (psi_f or observer.flux_base) * np.exp(1j * theta)
    flux = vector + SERVO.L_s * complex(*CURRENT)
    assert complex(*estimate.flux) == pytest.approx(flux, rel=1e-3)
    assert estimate.theta_e == pytest.approx(np.angle(vector), abs=1e-3)
    assert estimate.psi_f == pytest.approx(abs(vector), rel=1e-3)
    assert estimate.theta_e_std == pytest.approx(0.1, rel=1e-3)


def test_limits_of_a_seed_from_both_sides():
    observer = LeastSquaresObserver.for_machine(SERVO, sample_time=H)
    margin, largest_current = 1e-6, observer.current_limit * CURRENT / np.linalg.norm(CURRENT)
    for inside, beyond in (
        (
            {"psi_f": observer.length_min * (1 + margin)},
            {"psi_f": observer.length_min * (1 - margin)},
        ),
        (
            {"psi_f": 1e3 * observer.flux_base * (1 - margin)},
            {"psi_f": 1e3 * observer.flux_base * (1 + margin)},
        ),
        ({"current": largest_current * (1 - margin)}, {"current": largest_current * (1 + margin)}),
    ):
        assert first_estimate(observer, 0.5, **inside).theta_e_std < 0.2
        assert first_estimate(observer, 0.5, **beyond).theta_e_std > 1.8


@pytest.mark.parametrize("kind", [LeastSquaresObserver, AdaptiveObserver])
def test_defaults_of_a_seed(kind):
    observer = kind.for_machine(SERVO, sample_time=H)
    usual = 0.0125

    def seed(**given):
        return observer.seed(0.5, CURRENT, **{"theta_e_std": 0.1} | given)

    assert seed() == seed(psi_f=usual, psi_f_std=0.25 * usual)
    assert seed(psi_f=2 * usual) == seed(psi_f=2 * usual, psi_f_std=0.5 * usual)
    assert seed() != seed(psi_f_std=0.26 * usual)
    assert seed(theta_e_std=1e-9) == seed(theta_e_std=1e-3) != seed(theta_e_std=1.001e-3)
