"""Flux maps in machine files."""

from __future__ import annotations

import numpy as np
import pytest

from fluxobs import MachineError
from fluxobs.machines import (
    AlgebraicSaturation,
    FluxPoints,
    InteriorPMSM,
    SurfacePMSM,
    SynchronousReluctance,
    read_machine,
)

MODEL = AlgebraicSaturation(a_d0=17.4, a_dd=373, a_q0=52.1, a_qq=658, a_dq=1120)
MAGNET = AlgebraicSaturation(a_d0=17.4, a_dd=50, a_q0=14.0, a_qq=60, a_dq=30, psi_f=0.5)


def grid(limit=30.0, points=31):
    axis = np.linspace(-limit, limit, points)
    return (axis[:, None] + 1j * axis[None, :]).ravel()


@pytest.mark.parametrize("model", [MODEL, MAGNET], ids=["reluctance", "magnet"])
def test_the_model_is_invertible_and_reciprocal(model):
    i = grid()
    psi = model.flux(i)
    np.testing.assert_allclose(model.current(psi), i, atol=1e-8)
    assert model.flux(0j) == pytest.approx(model.psi_f, abs=1e-12)
    e = 1e-6
    dd, dq, qq = model.slopes(psi)
    by_d = (model.current(psi + e) - model.current(psi - e)) / (2 * e)
    by_q = (model.current(psi + 1j * e) - model.current(psi - 1j * e)) / (2 * e)
    for slope, expected in ((by_d.real, dd), (by_d.imag, dq), (by_q.real, dq), (by_q.imag, qq)):
        np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-3)


def machine_file(tmp_path, text, points=None):
    if points is not None:
        i, psi = points
        rows = np.column_stack([i.real, i.imag, psi.real, psi.imag])
        head = "i_d,i_q,psi_d,psi_q"
        np.savetxt(tmp_path / "map.csv", rows, delimiter=",", header=head, comments="")
    path = tmp_path / "motor.toml"
    path.write_text(text)
    return path


RELUCTANCE = 'kind = "synchronous-reluctance"\nR_s = 0.63\nn_p = 2\nrated_current = 22.0\n'


def test_a_table_beside_the_machine_file(tmp_path):
    i = grid()
    path = machine_file(tmp_path, RELUCTANCE + 'flux_map = "map.csv"\n', (i, MODEL.flux(i)))
    machine = read_machine(path)
    i_dq = np.array([10 + 12j, 5 - 18j])
    np.testing.assert_allclose(machine.flux_dq(i_dq), MODEL.flux(i_dq), atol=1e-3)
    # Inductances are computed from the map as slopes of chords.
    assert machine.L_q == pytest.approx(MODEL.flux(22j).imag / 22, rel=0.02)
    assert machine.L_d == pytest.approx(MODEL.flux(11 + 0j).real / 11, rel=0.02)
    # A copy keeps the map and the inductances.
    assert machine.with_values(R_s=0.7).flux_map is machine.flux_map


def test_the_parameters_of_the_model_in_the_machine_file(tmp_path):
    text = "flux_map = { a_d0 = 17.4, a_dd = 373, a_q0 = 52.1, a_qq = 658, a_dq = 1120 }\n"
    machine = read_machine(machine_file(tmp_path, RELUCTANCE + text))
    i_dq = np.array([10 + 12j, 5 - 18j])
    np.testing.assert_allclose(machine.flux_dq(i_dq), MODEL.flux(i_dq), atol=1e-3)


def test_a_magnet_machine_takes_its_flux_from_the_map():
    i = grid()
    machine = InteriorPMSM(
        R_s=0.5, n_p=3, rated_current=15.0, flux_map=FluxPoints(i, MAGNET.flux(i))
    )
    assert machine.psi_f == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize("share", [0.7, 0.5])
def test_an_inductance_that_falls_with_the_current(share):
    machine = SurfacePMSM(
        R_s=0.5, n_p=4, L_s=4e-3, L_s_rated=share * 4e-3, psi_f=0.1, rated_current=20.0
    )
    fit = machine.saturation
    assert machine.flux_dq(20j).imag == pytest.approx(share * 4e-3 * 20, rel=1e-3)
    assert machine.flux_dq(20j * np.exp(0.6j)) == pytest.approx(
        0.1 + share * 4e-3 * 20j * np.exp(0.6j), rel=1e-3
    )
    assert fit.table.at(1e-3j).by_q.imag == pytest.approx(4e-3, rel=3e-2)
    assert fit.reciprocity < 1e-2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('flux_map = "no.csv"\n', "no.csv: cannot be read"),
        ("flux_map = { a_d0 = 1.0, a_x = 2.0 }\n", "a_q0 is missing.*did you mean 'a_qq'"),
        ("flux_map = { a_d0 = -1.0, a_q0 = 2.0 }\n", "a_d0 must be positive"),
        ("flux_map = 3\n", "flux_map must be the path"),
        ("flux_map = { a_d0 = 17.0, a_q0 = 50.0, psi_f = 0.1 }\n", "this kind has no magnets"),
        (
            "L_d_rated = 0.03\nflux_map = { a_d0 = 17.0, a_q0 = 50.0 }\n",
            "L_d_rated and flux_map: give one",
        ),
    ],
)
def test_wrong_maps_in_a_machine_file_are_refused(tmp_path, text, message):
    with pytest.raises(MachineError, match=message):
        read_machine(machine_file(tmp_path, RELUCTANCE + text))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("i_d,i_q,psi_d\n1,2,3\n", "psi_q is missing"),
        ("i_d,i_q,psi_d,psi_q\n1,2,3,x\n", "point 1: psi_q is 'x', not a number"),
        ("", "is missing"),
    ],
)
def test_wrong_tables_are_refused(tmp_path, content, message):
    (tmp_path / "map.csv").write_text(content)
    with pytest.raises(MachineError, match=message):
        SynchronousReluctance(R_s=1.0, n_p=2, flux_map=tmp_path / "map.csv")


def test_a_model_needs_rated_current_and_magnets_need_psi_f():
    model = {"a_d0": 17.0, "a_q0": 50.0}
    with pytest.raises(MachineError, match="needs rated_current"):
        SynchronousReluctance(R_s=1.0, n_p=2, flux_map=model)
    with pytest.raises(MachineError, match="psi_f is missing"):
        InteriorPMSM(R_s=1.0, n_p=2, rated_current=5.0, flux_map=model)


def test_a_model_without_saturation_is_linear():
    plain = AlgebraicSaturation(a_d0=20.0, a_q0=50.0)
    np.testing.assert_allclose(plain.current([0.5 + 0.1j, -0.2j]), [10 + 5j, -10j], atol=1e-12)
    saturated = AlgebraicSaturation(a_d0=20.0, a_q0=50.0, a_dd=3.0, a_qq=7.0, a_dq=11.0)
    d, q = 0.5, 0.3  # exponents 5, 1, 1, 0
    i_d = (20 + 3 * d**5 + 11 / 2 * d * q**2) * d
    i_q = (50 + 7 * q + 11 / 3 * d**3) * q
    np.testing.assert_allclose(saturated.current([d + 1j * q]), [i_d + 1j * i_q])
