"""The induction machine: parameter conversions, slip, scales and refused parameters."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs import MachineError
from fluxobs.machines import InductionMachine, example
from fluxobs.machines.induction import MAGNETIZING, OFFSET, STILL

MACHINE = example("induction-2kw2")
T_MODEL = {"R_r": 2.4, "L_ls": 0.011, "L_lr": 0.013, "L_m": 0.23}


def test_t_model_and_inverse_gamma_have_the_same_impedance():
    """The impedance at the terminals is the same for any frequency and slip."""
    machine = InductionMachine(R_s=3.7, n_p=2, **T_MODEL)
    for omega, slip in ((314.0, 0.05), (314.0, 1.0), (60.0, -0.3)):
        rotor_branch = T_MODEL["R_r"] / slip + 1j * omega * T_MODEL["L_lr"]
        main = 1j * omega * T_MODEL["L_m"]
        t_model = 3.7 + 1j * omega * T_MODEL["L_ls"] + main * rotor_branch / (main + rotor_branch)
        main = 1j * omega * machine.L_M
        inverse_gamma = (
            machine.R_s
            + 1j * omega * machine.L_sigma
            + main * machine.R_R / slip / (main + machine.R_R / slip)
        )
        assert inverse_gamma == pytest.approx(t_model, rel=1e-12)


def test_plate_parameters_reproduce_the_rated_operating_point():
    plate = {"voltage": 400, "frequency": 50, "power": 2200, "current": 5.0, "speed": 1436}
    machine = InductionMachine(plate=plate | {"cos_phi": 0.82})
    assert machine.n_p == 2
    assert machine.rated_current == pytest.approx(5 * np.sqrt(2), rel=1e-3)
    omega, slip = 2 * np.pi * 50, 1 - 1436 / 1500
    main = 1j * omega * machine.L_M
    impedance = (
        machine.R_s
        + 1j * omega * machine.L_sigma
        + main * machine.R_R / slip / (main + machine.R_R / slip)
    )
    current = 400 / np.sqrt(3) / impedance
    assert abs(current) == pytest.approx(5.0, rel=0.01)
    assert np.cos(np.angle(current)) == pytest.approx(0.82, rel=0.01)


def test_slip_in_steady_state():
    psi, i_d, i_q = 0.9, 0.9 / MACHINE.L_M, 3.0
    direction = np.exp(0.4j)
    i = (i_d + 1j * i_q) * direction
    flux = psi * direction + MACHINE.L_sigma * i
    pair = [np.array([z.real, z.imag]) for z in (flux, i)]
    assert MACHINE.slip(*pair) == pytest.approx(MACHINE.R_R * i_q / psi)


def test_flux_base_without_a_rated_flux():
    machine = MACHINE.with_values(psi_R=None)
    assert 0.5 < machine.flux_base(7.1) / 0.9 < 2
    assert machine.flux_base(7.1, psi_f=0.4) == 0.4


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"R_R": 2.0, "L_sigma": 0.02}, "L_M is missing"),
        ({"R_r": 2.0, "L_ls": 0.01, "L_m": 0.2}, "L_lr is missing"),
        (T_MODEL | {"R_r": -1.0}, "R_r must be a positive number"),
        (T_MODEL | {"R_r": -0.5}, "R_r must be a positive number"),
        (T_MODEL | {"R_r": 0.0}, "R_r must be a positive number, got 0.0"),
        (T_MODEL | {"R_r": float("inf")}, "R_r must be a positive number"),
        (T_MODEL | {"R_r": True}, "R_r must be a positive number"),
        (T_MODEL | {"R_r": "1"}, "R_r must be a positive number"),
        ({"plate": {"voltage": 400}}, "plate needs voltage, frequency, power"),
        (
            {
                "plate": {
                    "voltage": 400,
                    "frequency": 50,
                    "power": 9000,
                    "current": 5.0,
                    "speed": 1436,
                    "cos_phi": 0.82,
                }
            },
            "more than the",
        ),
        (
            {
                "plate": {
                    "voltage": 400,
                    "frequency": 50,
                    "power": 2200,
                    "current": 5.0,
                    "speed": 1100,
                    "cos_phi": 0.82,
                }
            },
            "no slip between 0 and 20 %",
        ),
    ],
)
def test_wrong_parameters_are_refused(fields, message):
    with pytest.raises(MachineError, match=message):
        InductionMachine(**({"R_s": 3.7, "n_p": 2} | fields))


@pytest.mark.parametrize("rated", [5.0, None])
def test_the_map_of_a_cage(rated):
    """Thresholds are shares of the magnetizing current and of the rated current."""
    machine = InductionMachine(
        R_s=3.7, n_p=2, R_R=2.1, L_sigma=0.021, L_M=0.224, rated_current=rated
    )
    cage = machine.map_for(1e-4, 0.9)
    assert (cage.L_sigma, cage.L_M, cage.R_R) == (0.021, 0.224, 2.1)
    assert (cage.sample_time, cage.psi_R) == (1e-4, 0.9)
    magnetizing = 0.9 / 0.224
    assert cage.still == pytest.approx(STILL * magnetizing)
    assert cage.offset == pytest.approx(OFFSET * (rated or magnetizing / MAGNETIZING))
    assert 0 < STILL < 0.2
    assert 0 < OFFSET < 0.05
