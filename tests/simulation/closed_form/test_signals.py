"""The closed-form signals satisfy their equations."""

import numpy as np
import pytest

from fluxobs.machines.model.frames import clarke
from fluxobs.simulation.closed_form.signals import (
    between_rows,
    driven,
    inverter_loss,
    steady,
    vectors,
)
from support.records import CURRENTS, MACHINES

H, PARTS = 1e-4, 16


@pytest.mark.parametrize("name", MACHINES)
def test_flux_voltage_and_current_satisfy_the_equations(name):
    """λ = λ(i_dq) e^{jθ}, and the change of λ is the integral of u - R i."""
    machine, i_dq = MACHINES[name], CURRENTS[name]
    true = steady(machine, H, np.linspace(-400, 600, 300), 300, i_dq, 0.3)
    turn = np.exp(1j * true.theta_e)
    np.testing.assert_allclose(true.current, i_dq * turn, rtol=1e-12)
    np.testing.assert_allclose(true.flux, complex(machine.flux_dq(i_dq)) * turn, rtol=1e-12)
    volt_seconds = H * (true.voltage - machine.R_s * true.mean_current)
    np.testing.assert_allclose(volt_seconds, np.diff(true.flux), atol=1e-15)
    np.testing.assert_allclose(true.volt_seconds, np.diff(true.flux), atol=0)
    residual = machine.constraint.residual(vectors(true.flux), vectors(true.current))
    assert np.ptp(residual) < 1e-12 * np.abs(true.flux).max() ** 2


@pytest.mark.parametrize("speed", [500.0, -500.0, 0.0])
@pytest.mark.parametrize("name", MACHINES)
def test_steady_and_driven_agree_at_constant_speed(name, speed):
    machine, i_dq, rows = MACHINES[name], CURRENTS[name], 100
    exact = steady(machine, H, speed, rows, i_dq, 0.3)
    count = rows * PARTS + 1
    integrated = driven(machine, H, np.full(count, speed), np.full(count, i_dq), PARTS, 0.3)
    for field in ("theta_e", "flux", "current", "mean_current", "voltage"):
        a, b = getattr(exact, field), getattr(integrated, field)
        np.testing.assert_allclose(b, a, atol=1e-9 * (np.abs(a).max() + 1e-9), err_msg=field)


def test_the_mean_current_agrees_with_finer_integration():
    machine = MACHINES["servo-400w"]
    t = np.arange(50 * 256 + 1) / (50 * 256)
    speed, i_dq = 800 * t, 3 * np.sin(9 * t) + 6j * np.cos(5 * t)
    fine = driven(machine, H, speed, i_dq, 256)
    coarse = driven(machine, H, speed[::16], i_dq[::16], 16)
    np.testing.assert_allclose(coarse.mean_current, fine.mean_current, atol=1e-9)
    np.testing.assert_allclose(coarse.theta_e, fine.theta_e, atol=1e-12)


def test_between_rows_interpolates_linearly():
    rows = np.array([1.0, 3.0, 2.0])
    values = between_rows(rows, 4)
    np.testing.assert_allclose(values, [1, 1.5, 2, 2.5, 3, 2.75, 2.5, 2.25, 2])
    complex_values = between_rows(rows * 1j, 4)
    np.testing.assert_allclose(complex_values, 1j * values)


def test_inverter_loss_opposes_each_phase_current():
    current = 5 * np.exp(1j * np.linspace(0, 6, 40))
    lost = inverter_loss(current, 0.5, 0.01)
    phases = np.stack([(current * np.exp(-2j * np.pi / 3 * k)).real for k in range(3)])
    expected = clarke(*(0.5 * np.tanh(phases / 0.01))) @ [1, 1j]
    np.testing.assert_allclose(lost, expected, atol=1e-15)
    assert ((lost * current.conj()).real > 0).all()  # the lost voltage dissipates power
    assert (inverter_loss(current, 0.0, 0.01) == 0).all()
