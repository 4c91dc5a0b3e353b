"""Complete output of identifications: values, deviations, lines, tables, pictures."""

import pytest

import fluxobs
from fluxobs.machines import example
from fluxobs.simulation.closed_form.demo import LOG
from observers.test_cage import MACHINE, RAMPS, H, record
from support.identified import check_identification
from support.records import COURSE_TIME, PMSM, course, driven, log_columns, profile


def by_default():
    return fluxobs.identify(LOG, "servo-400w")


def all_but_the_map():
    samples = course(R_s=1.3 * PMSM.R_s, psi_f=0.9 * PMSM.psi_f, inverter=4.0, smoothing=0.2)
    free = ("R_s", "L_s", "psi_f", "inverter", "lag")
    return fluxobs.identify(log_columns(samples), PMSM, free=free)


def a_salient_machine():
    machine = example("ipm-2kw2")
    speed = profile((0, 0), (0.3, 200), (0.9, 200), (1.2, -200), (1.6, -200))
    load = profile(
        (0, 1), (0.5, 1), (0.51, 5), (0.8, 5), (0.81, 2), (1.3, 2), (1.31, -4), (1.6, -4)
    )
    true = {"R_s": 1.1 * machine.R_s, "inverter": 2.0, "smoothing": 0.2, "noise": 0.02}
    samples = driven(machine, COURSE_TIME, speed, -1.0 + 1j * load, **true)
    return fluxobs.identify(log_columns(samples), machine, free="R_s,psi_f,inverter")


def a_rotor():
    voltage, current, _, _ = record(RAMPS)
    log = fluxobs.read_log((voltage, current), sample_time=H, lag=1.0)
    return fluxobs.identify(log, MACHINE.scaled(["R_R"], 1.5), free="R_s,R_R")


IDENTIFICATIONS = (by_default, all_but_the_map, a_salient_machine, a_rotor)


@pytest.mark.parametrize("make", IDENTIFICATIONS, ids=lambda make: make.__name__)
def test_output_of_an_identification(make, tmp_path):
    check_identification(make.__name__, make(), tmp_path)
