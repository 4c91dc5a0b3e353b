"""Block commutation: the floating phase is found, and its voltage is its back-EMF."""

import itertools

import numpy as np
import pytest

import fluxobs
from fluxobs.errors import ModelError
from fluxobs.logs.quality.floating import AXES, floating_phase, with_back_emf
from fluxobs.logs.quality.marks import FLOATING, INJECTED, floating_of, with_floating
from fluxobs.logs.time.aligned import Aligned
from fluxobs.simulation.drive import Profile, simulate_block
from support.records import PMSM, SERVO, wrapped_degrees

H = 1e-4
SPEED = Profile([0, 0.3, 0.8, 1.2], [80, 400, 300, 500])
CURRENT = Profile([0, 0.6, 0.6, 1.2], [4.0, 4.0, 8.0, 8.0])


def block_run(advance=0.0, trapezoidal=False, speed=SPEED, current=CURRENT):
    return simulate_block(
        SERVO, H, 1.2, speed, current, 48.0, advance, 0.7, noise=0.02, trapezoidal=trapezoidal
    )


RUNS = {
    "sinusoidal": block_run(),
    "early": block_run(advance=0.3),
    "trapezoidal": block_run(advance=0.2, trapezoidal=True),
}


def rows_of(run, floating):
    """Return aligned rows of a log; the voltage of a row is that of the interval before it."""
    record = run.record(floating)
    voltage = np.concatenate([record.voltage[:1], record.voltage[:-1]])
    return Aligned(H * np.arange(len(voltage)), record.current, voltage, None)


@pytest.mark.parametrize("floating", ["zero", "mean"])
@pytest.mark.parametrize("name", RUNS)
def test_the_floating_phase_is_found_and_its_voltage_is_its_back_emf(name, floating):
    run = RUNS[name]
    rows, true = rows_of(run, floating), rows_of(run, "measured")
    phase = floating_phase(rows.current, rows.voltage, 0.2)
    assert (phase[1:] == run.floating[:-1] + 1).mean() > 0.99
    marks = with_floating(np.zeros(len(phase), int), phase)
    assert (floating_of(marks) == phase).all()
    filled = with_back_emf(rows._replace(marks=marks), SERVO, H).voltage
    size = np.sqrt(np.mean(true.voltage**2))
    before, after = (np.sqrt(np.mean((u - true.voltage) ** 2)) for u in (rows.voltage, filled))
    # The noise of the current acts through L / H: 0.12 V.
    assert before > 0.3 * size
    assert after < 0.035 * size


#: Each run once, each voltage of the floating phase once; the other pairs are slow.
QUICK = (("sinusoidal", "mean"), ("early", "measured"), ("trapezoidal", "zero"))


@pytest.mark.parametrize(
    ("name", "floating"),
    [
        pytest.param(*pair, marks=() if pair in QUICK else pytest.mark.slow)
        for pair in itertools.product(RUNS, ("measured", "zero", "mean"))
    ],
)
def test_the_estimate_is_right(name, floating):
    run = RUNS[name]
    result = fluxobs.estimate(run.record(floating), SERVO)
    error, valid = wrapped_degrees(result["theta_e"] - run.theta_e), result["valid"]
    assert valid.mean() > 0.98
    assert np.abs(error[valid]).max() < 4
    assert (np.abs(error) < 2 * np.degrees(result["theta_e_std"]))[valid].mean() > 0.9
    learnt = result.learnt
    assert abs(learnt.resistance - SERVO.R_s) < 4 * learnt.resistance_std
    assert abs(learnt.psi_f - SERVO.psi_f) < 4 * learnt.psi_f_std
    marked = (np.asarray(result["quality"]) & FLOATING > 0).mean()
    assert marked == 0 if floating == "measured" else marked > 0.98
    assert not result.warnings


def test_braking_and_reverse_rotation():
    run = block_run(speed=Profile([0, 1.2], [-300, -400]), current=Profile([0, 1.2], [-5, -5]))
    result = fluxobs.estimate(run.record("zero"), SERVO)
    error, valid = wrapped_degrees(result["theta_e"] - run.theta_e), result["valid"]
    assert valid.mean() > 0.95
    assert np.abs(error[valid]).max() < 3


def test_a_sinusoidal_drive_has_no_floating_phase():
    t = H * np.arange(8000)
    for speed in (400.0, 30.0, 2.0, 0.0):
        current = 8 * np.exp(1j * (speed * t + np.pi / 2))  # at rest, no current in phase a
        voltage = 0.36 * current + 0.0125j * speed * np.exp(1j * speed * t)
        vectors = [np.stack([z.real, z.imag], axis=1) for z in (current, voltage)]
        assert not floating_phase(*vectors, 0.2).any()


def test_axes_are_those_of_the_phases():
    a, b, c = AXES
    np.testing.assert_allclose(a + b + c, 0, atol=1e-15)


def test_the_simulation_names_what_it_cannot_do():
    with pytest.raises(ModelError, match="one inductance"):
        simulate_block(fluxobs.example("ipm-2kw2"), H, 1.0, 100.0, 4.0, 540.0)
    with pytest.raises(ModelError, match="less than two samples"):
        simulate_block(SERVO, H, 1e-4, 100.0, 4.0, 48.0)
    with pytest.raises(ModelError, match="floating must be one of measured, zero, mean"):
        RUNS["early"].record("open")


@pytest.mark.parametrize("period", [2, 4, 5])
def test_an_injected_signal_is_no_noise(period):
    rows = 12_000
    t = H * np.arange(rows)
    theta = np.cumsum(np.interp(t, [0, 1.2], [150.0, 400.0])) * H
    rotor = np.exp(1j * theta)
    i_dq = 4j + 0.5 * np.cos(2 * np.pi * np.arange(rows) / period)
    noise = np.random.default_rng(1).standard_normal((rows, 2)) @ [0.008, 0.008j]
    current = i_dq * rotor
    flux = PMSM.flux_dq(i_dq) * rotor
    mean = (current[1:] + current[:-1]) / 2
    voltage = np.append(np.diff(flux) / H + PMSM.R_s * mean, 0.0)
    voltage[-1] = voltage[-2]
    result = fluxobs.estimate((voltage, current + noise), PMSM, sample_time=H, lag=0)
    error, valid = wrapped_degrees(result["theta_e"] - theta), result["valid"]
    assert result.scales.current_noise == pytest.approx(0.008, rel=0.15)
    assert (np.asarray(result["quality"]) & INJECTED > 0).mean() > 0.95
    assert valid.mean() > 0.95
    assert np.abs(error[valid]).max() < 3
