"""The levitated lever: position, constraint and standard deviations, from its reluctances."""

import numpy as np
import pytest

from fluxobs.machines import example

MACHINE = example("maglev-knospe").with_values(k_1=3e-8, k_2=5e-8)
Q = np.array([-1.2e-4, 0.0, 0.8e-4])
FLUX = np.array([[2e-5, 1e-5], [1e-5, 3e-5], [1.5e-5, 1.5e-5]])
GAPS = np.stack([MACHINE.g - Q, MACHINE.g + Q], axis=1)
CURRENT = FLUX * GAPS / [MACHINE.k_1, MACHINE.k_2]


def test_the_position_satisfies_both_reluctances():
    position, length = MACHINE.position(FLUX, CURRENT)
    np.testing.assert_allclose(position, Q)
    np.testing.assert_allclose(length, np.linalg.norm(FLUX, axis=1))


def test_wrong_currents_are_combined_by_least_squares():
    """Each coil gives φ q; the coil with more flux has more weight."""
    wrong = CURRENT + np.array([0.05, -0.02])
    k = np.array([MACHINE.k_1, MACHINE.k_2])
    coils = np.stack([FLUX[:, 0] * MACHINE.g, -FLUX[:, 1] * MACHINE.g], 1) - [1, -1] * k * wrong
    expected = [
        np.linalg.lstsq(flux[:, None], coil, rcond=None)[0][0]
        for flux, coil in zip(FLUX, coils, strict=True)
    ]
    np.testing.assert_allclose(MACHINE.position(FLUX, wrong)[0], expected)


def test_the_constraint_holds():
    relation = MACHINE.constraint
    for flux, current in zip(FLUX, CURRENT, strict=True):
        square, mixed = flux @ relation.Q1 @ flux, flux @ relation.Q2 @ current
        assert square == pytest.approx(2 * MACHINE.g * flux[0] * flux[1])
        assert mixed == pytest.approx(-square)
        assert current @ relation.Q3 @ current == 0


def test_flux_base_and_noise_in_the_middle():
    base = MACHINE.flux_base(2.0)
    assert base**2 == pytest.approx(MACHINE.k_1 * 2.0 / MACHINE.g * MACHINE.k_2 * 2.0 / MACHINE.g)
    # Effect of the noise of both currents on the relation, at equal fluxes.
    noise = MACHINE.constraint_noise(base, 0.1)
    assert noise == pytest.approx(0.1 * base * np.sqrt(MACHINE.k_1**2 + MACHINE.k_2**2))


def test_position_std_by_finite_differences():
    flux_std = np.array([3e-8, 7e-8])
    small = 1e-10
    moves = [
        (MACHINE.position(FLUX + small * axis, CURRENT)[0] - Q) / small * std
        for axis, std in zip(np.eye(2), flux_std, strict=True)
    ]
    std = MACHINE.position_std(FLUX, flux_std, CURRENT)
    np.testing.assert_allclose(std, np.hypot(*moves), rtol=1e-3)


def test_voltages_drive_the_flux_of_a_core():
    """N dφ/dt = u - R i."""
    np.testing.assert_allclose(MACHINE.N * MACHINE.R, MACHINE.resistance * np.eye(2))
    np.testing.assert_allclose(MACHINE.N * MACHINE.B, np.eye(2))
    assert MACHINE.position_span == MACHINE.g
    assert MACHINE.position_error(3.0, 1.0) == 2.0
