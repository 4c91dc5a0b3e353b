"""Limits of a configuration, each tested from both sides, and the numbers that a step uses."""

import numpy as np
import pytest

from fluxobs import _core

#: All numbers that can be 1 are 1, so that a number in C equals the configuration's field.
UNIT = {
    **{name: np.zeros((2, 2)) for name in ("Q1", "Q2", "Q3", "R", "B")},
    "E": np.zeros(2),
    "C": np.zeros(2),
    **dict.fromkeys(("L_position", "kink_now", "kink_before", "length_min"), 0.0),
    **dict.fromkeys(("memory", "flux_base", "constraint_base", "constraint_noise"), 1.0),
    **dict.fromkeys(("current_noise", "current_limit", "drift_prior"), 1.0),
    "tracker_bandwidth": 1.0,
    "sample_time": 1e-3,
}


def element(name, row, column=None):
    """Return a function that changes one element of a matrix or vector."""

    def change(value):
        array = np.zeros_like(UNIT[name])
        array[row if column is None else (row, column)] = value
        return {name: array}

    return change


def number(name):
    return lambda value: {name: value}


def scaled_memory(value):
    """Return a memory, with sample time and drift prior in proportion."""
    return {"memory": value, "sample_time": value / 1e3, "drift_prior": 1 / value}


def short_memory(value):
    """Return a memory of 20 samples at a flux of 100 Wb."""
    common = {"flux_base": 100.0, "constraint_base": 1.0}
    return common | {"memory": value, "sample_time": value / 20, "drift_prior": 100 / value}


QUIET = {"current_noise": 1e-6}
BOTH = [(0, 0), (0, 1), (1, 0), (1, 1)]
DIAGONAL = [(0, 0), (1, 1)]
#: (change, other settings, lower limit, upper limit, field named in the error).
LIMITS = [
    *((element("Q1", i, i), {}, -500, 500, "Q1") for i in (0, 1)),  # it enters twice
    *((element("Q1", *at), {}, -1e3, 1e3, "Q1") for at in ((0, 1), (1, 0))),
    *((element("Q2", *at), QUIET, -1e9, 1e9, "Q2") for at in BOTH),
    *((element("Q3", *at), {}, -1e12, 1e12, "Q3") for at in DIAGONAL),
    *((element("Q3", *at), {}, -2e12, 2e12, "Q3") for at in ((0, 1), (1, 0))),
    *((element("R", *at), QUIET, None, 2.4e7, "R") for at in DIAGONAL),
    *((element("R", *at), QUIET, -2.4e7, 2.4e7, "R") for at in ((0, 1), (1, 0))),
    *((element("B", *at), {}, -1e15, 1e15, "B") for at in BOTH),
    *((element("E", i), {}, -1e3, 1e3, "E") for i in (0, 1)),
    *((element("C", i), {}, -1e12, 1e12, "C") for i in (0, 1)),
    (element("C", 1), {"current_limit": 10.0}, -1e11, 1e11, "C"),
    (element("Q2", 0, 1), QUIET | {"current_limit": 10.0}, -1e8, 1e8, "Q2"),
    (element("Q3", 0, 0), {"current_limit": 10.0}, -1e10, 1e10, "Q3"),
    (element("R", 0, 1), QUIET | {"current_limit": 10.0}, -2.4e6, 2.4e6, "R"),
    (number("memory"), {}, 9.99e-3, 1001, "memory"),
    (scaled_memory, {}, None, 1e12, "memory"),
    (short_memory, {}, 1e-10, None, "memory"),
    (number("current_limit"), {}, 1e-12, 1e12, "current_limit"),
    (number("drift_prior"), {}, 1e-6, 1e6, "drift_prior"),
    (number("constraint_noise"), {}, 1e-6, 1e3, "constraint_noise"),
    (number("kink_now"), {}, -1, 1, "kink_now"),
    (number("kink_before"), {}, -1, 1, "kink_before"),
    (number("L_position"), QUIET, -1e6, 1e6, "L_position"),
    (number("L_position"), QUIET | {"current_limit": 10.0}, -1e5, 1e5, "L_position"),
    (number("length_min"), {}, -1e3, 1e3, "length_min"),
    (number("current_noise"), {"L_position": 1.0}, None, 1e3, "current_noise"),
    (number("current_noise"), {"Q2": np.eye(2)}, None, 1e6, "current_noise"),
    (number("current_noise"), {"current_limit": 1e6}, 1e-6 / np.sqrt(40), None, "current_noise"),
]


@pytest.mark.parametrize(("change", "common", "lower", "upper", "field"), LIMITS)
def test_limits_from_both_sides(change, common, lower, upper, field):
    for limit, outwards in ((lower, -1.0), (upper, 1.0)):
        if limit is not None:
            step = outwards * 1e-6 * abs(limit)
            _core.Core(UNIT | common | change(limit - step), {})
            with pytest.raises(ValueError, match=f"^{field}: "):
                _core.Core(UNIT | common | change(limit + step), {})


@pytest.mark.parametrize("at", DIAGONAL)
def test_a_negative_resistance_is_refused(at):
    _core.Core(UNIT | element("R", *at)(0.0), {})
    with pytest.raises(ValueError, match=r"^R: "):
        _core.Core(UNIT | element("R", *at)(-1e-30), {})


@pytest.mark.parametrize("name", ["sample_time", "flux_base", "current_noise", "drift_prior"])
def test_zero_is_not_positive(name):
    with pytest.raises(ValueError, match=f"^{name}: "):
        _core.Core(UNIT | {name: 0.0}, {})


def test_the_numbers_of_a_step():
    """Per-unit numbers are calculated by hand; all fields differ, to reveal mix-ups."""
    config = UNIT | {
        "flux_base": 2.0, "memory": 0.5, "sample_time": 1e-3, "drift_prior": 12.0,
        "constraint_base": 8.0, "constraint_noise": 0.4, "current_noise": 0.05,
        "length_min": 0.5, "L_position": 0.6, "current_limit": 7.0,
        "kink_now": 0.25, "kink_before": -0.125, "tracker_bandwidth": 1000.0,
        "Q1": np.array([[3.0, 1.0], [2.0, 5.0]]), "Q2": np.array([[0.2, 0.4], [0.6, 0.8]]),
        "Q3": np.array([[0.4, 0.2], [0.6, 0.8]]), "E": np.array([4.0, 8.0]),
        "C": np.array([2.0, 6.0]), "R": np.array([[48.0, 96.0], [24.0, 16.0]]),
        "B": np.array([[10.0, 20.0], [30.0, 40.0]]),
    }  # fmt: skip
    parameters = _core.Core(config, {}).parameters()
    expected = {
        "Q1x2": [[3.0, 1.5], [1.5, 5.0]],  # the symmetric part, times 2 * 2^2 / 8
        "row_Q2": [[1.0, 2.0], [3.0, 4.0]],
        "row_Q3": [[1.0, 1.0], [1.0, 2.0]],
        "hR": [[1e-3, 2e-3], [0.5e-3, 1e-3 / 3]],
        "hB": [[5e-3, 10e-3], [15e-3, 20e-3]],
        "E": [1.0, 2.0],
        "row_C": [5.0, 15.0],
        "row_s": 20.0,
        "h": 2e-3,
        "rho": 0.998,
        "kink_now": 0.25,
        "kink_before": -0.125,
        "noise_information": 0.0375,  # (1 + 4 + 9 + 16) / 2 * 0.05^2
        "drift_prior_std": 3.0,
        "drift_base": 4.0,
        "reinject": 1 - 0.998**14,
        "over_noise": 10.0,
        "square_min": 0.0625,
        "L_position": 0.3,
        # 0.6^2 and a walk of (32 Ohm)^2 * 1 ms * 0.5 s / 4, times 0.05^2 / 2^2
        "position_noise": (0.36 + 0.128) * 0.000625,
        # a pole of 1 / (1 + 1 + 1/2)
        "track": [1 - 0.064, 1.5 * 0.36 * 1.4 / 1e-3, 0.216 / 1e-6],
        "sample_time": 1e-3,
        "current_limit": 7.0,
        "flux_base": 2.0,
    }
    assert parameters.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(parameters[name], value, rtol=1e-13, err_msg=name)
