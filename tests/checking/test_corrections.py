"""Each mistake's effect on vectors and parameters, compared with really exchanged phases."""

import numpy as np
import pytest

from fluxobs.checking.mistakes import (
    AS_GIVEN,
    FACTOR,
    FILE,
    FRAME,
    LAG,
    LINE,
    NEUTRAL,
    PHASES,
    SCALES,
    SIGN,
    Linear,
    Mistake,
    combine,
    inverted_sensors,
)

Z = np.array([1.0, 0.3 + 2.0j, -1.0 - 0.5j])
AXES = np.exp(2j * np.pi / 3 * np.arange(3))


def phases(z):
    """Return three phase quantities whose sum is zero."""
    return (z * AXES.conj()[:, None]).real


def vector(a, b, c):
    return 2 / 3 * (AXES @ np.stack([a, b, c]))


A, B, C = phases(Z)


def right(mistake, of):
    """Return the only mistake whose text contains `of`."""
    (found,) = [one for one in mistake if of in one.words]
    return found


@pytest.mark.parametrize(
    ("words", "wrong"),
    [
        ("b and c are exchanged", vector(A, C, B)),
        ("a and b are exchanged", vector(B, A, C)),
        ("a and c are exchanged", vector(C, B, A)),
        ("(b c a)", vector(C, A, B)),  # the text gives the order that restores a, b, c
        ("(c a b)", vector(B, C, A)),
        ("α and β", Z.imag + 1j * Z.real),
    ],
)
def test_exchanged_phases(words, wrong):
    mistake = right(PHASES, words)
    np.testing.assert_allclose(mistake.current(wrong), Z)
    np.testing.assert_array_equal(mistake.voltage(Z), Z)
    assert mistake.lag == 0


def test_all_currents_inverted():
    np.testing.assert_array_equal(SIGN[0].current(-Z), Z)


@pytest.mark.parametrize("measured", ["ab", "bc", "ac"])
def test_one_of_two_currents_inverted(measured):
    for phase, mistake in zip(measured, inverted_sensors(measured), strict=True):
        given = dict(zip("abc", (A, B, C), strict=True))
        given[phase] = -given[phase]
        (other,) = set("abc") - set(measured)
        given[other] = -sum(given[name] for name in measured)
        np.testing.assert_allclose(mistake.current(vector(*given.values())), Z)
        assert mistake.words == f"i_{phase} has the opposite sign (--scale i_{phase}=-1)"


def test_two_phases_given_as_alpha_and_beta():
    for mistake in FRAME:
        np.testing.assert_allclose(mistake.current(A + 1j * B), Z)
    np.testing.assert_allclose(FRAME[0].voltage(A + 1j * B), Z)
    np.testing.assert_array_equal(FRAME[1].voltage(Z), Z)


def test_line_voltages_and_phase_voltages():
    np.testing.assert_allclose(LINE[0].voltage(vector(A - B, B - C, C - A)), Z)
    np.testing.assert_allclose(LINE[1].voltage(vector(A - C, B - A, C - B)), Z)
    # Voltages of phases a and b that were read as u_ab and u_bc.
    from_lines = vector((2 * A + B) / 3, (B - A) / 3, -(A + 2 * B) / 3)
    np.testing.assert_allclose(NEUTRAL[0].voltage(from_lines), Z)
    for mistake in (*LINE, *NEUTRAL):
        np.testing.assert_array_equal(mistake.current(Z), Z)


@pytest.mark.parametrize(
    ("words", "voltage", "current"),
    [
        ("voltages are line to line", np.sqrt(3), 1),
        ("voltages are rms", 1 / np.sqrt(2), 1),
        ("currents are rms", 1, 1 / np.sqrt(2)),
        ("voltages and currents are rms", 1 / np.sqrt(2), 1 / np.sqrt(2)),
        ("vectors are power-invariant", np.sqrt(1.5), np.sqrt(1.5)),
        ("voltages alone are power-invariant", np.sqrt(1.5), 1),
        ("currents alone are power-invariant", 1, np.sqrt(1.5)),
    ],
)
def test_scaled_signals_look_like_scaled_parameters(words, voltage, current):
    """If u and i are scaled by v and c, u = R i + dλ/dt holds with R v/c, L v/c and ψ v."""
    (mistake,) = [one for one in SCALES if one.words.startswith(words)]
    R, L, psi, i, di = 2.0, 0.1, 0.5, 3.0 + 1j, -7.0j
    u = R * i + L * di + 1j * psi
    seen = R * mistake.resistance * i * current + L * mistake.inductance * di * current
    assert seen + 1j * psi * mistake.flux == pytest.approx(u * voltage)
    assert mistake.flux == pytest.approx(voltage)
    assert mistake.resistance == mistake.inductance
    assert mistake.arrangement == AS_GIVEN.arrangement


@pytest.mark.parametrize(
    ("words", "right_over_given"),
    [
        ("R_s in the machine file is line to line (halve it)", (1 / 2, 1, 1)),
        ("R_s in the machine file is half the phase's R_s (double it)", (2, 1, 1)),
        ("R_s and inductances in the machine file are line to line", (1 / 2, 1 / 2, 1)),
        ("psi_f in the machine file is an rms value (multiply by √2)", (1, 1, np.sqrt(2))),
        ("psi_f in the machine file is line to line (divide by √3)", (1, 1, 1 / np.sqrt(3))),
    ],
)
def test_values_of_the_machine_file(words, right_over_given):
    mistake = right(SCALES, words)
    factors = (mistake.resistance, mistake.inductance, mistake.flux)
    assert factors == pytest.approx(right_over_given)
    assert mistake.only_flux == words.startswith("psi_f")


def test_the_direction_of_an_unknown_factor():
    def moved(mistakes, words):
        return right(mistakes, words).loose

    assert moved(FILE, "psi_f") == (0, 0, 1)
    assert moved(FILE, "R_s") == (1, 0, 0)
    assert moved(FILE, "inductances") == (0, 1, 0)
    assert moved(FACTOR, "currents") == (1, 1, 0)
    assert moved(FACTOR, "voltages") == (1, 1, 1)
    assert [one.only_flux for one in FILE] == [True, False, False]
    assert not any(one.only_flux for one in (AS_GIVEN, *FACTOR, *SIGN))
    scaled = Mistake("scale", "", flux=2.0, inductance=2.0)
    assert not scaled.only_flux


def test_lags_reach_two_samples():
    assert [(one.lag, one.words) for one in LAG] == [(-2, "-2"), (-1, "-1"), (1, "+1"), (2, "+2")]


def test_the_prior_of_a_mistake():
    """Standard deviations: 25 % of R, 15 % of L, 8 % of ψ, 10 % of the voltage for V_d."""
    known = Mistake("scale", "", resistance=2.0, inductance=3.0, flux=5.0)
    prior = known.prior(0.02)
    np.testing.assert_allclose(prior.mean, [np.log(2), np.log(3), np.log(5), 0.02])
    spread = np.array([0.25, 0.15, 0.08, 0.1])
    np.testing.assert_allclose(prior.precision, np.diag(1 / spread**2), atol=1e-9)


def test_the_prior_of_an_unknown_factor():
    """The variance of the common factor, 3.5² in ln, is added to that of each parameter."""
    precision = FACTOR[0].prior(0.0).precision
    covariance = np.linalg.inv(precision)
    expected = np.diag([0.25, 0.15, 0.08, 0.1]) ** 2
    expected[:2, :2] += 3.5**2
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-9)


def test_mistakes_are_combined_in_order():
    one = Mistake("a", "", Linear(2j), Linear(0, 1j), 1, 2.0, 3.0, 5.0, (1.0, 0.0, 0.0))
    other = Mistake("b", "w", Linear(3), Linear(1, 1j), -2, 7.0, 11.0, 13.0)
    both = combine(one, other)
    assert (both.kind, both.words, both.lag) == ("b", "w", -1)
    assert (both.resistance, both.inductance, both.flux) == (14.0, 33.0, 65.0)
    assert both.loose == one.loose
    np.testing.assert_allclose(both.current(Z), 3 * (2j * Z))
    mirrored = 1j * Z.conj()
    np.testing.assert_allclose(both.voltage(Z), mirrored + 1j * mirrored.conj())
    assert combine(one, FACTOR[1]).loose == FACTOR[1].loose
