"""The JAX twin of the production observer gives the C core's numbers."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fluxobs import LeastSquaresObserver
from fluxobs.simulation.drive.twin import SquareRootLeastSquares, wrap
from support.records import CURRENTS, MACHINES, steady

TOLERANCE = 1e-10
MOST_ROWS = 6000


def run_twin(compiled, voltage, current):
    """Runs more rows than there are, so that all records are compiled for once; returns these."""
    rows = len(current)
    more = ((0, MOST_ROWS - rows), (0, 0))
    found = SquareRootLeastSquares.of(compiled).run(
        np.pad(voltage, more, "edge"), np.pad(current, more, "edge")
    )
    return replace(found, **{name: part[:rows] for name, part in vars(found).items()})


def agree(compiled, voltage, current):
    """Largest difference of any output, relative to its size, and the C core's estimate."""
    ours = compiled.run(voltage, current)
    twin = run_twin(compiled, voltage, current)
    scale = {
        "flux": compiled.flux_base,
        "psi_f": compiled.flux_base,
        "theta_e": 1.0,
        "theta_e_tracked": 1.0,
        "speed_e": np.abs(ours.speed_e).max() + 1.0,
        "drift": np.abs(ours.drift).max() + 1e-9,
        "theta_e_std": 1.0,
        "innovation": np.abs(ours.innovation).max() + 1e-9,
        "noise_share": max(1.0, np.abs(ours.noise_share).max()),
    }
    for name, size in scale.items():
        difference = getattr(twin, name) - getattr(ours, name)
        if name.startswith("theta_e") and not name.endswith("std"):
            difference = wrap(difference)
        assert np.abs(difference).max() < TOLERANCE * size, name
    assert (twin.valid == ours.valid).all()
    return ours


def observer(machine, h, noise=0.003, **options):
    sigma = max(noise, 1e-3) * machine.rated_current
    return LeastSquaresObserver.for_machine(machine, sample_time=h, current_noise=sigma, **options)


def record(machine, name, speed, rows=3000, bias=0.02, noise=0.003, h=1e-4):
    rated = machine.rated_current
    return steady(
        machine,
        h,
        speed,
        rows,
        i_dq=CURRENTS[name],
        current_bias=bias * rated * (0.6 + 0.8j),
        voltage_bias=bias * 20 * machine.R_s * (0.8 - 0.6j),
        noise=noise * rated,
    )


@pytest.mark.parametrize("name", MACHINES)
def test_a_whole_record_with_biases_and_noise(name):
    machine = MACHINES[name]
    data = record(machine, name, 500.0)
    found = agree(observer(machine, data.sample_time), data.voltage, data.current)
    assert found.valid.any()


def test_through_a_stop_and_a_reversal_carried_by_integration():
    machine = MACHINES["servo-400w"]
    rows = 6000
    knots = np.array([0, 1000, 1500, 3500, 4000, 6000])
    speed = np.interp(np.arange(rows), knots, [500.0, 500.0, 0.0, 0.0, -500.0, -500.0])
    data = record(machine, "servo-400w", speed, rows)
    found = agree(observer(machine, data.sample_time), data.voltage, data.current)
    assert not found.valid[2500:3500].any()
    assert found.valid[-1]


@pytest.mark.parametrize(
    ("spoil", "restarts"),
    [
        (lambda u, i: i.__setitem__((700, 1), np.nan), 0),
        (lambda u, i: i.__setitem__(slice(700, 708), np.nan), 1),
        (lambda u, i: u.__setitem__(slice(700, 703), np.nan), 0),
        (lambda u, i: u.__setitem__(slice(700, 709), np.inf), 1),
        (lambda u, i: i.__setitem__((700, 0), 1e6), 1),
        (lambda u, i: i.__setitem__((700, 0), 60.0), 0),
        (lambda u, i: u.__setitem__((700, 0), 500.0), None),
        (
            lambda u, i: (i.__setitem__(slice(0, 5), np.nan), u.__setitem__(slice(0, 9), np.nan)),
            None,
        ),
    ],
    ids=["hole", "gap", "voltage hole", "voltage gap", "absurd", "spike", "voltage spike", "late"],
)
def test_bad_samples(spoil, restarts):
    machine = MACHINES["servo-400w"]
    data = record(machine, "servo-400w", 500.0, 1500)
    u, i = data.voltage.copy(), data.current.copy()
    spoil(u, i)
    compiled = observer(machine, data.sample_time)
    found = agree(compiled, u, i)
    assert found.valid[-1]
    if restarts is not None:
        state, _ = compiled.resume(compiled.init(), u, i)
        assert compiled.counts(state).restarts == restarts


def test_a_prior_that_proves_too_tight_is_widened_alike():
    machine = MACHINES["servo-400w"]
    data = record(machine, "servo-400w", 500.0, 4000)
    compiled = observer(machine, data.sample_time)
    tight = replace(compiled, drift_prior=compiled.drift_prior / 300)
    found = agree(tight, data.voltage, data.current)
    assert np.abs(found.drift[-1] - data.drift).max() < 0.05


def test_volt_seconds_that_are_known():
    machine = MACHINES["servo-400w"]
    data = record(machine, "servo-400w", 500.0, 500)
    compiled = observer(machine, data.sample_time)
    twin = SquareRootLeastSquares.of(compiled)
    ours = compiled.run(volt_seconds=data.volt_seconds, current=data.current)

    def body(state, row):
        return twin.step_volt_seconds(state, *row)

    rows = (jnp.asarray(data.volt_seconds), jnp.asarray(data.current))
    found = jax.jit(lambda rows: jax.lax.scan(body, twin.init(), rows)[1])(rows)
    assert np.abs(np.asarray(found.flux) - ours.flux).max() < TOLERANCE * compiled.flux_base


def test_states_stay_finite_whatever_comes():
    machine = MACHINES["servo-400w"]
    rng = np.random.default_rng(5)
    bad = np.array([np.nan, np.inf, -np.inf, 1e300, 0.0])
    u, i = rng.choice(bad, (2, 1000, 2))
    u[::3], i[::2] = rng.standard_normal((334, 2)), rng.standard_normal((500, 2))
    found = run_twin(observer(machine, 1e-4), u, i)
    for name in ("flux", "theta_e", "theta_e_tracked", "speed_e", "drift", "theta_e_std"):
        assert np.isfinite(getattr(found, name)).all(), name
