"""The energy balance of a log, and temperatures."""

import numpy as np
import pytest

import fluxobs
from fluxobs.identification.energy import energy_of
from fluxobs.identification.report import lines
from fluxobs.machines import example, rotating
from fluxobs.simulation.closed_form.signals import driven, inverter_loss, vectors

H, PARTS = 1e-4, 8
#: Smooth knee of the inverter's loss [A], and loss [V].
LOSS = 0.4


@pytest.fixture(scope="module")
def log():
    """A servo that accelerates and is loaded; (log, true copper, inverter and shaft energy)."""
    machine = rotating(example("servo-400w"), "a test").with_values(R_s=0.36 * 1.12)
    t = np.arange(12_000 * PARTS + 1) * H / PARTS
    speed = np.interp(t, [0, 0.3, 0.8, 1.2], [0, 900, 900, 400])
    i_q = np.interp(t, [0, 0.05, 0.3, 0.32, 0.6, 0.61, 1.2], [0, 6, 6, 2, 2, 9, 9])
    true = driven(machine, H, speed, 1j * i_q, PARTS, theta0=0.4)
    u = true.voltage + inverter_loss(true.mean_current, LOSS, 0.2)
    noise = 0.01 * np.random.default_rng(1).standard_normal((12_000, 2))
    torque = 1.5 * machine.n_p * machine.psi_f * i_q
    power = {
        "copper": 1.5 * machine.R_s * i_q**2,
        "mechanical": torque * speed / machine.n_p,
    }
    return (vectors(u), vectors(true.current)[:-1] + noise), power, speed


def test_the_balance_is_that_of_the_drive(log):
    arrays, power, _ = log
    found = fluxobs.identify(arrays, "servo-400w", sample_time=H, lag=0)
    energy = energy_of(found.run)
    valid = found.run["valid"] > 0
    pair = np.repeat(valid[1:] & valid[:-1], PARTS)
    for name, values in power.items():
        true = values[: len(pair)][pair].sum() * H / PARTS
        assert getattr(energy, name) == pytest.approx(true, rel=0.03), name
    assert abs(energy.rest) < 0.01 * energy.electrical
    assert abs(energy.rest) < energy.std
    assert energy.electrical == pytest.approx(
        energy.copper + energy.inverter + energy.mechanical + energy.stored + energy.rest
    )
    text = "\n".join(lines(found))
    assert "Energy over the valid rows: electrical" in text
    # 12 % more resistance are 30.5 K of copper.
    assert "Winding: 5" in text
    assert "°C, if R_s = 0.36 Ω holds at 20 °C (copper" in text


def test_an_iron_loss_is_in_the_rest_or_in_the_standard_deviation_of_the_shaft(log):
    """A current g e of the induced voltage e takes 3/2 g |e|² that reaches no shaft."""
    (u, i), _, speed = log
    machine = example("servo-400w")
    rows = len(i)
    base = fluxobs.identify((u, i), "servo-400w", sample_time=H, lag=0)
    theta = base.run["theta_e"]
    emf = speed[: rows * PARTS : PARTS] * machine.psi_f
    g = 0.3 / (900 * machine.psi_f)
    iron = g * emf * 1j * np.exp(1j * theta)
    found = fluxobs.identify((u, i + vectors(iron)), "servo-400w", sample_time=H, lag=0)
    energy, before = energy_of(found.run), energy_of(base.run)
    lost = 1.5 * g * (emf**2)[found.run["valid"] > 0].sum() * H
    assert energy.electrical - before.electrical > lost
    assert energy.mechanical - before.mechanical < 2 * energy.std
