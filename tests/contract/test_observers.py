"""What every observer keeps, whatever is inside: add an observer to OBSERVERS and it is tested."""

import copy
import pickle
import threading

import numpy as np
import pytest

from fluxobs import LeastSquaresObserver, Record
from support.records import CURRENTS, MACHINES, steady

H, ROWS = 1e-4, 1500
FIELDS = (
    "flux",
    "psi_f",
    "theta_e",
    "theta_e_tracked",
    "speed_e",
    "drift",
    "theta_e_std",
    "valid",
    "innovation",
    "noise_share",
)
OBSERVERS = {
    f"{name}, {precision}": (
        name,
        LeastSquaresObserver.for_machine(MACHINES[name], sample_time=H, precision=precision),
    )
    for name in MACHINES
    for precision in ("double", "single")
}


@pytest.fixture(params=OBSERVERS)
def case(request):
    name, observer = OBSERVERS[request.param]
    samples = steady(MACHINES[name], H, 500.0, ROWS, CURRENTS[name], 0.1 + 0.05j, 0.2, noise=0.02)
    return observer, samples


def same(one, other, rows=slice(None)):
    for field in FIELDS:
        a, b = getattr(one, field), np.asarray(getattr(other, field))[rows]
        np.testing.assert_array_equal(a, b, err_msg=field, strict=True)


def step_through(observer, samples, state=None, rows=range(ROWS)):
    state = observer.init() if state is None else state
    found = []
    for k in rows:
        state, estimate = observer.step(state, samples.voltage[k], samples.current[k])
        found.append(estimate)
    return state, found


def test_step_loop_is_run_bit_for_bit(case):
    observer, samples = case
    whole = observer.run(samples.voltage, samples.current)
    _, found = step_through(observer, samples)
    for k, estimate in enumerate(found):
        same(estimate, whole, k)


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


def test_resume_in_pieces_is_run_bit_for_bit(case):
    observer, samples = case
    whole = observer.run(samples.voltage, samples.current)
    state, start = observer.init(), 0
    for stop in (1, 2, 700, ROWS):
        rows = slice(start, stop)
        state, part = observer.resume(state, samples.voltage[rows], samples.current[rows])
        same(part, whole, rows)
        start = stop


def test_state_and_inputs_are_not_changed(case):
    observer, samples = case
    state, _ = step_through(observer, samples, rows=range(50))
    before, voltage = copy.deepcopy(state), samples.voltage.copy()
    observer.step(state, samples.voltage[50], samples.current[50])
    observer.resume(state, samples.voltage[50:], samples.current[50:])
    assert state == before
    np.testing.assert_array_equal(samples.voltage, voltage)
    with pytest.raises(ValueError, match="read-only"):
        state.raw[0] = 1


def test_pickled_observer_and_state_go_on_the_same(case):
    observer, samples = case
    state, _ = step_through(observer, samples, rows=range(50))
    revived, saved = pickle.loads(pickle.dumps((observer, state)))
    assert saved == state
    after, one = observer.step(state, samples.voltage[50], samples.current[50])
    again, other = revived.step(saved, samples.voltage[50], samples.current[50])
    assert after == again
    same(one, other, ())


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
    assert len(ticks) > 3  # this thread ran while the other was inside run


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
