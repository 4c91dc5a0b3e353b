"""All texts of results are compared word by word: summary, warnings, facts, report, picture."""

import numpy as np
import pytest

import fluxobs
from fluxobs.machines import example
from fluxobs.presentation.report import _texts
from fluxobs.simulation.closed_form.demo import LOG
from support.expected import check
from support.records import PMSM, SERVO, course, log_columns, steady

pytestmark = pytest.mark.mistakes

H = 1e-4


def with_truth():
    """Estimate a steady drive with a true angle in degrees, a few bad samples and a gap."""
    samples = steady(SERVO, H, 500.0, 3000, 6j, 0.15 - 0.1j, -0.1 + 0.05j, 0.02)
    columns = log_columns(samples) | {"angle": np.degrees(samples.theta)}
    columns["i_alpha"][1000:1004] = np.nan
    columns["u_beta"][1500] = np.nan
    columns = {name: np.delete(values, range(2000, 2040)) for name, values in columns.items()}
    return fluxobs.estimate(
        columns, SERVO, unknowns="drift", truth={"theta_e": "angle"}, unit={"theta_e": "deg"}
    )


def plain_with_wrong_values():
    columns = log_columns(course(R_s=1.3 * PMSM.R_s, inverter=6.0, smoothing=0.2))
    return fluxobs.estimate(columns, PMSM, unknowns="drift")


def learnt():
    columns = log_columns(course(R_s=1.3 * PMSM.R_s, inverter=6.0, smoothing=0.2))
    return fluxobs.estimate(columns, PMSM)


def causal():
    return fluxobs.estimate(LOG, "servo-400w", causal=True)


def encoder():
    table = np.genfromtxt(LOG, delimiter=",", names=True)
    theta, t = np.unwrap(table["theta_e"]), table["t"]
    shaft = np.interp(t - 6e-5, t, theta) / 4
    columns = {name: table[name] for name in ("t", "u_alpha", "u_beta", "i_alpha", "i_beta")}
    columns["angle"] = np.mod(0.3 + 0.02 * np.cos(shaft + 1.0) - shaft, 2 * np.pi)
    return fluxobs.estimate(columns, "servo-400w", truth={"theta_mech": "angle"})


def too_short():
    columns = log_columns(steady(SERVO, H, 500.0, 60, 6j, noise=0.02))
    return fluxobs.estimate(columns, SERVO)


def a_reluctance_machine():
    speed = 300 + 100 * np.sin(np.arange(4000) / 300)
    machine = example("synrm-6kw7")
    samples = steady(machine, H, speed, 4000, 9 + 9j, current_bias=0.3, noise=0.02)
    return fluxobs.estimate(log_columns(samples), machine, unknowns="drift,current-bias")


def a_levitation():
    """Estimate a swinging magnet and fluxes; a row's voltage is the mean of the next interval."""
    machine, t = example("maglev-knospe"), 2e-3 * np.arange(3001)
    y = 1e-4 * np.sin(12 * t)
    flux = 2e-5 * np.stack([1 + 0.3 * np.sin(20 * t), 1 + 0.2 * np.cos(27 * t)], axis=1)
    gaps = np.stack([(machine.g - y) / machine.k_1, (machine.g + y) / machine.k_2], axis=1)
    current = flux * gaps
    mean = (current[1:] + current[:-1]) / 2
    voltage = machine.N * np.diff(flux, axis=0) / 2e-3 + machine.resistance * mean
    measured = current[:-1] + 1e-4 * np.random.default_rng(1).standard_normal((3000, 2))
    columns = {"t": t[:-1], "y": y[:-1]}
    columns |= {
        f"{symbol}_{port + 1}": values[:, port]
        for symbol, values in (("u", voltage), ("i", measured))
        for port in (0, 1)
    }
    return fluxobs.estimate(columns, "maglev-knospe", truth={"position": "y"})


RESULTS = (
    *(with_truth, plain_with_wrong_values, learnt, causal, encoder, too_short),
    *(a_reluctance_machine, a_levitation),
)


@pytest.mark.parametrize("make", RESULTS, ids=lambda make: make.__name__)
def test_texts_of_a_result(make):
    result = make()
    texts = _texts(result, "fluxobs estimate log.csv --machine motor.toml")
    facts = {name: value for name, value in result.facts.items() if name != "log"}
    contents = {"words": texts, "facts": facts, "picture": result.plot()}
    check(f"estimation/{make.__name__}", contents)


def test_a_picture_for_a_paper():
    check("estimation/two_columns", learnt().plot("two columns", ["locus", "error", "resistance"]))
