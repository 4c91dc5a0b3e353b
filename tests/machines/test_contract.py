"""Every kind of machine answers what the contract asks, and the answers fit each other."""

from typing import ClassVar

import numpy as np
import pytest

import fluxobs
from fluxobs.machines import KINDS, RotatingMachine, example, example_names
from fluxobs.machines.rotating import MagnetMachine
from fluxobs.synthetic.demo import LOG
from fluxobs.validation import Positive

EXAMPLES = [example(name) for name in example_names()]


def test_every_kind_has_an_example():
    assert {machine.kind for machine in EXAMPLES} == set(KINDS)


@pytest.mark.parametrize("machine", EXAMPLES, ids=example_names())
def test_answers(machine):
    rated, position = machine.rated_current, machine.position_output
    assert machine.R.shape == machine.B.shape == (2, 2)
    assert machine.constraint.n == 2
    base = machine.flux_base(rated)
    assert base > 0
    assert 0 < machine.constraint_noise(base, 0.01 * rated) < np.abs(machine.constraint.Q1).max()
    assert machine.position_span > 0
    assert len(machine.ports) == 2
    flux, current = np.full((3, 2), base), np.full((3, 2), 0.1 * rated)
    where, length = machine.position(flux, current)
    assert where.shape == length.shape == (3,)
    assert (length > 0).all()
    std = machine.position_std(flux, 0.01 * flux, current)
    # A hundredth of the flux turns the angle, or moves the body, by about as much of its span.
    assert (std < 0.05 * machine.position_span).all()
    for channel in position.truths:
        true = machine.true_position(channel, 0.1 * where / getattr(machine, "n_p", 1))
        assert true.shape == (3,)
    assert np.abs(machine.position_error(where, where)).max() == 0


@pytest.mark.parametrize("machine", EXAMPLES, ids=example_names())
def test_copies_keep_the_rest(machine):
    name = "R_s" if isinstance(machine, RotatingMachine) else "k_1"
    twice = machine.scaled([name, "no_such"], 2.0)
    assert getattr(twice, name) == 2 * getattr(machine, name)
    assert twice.scaled([name], 0.5) == machine
    with pytest.raises(fluxobs.MachineError):
        machine.scaled([name], -1.0)


ROTATING = [machine for machine in EXAMPLES if isinstance(machine, RotatingMachine)]


@pytest.mark.parametrize("machine", ROTATING, ids=lambda machine: machine.kind)
def test_flux_in_rotor_coordinates_fulfils_the_relation(machine):
    """λ - L i lies along d with the length that saliency and magnet flux say."""
    i_dq = np.array([0.0, 2 + 3j, 1 - 4j]) if machine.magnets else np.array([2 + 3j, 1 - 4j])
    turn = np.exp(0.7j)
    flux, current = (
        np.stack([z.real, z.imag], axis=-1) for z in (machine.flux_dq(i_dq) * turn, i_dq * turn)
    )
    angle, length = machine.position(flux, current)
    np.testing.assert_allclose(angle, 0.7, rtol=1e-12)
    np.testing.assert_allclose(length, machine.magnet_flux + machine.saliency * i_dq.real)
    if machine.saliency == 0 or not machine.magnets:  # else the length moves with i_d
        scale = machine.constraint_noise(machine.flux_base(1.0), 1.0)
        assert np.abs(machine.constraint.residual(flux, current)).max() < 1e-12 * max(scale, 1e-3)


def test_psi_f_that_is_missing_is_asked_for():
    machine = fluxobs.SurfacePMSM(R_s=1.0, L_s=1e-3, n_p=2)
    assert machine.magnet_flux is None
    assert machine.flux_base(3.0) is None
    assert machine.flux_base(3.0, psi_f=0.1) == 0.1
    with pytest.raises(fluxobs.MachineError, match="psi_f is missing"):
        machine.flux_dq(1.0)


class WoundField(MagnetMachine):
    """A kind that the package does not know: one inductance under another name."""

    kind: ClassVar[str] = "wound-field"
    inductances = ("L_sync", "L_sync")

    L_sync: Positive


def test_a_new_kind_is_one_class(monkeypatch, tmp_path):
    """Registered, it is read from files, estimated, identified, checked and exported."""
    monkeypatch.setitem(KINDS, WoundField.kind, WoundField)
    file = tmp_path / "wound.toml"
    file.write_text(
        'kind = "wound-field"\nR_s = 0.36\nL_sync = 0.6e-3\nn_p = 4\npsi_f = 0.0125\n'
        "rated_current = 12.0\n"
    )
    machine, known = fluxobs.read_machine(file), fluxobs.example("servo-400w")
    for unknowns in ("drift", "drift,resistance,inverter"):
        new = fluxobs.estimate(LOG, machine, unknowns=unknowns, stop=0.4)
        old = fluxobs.estimate(LOG, known, unknowns=unknowns, stop=0.4)
        assert new.estimates.equals(old.estimates, null_equal=True)
    assert fluxobs.identify(LOG, machine).machine.R_s == fluxobs.identify(LOG, known).machine.R_s
    done = fluxobs.export(machine, 1e-4, tmp_path / "out")
    assert (
        done.observer.parameters()
        == fluxobs.export(known, 1e-4, tmp_path / "o2").observer.parameters()
    )
