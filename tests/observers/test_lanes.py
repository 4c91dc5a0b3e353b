"""Each record gives the same bits in a batch as alone."""

import numpy as np
import pytest

from fluxobs import _core, _core_single
from fluxobs.machines import example
from fluxobs.observers import LeastSquaresObserver
from fluxobs.simulation.closed_form.signals import driven, vectors

H, ROWS = 1e-4, 3000
FIELDS = ("flux", "psi_f", "theta_e", "theta_e_tracked", "speed_e", "drift", "theta_e_std")
FIELDS += ("valid", "innovation", "noise_share")
#: Share of bad samples.
BAD = 0.002


def batch(machine, lanes, bad, seed):
    """Return records that start at any angle, run up, stop and reverse.

    With `bad`, some samples are missing, implausible or contradictory.
    """
    rng = np.random.default_rng(seed)
    rows = np.arange(ROWS * 4 + 1) / 4
    rated, top = machine.rated_current, 0.2 * 2 * np.pi / (20 * H)
    along = machine.magnetizing_current or (0.0 if machine.magnets else 0.5 * rated)
    voltages, currents = [], []
    for lane in range(lanes):
        shift = 100 * (lane % 5)
        row_of_step = (
            np.array([0, 200, 500, 1500, 1600, 1900, 2100, 2999])
            + np.array([0, 1, 1, 1, 1, 1, 1, 0]) * shift
        )
        speed = np.interp(rows, row_of_step, top * np.array([0, 0, 1, 1, 0, 0, -0.7, -0.7]))
        load = 0.4 * rated * np.interp(rows, (800, 900), (0.1, 1.0))
        truth = driven(machine, H, speed, along + 1j * load, 4, rng.uniform(-3, 3))
        i = vectors(truth.current[1:]) + 0.002 * rated * rng.standard_normal((ROWS, 2))
        u = vectors(truth.voltage) + np.array([0.02, -0.01]) * machine.R_s * rated
        u[0] = np.nan
        if bad:
            fault = rng.uniform(size=ROWS) / BAD
            u[(fault > 0) & (fault < 0.2)] = np.nan
            i[(fault > 0.2) & (fault < 0.4)] = np.nan
            i[(fault > 0.4) & (fault < 0.6)] *= -1.5
            i[(fault > 0.6) & (fault < 0.7)] = 1e9
            u[(fault > 0.7) & (fault < 0.8)] = np.inf
            u[(fault > 0.8) & (fault < 0.9), 0] = -1e300
            u[(fault > 0.9) & (fault < 1.0)] = 1e4
        voltages.append(u)
        currents.append(i + 0.01 * rated)
    return np.array(voltages), np.array(currents)


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("name", ["servo-400w", "drone-900kv", "pmsm-2kw2", "synrm-6kw7"])
@pytest.mark.parametrize("bad", [False, True], ids=["good", "spoilt"])
def test_a_record_has_the_same_bits_alone(name, precision, bad):
    lanes = (_core_single if precision == "single" else _core).lanes
    observer = LeastSquaresObserver.for_machine(
        example(name), sample_time=H, precision=precision, held=name == "drone-900kv"
    )
    u, i = batch(example(name), 2 * lanes + 1, bad, seed=3)
    half = ROWS // 2 - 1
    state, first_half = observer.resume(
        observer.init(len(u.shape[:1]) * (len(u),)), u[:, :half], i[:, :half]
    )
    last_state, second_half = observer.resume(state, u[:, half:], i[:, half:])
    for lane in range(len(u)):
        alone_state, alone = observer.resume(observer.init(), u[lane], i[lane])
        for field in FIELDS:
            together = np.concatenate(
                [getattr(first_half, field)[lane], getattr(second_half, field)[lane]]
            )
            np.testing.assert_array_equal(together, getattr(alone, field), err_msg=field)
        assert np.array_equal(last_state.raw[lane], alone_state.raw[0]), "another state"
    assert np.concatenate([first_half.valid, second_half.valid], axis=1).mean() > 0.2
    if bad:
        counts = [observer.counts(last_state, lane) for lane in range(len(u))]
        assert sum(count.restarts for count in counts) > 0
        assert sum(count.outliers for count in counts) > 0


def test_a_diverged_lane_restarts_as_alone():
    """After a long rest in noise, the least squares has no information left."""
    observer = LeastSquaresObserver.for_machine(example("servo-400w"), sample_time=H, memory=20 * H)
    rng = np.random.default_rng(5)
    i = 0.5 * rng.standard_normal((2 * _core.lanes, 20_000, 2))
    u = 2.0 * rng.standard_normal(i.shape)
    batch_estimate = observer.run(u, i)
    for lane in (0, 3, len(i) - 1):
        alone = observer.run(u[lane], i[lane])
        for field in FIELDS:
            np.testing.assert_array_equal(
                getattr(batch_estimate, field)[lane], getattr(alone, field)
            )
