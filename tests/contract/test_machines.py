"""Every kind of machine fulfils the contract of machines/contract.py with consistent answers."""

from __future__ import annotations

from typing import ClassVar, get_args

import numpy as np
import pytest

import fluxobs
from fluxobs import FluxobsError, MachineError, QuadraticConstraint
from fluxobs.core.validation import Positive
from fluxobs.machines import (
    KINDS,
    Machine,
    MagnetMachine,
    Position,
    RotatingMachine,
    example,
    example_names,
    machine_from,
)
from fluxobs.machines.contract import angle_std
from fluxobs.machines.model.frames import Frame, angle_error, wrap
from fluxobs.machines.model.immersion import Immersion
from fluxobs.simulation.closed_form.demo import LOG
from support.records import SERVO, log_columns, steady

H = 1e-4
EXAMPLES = [example(name) for name in example_names()]


def test_every_kind_has_an_example():
    assert {machine.kind for machine in EXAMPLES} == set(KINDS)


@pytest.mark.parametrize("machine", EXAMPLES, ids=example_names())
def test_shapes_and_sizes_of_the_answers(machine):
    rated, position = machine.rated_current, machine.position_output
    assert machine.R.shape == machine.B.shape == (2, 2)
    assert machine.constraint.n == 2
    base = machine.flux_base(rated)
    assert base > 0
    assert 0 < machine.constraint_noise(base, 0.01 * rated) < np.abs(machine.constraint.Q1).max()
    assert machine.position_span > 0
    assert len(machine.ports) == 2
    flux, current = np.full((3, 2), base), np.full((3, 2), 0.1 * rated)
    angle, length = machine.position(flux, current)
    assert angle.shape == length.shape == (3,)
    assert (length > 0).all()
    std = machine.position_std(flux, 0.01 * flux, current)
    # An error of 1 % of the flux changes the position by about 1 % of the position's span.
    assert (std < 0.05 * machine.position_span).all()
    for channel in position.truths:
        true = machine.true_position(channel, 0.1 * angle / getattr(machine, "n_p", 1))
        assert true.shape == (3,)
    assert np.abs(machine.position_error(angle, angle)).max() == 0


@pytest.mark.parametrize("machine", EXAMPLES, ids=example_names())
def test_scaled_copies_keep_all_other_parameters(machine):
    name = "R_s" if isinstance(machine, RotatingMachine) else "k_1"
    doubled = machine.scaled([name, "no_such"], 2.0)
    assert getattr(doubled, name) == 2 * getattr(machine, name)
    assert doubled.scaled([name], 0.5) == machine
    with pytest.raises(fluxobs.MachineError):
        machine.scaled([name], -1.0)


ROTATING = [machine for machine in EXAMPLES if isinstance(machine, RotatingMachine)]


@pytest.mark.parametrize("machine", ROTATING, ids=lambda machine: machine.kind)
def test_flux_in_rotor_coordinates_satisfies_the_relation(machine):
    """λ - L i lies along d; saliency and magnet flux determine its length."""
    i_dq = np.array([0.0, 2 + 3j, 1 - 4j]) if machine.magnets else np.array([2 + 3j, 1 - 4j])
    turn = np.exp(0.7j)
    flux, current = (
        np.stack([z.real, z.imag], axis=-1) for z in (machine.flux_dq(i_dq) * turn, i_dq * turn)
    )
    angle, length = machine.position(flux, current)
    np.testing.assert_allclose(angle, 0.7, rtol=1e-12)
    if isinstance(machine, RotatingMachine) and machine.saturation:  # the length is the active flux
        active = machine.saturation.table.at(i_dq).auxiliary(i_dq).real
        np.testing.assert_allclose(length, active, rtol=1e-9)
        return
    np.testing.assert_allclose(length, machine.magnet_flux + machine.saliency * i_dq.real)
    if machine.saliency == 0 or not machine.magnets:  # else the length varies with i_d
        scale = machine.constraint_noise(machine.flux_base(1.0), 1.0)
        assert np.abs(machine.constraint.residual(flux, current)).max() < 1e-12 * max(scale, 1e-3)


def test_a_missing_psi_f_is_reported():
    machine = fluxobs.SurfacePMSM(R_s=1.0, L_s=1e-3, n_p=2)
    assert machine.magnet_flux is None
    assert machine.flux_base(3.0) is None
    assert machine.flux_base(3.0, psi_f=0.1) == 0.1
    with pytest.raises(fluxobs.MachineError, match="psi_f is missing"):
        machine.flux_dq(1.0)


# ---- at states of each kind, and of one that is not part of the package ----------------------


class TwoCoils(Machine):
    """Rotating machine that implements the whole contract: coils a and b, angle in turns."""

    kind = "two-coils"
    frame = "ports"
    ports = ("a", "b")
    position_output = Position("turned", ("position",), 360.0, "°", "Turned")

    ohm: Positive
    henry: Positive
    weber: Positive

    @property
    def R(self):
        return self.ohm * np.eye(2)

    @property
    def B(self):
        return np.eye(2)

    @property
    def constraint(self):
        L, identity = self.henry, np.eye(2)
        return QuadraticConstraint(
            identity, -2 * L * identity, L * L * identity, d=-(self.weber**2)
        )

    def flux_base(self, rated_current, psi_f=None):
        return self.weber if psi_f is None else psi_f

    def constraint_noise(self, flux_base, noise):
        return 2 * self.henry * flux_base * noise

    def position(self, flux, current):
        x = np.asarray(flux) - self.henry * np.asarray(current)
        return np.arctan2(x[..., 1], x[..., 0]) / (2 * np.pi), np.hypot(x[..., 0], x[..., 1])

    def position_std(self, flux, flux_std, current):
        return angle_std(flux_std, self.position(flux, current)[1]) / (2 * np.pi)

    def true_position(self, channel, value):
        return wrap(value) / (2 * np.pi)

    def position_error(self, estimated, true):
        return angle_error(2 * np.pi * estimated, 2 * np.pi * true) / (2 * np.pi)


COILS = TwoCoils(
    ohm=SERVO.R_s, henry=SERVO.L_s, weber=SERVO.psi_f, rated_current=SERVO.rated_current
)
MACHINES = {name: example(name) for name in example_names()} | {"coils": COILS}


@pytest.fixture(params=MACHINES)
def machine(request):
    return MACHINES[request.param]


def states(machine, count=50):
    """Return random positions, with the corresponding fluxes and currents."""
    rng = np.random.default_rng(3)
    size = machine.flux_base(machine.rated_current)
    if isinstance(machine, RotatingMachine):
        theta = rng.uniform(-3, 3, count)
        i_d, i_q = machine.rated_current * rng.uniform(0.3, 1, (2, count))
        i_d *= -1 if machine.saliency < 0 else 1  # the reluctance torque then adds
        turn = np.exp(1j * theta)
        current = (i_d + 1j * i_q) * turn
        flux = machine.flux_dq(i_d + 1j * i_q) * turn
        return (
            theta,
            np.stack([flux.real, flux.imag], -1),
            np.stack([current.real, current.imag], -1),
        )
    if isinstance(machine, TwoCoils):
        turned = rng.uniform(-0.45, 0.45, count)
        current = machine.rated_current * rng.uniform(-1, 1, (count, 2))
        angle = 2 * np.pi * turned
        x = machine.weber * np.stack([np.cos(angle), np.sin(angle)], -1)
        return turned, x + machine.henry * current, current
    position = 0.5 * machine.g * rng.uniform(-1, 1, count)
    flux = size * rng.uniform(0.5, 1, (count, 2))
    gaps = np.stack([machine.g - position, machine.g + position], -1)
    return position, flux, flux * gaps / [machine.k_1, machine.k_2]


def test_matrices_and_frame(machine):
    for matrix in (machine.R, machine.B):
        assert matrix.shape == (2, 2)
        assert np.isfinite(matrix).all()
        assert (np.diag(matrix) > 0).all()
    assert machine.frame in get_args(Frame)
    assert len(machine.ports) == len(set(machine.ports)) == 2
    assert machine.memory > 0
    assert machine.shortest >= 0


def test_the_relation_holds_at_every_state(machine):
    _, flux, current = states(machine)
    constraint = machine.constraint
    assert constraint.n == 2
    residual = constraint.residual(flux, current)
    size = np.abs(constraint.Q1).max() * machine.flux_base(machine.rated_current) ** 2
    expected = np.zeros(len(flux))
    if isinstance(machine, RotatingMachine) and machine.saturation:
        return  # the relation is for a linear machine and gives only scales
    if isinstance(machine, MagnetMachine):  # residual of a salient machine: active flux² - ψ_f²
        _, length = machine.position(flux, current)
        expected = length**2 - machine.psi_f**2
        assert (np.ptp(length) > 0.01 * machine.psi_f) is np.bool_(machine.saliency != 0)
    assert np.abs(residual - expected).max() < 1e-9 * size


def test_position_from_flux_and_current(machine):
    true, flux, current = states(machine)
    estimate, length = machine.position(flux, current)
    assert estimate.shape == length.shape == true.shape
    assert (length > machine.shortest * machine.flux_base(machine.rated_current)).all()
    error = machine.position_error(estimate, true)
    assert np.abs(error).max() < 1e-9 * machine.position_span
    single, _ = machine.position(flux[0], current[0])
    assert single == pytest.approx(estimate[0], abs=1e-12)
    std = machine.position_std(flux, 0.01 * np.abs(flux), current)
    assert ((std > 0) & (std < machine.position_span)).all()
    assert (machine.position_std(flux, 0.02 * np.abs(flux), current) > std).all()


def test_truth_channels(machine):
    output = machine.position_output
    assert output.truths
    assert output.factor > 0
    for channel in output.truths:
        true = machine.true_position(channel, np.array([0.0, 1e-5]))
        assert true.shape == (2,)
        assert machine.position_error(true, true) == pytest.approx(0, abs=1e-15)


def test_flux_base_and_noise(machine):
    rated = machine.rated_current
    base = machine.flux_base(rated)
    assert base > 0
    noise = machine.constraint_noise(base, 0.01 * rated)
    assert noise > 0
    assert machine.constraint_noise(base, 0.02 * rated) == pytest.approx(2 * noise)


def test_copies_with_other_values(machine):
    other = machine.with_values(rated_current=2 * machine.rated_current)
    assert type(other) is type(machine)
    assert other.rated_current == 2 * machine.rated_current
    assert other.with_values(rated_current=machine.rated_current) == machine
    assert machine.scaled(["rated_current", "no such"], 3.0).rated_current == pytest.approx(
        3 * machine.rated_current
    )
    with pytest.raises(MachineError, match="rated_current must be positive, got -1"):
        machine.with_values(rated_current=-1.0)
    with pytest.raises(MachineError, match="'rated_curent'; did you mean 'rated_current'"):
        machine.with_values(rated_curent=1.0)


def test_constructors_raise_machine_errors(machine):
    with pytest.raises(MachineError, match="is missing"):
        type(machine)()
    with pytest.raises(MachineError, match="rated_current"):
        type(machine)(**machine.parameters() | {"rated_current": "much"})
    assert issubclass(MachineError, FluxobsError)


@pytest.mark.parametrize("name", example_names())
def test_parameters_in_a_file_give_the_same_machine(name):
    machine = example(name)
    fields = {name: value for name, value in machine.parameters().items() if value is not None}
    assert set(fields) <= set(machine.parameter_names())
    assert machine_from(fields | {"kind": machine.kind}) == machine


def test_the_immersion_sees_the_flux_of_every_kind(machine):
    assert Immersion((machine.constraint,), ("drift",)).invisible().shape[1] == 0


# ---- a user's own kinds ----------------------------------------------------------------------


class WoundField(MagnetMachine):
    """Kind of machine outside the package, with another name for the inductance."""

    kind: ClassVar[str] = "wound-field"
    inductances = ("L_sync", "L_sync")

    L_sync: Positive


def test_a_new_kind_is_one_class(monkeypatch, tmp_path):
    """A registered kind can be read from files, estimated, identified, checked and exported."""
    monkeypatch.setitem(KINDS, WoundField.kind, WoundField)
    file = tmp_path / "wound.toml"
    file.write_text(
        'kind = "wound-field"\nR_s = 0.36\nL_sync = 0.6e-3\nn_p = 4\npsi_f = 0.0125\n'
        "rated_current = 12.0\n"
    )
    machine, servo = fluxobs.read_machine(file), fluxobs.example("servo-400w")
    for unknowns in ("drift", "drift,resistance,inverter"):
        new = fluxobs.estimate(LOG, machine, unknowns=unknowns, stop=0.4)
        old = fluxobs.estimate(LOG, servo, unknowns=unknowns, stop=0.4)
        assert new["valid"].any()
        assert new.estimates.equals(old.estimates, null_equal=True)
    new, old = (fluxobs.identify(LOG, kind, stop=0.2).machine for kind in (machine, servo))
    assert new.R_s == old.R_s
    exported = fluxobs.export(machine, 1e-4, tmp_path / "out", unknowns="drift")
    assert (
        exported.observer.parameters()
        == fluxobs.export(servo, 1e-4, tmp_path / "o2", unknowns="drift").observer.parameters()
    )


SAMPLES = steady(SERVO, H, 500.0, 3000, 6j, 0.15 - 0.1j, -0.1 + 0.05j, 0.02)
COLUMNS = log_columns(SAMPLES)


def test_a_new_kind_of_machine_is_estimated():
    names = {"u_alpha": "u_1", "u_beta": "u_2", "i_alpha": "i_1", "i_beta": "i_2", "t": "t"}
    columns = {names[name]: values for name, values in COLUMNS.items()}
    columns["angle"] = SAMPLES.theta
    result = fluxobs.estimate(columns, COILS, truth={"position": "angle"})
    assert result.estimates.columns == [
        *("t", "flux_a", "flux_b", "flux_a_std", "flux_b_std", "turned", "turned_std"),
        *("drift_a", "drift_b", "noise_share", "valid", "turned_error"),
    ]
    assert result["valid"][-1000:].all()
    assert np.abs(result["turned_error"][-1000:]).max() < 2 / 360
    np.testing.assert_allclose(
        result.estimates.select("drift_a", "drift_b").row(-1), SAMPLES.drift, atol=0.01
    )
    assert len(result.plot().axes) > 2
