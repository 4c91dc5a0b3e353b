"""`check` and `estimate` on every usual mistake, with and without a true angle.

They report the mistake or say that the log cannot identify it; they report no other mistake.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

import fluxobs
from fluxobs import RecordError, estimate
from fluxobs.checking.search import check_log
from fluxobs.logs.for_machine import open_for
from fluxobs.machines import example
from support.records import COURSE_TIME, PMSM, course

pytestmark = pytest.mark.mistakes

ROWS = slice(1, -1)  # the first and last voltages are unknown
SAMPLES = course()
THETA = np.mod(SAMPLES.theta, 2 * np.pi)
LAYOUT = {"frame": "abc", "lag": -1}
AXES = np.exp(2j * np.pi / 3 * np.arange(3))


def _columns():
    """Return columns of three phases, with voltages that act one sample later."""
    u, i = (getattr(SAMPLES, name) @ [1, 1j] for name in ("voltage", "current"))
    u = np.concatenate([u[2:], u[-1:], u[-1:]])
    columns = {"t": np.arange(len(u)) * COURSE_TIME, "angle": THETA}
    for name, axis in zip("abc", AXES, strict=True):
        columns[f"u_{name}"], columns[f"i_{name}"] = (u * axis.conj()).real, (i * axis.conj()).real
    return {name: values[ROWS] for name, values in columns.items()}


GOOD = _columns()


def permuted(what, order):
    return {
        f"{w}_{new}": GOOD[f"{w}_{old}"]
        for w in what
        for new, old in zip("abc", order, strict=True)
    }


def phases(what, change):
    return {f"{what}_{p}": change(GOOD[f"{what}_{p}"]) for p in "abc"}


def dq(angle):
    """Return SAMPLES in rotor coordinates, with `angle` as the column of the rotor angle."""
    theta = SAMPLES.theta
    i = SAMPLES.current @ [1, 1j] * np.exp(-1j * theta)
    middle = np.concatenate([theta[:1], (theta[1:] + theta[:-1]) / 2])
    u = SAMPLES.voltage @ [1, 1j] * np.exp(-1j * middle)
    u = np.concatenate([u[1:], u[-1:]])
    columns = {"t": np.arange(len(u)) * COURSE_TIME, "angle": THETA, "theta_e": angle}
    columns |= {"u_d": u.real, "u_q": u.imag, "i_d": i.real, "i_q": i.imag}
    return {name: values[ROWS] for name, values in columns.items()}


def spiked():
    current = GOOD["i_a"].copy()
    current[250::500] += 200
    return {"i_a": current}


LINE = {
    "u_a": GOOD["u_a"] - GOOD["u_b"],
    "u_b": GOOD["u_b"] - GOOD["u_c"],
    "u_c": GOOD["u_c"] - GOOD["u_a"],
}
DUTY = {f"d_{p}": np.round((GOOD[f"u_{p}"] / 600 + 0.5) * 4096) for p in "abc"}
AS_ALPHABETA = {
    new: GOOD[old]
    for new, old in (("u_alpha", "u_a"), ("u_beta", "u_b"), ("i_alpha", "i_a"), ("i_beta", "i_b"))
} | {"t": GOOD["t"]}
ONLY_TRUTH = "Only a true angle"

#: Changed columns, machine, layout, expected text without a true angle, expected text with one.
#: None as the first text: no finding is expected. None as the second text: both texts are equal.
CASES = {
    "nothing": ({}, PMSM, {}, None, None),
    "current's phases shifted": (permuted("i", "bca"), PMSM, {}, r"shifted by one \(c a b\)", None),
    "both pairs exchanged": (permuted("iu", "acb"), PMSM, {}, ONLY_TRUTH, "turns against"),
    "lag 0": ({}, PMSM, {"lag": 0}, r"Fits equally well: .*-1", "with --lag -1"),
    "lag +1": ({}, PMSM, {"lag": 1}, r"Fits equally well: .*-1", "with --lag -1"),
    "psi_f x 7": ({}, PMSM.with_values(psi_f=7 * PMSM.psi_f), {}, r"psi_f .* 0\.545 Wb fits", None),
    "psi_f x 1000": ({}, PMSM.with_values(psi_f=545), {}, r"psi_f .* 0\.545 Wb fits", None),
    "psi_f / 10": ({}, PMSM.with_values(psi_f=0.0545), {}, r"psi_f .* 0\.545 Wb fits", None),
    "L in mH": ({}, PMSM.with_values(L_s=36), {}, r"inductances .* L_s = 0\.0[34]\d* H", None),
    "R_s x 2": (
        {},
        PMSM.with_values(R_s=7.2),
        {},
        r"R_s in the machine file .* 3\.[56]\d* Ω",
        None,
    ),
    "R_s / 2": (
        {},
        PMSM.with_values(R_s=1.8),
        {},
        r"R_s in the machine file .* 3\.[56]\d* Ω",
        None,
    ),
    "L x 2": ({}, PMSM.with_values(L_s=0.072), {}, r"inductances .* L_s = 0\.0[34]\d* H", None),
    "L / 2": ({}, PMSM.with_values(L_s=0.018), {}, r"inductances .* L_s = 0\.0[34]\d* H", None),
    "currents in mA": (
        *(phases("i", lambda x: 1000 * x), PMSM, {}),
        r"scale of the currents is wrong: multiply them by about 0\.00(1|099)",
        None,
    ),
    "line voltages": (LINE, PMSM, {}, "line to line", None),
    "poles for pairs": (
        *({"angle": np.unwrap(GOOD["angle"]) / 3}, PMSM.with_values(n_p=6), {"mech": True}),
        *(ONLY_TRUTH, "n_p is 6, but 3 would fit"),
    ),
    "zero off by 10": ({"angle": GOOD["angle"] + 0.175}, PMSM, {}, None, r"zero .* off by -9|-10"),
    "zero off by 40": ({"angle": GOOD["angle"] + 0.698}, PMSM, {}, None, r"zero .* off by -39|-40"),
    "truth in degrees": ({"angle": np.degrees(GOOD["angle"])}, PMSM, {}, None, None),
    "truth not in radians": (
        *({"angle": np.degrees(GOOD["angle"])}, PMSM, {"unit": {"theta_e": "rad"}}),
        *(None, "--unit theta_e=deg"),
    ),
    "i_a twice": ({"i_b": GOOD["i_a"]}, PMSM, {}, "i_a and i_b hold the same signal", None),
    "voltage is the current": (
        *(permuted("i", "abc") | {f"u_{p}": GOOD[f"i_{p}"] for p in "abc"}, PMSM, {}),
        *("u_a and i_a hold the same signal", None),
    ),
    "a reluctance machine": ({}, example("synrm-6kw7"), {}, "a machine with a magnet does", None),
    "angle in degrees": (
        *(dq(np.degrees(THETA)), PMSM, {"frame": "dq", "lag": 0, "unit": {"theta_e": "rad"}}),
        *("theta_e wraps at 360: it is probably not in radians", None),
    ),
    "dq as it should be": (dq(THETA), PMSM, {"frame": "dq", "lag": 0}, None, None),
    "duty in counts": (
        *(DUTY | {"udc": np.full(len(GOOD["t"]), 600.0)}, PMSM, {"frame": "duty"}),
        *("full scale is 4096", None),
    ),
    "raw counts": (
        *(phases("i", lambda x: np.round(2048 + 100 * x)), PMSM, {}),
        *("raw converter counts", None),
    ),
    "counts about zero": (
        *(phases("i", lambda x: np.round(100 * x)), PMSM, {}),
        *(r"scale of the currents is wrong: multiply them by about 0\.0(1|099)", None),
    ),
    "spikes": (spiked(), PMSM, {}, r"single rows .*i_a: 4\d", None),
    "frame forgotten": (AS_ALPHABETA, PMSM, {"frame": "alphabeta"}, r"\(--frame abc\)", None),
}


def case(name, with_truth):
    changed, machine, layout, without_truth, text_with_truth = CASES[name]
    layout = LAYOUT | layout
    channel = "theta_mech" if layout.pop("mech", False) else "theta_e"
    columns = GOOD | changed if layout["frame"] in ("abc", "duty") else {"angle": GOOD["angle"]}
    columns = columns | changed
    layout["truth"] = {channel: "angle"} if with_truth else {"none": "-"}
    message = text_with_truth if with_truth and text_with_truth is not None else without_truth
    return columns, machine, layout, message


def cases(quick):
    """Return (name, with_truth) for every case; slow cases are marked as slow."""
    return [
        pytest.param(
            name,
            with_truth,
            id=f"{name}-{'with' if with_truth else 'without'} truth",
            marks=() if quick(name, with_truth) else pytest.mark.slow,
        )
        for name in CASES
        for with_truth in (False, True)
    ]


#: Cases that differ from another one in the size of a factor only: they are slow.
ALIKE = ("psi_f x 1000", "psi_f / 10", "L in mH", "R_s / 2", "L / 2", "counts about zero", "lag +1")


# If a true angle does not change the text, only the case without a true angle is quick.
@pytest.mark.parametrize(
    ("name", "with_truth"),
    cases(
        lambda name, with_truth: (
            name not in ALIKE and (not with_truth or CASES[name][-1] is not None)
        )
    ),
)
def test_check(name, with_truth):
    columns, machine, layout, message = case(name, with_truth)
    found = check_log(open_for(columns, machine, **layout), machine)
    if message is None:
        assert found.sound, str(found)
        return
    assert re.search(message, str(found)), str(found)
    ambiguous = message == ONLY_TRUTH or message.startswith("Fits equally")
    assert found.sound == ambiguous, str(found)
    # Only the mistake of this case is reported.
    blamed = [str(finding) for finding in found.mistakes]
    assert all(re.search(message, text) for text in blamed[:1]), blamed


#: `estimate` runs the same search; a few cases check that it prints the findings.
QUICK = ("nothing", "both pairs exchanged", "lag 0", "truth not in radians")


@pytest.mark.parametrize(("name", "with_truth"), cases(lambda name, with_truth: name in QUICK))
def test_estimate(name, with_truth):
    columns, machine, layout, message = case(name, with_truth)
    try:
        text = str(estimate(columns, machine, **layout))
    except (RecordError, fluxobs.FluxobsError) as error:
        text = str(error)
    if message is None:
        assert "NOT as given" not in text
    elif message == ONLY_TRUTH or message.startswith("Fits equally"):
        assert "NOT as given" not in text
        assert "cannot be told" in text
    else:
        assert re.search(message, text), text
