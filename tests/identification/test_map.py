"""identify --free map: saturation of a machine, from a log without a position."""

from __future__ import annotations

import numpy as np
import pytest

import fluxobs
from fluxobs import FluxobsError
from fluxobs.machines import AlgebraicSaturation, SynchronousReluctance, read_machine
from fluxobs.simulation.closed_form.signals import between_rows, driven_cage, vectors
from observers.test_cage import BIAS, CONSTANT, MACHINE, RAMPS, VOLTAGE_BIAS, H
from observers.test_maps import MODEL, reluctance_record
from support.identified import check_identification
from support.records import log_columns, profile, white


class Exact(SynchronousReluctance):
    """The reluctance machine with an exact map instead of splines."""

    def flux_dq(self, current):
        return MODEL.flux(current)


GIVEN = {"n_p": 2, "rated_current": 22.0, "L_d": 0.047, "L_q": 0.0085}
TRUE = Exact(R_s=0.63, **GIVEN)
START = SynchronousReluctance(R_s=0.69, inverter_voltage=0.0, inverter_voltage_std=0.01, **GIVEN)


@pytest.fixture(scope="module")
def log():
    columns = log_columns(reluctance_record(machine=TRUE))
    return {name: np.asarray(column) for name, column in columns.items()}


@pytest.fixture(scope="module")
def identified(log):
    return fluxobs.identify(log, START, free="R_s,map")


def test_fluxes_in_the_visited_region_and_their_standard_deviations(identified):
    """Errors are below 3 % of the flux, and 95 % of them within three standard deviations."""
    assert identified.segment_fit.after.converged
    assert identified.machine.R_s == pytest.approx(0.63, rel=0.005)
    currents = (identified.map.visited[:, None] * np.array([0.9, 0.95, 1.0])).ravel()
    currents = currents[identified.map.inside(currents)]
    assert len(currents) > 10
    error, std = (
        identified.map.flux(currents) - MODEL.flux(currents),
        identified.map.flux_std(currents),
    )
    assert np.abs(error).max() < 0.03 * np.abs(MODEL.flux(currents)).max()
    assert np.mean(np.abs(error.real) < 3 * std.real) > 0.95
    assert np.mean(np.abs(error.imag) < 3 * std.imag) > 0.95
    assert std.real.max() < 0.05
    assert identified.map.inside(10 + 5j)
    assert not identified.map.inside(20 + 5j)


def test_the_output_of_a_map(identified, tmp_path):
    check_identification("how_it_saturates", identified, tmp_path)


@pytest.mark.slow
def test_the_machine_file_and_the_table_can_be_used(identified, log, tmp_path):
    identified.write(tmp_path / "found.toml")
    identified.write(tmp_path / "map.csv")
    identified.write(tmp_path / "map.png")
    by_model = read_machine(tmp_path / "found.toml")
    assert isinstance(by_model.flux_map, AlgebraicSaturation)
    (tmp_path / "table.toml").write_text(
        'kind = "synchronous-reluctance"\nR_s = 0.63\nn_p = 2\nrated_current = 22.0\n'
        'flux_map = "map.csv"\n'
    )
    by_table = read_machine(tmp_path / "table.toml")
    i = np.array([10 + 5j, 11 + 15j])
    np.testing.assert_allclose(by_model.flux_dq(i), identified.map.flux(i), atol=1e-3)
    np.testing.assert_allclose(by_table.flux_dq(i), identified.map.flux(i), atol=1e-3)
    log = log | {"theta_e": reluctance_record(machine=TRUE).theta}
    result = fluxobs.estimate(log, by_model, unknowns="drift")
    assert not result.warnings
    check = fluxobs.check(log, by_model)
    assert not check.mistakes


def test_the_report_names_the_visited_region_and_missing_saturation(identified):
    text = str(identified)
    assert "Visited: i_d from 7." in text
    assert "i_d hardly changes in this log: the saturation of psi_d cannot be identified" in text
    assert "a_qq = " in text


@pytest.mark.slow
def test_an_unknown_inverter_increases_the_standard_deviations(log):
    machine = START.with_values(inverter_voltage=None, inverter_voltage_std=1.0)
    first_half = {name: values[: len(values) // 2] for name, values in log.items()}
    identified = fluxobs.identify(first_half, machine, free="R_s,map")
    std, own = identified.map.flux_std(10 + 10j), identified.map.flux_std(10 + 10j, own=True)
    assert std.imag > 1.5 * own.imag
    assert "inverter_voltage_std" in str(identified)


def test_with_a_map_resistance_is_free_but_inductances_are_not(log):
    machine = START.with_values(flux_map=MODEL, L_d=None, L_q=None)
    identified = fluxobs.identify(log, machine, free="R_s")
    assert identified.machine.R_s == pytest.approx(0.63, rel=0.01)
    with pytest.raises(FluxobsError, match="has no 'L_d'"):
        fluxobs.identify(log, machine, free="R_s,L_d")
    with pytest.raises(FluxobsError, match="map already contains the inductances"):
        fluxobs.identify(log, START, free="L_d,map")
    with pytest.raises(FluxobsError, match="has no 'map'"):
        fluxobs.identify(log, MACHINE, free="map")


def cage_log(psi):
    speed = profile((0, 60), (0.4, 310), (1.8, 310), (2.2, -200), (2.4, -200))
    i_q = profile((0, 2), (0.6, 2), (0.602, 5), (1.3, 5), (1.31, 1), (1.9, 4), (2.4, 4))
    true, mechanical = driven_cage(
        MACHINE, H, *(between_rows(x, 16) for x in (speed, psi, i_q)), 16
    )
    current = true.current[:-1] + BIAS + 0.02 * white(len(true.voltage), 0)
    voltage, i = vectors(true.voltage + VOLTAGE_BIAS), vectors(current)
    log = {
        "t": H * np.arange(len(i)),
        "u_alpha": voltage[:, 0],
        "u_beta": voltage[:, 1],
        "i_alpha": i[:, 0],
        "i_beta": i[:, 1],
        "theta_e": true.theta_e[:-1],
    }
    return log, mechanical[:-1]


def test_an_induction_machine_with_every_function(tmp_path):
    log, mechanical = cage_log(CONSTANT)
    result = fluxobs.estimate(log, "induction-2kw2")
    assert not result.warnings
    assert "rotor flux" in result.summary
    valid = result["valid"]
    error = (result["speed_mech"] - mechanical[-len(valid) :])[valid]
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert {"slip_e", "speed_mech_std", "torque"} < set(result.estimates.columns)
    assert not fluxobs.check(log, "induction-2kw2").mistakes
    identified = fluxobs.identify(log, MACHINE.with_values(R_s=4.4, inverter_voltage_std=0.01))
    values = {p.name: p for p in identified.parameters}
    assert values["psi_R"].value == pytest.approx(0.9, rel=0.02)
    assert values["R_s"].value == pytest.approx(3.7, rel=0.03)


def test_a_changing_rotor_flux_is_no_mistake():
    log, _ = cage_log(RAMPS)
    assert not fluxobs.check(log, "induction-2kw2").mistakes
