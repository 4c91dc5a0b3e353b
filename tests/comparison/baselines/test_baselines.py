"""Each observer in common use finds the angle when its assumptions are met."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs.comparison.baselines import (
    ClampedIntegrator,
    KalmanFilter,
    LengthGradient,
    SpeedAdaptiveObserver,
    run,
)
from fluxobs.comparison.catalogue import CATALOGUE, Entry
from fluxobs.comparison.compare import setting_for
from fluxobs.simulation.drive import Motor
from support.records import CURRENTS, MACHINES, steady, wrapped_degrees

H = 1.25e-4
#: rms error [°] with recommended gains at the end of a clean record at constant speed.
LIMITS = dict.fromkeys((entry.name for entry in CATALOGUE), 0.1)
LIMITS |= {"voltage model, low-pass": 1.0, "voltage model, high-pass": 1.0}


def late_error(machine, data, guess, share=0.8):
    error = np.asarray(guess.theta_e) - data.theta
    if machine.half_turn_ambiguous:
        error = wrapped_degrees(2 * error) / 2
    else:
        error = wrapped_degrees(error)
    return np.sqrt(np.mean(error[int(share * len(error)) :] ** 2))


def clean(name, speed=300.0, rows=8000, **options):
    machine = MACHINES[name]
    return machine, steady(machine, H, speed, rows, i_dq=CURRENTS[name], **options)


@pytest.mark.parametrize("entry", CATALOGUE, ids=lambda entry: entry.name)
@pytest.mark.parametrize("speed", [300.0, -300.0])
def test_correct_without_bias(entry: Entry, speed):
    machine, data = clean("pmsm-2kw2", speed)
    setting = setting_for(H, data.voltage, data.current, machine, 471.0)
    observer = entry.build(setting, entry.recommended(setting))
    guess = run(observer, jnp.asarray(data.voltage), jnp.asarray(data.current))
    assert late_error(machine, data, guess) < LIMITS[entry.name]
    speeds = np.asarray(guess.speed_e)[-1000:]
    assert np.mean(speeds) == pytest.approx(speed, rel=0.01)


SALIENT = [
    "voltage model, low-pass",
    "gradient (Ortega, Lee)",
    "speed-adaptive (Hinkkanen)",
    "sliding mode",
    "extended EMF with PLL",
    "extended Kalman filter",
]


@pytest.mark.parametrize("machine_name", ["ipm-2kw2", "synrm-6kw7"])
@pytest.mark.parametrize("name", SALIENT)
def test_salient_machines_through_their_active_flux(name, machine_name):
    entry = next(entry for entry in CATALOGUE if entry.name == name)
    machine, data = clean(machine_name)
    setting = setting_for(H, data.voltage, data.current, machine, 471.0)
    observer = entry.build(setting, entry.recommended(setting))
    guess = run(observer, jnp.asarray(data.voltage), jnp.asarray(data.current))
    assert late_error(machine, data, guess) < 1.5


def test_error_of_a_bias_as_in_the_literature():
    """The stationary circle of the gradient observer shifts by drift/gain (first order)."""
    machine, data = clean("pmsm-2kw2", voltage_bias=2.0)
    motor = Motor.of(machine)
    guess = run(
        LengthGradient(motor, H, 100.0, 500.0), jnp.asarray(data.voltage), jnp.asarray(data.current)
    )
    error = late_error(machine, data, guess)
    # The drift δ with radial rate g causes a ripple of about δ/(ψ ω) to δ/(ψ g/2).
    assert 0.3 * 2.0 / (0.545 * 300) < np.radians(error) < 2 * 2.0 / (0.545 * 50)
    assert error > 0.3


def test_adaptation_finds_a_wrong_magnet_flux():
    machine, data = clean("pmsm-2kw2")
    believed = Motor.of(machine.model_copy(update={"psi_f": 0.8 * machine.psi_f}))
    guess = run(
        LengthGradient(believed, H, 100.0, 500.0, adaptation=30.0),
        jnp.asarray(data.voltage),
        jnp.asarray(data.current),
    )
    assert late_error(machine, data, guess) < 0.05
    x = np.asarray(guess.flux)[-1] - machine.L_s * data.current[-1]
    assert np.hypot(*x) == pytest.approx(machine.psi_f, rel=1e-3)


def test_a_drift_state_removes_a_bias():
    machine, data = clean("pmsm-2kw2", voltage_bias=2.0 - 1.0j)
    motor = Motor.of(machine)
    errors = [
        late_error(
            machine,
            data,
            run(
                KalmanFilter(motor, H, 0.3, 500.0, 0.02, 471.0, 0.3, 3.0, with_drift),
                jnp.asarray(data.voltage),
                jnp.asarray(data.current),
            ),
        )
        for with_drift in (False, True)
    ]
    assert errors[0] > 0.2
    assert errors[1] < 0.02


def test_a_missing_first_voltage_does_no_harm():
    """A record does not contain the interval before its first row."""
    machine, data = clean("pmsm-2kw2")
    u = data.voltage.copy()
    u[0] = np.nan
    for kind in (
        ClampedIntegrator(Motor.of(machine), H, 1.0, 500.0),
        SpeedAdaptiveObserver(Motor.of(machine), H, 1.0, 250.0),
    ):
        guess = run(kind, jnp.asarray(u), jnp.asarray(data.current))
        assert np.isfinite(np.asarray(guess.theta_e)).all()
