"""Machines from files: valid files, and messages for invalid ones."""

import numpy as np
import pytest

from fluxobs import MachineError, SurfacePMSM, read_machine
from fluxobs.machines import KINDS, example, example_names, machine_from

VALID = {"kind": "surface-pmsm", "R_s": 0.4, "L_s": 1e-3, "n_p": 4}


def test_shipped_machines_are_of_every_kind():
    assert {example(name).kind for name in example_names()} == set(KINDS)


def test_toml_file_and_example_name(tmp_path):
    path = tmp_path / "motor.toml"
    path.write_text('kind = "surface-pmsm"\nR_s = 0.4\nL_s = 1e-3\nn_p = 4\n')
    machine = read_machine(path)
    assert machine == SurfacePMSM(R_s=0.4, L_s=1e-3, n_p=4)
    np.testing.assert_array_equal(machine.R, 0.4 * np.eye(2))
    np.testing.assert_array_equal(machine.B, np.eye(2))
    assert read_machine("servo-400w") == example("servo-400w")


def test_machines_are_frozen():
    with pytest.raises(ValueError, match="frozen"):
        example("servo-400w").R_s = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"R_s": -1}, "R_s must be positive, got -1"),
        ({"R_s": 0}, "R_s must be positive, got 0"),
        ({"R_s": "low"}, "R_s: input should be a valid number.*got 'low'"),
        ({"R_s": float("nan")}, "R_s"),
        ({"L_s": None}, "L_s"),
        ({"n_p": 1.5}, "n_p"),
        ({"n_p": 0}, "n_p must be at least 1, got 0"),
        ({"n_p": 2**63 - 1}, "n_p must be at most 1000"),
        ({"psi_f": 1e308}, r"psi_f must be at most 1e\+24, got 1e\+308"),
        ({"R_s": 1e-320}, "R_s must be at least 1e-24, got 1e-320"),
        ({"Rs": 1}, "unknown field 'Rs'; did you mean 'R_s'"),
        ({"kind": "surface-pmms"}, "unknown kind 'surface-pmms'; did you mean 'surface-pmsm'"),
        ({"kind": "interior-pmsm"}, "L_d is missing"),
    ],
)
def test_messages_name_field_and_remedy(change, message):
    with pytest.raises(MachineError, match=f"motor.toml.*({message})"):
        machine_from(VALID | change, source="motor.toml")


def test_a_message_lists_all_wrong_fields():
    with pytest.raises(MachineError, match=r"L_s is missing.*R_s must be positive|R_s.*L_s"):
        machine_from({"kind": "surface-pmsm", "R_s": -1, "n_p": 2})


def test_L_d_must_exceed_L_q():
    fields = {"kind": "synchronous-reluctance", "R_s": 1, "L_d": 1e-3, "L_q": 2e-3, "n_p": 2}
    with pytest.raises(MachineError, match="L_d must be larger than L_q"):
        machine_from(fields)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "no such machine file or shipped"),
        ("R_s = ", "not TOML"),
        ("R_s = 1", "kind is missing"),
    ],
)
def test_unreadable_files(tmp_path, text, message):
    path = tmp_path / "motor.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(MachineError, match=message):
        read_machine(path)


def test_the_transient_inductance_is_the_mean_over_directions():
    """A voltage step along n raises the current along n by n'L⁻¹n per second."""
    machine = example("ipm-2kw2")
    n = np.array([np.cos(a := np.linspace(0, np.pi, 360, endpoint=False)), np.sin(a)])
    slope = np.einsum("ik,ij,jk->k", n, np.diag(1 / np.array(machine.L_dq)), n)
    assert machine.transient_inductance == pytest.approx(1 / slope.mean(), rel=1e-12)
    assert machine.transient_inductance < 0.99 * np.mean(machine.L_dq)
