"""The direction from an injected current: sensitivities by running again, and its weight."""

from dataclasses import replace

import numpy as np
import pytest

from fluxobs.logs.quality.marks import INJECTED
from fluxobs.logs.scales import Scales
from fluxobs.machines import example
from fluxobs.smoothing.record import (
    QUANTITIES,
    SHARES,
    RecordSamples,
    SmoothingModel,
    smooth_record,
)
from support.assumed import alone
from support.at_rest import RATED_SPEED, H, interior, record_at_rest

T = H * np.arange(16_000)
SPEED = np.interp(T, [0.3, 0.4], [0.3, 0.0])
REST = T > 0.6


def prepared(machine, noise=0.002, **conditions):
    """Return (model, samples, angle) of a record whose angle is known while the rotor turns."""
    record = record_at_rest(machine, SPEED, 2, noise=noise, resistance=1.0, loss=0.0, **conditions)
    rated = machine.rated_current
    scales = Scales(0.7 * rated, 130.0, noise * rated, 1.0, 140.0)
    model = SmoothingModel.of(
        machine, scales, H, machine.flux_base(rated), noise * rated, 0.3 * RATED_SPEED, {}
    )
    voltage = record.samples.voltage.copy()
    voltage[0] = voltage[1]
    angle = np.unwrap(record.samples.theta)
    std = np.where(T < 0.35, 0.02, np.inf)
    marks = np.full(len(T), INJECTED)
    return model, RecordSamples(voltage, record.samples.current, marks, angle, std), angle


@pytest.mark.parametrize("machine", [interior(1.5), example("ipm-5kw6")], ids=["linear", "map"])
def test_the_smoother_keeps_the_angle_at_rest(machine):
    model, samples, angle = prepared(machine)
    known = smooth_record(model, samples, model.prior(), learning=True)
    error = np.degrees(known.outputs["theta_e"] - angle + np.pi) % 360 - 180
    std = np.degrees(known.outputs["theta_e_std"])
    assert np.sqrt(np.mean(error[REST] ** 2)) < 1.5
    assert np.mean(np.abs(error) < 2 * std) > 0.95
    assert np.median(std[REST]) < 4.0
    without = smooth_record(
        model, replace(samples, marks=np.zeros(len(T), int)), model.prior(), learning=True
    )
    assert np.median(without.outputs["theta_e_std"][REST]) > 2 * np.radians(np.median(std[REST]))


@pytest.mark.parametrize(
    "name",
    ["tilt", "current_gain_re", "current_gain_im", "voltage_gain_re", "voltage_gain_im"],
)
def test_a_share_is_what_running_again_gives(name):
    """The derivatives of the direction by the assumptions."""
    model, samples, _ = prepared(interior(1.5), noise=1e-5)
    shares = smooth_record(model, samples, alone(model, name), learning=False).shares
    m = model.rows_per_block
    share = np.sqrt(shares[:, QUANTITIES.index("theta_e"), SHARES.index(name)])
    ends = [
        smooth_record(
            model,
            samples,
            alone(model, name).with_deviation(name, sign * 0.1 * model.stds[name]),
            learning=False,
        )
        for sign in (1, -1)
    ]
    moved = 5 * (ends[0].outputs["theta_e"] - ends[1].outputs["theta_e"] + np.pi) % (10 * np.pi)
    moved = np.abs(moved - 5 * np.pi)[: len(share) * m].reshape(-1, m).mean(axis=1)
    rest = REST[: len(share) * m : m]
    rest[-5:] = False
    np.testing.assert_allclose(moved[rest], share[rest], rtol=0.15, atol=1e-3)


def test_a_surface_machine_has_no_direction():
    """Its estimates are the same, bit by bit, with and without injection marks."""
    machine = example("pmsm-2kw2")
    model, samples, _ = prepared(machine)
    assert model.stds["tilt"] == 0
    with_marks = smooth_record(model, samples, model.prior(), learning=True)
    samples = replace(samples, marks=np.zeros(len(T), int))
    without = smooth_record(model, samples, model.prior(), learning=True)
    np.testing.assert_array_equal(with_marks.outputs["theta_e"], without.outputs["theta_e"])
    np.testing.assert_array_equal(with_marks.outputs["theta_e_std"], without.outputs["theta_e_std"])


@pytest.mark.parametrize(
    "wave",
    [np.array([1, -1]), np.array([1, 1, -1, -1]), np.exp(0.4j * np.pi * np.arange(5))],
    ids=["half the rate", "a quarter", "rotating"],
)
def test_the_row_reaches_the_bound(wave):
    """Against least squares on the currents, whose variance is the Cramér–Rao bound.

    The unknowns are the angle and the constant flux; volt-seconds are known. Both angles are
    linear in the noise, so that they are compared noise by noise.
    """
    L_d, L_q, amplitude, std, rows = 36e-3, 54e-3, 0.14, 0.014, 400
    ripple = amplitude * np.resize(wave, rows)
    flux = L_d * ripple.real + 1j * L_q * ripple.imag  # true angle 0
    rng = np.random.default_rng(1)
    noise = std * (rng.standard_normal((500, rows)) + 1j * rng.standard_normal((500, rows)))

    gain = np.diff(flux)
    d = gain.real / L_d + 1j * gain.imag / L_q
    beside = 1j * (L_d - L_q) * np.conj(d)
    rest = -(L_d * np.diff(noise.real) + 1j * L_q * np.diff(noise.imag))
    row = -np.real(rest * np.conj(beside)).sum(axis=1) / np.sum(np.abs(beside) ** 2)

    by_angle = 1j * (L_d - L_q) * np.conj(ripple)
    by_angle = by_angle.real / L_d + 1j * by_angle.imag / L_q
    columns = np.stack([by_angle, np.ones(rows) / L_d, 1j * np.ones(rows) / L_q], axis=1)
    A = np.concatenate([columns.real, columns.imag])
    y = np.concatenate([noise.real, noise.imag], axis=1)
    least_squares = np.linalg.lstsq(A, y.T, rcond=None)[0][0]
    ratio = row.std() / least_squares.std()
    assert 0.97 < ratio < 1.15
    assert row.std() == pytest.approx(std * np.sqrt(np.linalg.inv(A.T @ A)[0, 0]) * ratio, rel=0.1)
