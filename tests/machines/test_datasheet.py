"""Compare datasheets with physical quantities, which do not depend on the kind of description."""

import numpy as np
import pytest

from fluxobs import InteriorPMSM, MachineError, SurfacePMSM, SynchronousReluctance
from fluxobs.machines import read_machine
from fluxobs.machines.new import new_machine

PSI, N_P, R, L = 0.012, 7, 0.4, 0.9e-3
WINDING = {"R_line": 2 * R, "L_line": 2 * L}


def surface(**fields):
    return SurfacePMSM(**({"n_p": N_P} | WINDING | fields))


def terminal_voltage(machine, omega):
    """Return the peak voltage between two terminals, computed from the flux over a turn."""
    angle = np.linspace(0, 2 * np.pi, 721)
    phases = [machine.psi_f * np.cos(angle - shift) for shift in (0, 2 * np.pi / 3)]
    line = np.gradient(phases[0] - phases[1], angle) * machine.n_p * omega
    return np.abs(line[2:-2]).max()


@pytest.mark.parametrize("of", ["line peak", "line rms"])
def test_kv_is_the_speed_per_volt_between_terminals(of):
    machine = surface(kv=900.0, kv_of=of)
    voltage = terminal_voltage(machine, 900 * 2 * np.pi / 60)
    assert voltage == pytest.approx(1.0 if of == "line peak" else np.sqrt(2), rel=1e-4)


def test_voltage_and_torque_constants_give_the_same_flux():
    """Power balance: three times the rms phase EMF times the rms current is torque · speed."""
    omega, rms = 100.0, 3.0
    from_voltage = surface(K_e=52.0)  # V rms between terminals at 1000 rpm
    emf = 52.0 / 1000 * omega * 60 / (2 * np.pi) / np.sqrt(3)
    torque = 3 * emf * rms / omega
    from_torque = surface(K_t=torque / rms)
    assert from_torque.psi_f == pytest.approx(from_voltage.psi_f, rel=1e-4)
    assert surface(K_t=torque / rms / np.sqrt(2), K_t_of="peak").psi_f == pytest.approx(
        from_voltage.psi_f, rel=1e-4
    )


def test_block_commutation_relates_volts_to_torque():
    """Power balance: DC voltage between two terminals times DC current is torque · speed."""
    kv = 700.0  # rpm/V
    from_torque = surface(K_t=60 / (2 * np.pi) / kv, K_t_of="dc")
    assert from_torque.psi_f == pytest.approx(surface(kv=kv).psi_f, rel=1e-4)


def test_power_without_speed_and_missing_inductance():
    fields = {"poles": 4, "kv": 900, "R_line": 0.1}
    new = new_machine("surface-pmsm", fields | {"L_line": 3e-5, "rated_power": 90})
    assert any("needs rated_speed_rpm" in text for text in new.assumed)
    with pytest.raises(MachineError, match="Measure it between two terminals with an LCR meter"):
        new_machine("surface-pmsm", fields)


def test_winding_resistance_in_star_and_delta():
    star, delta = 0.3, 0.9
    between_star, between_delta = 2 * star, 1 / (1 / delta + 1 / (2 * delta))
    assert between_star == pytest.approx(between_delta)
    for fields in (
        {"R_line": between_star},
        {"R_phase": star},
        {"R_phase": delta, "connection": "delta"},
    ):
        machine = SurfacePMSM(n_p=4, psi_f=PSI, L_s=L, **fields)
        assert machine.R_s == pytest.approx(star, rel=1e-6)


def test_inductances_from_the_smallest_and_the_largest():
    line = {"R_line": 1.0, "L_line_min": 4e-3, "L_line_max": 10e-3, "n_p": 3}
    interior, reluctance = InteriorPMSM(psi_f=0.1, **line), SynchronousReluctance(**line)
    assert interior.L_dq == pytest.approx((2e-3, 5e-3))
    assert reluctance.L_dq == pytest.approx((5e-3, 2e-3))
    # The inductance between two terminals is 2 L_Σ - 2 L_Δ cos, with the mean L_d + L_q.
    assert SurfacePMSM(psi_f=0.1, **line).L_s == pytest.approx(3.5e-3)


def test_rated_values():
    machine = surface(psi_f=PSI, rated_current_rms=10.0, rated_speed_rpm=3000.0)
    assert machine.rated_current == pytest.approx(14.1421, rel=1e-4)
    assert machine.rated_speed == pytest.approx(314.159, rel=1e-4)
    powered = surface(psi_f=PSI, rated_power=400.0, rated_speed_rpm=3000.0)
    torque = 1.5 * N_P * PSI * powered.rated_current
    assert torque * 314.159 == pytest.approx(400.0, rel=1e-4)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kv": 900.0, "K_e": 5.0}, "kv and K_e: give one of them"),
        ({"kv": -1.0}, "kv must be a positive number"),
        ({"kv": 900.0, "kv_of": "rms"}, "did you mean 'line rms'"),
        ({"psi_f": PSI, "poles": 7}, "poles must be even"),
        ({"psi_f": PSI, "R_s": 0.4}, "R_s is given twice"),
        ({"psi_f": PSI, "poles": 14}, "n_p is given twice"),
        ({"psi_f": PSI, "R_phase": 0.4}, "R_line and R_phase"),
        ({"psi_f": PSI, "L_line_min": 0.4}, "belong together"),
    ],
)
def test_wrong_fields_are_named(fields, message):
    with pytest.raises(MachineError, match=message):
        surface(**fields)


def test_a_reluctance_machine_has_no_kv():
    with pytest.raises(MachineError, match="no magnets"):
        SynchronousReluctance(R_line=1.0, L_d=0.1, L_q=0.02, n_p=2, kv=900.0)


def test_a_new_machine_file_can_be_read(tmp_path):
    fields = {"poles": 14, "kv": 900, "R_line": 0.11, "L_line": 28e-6, "rated_current_rms": 20}
    new = new_machine("surface-pmsm", fields)
    (tmp_path / "motor.toml").write_text(new.text)
    reread = read_machine(tmp_path / "motor.toml")
    assert reread == new.machine
    assert any("line peak" in text for text in new.assumed)
    (tmp_path / "sheet.toml").write_text(
        'kind = "surface-pmsm"\npoles = 14\nkv = 900\nR_line = 0.11\nL_line = 28e-6\n'
        "rated_current_rms = 20\n"
    )
    assert read_machine(tmp_path / "sheet.toml") == reread


def test_a_machine_from_an_induction_motor_plate():
    plate = {"voltage": 400, "frequency": 50, "power": 2200, "current": 5.0, "speed": 1436}
    new = new_machine("induction", plate | {"cos_phi": 0.82})
    assert new.machine.n_p == 2
    with pytest.raises(MachineError, match="unknown field 'curent'"):
        new_machine("induction", {"curent": 5.0})
