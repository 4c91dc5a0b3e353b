"""Plain and adaptive observers on machines whose flux is a nonlinear function of the current."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs import AdaptiveObserver, LeastSquaresObserver
from fluxobs.machines import (
    AlgebraicSaturation,
    FluxPoints,
    SurfacePMSM,
    SynchronousReluctance,
    example,
)
from support.records import driven, profile, wrapped_degrees

H = 1.25e-4
MODEL = AlgebraicSaturation(a_d0=17.4, a_dd=373, a_q0=52.1, a_qq=658, a_dq=1120)
RELUCTANCE = SynchronousReluctance(R_s=0.63, n_p=2, rated_current=22.0, flux_map=MODEL)
INTERIOR = example("ipm-2kw2")


def reluctance_record(seed=0, theta0=0.7, machine=RELUCTANCE, noise=0.05):
    """Return a record: i_q -8 to 18 A, i_d 8 to 12 A, a reversal, and an offset of 1.1 V."""
    speed = 2 * np.pi * 20 * profile((0, 1), (0.2, 1), (0.6, 4), (1.2, 4), (1.7, -3), (2, -3))
    i_q = profile(
        *((0, 4), (0.4, 4), (0.43, 18), (0.9, 18), (0.93, 8), (1.3, 8), (1.35, -8), (2, -8))
    )
    i_d = profile((0, 8), (0.4, 8), (0.45, 12), (0.9, 12), (1.0, 10), (2, 10))
    return driven(
        machine,
        H,
        speed,
        i_d + 1j * i_q,
        voltage_bias=1 + 0.5j,
        noise=noise,
        theta0=theta0,
        seed=seed,
    )


def errors(estimate, samples, half=False):
    turn = 2 if half else 1
    return wrapped_degrees(turn * (estimate.theta_e - samples.theta)) / turn


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


def test_a_saturated_reluctance_machine_from_a_cold_start():
    """Required: 0.1 degrees rms, at most 3 degrees on valid rows."""
    samples = reluctance_record()
    estimate = LeastSquaresObserver.for_machine(RELUCTANCE, sample_time=H).run(
        samples.voltage, samples.current
    )
    error = errors(estimate, samples, half=True)
    settled = np.arange(len(error)) * H > 0.2
    assert rms(error[settled]) < 0.1
    assert np.abs(error[estimate.valid]).max() < 3.0
    assert estimate.valid[settled].mean() > 0.95
    std = np.degrees(estimate.theta_e_std)
    assert 0.5 < rms(error[estimate.valid] / std[estimate.valid]) < 1.5
    linear = SynchronousReluctance(
        R_s=0.63, n_p=2, rated_current=22.0, L_d=RELUCTANCE.L_d, L_q=RELUCTANCE.L_q
    )
    without_map = LeastSquaresObserver.for_machine(linear, sample_time=H).run(
        samples.voltage, samples.current
    )
    assert rms(errors(without_map, samples, half=True)[settled]) > 1.5


@pytest.mark.parametrize("theta0", np.arange(-3, 3.2, 0.78))
def test_it_starts_at_any_angle(theta0):
    samples = reluctance_record(theta0=theta0, seed=3)
    estimate = LeastSquaresObserver.for_machine(RELUCTANCE, sample_time=H).run(
        samples.voltage[:4000], samples.current[:4000]
    )
    error = wrapped_degrees(2 * (estimate.theta_e - samples.theta[:4000])) / 2
    std = np.degrees(estimate.theta_e_std)
    assert np.abs(error[estimate.valid]).max() < 5.0
    assert np.abs(error[estimate.valid] / std[estimate.valid]).max() < 5.0
    assert estimate.valid[-1000:].mean() > 0.9
    assert rms(error[-1000:][estimate.valid[-1000:]]) < 0.2


def test_single_precision_is_enough():
    samples = reluctance_record()
    run = {
        precision: LeastSquaresObserver.for_machine(
            RELUCTANCE, sample_time=H, precision=precision
        ).run(samples.voltage, samples.current)
        for precision in ("double", "single")
    }
    difference = wrapped_degrees(run["single"].theta_e - run["double"].theta_e)[4000:]
    assert np.abs(difference).max() < 0.05


def test_a_current_outside_the_map_is_not_valid_and_is_counted():
    small = RELUCTANCE.with_values(rated_current=8.0)  # the map then covers up to 16 A
    samples = reluctance_record()
    observer = LeastSquaresObserver.for_machine(small, sample_time=H)
    state, estimate = observer.resume(observer.init(), samples.voltage, samples.current)
    outside = np.abs(samples.current @ [1, 1j]) > 20  # 18 A along q
    assert outside.sum() > 1000
    assert not estimate.valid[outside].any()
    assert observer.counts(state).outside > 0.9 * outside.sum()


@pytest.mark.parametrize("share", [0.7, 0.5])
def test_a_surface_machine_whose_inductance_falls(share):
    """Required: 0.2 degrees rms; a constant inductance gives 3.7 and 6.6 degrees."""
    values = {"R_s": 0.5, "n_p": 4, "L_s": 3e-3, "psi_f": 0.1, "rated_current": 20.0}
    machine = SurfacePMSM(**values, L_s_rated=share * 3e-3)
    speed = profile((0, 300), (1.0, 300), (1.4, -300), (1.8, -300))
    i_q = profile((0, 3), (0.3, 3), (0.31, 20), (0.8, 20), (0.81, -10), (1.8, 15))
    samples = driven(machine, H, speed, 0j + 1j * i_q, voltage_bias=0.5 + 0.2j, noise=0.04, seed=1)
    for model, lower, upper in ((machine, 0.0, 0.2), (SurfacePMSM(**values), 1.5, 30.0)):
        estimate = LeastSquaresObserver.for_machine(model, sample_time=H).run(
            samples.voltage, samples.current
        )
        assert lower <= rms(errors(estimate, samples)[2000:]) < upper


def interior_record(machine, seed=0, theta0=0.7):
    i_q = profile(
        *((0, 1), (0.3, 1), (0.302, 7), (0.7, 7), (0.703, -3), (1.2, -3), (1.22, 5), (1.6, 5))
    )
    i_d = profile((0, -0.5), (0.3, -0.5), (0.302, -5.5), (0.5, -5.5), (0.502, -0.5), (0.9, -0.5))
    i_d = np.concatenate([i_d, np.full(len(i_q) - len(i_d), -6.5)])
    speed = profile((0, 314), (1.3, 314), (1.6, -200))
    return driven(
        machine,
        H,
        speed,
        i_d + 1j * i_q,
        voltage_bias=1 + 0.5j,
        noise=0.02,
        theta0=theta0,
        seed=seed,
    )


@pytest.mark.parametrize(("ratio", "largest"), [(None, 0.15), (4.0, 0.3), (6.5, 0.4)])
def test_an_interior_machine_whose_i_d_steps(ratio, largest):
    machine = INTERIOR if ratio is None else INTERIOR.with_values(L_q=ratio * INTERIOR.L_d)
    samples = interior_record(machine)
    estimate = LeastSquaresObserver.for_machine(machine, sample_time=H).run(
        samples.voltage, samples.current
    )
    error = errors(estimate, samples)
    assert rms(error[estimate.valid]) < largest
    assert np.abs(error[estimate.valid]).max() < 2.0
    assert estimate.valid[800:].mean() > 0.97


def test_error_of_a_salient_machine_with_a_current_bias():
    """A bias acts as a wrong i_d: the error is about (L_q - L_d) |bias| / psi_f at most."""
    bias = 0.1 * INTERIOR.rated_current
    speed = np.full(6001, 400.0)
    samples = driven(INTERIOR, H, speed, np.full(6001, 4j))
    current = samples.current + np.array([bias, 0.0])
    estimate = LeastSquaresObserver.for_machine(INTERIOR, sample_time=H).run(
        samples.voltage, current
    )
    error = np.radians(errors(estimate, samples)[3000:])
    bound = (INTERIOR.L_q - INTERIOR.L_d) * bias / INTERIOR.psi_f
    assert 0.5 * bound < np.abs(error).max() < 1.1 * bound


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.2, 1.5])
def test_the_adaptive_observer_learns_the_resistance_of_a_saturated_machine(factor):
    samples = reluctance_record(seed=2)
    machine = RELUCTANCE.with_values(R_s=factor * 0.63)
    observer = AdaptiveObserver.for_machine(machine, sample_time=H)
    state, estimate = observer.resume(observer.init(), samples.voltage, samples.current)
    learnt = observer.learnt(state)
    assert learnt.resistance == pytest.approx(0.63, abs=max(3 * learnt.resistance_std, 0.01))
    assert learnt.resistance_std < 0.1
    error = errors(estimate, samples, half=True)
    assert np.abs(error[estimate.valid]).max() < 5.0
    assert rms(error[estimate.valid][-4000:]) < 0.3


def scaled(machine, along_d, along_q):
    """Return the machine with the current-dependent part of its flux scaled along d and along q."""
    points = machine.flux_map
    if points is None:
        return machine.with_values(L_d=along_d * machine.L_d, L_q=along_q * machine.L_q)
    psi, flux = machine.saturation.table.psi_f, points.flux
    flux = psi + along_d * (flux.real - psi) + 1j * along_q * flux.imag
    return machine.with_values(flux_map=FluxPoints(points.current, flux))


@pytest.mark.parametrize("name", ["ipm-5kw6", "synrm-6kw7"])
@pytest.mark.parametrize(("along_d", "along_q"), [(1.06, 0.93), (0.94, 1.07)])
def test_the_adaptive_observer_learns_the_inductances(name, along_d, along_q):
    """An error of L_q turns the position; load steps of a salient machine identify this error."""
    assumed = example(name)
    true = scaled(assumed, along_d, along_q)
    rated, top = assumed.rated_current, 150.0
    speed = profile((0, 0), (0.3, top), (1.2, top), (1.6, -top), (2.5, -top), (3, top / 3))
    i_q = 0.7 * rated * profile((0, 0.2), (0.6, 0.2), (0.61, 1), (1.4, 1), (1.41, -1), (3, -0.4))
    i_d = 0.3 * rated * np.sign(true.saliency) * profile((0, 1), (0.9, 1), (0.91, 2), (3, 2))
    samples = driven(true, H, speed, i_d + 1j * i_q, R_s=1.2 * true.R_s, noise=0.002 * rated)
    observer = AdaptiveObserver.for_machine(assumed, sample_time=H)
    state, estimate = observer.resume(observer.init(), samples.voltage, samples.current)
    learnt = observer.learnt(state)
    error_of_inductances = np.array([along_d, along_q]) - 1 - learnt.inductance_error
    assert (np.abs(error_of_inductances) < 3 * np.array(learnt.inductance_std)).all()
    assert learnt.inductance_std[1] < 0.3 * observer.L_q_std
    error = errors(estimate, samples, half=not assumed.magnets)
    valid = estimate.valid
    assert valid[-8000:].mean() > 0.9
    assert rms(error[valid][-8000:]) < 1.0
    assert np.mean(np.abs(np.radians(error)) < 2 * estimate.theta_e_std, where=valid) > 0.97
