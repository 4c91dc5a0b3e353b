"""Machines that saturate, that have no magnets, and with a cage."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
import pytest

from engine.estimates import changed, degrees, estimate
from engine.likelihood import INDEX, N, Start, course_of, library, settled
from engine.likelihood import Machine as EngineMachine
from engine.machines import flux_map, machine_file
from engine.voltage_fed import Cage, H, Mapped, Run, run
from fluxobs import InductionMachine, SynchronousReluctance
from fluxobs.inference.posterior import Posterior
from fluxobs.machines import example

ROWS = 4000
NOISE = 0.02
SATURATED = example("synrm-6kw7-saturated")
MAP = flux_map(SATURATED, H)


class At(ctypes.Structure):
    """fo_mapped; see firmware/fluxobs_map.h."""

    _fields_ = (
        *((name, ctypes.c_double * 2) for name in ("flux", "by_d", "by_q", "auxiliary")),
        ("outside", ctypes.c_bool),
    )


CAGE = Cage(R=3.7, L_sigma=0.021, R_R=2.1, L_M=0.224)


def speeds(rows: int = ROWS) -> np.ndarray:
    """Return speeds from 80 to 140 rad/s with a wave."""
    t = H * np.arange(rows)
    return 80 + 150 * t + 8 * np.sin(20 * t)


def loads(i_d: float, i_q: float, rows: int = ROWS) -> np.ndarray:
    """Return set points of the current with steps and ramps of i_q."""
    at = (0, 1000, 1010, 2000, 2500, 3000, 3010, 4000)
    share = np.interp(np.arange(rows), at, (0.4, 0.4, 1.0, 1.0, -0.5, -0.5, 0.6, 0.6))
    return i_d + 1j * i_q * share


def falling(i: complex) -> tuple[complex, complex, complex]:
    """Return the flux of a reluctance machine whose inductances fall with the current."""
    share, L_d, L_q, rated = (0.25, 0.1), 46e-3, 6.8e-3, 15.5
    d, q = (1 / (1 + s * abs(x) / rated) for s, x in zip(share, (i.real, i.imag), strict=True))
    return complex(L_d * i.real * d, L_q * i.imag * q), L_d * d * d + 0j, 1j * L_q * q * q


def tabled(i: complex) -> tuple[complex, complex, complex]:
    """Return the flux of the library's saturated machine."""
    out = At()
    library().fo_map_at_mapped(
        ctypes.byref(MAP),
        (ctypes.c_double * 2)(i.real, i.imag),
        ctypes.c_double(),
        ctypes.byref(out),
    )
    return complex(*out.flux), complex(*out.by_d), complex(*out.by_q)


MACHINES = {
    "falling": Mapped(0.54, falling, 46e-3 + 6.8e-3j),
    "table": Mapped(0.54, tabled, 46e-3 + 6.8e-3j),
}
#: ln of a scale of 8 %, which the file lacks.
WRONG = 0.08


@cache
def reluctance(kind: str) -> tuple[Run, Posterior]:
    """Return a run of a reluctance machine, and its estimate from a wrong file."""
    made = run(MACHINES[kind], speeds(), loads(8.0, 12.0), NOISE, seed=3)
    linear = SynchronousReluctance(R_s=0.6, L_d=42e-3, L_q=6.3e-3, n_p=2, rated_current=15.5)
    file = machine_file(linear if kind == "falling" else SATURATED, H, lag=(0.0, 0.3))
    if kind == "falling":
        file = changed(file, saturation_std=0.2)
    else:
        file = changed(file, L_d=np.exp(WRONG), L_q=np.exp(-WRONG))
    course = made.angle + 0.1 + 0.05 * np.sin(np.arange(ROWS) / 500)
    return made, estimate(made.voltage, made.current, H, file, course)


@pytest.mark.parametrize("kind", MACHINES)
def test_a_saturated_machine_without_magnets(kind):
    made, e = reluctance(kind)
    error = degrees(e.rows["angle"], made.angle)
    assert np.sqrt(np.mean(error**2)) < 0.2
    assert np.mean((error / np.degrees(e.rows["angle_std"])) ** 2) < 4
    true = {"resistance": np.log(0.54)}
    if kind == "falling":
        true |= {"saturation_d": 0.25, "saturation_q": 0.1}
        for axis, value in (("d", 46e-3), ("q", 6.8e-3)):  # at half the rated current
            true[f"L_{axis}"] = np.log(value / (1 + 0.5 * true[f"saturation_{axis}"]))
    else:
        true |= {"L_d": 0.0, "L_q": 0.0}
    for name, value in true.items():
        assert abs(e.value(name) - value) < 3.5 * e.std(name), name
        assert e.std(name) < 0.1, name


@cache
def cage() -> tuple[Run, Posterior]:
    """Return a run of a cage machine, and its estimate from a wrong file."""
    made = run(CAGE, speeds(), loads(3.5, 5.0), NOISE, seed=4)
    given = InductionMachine(
        R_s=4.2, R_R=2.6, L_sigma=0.019, L_M=0.25, n_p=2, rated_current=7.0, psi_R=0.8
    )
    file = machine_file(given, H, lag=(0.0, 0.3))
    return made, estimate(made.voltage, made.current, H, file, made.angle + 0.1)


def test_a_cage_machine():
    """Angle of the rotor flux and speed of the rotor, with the rotor resistance learnt."""
    made, e = cage()
    error = degrees(e.rows["angle"], made.angle)
    assert np.sqrt(np.mean(error**2)) < 0.3
    assert np.mean((error / np.degrees(e.rows["angle_std"])) ** 2) < 4
    wrong = e.rows["speed"][50:] - made.speed[50:]
    assert np.sqrt(np.mean(wrong**2)) < 2.0
    true = {"resistance": CAGE.R, "L_d": CAGE.L_sigma, "rotor_resistance": CAGE.R_R}
    for name, value in (true | {"magnetizing": CAGE.L_M}).items():
        assert abs(e.value(name) - np.log(value)) < 3.5 * e.std(name), name
        assert e.std(name) < 0.1, name


#: Drives whose scores are taken. Their mean is within 4.5 standard errors of zero for each of nine
#: parameters with a probability of 0.94 (Student's distribution, five degrees of freedom).
DRIVES, MOST = 6, 4.5


def test_score_of_a_cage_has_mean_zero_at_the_truth():
    """The rotor flux, the slip and their time in the interval are exact enough."""
    p = np.zeros(N)
    true = {"resistance": CAGE.R, "L_d": CAGE.L_sigma, "L_q": CAGE.L_sigma, "psi_f": 0.0}
    true |= {"rotor_resistance": CAGE.R_R, "magnetizing": CAGE.L_M, "noise": NOISE}
    true |= {"loss": 1e-6, "knee": 1.0, "voltage": 1e-4, "drift": 1e-3, "acceleration": 500.0}
    for name, value in true.items():
        p[INDEX[name]] = np.log(value) if value else -np.inf
    p[INDEX["colour_gain"]] = 1e-9  # not zero: the filter keeps the states of coloured noise
    psi, rows = CAGE.L_M * 3.5, 2500
    rng = np.random.default_rng(0)
    scores = []
    for seed in range(DRIVES):
        accelerations = np.cumsum(500 * np.sqrt(H) * rng.standard_normal(rows))
        made = run(CAGE, 100 + H * np.cumsum(accelerations), loads(3.5, 5.0, rows), NOISE, seed)
        course = course_of(made.current, made.angle, p)
        flux = CAGE.L_sigma * made.current + psi * np.exp(1j * made.angle)
        course["flux"], course["psi"] = np.stack([flux.real, flux.imag], axis=1), psi
        machine = EngineMachine(None, True, False, 7.0, 1e-6)
        start = Start(1.0, 1.8, 300.0, 0.3, 1e4, 5.0, 300)
        got, _ = settled(made.voltage, made.current, H, p, course, start, machine=machine)
        scores.append(got.score / np.sqrt(np.maximum(np.diag(got.information), 1e-30)))
    for name in (*true, "lag", "heat"):
        if name in ("L_q", "psi_f", "knee", "voltage", "drift"):
            continue
        own = np.array(scores)[:, INDEX[name]]
        assert abs(own.mean()) < MOST * own.std() / np.sqrt(DRIVES - 1), name
        assert own.std() < 2.5, name
