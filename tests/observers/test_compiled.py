"""Common features of the compiled observers: batches, threads, states of bytes, records.

tests/contract checks what all observers have in common.
"""

import pickle
import threading

import numpy as np
import pytest

from fluxobs import AdaptiveObserver, LeastSquaresObserver, Record
from fluxobs.observers import outputs
from fluxobs.observers.adaptive import AdaptiveEstimate
from fluxobs.observers.base import Estimate
from support.records import CURRENTS, MACHINES, steady

H, ROWS = 1e-4, 1500
KINDS = {LeastSquaresObserver: Estimate, AdaptiveObserver: AdaptiveEstimate}
OBSERVERS = {
    f"{name}, {precision}{', adaptive' if kind is AdaptiveObserver else ''}": (
        name,
        kind.for_machine(MACHINES[name], sample_time=H, precision=precision),
    )
    for kind in KINDS
    for name in MACHINES
    for precision in ("double", "single")
}


@pytest.fixture(params=OBSERVERS)
def case(request):
    name, observer = OBSERVERS[request.param]
    samples = steady(MACHINES[name], H, 500.0, ROWS, CURRENTS[name], 0.1 + 0.05j, 0.2, noise=0.02)
    return observer, samples


def same(actual, expected, rows=slice(None)):
    assert type(actual) is type(expected)
    for field in outputs(type(actual)):
        a, b = getattr(actual, field.name), np.asarray(getattr(expected, field.name))[rows]
        np.testing.assert_array_equal(a, b, err_msg=field.name, strict=True)


def after(observer, samples, rows):
    return observer.resume(observer.init(), samples.voltage[:rows], samples.current[:rows])[0]


def test_batch_lane_is_run_bit_for_bit(case):
    observer, samples = case
    scales = np.array([1.0, 0.7, -1.0, 0.2, 1.3])
    voltage = scales[:, None, None] * samples.voltage
    current = scales[:, None, None] * samples.current
    for threads in (1, 3):
        batch = observer.run(voltage, current, threads=threads)
        assert batch.flux.shape == (5, ROWS, 2)
        for lane in range(5):
            same(observer.run(voltage[lane], current[lane]), batch, lane)


def test_pickled_observer_and_state_continue_alike(case):
    observer, samples = case
    state = after(observer, samples, 50)
    revived, saved = pickle.loads(pickle.dumps((observer, state)))
    assert saved == state
    moved, estimate = observer.step(state, samples.voltage[50], samples.current[50])
    repeated_state, repeated = revived.step(saved, samples.voltage[50], samples.current[50])
    assert moved == repeated_state
    same(estimate, repeated, ())


def test_states_are_read_only(case):
    observer, samples = case
    state = after(observer, samples, 50)
    with pytest.raises(ValueError, match="read-only"):
        state.raw[0] = 1


def test_record_and_arrays_agree(case):
    observer, samples = case
    gap = np.full((1, 2), np.nan)
    record = Record(H, np.concatenate([samples.voltage[1:], gap]), samples.current)
    first = samples.voltage.copy()
    first[0] = np.nan
    same(observer.run(record), observer.run(first, samples.current))


def test_batch_shapes_of_step(case):
    observer, samples = case
    state = observer.init((2, 3))
    both = np.broadcast_to(samples.current[0], (2, 3, 2))
    state, estimate = observer.step(state, np.zeros((2, 3, 2)), both)
    assert state.batch == (2, 3)
    assert estimate.flux.shape == (2, 3, 2)
    assert estimate.valid.shape == (2, 3)


def test_run_releases_the_gil():
    observer = OBSERVERS["servo-400w, double"][1]
    samples = steady(MACHINES["servo-400w"], H, 500.0, 300_000)
    done, ticks = threading.Event(), []

    def work():
        observer.run(samples.voltage, samples.current)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    while not done.wait(0.002):
        ticks.append(1)
    thread.join()
    assert len(ticks) > 3  # this thread ran while the other thread was inside run


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda o: o.run(np.zeros((5, 2))), TypeError, "current"),
        (lambda o: o.run(np.zeros((5, 3)), np.zeros((5, 3))), ValueError, "shape"),
        (lambda o: o.run(np.zeros((4, 2)), np.zeros((5, 2))), ValueError, "shape"),
        (lambda o: o.run(current=np.zeros((5, 2))), TypeError, "voltage or volt_seconds"),
        (lambda o: o.step(o.init(), [0, 0]), TypeError, "current is missing"),
        (lambda o: o.step(o.init(), [0, 0, 0], [0, 0]), ValueError, r"shape \(2,\)"),
        (
            lambda o: o.run(Record(2 * H, np.zeros((9, 2)), np.zeros((9, 2)))),
            ValueError,
            "sample time",
        ),
    ],
)
def test_unusable_calls_are_explained(call, error, message):
    with pytest.raises(error, match=message):
        call(OBSERVERS["servo-400w, double"][1])
