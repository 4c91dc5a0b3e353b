"""A log with every n-th current: what it keeps, and what learning begins with."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import numpy as np
import pytest

from engine.estimates import degrees, estimate, file_of
from engine.likelihood import COURSE, Array, Complex, Log, address, library, log_of, pointer
from engine.loop import SURFACE, simulated

H = 1e-4


class Thinned(ctypes.Structure):
    """A thinned log; see engine/thinning.h."""

    _fields_ = (
        ("log", Log),
        ("factor", ctypes.c_size_t),
        ("shift", ctypes.c_long),
        ("values", ctypes.c_void_p),
    )


def numbers(values: object, rows: int) -> Complex:
    """Return the vectors that a log points at."""
    pairs = np.ctypeslib.as_array(values, (rows, 2)).copy()
    return pairs @ [1, 1j]


def thinned(
    voltage: Complex, current: Complex, factor: int, lag: float = 0.0
) -> tuple[Complex, Complex, Log]:
    """Return voltages and currents of the thinned log, and the log without them."""
    out = Thinned()
    with log_of(voltage, current, H) as log:
        done = library().fo_thin(
            ctypes.byref(log), ctypes.c_size_t(factor), ctypes.c_double(lag), ctypes.byref(out)
        )
    assert done
    rows = out.log.rows
    u, i = numbers(out.log.voltage, rows), numbers(out.log.current, rows)
    library().fo_free_thinned(ctypes.byref(out))
    return u, i, out.log


def vectors(rows: int) -> tuple[Complex, Complex]:
    rng = np.random.default_rng(0)
    u, i = rng.normal(size=(2, rows, 2)) @ np.array([1, 1j])
    return u, i


def test_currents_are_those_of_the_log_and_voltages_their_means():
    u, i = vectors(12)
    voltage, current, log = thinned(u, i, 4)
    assert (current == i[::4]).all()
    assert voltage == pytest.approx(u.reshape(3, 4).mean(axis=1))
    assert log.sample_time == pytest.approx(4 * H)
    assert log.periods == 4


def test_late_voltages_are_shifted():
    u, i = vectors(12)
    voltage, _, _ = thinned(u, i, 4, lag=1.2)
    assert voltage[1:] == pytest.approx(u[3:11].reshape(2, 4).mean(axis=1))


def test_a_mean_without_one_of_its_voltages_is_unknown():
    u, i = vectors(12)
    u[5] = np.nan
    voltage, _, _ = thinned(u, i, 4)
    assert np.isfinite(voltage).tolist() == [True, False, True]


def test_the_course_between_thinned_rows_is_smooth():
    """A cubic through four rows that turn by 0.2 rad each; a line continues it at the ends."""
    at = np.arange(81)
    angle, flux = 0.05 * at + 1e-4 * at**2, 0.01 * np.exp(1j * (0.05 * at + 0.3))
    coarse, fine = np.zeros(21, COURSE), np.zeros(81, COURSE)
    coarse["angle"], coarse["flux"] = angle[::4], np.stack([flux.real, flux.imag], axis=1)[::4]
    library().fo_fill(
        address(coarse), ctypes.c_size_t(21), ctypes.c_size_t(4), address(fine), ctypes.c_size_t(81)
    )
    assert fine["angle"][:77] == pytest.approx(angle[:77], abs=3e-4)
    assert fine["angle"][4:77] == pytest.approx(angle[4:77], abs=1e-9)
    assert fine["flux"][:77] @ [1, 1j] == pytest.approx(flux[:77], abs=3e-6)


@pytest.mark.parametrize(
    ("speed", "decay", "factor"),
    [(10.0, 10.0, 4), (4000.0, 10.0, 2), (10.0, 8000.0, 1), (11000.0, 1.0, 1)],
)
def test_a_row_turns_and_decays_by_less_than_one(speed: float, decay: float, factor: int):
    u, i = vectors(6000)
    angle: Array = speed * H * np.arange(6000)
    code = library()
    code.fo_thinning.restype = ctypes.c_size_t
    with log_of(u, i, H) as log:
        assert code.fo_thinning(ctypes.byref(log), pointer(angle), ctypes.c_double(decay)) == factor


def test_a_lag_that_the_log_does_not_state_is_learnt():
    """The voltages act one sample late; the log says 0 ± 0.1. The prior has heavy tails."""
    record = simulated(replace(SURFACE, duration=0.4, lag=1, bandwidth=0.2), 1, seed=5)
    file = file_of(0.4, 5.5e-4, 5.5e-4, 0.0115, 12.0, lag=(0.0, 0.1))
    e = estimate(record.voltage[:, 0], record.current[:, 0], H, file, record.angle[:, 0] + 0.05)
    assert abs(e.value("lag") - 1.0) < 0.1
    error = degrees(e.rows["angle"], record.angle[:, 0])
    assert np.sqrt(np.mean(error**2)) < 0.5
