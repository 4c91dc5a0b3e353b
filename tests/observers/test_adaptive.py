"""The adaptive observer: start, resistance, inverter, magnet, saliency, standard deviations."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from fluxobs import AdaptiveObserver, FluxobsError, SurfacePMSM, _core
from fluxobs.observers import Priors
from fluxobs.observers.adaptive import REASONS
from support.records import COURSE_TIME as H
from support.records import MACHINES, course, driven, profile, wrapped_degrees
from support.records import PMSM as MACHINE

RATED = MACHINE.rated_current
SPEED_TIMES, LOAD_TIMES = (0, 0.3, 0.9, 1.2, 2.0), (0, 0.5, 0.51, 1.1, 1.11, 2.0)
BOTH = ("drift", "resistance", "inverter")


def start(noise, seed):
    """Return a start from rest at an unknown angle: 1.5 turns, with an offset of 5 %."""
    rng = np.random.default_rng(seed)
    speed = profile((0, 0), (0.02, 0), (0.08, 250), (0.13, 250))
    return driven(
        MACHINE,
        H,
        speed,
        np.full(len(speed), 0.5j * RATED),
        voltage_bias=0.05 * MACHINE.R_s * RATED * np.exp(1j * rng.uniform(0, 6)),
        noise=noise * RATED,
        theta0=rng.uniform(-3, 3),
        seed=seed,
    )


def errors(estimate, samples):
    return wrapped_degrees(estimate.theta_e - samples.theta)


def rms(x):
    return float(np.sqrt(np.mean(x**2)))


@pytest.mark.parametrize(("noise", "turned"), [(0.005, 90), (0.025, 180)])
def test_start_within_a_fraction_of_a_turn(noise, turned):
    for seed in range(20):
        samples = start(noise, seed)
        observer = AdaptiveObserver.for_machine(
            MACHINE, sample_time=H, unknowns=("drift",), current_noise=noise * RATED
        )
        error = np.abs(errors(observer.run(samples.voltage, samples.current), samples))
        row = np.argmax(samples.theta - samples.theta[0] > np.radians(turned))
        assert error[row] < 5
        plain = observer.plain.run(samples.voltage, samples.current)
        assert np.abs(wrapped_degrees(plain.theta_e - samples.theta))[row] > error[row]


def test_a_start_returns_both_candidate_angles():
    samples = start(0.005, 3)
    observer = AdaptiveObserver.for_machine(
        MACHINE, sample_time=H, unknowns=("drift",), current_noise=0.005 * RATED
    )
    estimate = observer.run(samples.voltage, samples.current)
    turned = np.degrees(samples.theta - samples.theta[0])
    early = (turned > 3) & ~estimate.adapting
    assert early.any()
    # One of the two candidates is right, but no candidate is valid.
    error_of_other = np.abs(wrapped_degrees(estimate.theta_e_other - samples.theta))
    nearer = np.minimum(np.abs(errors(estimate, samples)), error_of_other)
    assert np.median(nearer[early]) < 15
    assert estimate.weight_other[early].max() > 0.4
    assert not estimate.valid[early].any()
    assert (estimate.weight_other[estimate.adapting] == 0).all()


@pytest.mark.parametrize("projection", ["never", "start"])
def test_projections_reach_the_same_accuracy(projection):
    samples = course(R_s=1.2 * MACHINE.R_s)
    observer = AdaptiveObserver.for_machine(
        MACHINE, sample_time=H, unknowns=("drift", "resistance"), projection=projection
    )
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(int(0.7 / H), None)
    assert rms(errors(estimate, samples)[settled]) < 0.3


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.2, 1.5])
def test_resistance(factor):
    samples = course()
    assumed = MACHINE.model_copy(update={"R_s": MACHINE.R_s * factor})
    observer = AdaptiveObserver.for_machine(
        assumed,
        sample_time=H,
        priors=Priors(resistance=0.5 * assumed.R_s),
    )
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(int(0.7 / H), None)
    assert rms(errors(estimate, samples)[settled]) < 0.1
    error = np.abs(estimate.resistance - MACHINE.R_s)
    assert (error <= 3 * estimate.resistance_std).all()
    assert error[-1] < 0.005 * MACHINE.R_s
    assert estimate.resistance_std[-1] < 0.05 * MACHINE.R_s
    plain = observer.plain.run(samples.voltage, samples.current)
    assert rms(errors(plain, samples)[settled]) > 0.3


@pytest.mark.parametrize("assumed", [0.12, 0.18, 0.08])
def test_never_certain_and_wrong(assumed):
    """On this record a joint filter converged to R = 0.21 ± 0.010 Ω (docs/theory.md)."""
    h, rows = 5e-5, 80_000
    t = np.arange(rows) * h
    true = SurfacePMSM(R_s=0.12, L_s=120e-6, psi_f=0.0105, n_p=7, rated_current=30.0)
    speed = 600 * np.sin(2 * np.pi * t / 100) + 300 * np.sin(2 * np.pi * t / 7)
    current = 1j * (5 + 3 * np.sin(2 * np.pi * t / 3))
    samples = driven(true, h, speed, current, noise=0.05)
    biased = samples.current + np.array([0.1, -0.05])
    machine = true.with_values(R_s=assumed)
    observer = AdaptiveObserver.for_machine(
        machine,
        sample_time=h,
        priors=Priors(resistance=0.5 * assumed),
    )
    estimate = observer.run(samples.voltage, biased)
    error = np.abs(errors(estimate, samples))
    assert error[estimate.valid].max() < 5
    assert (np.abs(estimate.resistance - 0.12) <= 3 * estimate.resistance_std).all()
    settled = t > 2
    assert estimate.valid[settled].mean() > 0.7
    assert error[settled & estimate.valid].max() < 2
    assert estimate.resistance[-1] == pytest.approx(0.12, rel=0.01)


def test_an_emf_within_the_uncertainty_is_not_valid():
    """At 1 V of EMF and 8 A, the opposite angle fits equally well with 0.25 Ω more resistance.

    At higher speed, only the true angle fits.
    """
    machine = MACHINES["servo-400w"]
    speed = profile((0, 80), (1.0, 80), (1.3, 800), (2.0, 800))
    samples = driven(machine, H, speed, np.full(len(speed), 8j), noise=0.02)
    assumed = machine.with_values(R_s=0.6)
    observer = AdaptiveObserver.for_machine(
        assumed,
        sample_time=H,
        priors=Priors(resistance=0.3),
    )
    estimate = observer.run(samples.voltage, samples.current)
    slow = np.arange(len(speed)) * H < 1.0
    assert not estimate.valid[slow].any()
    assert estimate.valid[-2000:].mean() > 0.5
    assert np.abs(errors(estimate, samples))[estimate.valid].max() < 5


def test_errors_without_residual_are_in_the_standard_deviation():
    samples = course()
    for change in (1.15, 0.85):
        machine = MACHINE.with_values(L_s=change * MACHINE.L_s)
        observer = AdaptiveObserver.for_machine(machine, sample_time=H)
        estimate = observer.run(samples.voltage, samples.current)
        within = np.abs(np.radians(errors(estimate, samples))) < 2 * estimate.theta_e_std
        assert within[estimate.valid].mean() > 0.85
        exact = replace(observer, L_q_std=0.0).run(samples.voltage, samples.current)
        assert (exact.theta_e == estimate.theta_e).all()
        assert exact.theta_e_std[-1] < estimate.theta_e_std[-1]


def test_offsets_and_asymmetry_are_learnt():
    true = course(inverter=8.0, smoothing=0.05 * RATED)
    g, offset = 0.008 - 0.004j, np.array([0.12, -0.08])
    u = true.voltage[:, 0] + 1j * true.voltage[:, 1]
    # If the measured voltage is u, the voltage u + g conj(u) acts.
    measured = (u - g * np.conj(u)) / (1 - abs(g) ** 2)
    observer = AdaptiveObserver.for_machine(
        MACHINE,
        sample_time=H,
        unknowns=(*BOTH, "asymmetry"),
        priors=Priors(inverter=5.0),
    )
    state, estimate = observer.resume(
        observer.init(), np.stack([measured.real, measured.imag], axis=1), true.current + offset
    )
    learnt = observer.learnt(state)
    np.testing.assert_allclose(learnt.asymmetry, [g.real, g.imag], atol=0.001)
    assert (np.abs(learnt.offset - offset) < 3 * np.array(learnt.offset_std)).all()
    assert max(learnt.offset_std) < 0.6 * observer.offset_std
    assert learnt.inverter_voltage == pytest.approx(8.0, abs=3 * learnt.inverter_std)
    assert learnt.resistance == estimate.resistance[-1]
    assert rms(errors(estimate, true)[int(0.7 / H) :]) < 0.25
    assert observer.restarts(state) == 0


def test_inverter_at_a_tenth_of_the_speed():
    speed = profile((0, 0), (0.1, 47), (2.0, 47))
    load = profile((0, 3), (0.8, 3), (0.81, 6), (1.3, 6), (1.31, 2), (2.0, 2))
    samples = driven(
        MACHINE, H, speed, 1j * load, inverter=10.8, smoothing=0.05 * RATED, noise=0.02
    )
    observer = AdaptiveObserver.for_machine(MACHINE, sample_time=H, unknowns=BOTH)
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(int(1.0 / H), None)
    assert rms(errors(estimate, samples)[settled]) < 0.5
    assert estimate.inverter_voltage[-1] == pytest.approx(10.8, rel=0.1)
    plain = observer.plain.run(samples.voltage, samples.current)
    assert rms(errors(plain, samples)[settled]) > 1


def test_magnet_flux_and_its_standard_deviation():
    samples = course(psi_f=0.85 * MACHINE.psi_f)
    estimate = AdaptiveObserver.for_machine(MACHINE, sample_time=H).run(
        samples.voltage, samples.current
    )
    settled = slice(int(1.0 / H), None)
    error = estimate.psi_f[settled] - 0.85 * MACHINE.psi_f
    assert rms(error / estimate.psi_f_std[settled]) < 2
    assert estimate.psi_f_std[-1] < 0.02 * MACHINE.psi_f


def test_a_known_magnet_flux_identifies_the_resistance_at_steady_state():
    speed = profile((0, 0), (0.3, 100), (2.0, 100))
    samples = driven(MACHINE, H, speed, np.full(len(speed), 5j), R_s=1.2 * MACHINE.R_s, noise=0.02)

    def estimate_with(psi_f_std):
        observer = AdaptiveObserver.for_machine(
            MACHINE,
            sample_time=H,
            unknowns=("drift", "resistance"),
            priors=Priors(psi_f=psi_f_std),
        )
        return observer.run(samples.voltage, samples.current)

    known = estimate_with(0.001 * MACHINE.psi_f)
    assert known.resistance[-1] == pytest.approx(1.2 * MACHINE.R_s, rel=0.02)
    assert known.resistance_std[-1] < 0.3 * estimate_with(None).resistance_std[-1]


def test_an_unidentifiable_resistance_keeps_its_value_and_the_position():
    """Without load, at low speed for seconds, the resistance is not identifiable."""
    machine = MACHINES["servo-400w"]
    rows = int(3.0 / H)
    speed = np.interp(np.arange(rows) * H, [0, 0.2, 3.0], [0, 126, 126])
    samples = driven(machine, H, speed, np.full(rows, 0.05j), noise=0.04)
    observer = AdaptiveObserver.for_machine(
        machine, sample_time=H, unknowns=("drift", "resistance"), current_noise=0.04
    )
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(rows // 2, None)
    assert np.abs(estimate.resistance[settled] - machine.R_s).max() < 0.2 * machine.R_s
    assert estimate.resistance_std[-1] > 0.8 * observer.resistance_std
    plain = observer.plain.run(samples.voltage, samples.current)
    assert (
        rms(errors(estimate, samples)[settled]) < 1.2 * rms(errors(plain, samples)[settled]) + 0.05
    )


def test_slow_turning():
    """At 4 rad/s, the rotor turns too little within the memory of the plain observer."""
    speed = profile((0, 100), (0.4, 100), (0.6, 4), (4.0, 4))
    samples = driven(MACHINE, H, speed, np.full(len(speed), 2j), noise=0.005 * RATED)
    observer = AdaptiveObserver.for_machine(
        MACHINE, sample_time=H, unknowns=("drift",), current_noise=0.005 * RATED
    )
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(int(2.0 / H), None)
    assert np.abs(errors(estimate, samples)[settled]).max() < 5
    assert estimate.valid[settled].all()
    assert not observer.plain.run(samples.voltage, samples.current).valid[settled].any()


def test_standstill_is_not_valid():
    speed = profile((0, 100), (0.4, 100), (0.5, 0), (8.0, 0))
    samples = driven(MACHINE, H, speed, np.full(len(speed), 2j), noise=0.02 * RATED)
    observer = AdaptiveObserver.for_machine(
        MACHINE, sample_time=H, unknowns=("drift",), current_noise=0.02 * RATED
    )
    estimate = observer.run(samples.voltage, samples.current)
    error = np.abs(errors(estimate, samples))
    assert not estimate.valid[-1]
    assert error[estimate.valid].max() < 10


def test_interior_machine_with_moving_i_d():
    machine = MACHINES["ipm-2kw2"]
    speed = profile((0, 0), (0.3, 240), (2.0, 240))
    i_d = profile((0, 0), (0.6, 0), (0.61, -6), (1.0, -6), (1.01, 0), (1.4, 0), (1.41, 4), (2, 4))
    samples = driven(machine, H, speed, i_d + 4j, noise=0.01)
    observer = AdaptiveObserver.for_machine(machine, sample_time=H, unknowns=("drift",))
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(int(0.5 / H), None)
    constant_i_d = observer.plain.run(samples.voltage, samples.current)  # the guard
    mapped = replace(observer.plain, flux_map=machine.map_for(H, machine.psi_f))
    plain = mapped.run(samples.voltage, samples.current)
    assert np.abs(errors(estimate, samples)[settled]).max() < 1
    assert np.abs(errors(plain, samples)[settled]).max() < 1
    assert np.abs(errors(constant_i_d, samples)[settled]).max() > 2  # i_d assumed constant
    assert rms(estimate.psi_f[settled] - machine.psi_f) < 0.005 * machine.psi_f


def test_reluctance_machine():
    machine = MACHINES["synrm-6kw7"]
    speed = profile((0, 100), (0.5, 100), (0.9, -200), (1.5, -200))
    load = profile((0, 10), (0.3, 10), (0.31, 15), (0.7, 15), (0.71, 8), (1.5, 8))
    samples = driven(machine, H, speed, 8 + 1j * load, R_s=1.3 * machine.R_s, noise=0.02)
    observer = AdaptiveObserver.for_machine(machine, sample_time=H)
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(int(0.5 / H), None)
    error = wrapped_degrees(2 * (estimate.theta_e - samples.theta)) / 2
    assert rms(error[settled]) < 0.5
    assert estimate.resistance[-1] == pytest.approx(1.3 * machine.R_s, rel=0.05)
    assert (estimate.psi_f == 0).all() or estimate.psi_f_std.max() == 0


def test_standard_deviations_are_consistent():
    """Normalised squared errors are near 1, with parameters drawn from their priors."""
    scores = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        R, psi = MACHINE.R_s * (1 + 0.2 * rng.standard_normal()), 0.545 * rng.normal(1, 0.15)
        V = 2.0 * abs(rng.standard_normal())
        speeds = [(t, 200 * s) for t, s in zip(SPEED_TIMES, rng.uniform(-1, 1, 5), strict=True)]
        loads = [(t, 5 * s) for t, s in zip(LOAD_TIMES, rng.uniform(-1, 1, 6), strict=True)]
        bias = 0.2 * (rng.standard_normal() + 1j * rng.standard_normal())
        samples = driven(
            MACHINE,
            H,
            profile(*speeds),
            1j * profile(*loads),
            R_s=R,
            psi_f=psi,
            inverter=V,
            smoothing=0.05 * RATED,
            voltage_bias=bias,
            noise=0.02,
            seed=seed,
        )
        observer = AdaptiveObserver.for_machine(
            MACHINE,
            sample_time=H,
            current_noise=0.02,
            slow_memory=1000.0,
            priors=Priors(
                resistance=0.2 * MACHINE.R_s,
                psi_f=0.15 * 0.545,
                inverter=2.0,
                inductance=0.0,
                lag=0.0,
                delay=0.0,
                current_gain=0.0,
                iron_current=0.0,
                harmonics=0.0,
            ),
        )
        estimate = observer.run(samples.voltage, samples.current)
        for row in (10_000, 13_000, 15_900):
            if not estimate.valid[row]:
                continue
            drift = estimate.drift[row] + np.array([bias.real, bias.imag])
            angle = np.radians(wrapped_degrees(estimate.theta_e[row] - samples.theta[row]))
            scores.append(
                [
                    (angle / estimate.theta_e_std[row]) ** 2,
                    np.mean(drift**2) / estimate.drift_std[row] ** 2,
                    ((estimate.psi_f[row] - psi) / estimate.psi_f_std[row]) ** 2,
                    ((estimate.resistance[row] - R) / estimate.resistance_std[row]) ** 2,
                    ((estimate.inverter_voltage[row] - V) / estimate.inverter_voltage_std[row])
                    ** 2,
                ]
            )
    assert len(scores) > 60
    assert np.median(scores, axis=0).max() < 2  # normal distribution: 0.45
    # A mean below 1 is expected: the filter assumes machines that are less exact.
    assert 0.03 < np.mean(np.minimum(scores, 25)) < 1.5
    assert (np.array(scores) < 9).mean(axis=0).min() > 0.95


def test_steps_are_the_run_and_batches_lanes():
    samples = course(R_s=1.1 * MACHINE.R_s)
    u, i = samples.voltage[:3000], samples.current[:3000]
    observer = AdaptiveObserver.for_machine(MACHINE, sample_time=H)
    whole = observer.run(u, i)
    state = observer.init()
    for k in range(3000):
        state, estimate = observer.step(state, u[k], i[k])
        if k % 500 == 499:
            assert estimate.theta_e == whole.theta_e[k]
            assert estimate.resistance == whole.resistance[k]
    lanes = observer.run(np.stack([u, u[::-1]]), np.stack([i, i[::-1]]))
    np.testing.assert_array_equal(lanes.flux[0], whole.flux)
    unpickled = pickle.loads(pickle.dumps(observer)).run(u, i)
    np.testing.assert_array_equal(unpickled.theta_e, whole.theta_e)
    middle, _ = observer.resume(observer.init(), u[:1700], i[:1700])
    resumed = observer.resume(middle, u[1700:], i[1700:])[1]
    np.testing.assert_array_equal(resumed.resistance, whole.resistance[1700:])


def test_single_precision():
    samples = course(R_s=1.2 * MACHINE.R_s)
    double, single = (
        AdaptiveObserver.for_machine(MACHINE, sample_time=H, precision=p).run(
            samples.voltage, samples.current
        )
        for p in ("double", "single")
    )
    settled = slice(int(0.7 / H), None)
    assert np.abs(wrapped_degrees(single.theta_e - double.theta_e)[settled]).max() < 0.05
    assert np.abs(single.resistance - double.resistance)[settled].max() < 0.02 * MACHINE.R_s


def test_a_parameter_with_a_prior_of_zero_is_exact():
    samples = course()
    estimate = AdaptiveObserver.for_machine(MACHINE, sample_time=H, unknowns=("drift",)).run(
        samples.voltage, samples.current
    )
    assert (estimate.resistance == MACHINE.R_s).all()
    assert (estimate.inverter_voltage == 0).all()
    assert (estimate.resistance_std == 0).all()


def test_a_known_inverter_is_compensated():
    samples = course(inverter=8.0, smoothing=0.05 * RATED)
    machine = MACHINE.model_copy(update={"inverter_voltage": 8.0})
    observer = AdaptiveObserver.for_machine(machine, sample_time=H, unknowns=("drift",))
    estimate = observer.run(samples.voltage, samples.current)
    settled = slice(int(0.7 / H), None)
    assert rms(errors(estimate, samples)[settled]) < 0.3


def test_unusable_settings():
    with pytest.raises(FluxobsError, match="estimates drift, resistance, inverter, asymmetry"):
        AdaptiveObserver.for_machine(MACHINE, sample_time=H, unknowns=("drift", "current-bias"))
    with pytest.raises(FluxobsError, match="resistance is not an unknown"):
        AdaptiveObserver.for_machine(
            MACHINE,
            sample_time=H,
            unknowns=("drift",),
            priors=Priors(resistance=0.1),
        )
    with pytest.raises(FluxobsError, match="no magnets"):
        AdaptiveObserver.for_machine(
            MACHINES["synrm-6kw7"],
            sample_time=H,
            priors=Priors(psi_f=0.1),
        )
    valid_observer = AdaptiveObserver.for_machine(MACHINE, sample_time=H)
    for field, value in (
        ("resistance_std", -1.0),
        ("inverter_std", np.nan),
        ("psi_f_std", np.inf),
        ("slow_memory", 0.0),
        ("inverter_current", -0.1),
        ("saliency", np.inf),
        ("projection", "sometimes"),
        ("resistance_std", 1e30),
    ):
        with pytest.raises(ValueError, match=field):
            replace(valid_observer, **{field: value})


@pytest.mark.parametrize("h", [2e-5, 2e-4])
@pytest.mark.parametrize(
    ("name", "speed", "current"), [("servo-400w", 800, 6), ("pmsm-2kw2", 150, 6)]
)
def test_a_steady_load_does_not_make_valid_flicker(name, speed, current, h):
    """R is not identifiable at steady load, but its error is correlated with that of the flux.

    So the standard deviation of the position does not vary between measurement rows. After a step
    of the load, this standard deviation grows.
    """
    machine, rows = MACHINES[name], int(1.2 / h)
    load = np.where(np.arange(rows + 1) < 0.8 * rows, current, 1.5 * current)
    samples = driven(
        machine,
        h,
        np.full(rows + 1, float(speed)),
        1j * load,
        noise=0.002 * machine.rated_current,
        R_s=1.2 * machine.R_s,
    )
    observer = AdaptiveObserver.for_machine(machine, sample_time=h, unknowns=BOTH)
    estimate = observer.run(samples.voltage, samples.current)
    steady = slice(rows // 2, int(0.8 * rows))
    assert estimate.valid[steady].all()
    std = np.degrees(estimate.theta_e_std)
    assert std[steady].max() < 1.2 * std[steady].min()
    error = np.abs(errors(estimate, samples))
    assert (error < 3 * std)[estimate.valid].all()
    # The load step determines the share of R i in the voltage; before that, the angle is uncertain.
    after = slice(int(0.8 * rows) + 1, int(0.8 * rows) + int(0.5 / speed / h))
    assert std[after].max() > 1.1 * std[steady].max()


def test_why_a_position_is_not_valid():
    """Each row has a reason; it is "valid" exactly on the valid rows."""
    assert list(REASONS) == _core.reasons
    samples = course()
    voltage, current = samples.voltage.copy(), samples.current.copy()
    current[12_000] = np.nan
    estimate = AdaptiveObserver.for_machine(MACHINE, sample_time=H).run(voltage, current)
    words = np.array(REASONS)[estimate.valid_reason.astype(int)]
    np.testing.assert_array_equal(words == "valid", estimate.valid)
    assert words[12_000] == "bad sample"
    assert words[0] == "no data"
    assert {"searching", "unconfirmed"} <= set(words[: int(0.3 / H)])


@pytest.mark.parametrize("row", [4000, 4001])
def test_an_absurd_current_restarts_with_an_unknown_angle(row):
    """In one of two samples in a row the guard has no measurement row."""
    t = H * np.arange(6000)
    speed, load = np.interp(t, [0, 0.1], [0, 250]), np.full(len(t), 1j)
    samples = driven(MACHINE, H, speed, load)
    observer = AdaptiveObserver.for_machine(MACHINE, sample_time=H)
    assert observer.run(samples.voltage, samples.current).valid[row]
    current = samples.current.copy()
    current[row] = 1e9
    estimate = observer.run(samples.voltage, current)
    assert not estimate.valid[row]
    assert estimate.theta_e_std[row] == pytest.approx(np.pi / np.sqrt(3))
