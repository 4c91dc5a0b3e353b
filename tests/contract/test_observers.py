"""What every observer keeps, whatever is inside.

Add an observer by a line of OBSERVERS, and it is held to all of this. What it does not offer of the
protocols in fluxobs.observers.base, such as going on from a state, is not asked of it.
"""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest

from fluxobs import AdaptiveObserver, FluxobsError, Immersion, LeastSquaresObserver
from fluxobs.comparison.catalogue import CATALOGUE
from fluxobs.comparison.compare import setting_for
from fluxobs.observers import (
    AdaptiveEstimate,
    Estimate,
    ImmersionEstimate,
    ImmersionObserver,
    LogObserver,
    Observer,
    outputs,
)
from fluxobs.simulation.drive.loop_observer import LoopObserver
from support.records import CURRENTS, MACHINES, Samples, steady

H, SPEED = 1e-4, 500.0


@dataclass(frozen=True)
class Case:
    """An observer and the record that it is asked about."""

    make: Callable[[], Observer[Any, Any]]
    machine: str
    rows: int
    estimate: type = Estimate
    #: It steps in JAX: then the run is compiled otherwise than the step, and equal to rounding.
    compiled: bool = False
    #: Missing samples; the comparison holds the last ones for observers that take none.
    takes_gaps: bool = True


def immersed(name: str, unknowns: tuple[str, ...]) -> ImmersionObserver:
    machine = MACHINES[name]
    plain = LeastSquaresObserver.for_machine(machine, sample_time=H)
    return ImmersionObserver(
        Immersion((machine.constraint,), unknowns, machine.R),
        machine.R,
        machine.B,
        H,
        0.03,
        plain.flux_base,
        plain.constraint_noise,
        plain.drift_prior,
        0.1,
    )


def twin() -> LoopObserver:
    compiled = LeastSquaresObserver.for_machine(MACHINES["servo-400w"], sample_time=H)
    return LoopObserver.of(compiled)


def baseline(entry: Any) -> Observer[Any, Any]:
    samples = record("pmsm-2kw2", 400)
    machine = MACHINES["pmsm-2kw2"]
    setting = setting_for(H, samples.voltage, samples.current, machine, SPEED)
    made: Observer[Any, Any] = entry.build(setting, entry.recommended(setting))
    return made


@cache
def record(name: str, rows: int) -> Samples:
    return steady(MACHINES[name], H, SPEED, rows, CURRENTS[name], 0.1 + 0.05j, 0.2, noise=0.02)


def of(kind: Any, name: str, precision: str) -> Callable[[], Observer[Any, Any]]:
    return lambda: kind.for_machine(MACHINES[name], sample_time=H, precision=precision)


OBSERVERS: dict[str, Case] = {}
for name in MACHINES:
    for precision in ("double", "single"):
        OBSERVERS |= {
            f"{name}, {precision}": Case(of(LeastSquaresObserver, name, precision), name, 1500),
            f"{name}, {precision}, adaptive": Case(
                of(AdaptiveObserver, name, precision), name, 1500, AdaptiveEstimate
            ),
        }
OBSERVERS |= {
    "immersed": Case(
        lambda: immersed("servo-400w", ("drift",)), "servo-400w", 400, ImmersionEstimate
    ),
    "immersed, current bias": Case(
        lambda: immersed("synrm-6kw7", ("drift", "current-bias")),
        "synrm-6kw7",
        400,
        ImmersionEstimate,
    ),
    "twin": Case(twin, "servo-400w", 400, compiled=True),
}
OBSERVERS |= {
    entry.name: Case(
        lambda entry=entry: baseline(entry), "pmsm-2kw2", 400, compiled=True, takes_gaps=False
    )
    for entry in CATALOGUE
    if not entry.least_squares
}


def offers(observer: object, protocol: type) -> bool:
    """Whether it has all that a protocol names."""
    return all(hasattr(observer, name) for name in dir(protocol) if not name.startswith("_"))


@cache
def made(name: str) -> Observer[Any, Any]:
    return OBSERVERS[name].make()


@cache
def whole(name: str) -> Any:
    samples = samples_of(name)
    return made(name).run(samples.voltage, samples.current)


def samples_of(name: str) -> Samples:
    return record(OBSERVERS[name].machine, OBSERVERS[name].rows)


@cache
def stepping(name: str) -> Callable[..., Any]:
    observer = made(name)
    if not OBSERVERS[name].compiled:
        return observer.step
    step = eqx.filter_jit(lambda one, *row: one.step(*row))
    return lambda *row: step(observer, *row)


def fields(estimate: Any) -> dict[str, np.ndarray]:
    """What an estimate says: of a dataclass or a named tuple."""
    names = getattr(estimate, "_fields", None) or estimate.__dataclass_fields__
    return {name: np.asarray(getattr(estimate, name)) for name in names}


def same(one: Any, other: Any, rows: Any, *, exact: bool) -> None:
    one, other = fields(one), fields(other)
    assert set(one) == set(other)
    for name, value in one.items():
        expected = other[name][rows]
        assert (value.shape, value.dtype) == (expected.shape, expected.dtype), name
        if exact or value.dtype == bool:
            np.testing.assert_array_equal(value, expected, err_msg=name)
            continue
        difference, size = value - expected, np.abs(other[name]).max() + 1e-300
        if name.startswith("theta_e") and not name.endswith("std"):
            difference = np.angle(np.exp(1j * difference))
        assert np.abs(difference).max() < 1e-9 * size, name


def leaves(state: Any) -> list[np.ndarray]:
    """Numbers in a state, bytes or not."""
    if hasattr(state, "raw"):
        return [state.raw]
    parts = vars(state).values() if hasattr(state, "__dataclass_fields__") else [state]
    return [np.array(leaf) for leaf in jax.tree.leaves(list(parts))]


def equal(one: Any, other: Any) -> bool:
    pairs = zip(leaves(one), leaves(other), strict=True)
    return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs)


@pytest.fixture(scope="module", params=OBSERVERS)
def name(request):
    """Of an observer. Of this scope, so that all that is asked of one is asked in a row."""
    return request.param


OF_LOGS = [name for name in OBSERVERS if offers(made(name), LogObserver)]


@pytest.fixture(scope="module", params=OF_LOGS)
def of_logs(request):
    return request.param


def test_it_offers_the_protocol(name):
    observer = made(name)
    assert offers(observer, Observer)
    assert float(observer.sample_time) == pytest.approx(H)
    if offers(observer, LogObserver):
        assert 10 * H <= float(observer.memory) < 1


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n == "twin" else ()) for n in OBSERVERS]
)
def test_step_loop_is_run(name):
    samples, step, state = samples_of(name), stepping(name), made(name).init()
    found, exact = whole(name), not OBSERVERS[name].compiled
    for k in range(len(samples.current)):
        state, estimate = step(state, samples.voltage[k], samples.current[k])
        if exact or k % 20 == 0:
            same(estimate, found, k, exact=exact)


def test_estimates_have_the_listed_fields_and_shapes(name):
    """By name, unit and shape what the one list of outputs says; of a baseline some of it."""
    observer, samples, case = made(name), samples_of(name), OBSERVERS[name]
    listed = {one.name: one for one in outputs(case.estimate)}
    _, one = stepping(name)(observer.init(), samples.voltage[1], samples.current[1])
    for estimate, shape in ((one, ()), (whole(name), (case.rows,))):
        values = fields(estimate)
        if isinstance(estimate, case.estimate):
            assert set(values) == set(listed)
        assert {"flux", "valid"} <= set(values) <= set(listed)
        for field, value in values.items():
            if case.estimate is ImmersionEstimate and field == "innovation":
                assert value.shape == (*shape, 1)  # a relation each
                continue
            assert value.shape == ((*shape, 2) if listed[field].vector else shape), field
            assert (value.dtype == bool) is listed[field].boolean, field
            assert np.isfinite(value).all(), field


def test_resume_in_pieces_is_run_bit_for_bit(of_logs):
    observer, samples = made(of_logs), samples_of(of_logs)
    rows = len(samples.current)
    state, start = observer.init(), 0
    for stop in (1, 2, rows // 2, rows):
        part = slice(start, stop)
        state, found = observer.resume(state, samples.voltage[part], samples.current[part])
        same(found, whole(of_logs), part, exact=True)
        start = stop


def test_state_and_inputs_are_not_changed(name):
    observer, samples, step = made(name), samples_of(name), stepping(name)
    voltage, current = samples.voltage.copy(), samples.current.copy()
    state = observer.init()
    for k in range(30):
        state, _ = step(state, voltage[k], current[k])
    before = copy.deepcopy(leaves(state))
    first = step(state, voltage[30], current[30])
    if offers(observer, LogObserver):
        observer.resume(state, voltage[30:60], current[30:60])
    again = step(state, voltage[30], current[30])
    for was, now in zip(before, leaves(state), strict=True):
        np.testing.assert_array_equal(was, now)
    same(first[1], again[1], (), exact=True)
    assert equal(first[0], again[0])
    np.testing.assert_array_equal(voltage, samples.voltage)
    np.testing.assert_array_equal(current, samples.current)


def test_the_voltage_before_the_first_row_may_be_missing(name):
    samples = samples_of(name)
    voltage = samples.voltage.copy()
    voltage[0] = np.nan
    found = made(name).run(voltage, samples.current)
    for field, value in fields(found).items():
        assert np.isfinite(value).all(), field


@pytest.mark.parametrize("missing", ["voltage", "current"])
@pytest.mark.parametrize("name", [name for name, case in OBSERVERS.items() if case.takes_gaps])
def test_missing_samples_leave_numbers_and_no_claim(name, missing):
    case, samples = OBSERVERS[name], samples_of(name)
    signals = {"voltage": samples.voltage.copy(), "current": samples.current.copy()}
    rows = [case.rows // 2, case.rows // 2 + 7]
    signals[missing][rows] = np.nan
    observer = made(name)
    found = observer.run(signals["voltage"], signals["current"])
    for field, value in fields(found).items():
        assert np.isfinite(value).all(), field
    assert not np.asarray(found.valid)[rows].any()
    if offers(observer, LogObserver):
        state, _ = observer.resume(observer.init(), signals["voltage"], signals["current"])
        counts = observer.counts(state)
        bad = {"voltage": counts.bad_voltages, "current": counts.bad_currents}
        assert bad == {"voltage": 0, "current": 0} | {missing: 2}


def test_pickled_observer_and_state_go_on_the_same(of_logs):
    observer, samples = made(of_logs), samples_of(of_logs)
    state, _ = observer.resume(observer.init(), samples.voltage[:50], samples.current[:50])
    revived, saved = pickle.loads(pickle.dumps((observer, state)))
    assert equal(saved, state)
    one = observer.step(state, samples.voltage[50], samples.current[50])
    other = revived.step(saved, samples.voltage[50], samples.current[50])
    assert equal(one[0], other[0])
    same(one[1], other[1], (), exact=True)


CALLS = {
    "three components": lambda o: o.run(np.zeros((5, 3)), np.zeros((5, 3))),
    "lengths": lambda o: o.run(np.zeros((4, 2)), np.zeros((5, 2))),
    "no current": lambda o: o.run(np.zeros((5, 2)), None),
    "no voltage": lambda o: o.run(None, np.zeros((5, 2))),
    "flat": lambda o: o.run(np.zeros(2), np.zeros(2)),
    "step without voltage": lambda o: o.step(o.init(), None, [0.0, 0.0]),
    "step without current": lambda o: o.step(o.init(), [0.0, 0.0], None),
    "step of three": lambda o: o.step(o.init(), [0.0, 0.0, 0.0], [0.0, 0.0]),
    "step of one": lambda o: o.step(o.init(), [0.0, 0.0], [0.0]),
}


@pytest.mark.parametrize("call", CALLS)
def test_what_is_of_the_user_s_making_is_a_fluxobs_error(of_logs, call):
    with pytest.raises(FluxobsError):
        CALLS[call](made(of_logs))


@pytest.mark.parametrize("change", [{"memory": 1e-4}, {"memory": np.nan}, {"sample_time": -1.0}])
def test_settings_that_cannot_work_are_fluxobs_errors(of_logs, change):
    observer = made(of_logs)
    plain = getattr(observer, "plain", observer)  # of the adaptive one
    with pytest.raises(FluxobsError):
        replace(plain, **change)
