"""Contract of every observer, whatever its method.

Each entry of OBSERVERS is tested against the whole contract, except parts of the protocols in
fluxobs.observers.base that the observer does not offer, such as resuming from a state.
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
    """An observer and the record for its tests."""

    make: Callable[[], Observer[Any, Any]]
    machine: str
    rows: int
    estimate: type = Estimate
    #: The observer steps in JAX: run and step are compiled differently and agree only to rounding.
    compiled: bool = False
    #: The observer accepts missing samples. If not, the comparison holds the last sample.
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
    observer: Observer[Any, Any] = entry.build(setting, entry.recommended(setting))
    return observer


@cache
def record(name: str, rows: int) -> Samples:
    return steady(MACHINES[name], H, SPEED, rows, CURRENTS[name], 0.1 + 0.05j, 0.2, noise=0.02)


def maker(kind: Any, name: str, precision: str) -> Callable[[], Observer[Any, Any]]:
    return lambda: kind.for_machine(MACHINES[name], sample_time=H, precision=precision)


OBSERVERS: dict[str, Case] = {}
for name in MACHINES:
    for precision in ("double", "single"):
        OBSERVERS |= {
            f"{name}, {precision}": Case(maker(LeastSquaresObserver, name, precision), name, 1500),
            f"{name}, {precision}, adaptive": Case(
                maker(AdaptiveObserver, name, precision), name, 1500, AdaptiveEstimate
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
    """Whether the observer has all public attributes of a protocol."""
    return all(hasattr(observer, name) for name in dir(protocol) if not name.startswith("_"))


@cache
def observer_of(name: str) -> Observer[Any, Any]:
    return OBSERVERS[name].make()


@cache
def full_run(name: str) -> Any:
    samples = samples_of(name)
    return observer_of(name).run(samples.voltage, samples.current)


def samples_of(name: str) -> Samples:
    return record(OBSERVERS[name].machine, OBSERVERS[name].rows)


@cache
def step_of(name: str) -> Callable[..., Any]:
    observer = observer_of(name)
    if not OBSERVERS[name].compiled:
        return observer.step
    step = eqx.filter_jit(lambda observer, *row: observer.step(*row))
    return lambda *row: step(observer, *row)


def fields(estimate: Any) -> dict[str, np.ndarray]:
    """Return the fields of an estimate, a dataclass or a named tuple."""
    if isinstance(estimate, dict):
        return estimate
    names = getattr(estimate, "_fields", None) or estimate.__dataclass_fields__
    return {name: np.asarray(getattr(estimate, name)) for name in names}


def joined(estimates: list[Any]) -> dict[str, np.ndarray]:
    """Return the fields of estimates of single rows as arrays of all rows."""
    columns = [fields(estimate) for estimate in estimates]
    for name, first in columns[0].items():
        assert {column[name].dtype for column in columns} == {first.dtype}, name
    return {name: np.stack([column[name] for column in columns]) for name in columns[0]}


def assert_same(estimate: Any, reference: Any, rows: Any, *, exact: bool) -> None:
    estimate, reference = fields(estimate), fields(reference)
    assert set(estimate) == set(reference)
    for name, value in estimate.items():
        expected = reference[name][rows]
        assert (value.shape, value.dtype) == (expected.shape, expected.dtype), name
        if exact or value.dtype == bool:
            np.testing.assert_array_equal(value, expected, err_msg=name)
            continue
        difference, size = value - expected, np.abs(reference[name]).max() + 1e-300
        if name.startswith("theta_e") and not name.endswith("std"):
            difference = np.angle(np.exp(1j * difference))
        assert np.abs(difference).max() < 1e-9 * size, name


def leaves(state: Any) -> list[np.ndarray]:
    """Return the numbers in a state, which may be stored as bytes."""
    if hasattr(state, "raw"):
        return [state.raw]
    values = vars(state).values() if hasattr(state, "__dataclass_fields__") else [state]
    return [np.array(leaf) for leaf in jax.tree.leaves(list(values))]


def equal_states(first: Any, second: Any) -> bool:
    pairs = zip(leaves(first), leaves(second), strict=True)
    return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs)


@pytest.fixture(scope="module", params=OBSERVERS)
def name(request):
    """Name of an observer. Due to the module scope, the tests of one observer run consecutively."""
    return request.param


OF_LOGS = [name for name in OBSERVERS if offers(observer_of(name), LogObserver)]


@pytest.fixture(scope="module", params=OF_LOGS)
def of_logs(request):
    return request.param


def test_it_has_the_protocol(name):
    observer = observer_of(name)
    assert offers(observer, Observer)
    assert float(observer.sample_time) == pytest.approx(H)
    if offers(observer, LogObserver):
        assert 10 * H <= float(observer.memory) < 1


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n == "twin" else ()) for n in OBSERVERS]
)
def test_a_loop_of_steps_equals_a_run(name):
    samples, step, state = samples_of(name), step_of(name), observer_of(name).init()
    steps = []
    for voltage, current in zip(samples.voltage, samples.current, strict=True):
        state, estimate = step(state, voltage, current)
        steps.append(estimate)
    exact = not OBSERVERS[name].compiled
    rows = slice(None) if exact else slice(None, None, 20)
    assert_same(joined(steps[rows]), full_run(name), rows, exact=exact)


def test_estimates_have_the_listed_fields_and_shapes(name):
    """Names and shapes equal those of :func:`outputs`; a baseline has only some outputs."""
    observer, samples, case = observer_of(name), samples_of(name), OBSERVERS[name]
    listed = {output.name: output for output in outputs(case.estimate)}
    _, single = step_of(name)(observer.init(), samples.voltage[1], samples.current[1])
    for estimate, shape in ((single, ()), (full_run(name), (case.rows,))):
        values = fields(estimate)
        if isinstance(estimate, case.estimate):
            assert set(values) == set(listed)
        assert {"flux", "valid"} <= set(values) <= set(listed)
        for field, value in values.items():
            if case.estimate is ImmersionEstimate and field == "innovation":
                assert value.shape == (*shape, 1)  # one per relation
                continue
            assert value.shape == ((*shape, 2) if listed[field].vector else shape), field
            assert (value.dtype == bool) is listed[field].boolean, field
            assert np.isfinite(value).all(), field


def test_resume_in_chunks_is_run_bit_for_bit(of_logs):
    observer, samples = observer_of(of_logs), samples_of(of_logs)
    rows = len(samples.current)
    state, start = observer.init(), 0
    for stop in (1, 2, rows // 2, rows):
        chunk = slice(start, stop)
        state, estimates = observer.resume(state, samples.voltage[chunk], samples.current[chunk])
        assert_same(estimates, full_run(of_logs), chunk, exact=True)
        start = stop


def test_state_and_inputs_are_not_changed(name):
    observer, samples, step = observer_of(name), samples_of(name), step_of(name)
    voltage, current = samples.voltage.copy(), samples.current.copy()
    state = observer.init()
    for k in range(30):
        state, _ = step(state, voltage[k], current[k])
    before = copy.deepcopy(leaves(state))
    first = step(state, voltage[30], current[30])
    if offers(observer, LogObserver):
        observer.resume(state, voltage[30:60], current[30:60])
    second = step(state, voltage[30], current[30])
    for old, new in zip(before, leaves(state), strict=True):
        np.testing.assert_array_equal(old, new)
    assert_same(first[1], second[1], (), exact=True)
    assert equal_states(first[0], second[0])
    np.testing.assert_array_equal(voltage, samples.voltage)
    np.testing.assert_array_equal(current, samples.current)


def test_the_voltage_before_the_first_row_may_be_missing(name):
    samples = samples_of(name)
    voltage = samples.voltage.copy()
    voltage[0] = np.nan
    estimates = observer_of(name).run(voltage, samples.current)
    for field, value in fields(estimates).items():
        assert np.isfinite(value).all(), field


@pytest.mark.parametrize("missing", ["voltage", "current"])
@pytest.mark.parametrize("name", [name for name, case in OBSERVERS.items() if case.takes_gaps])
def test_missing_samples_give_finite_estimates_that_are_not_valid(name, missing):
    case, samples = OBSERVERS[name], samples_of(name)
    signals = {"voltage": samples.voltage.copy(), "current": samples.current.copy()}
    rows = [case.rows // 2, case.rows // 2 + 7]
    signals[missing][rows] = np.nan
    observer = observer_of(name)
    estimates = observer.run(signals["voltage"], signals["current"])
    for field, value in fields(estimates).items():
        assert np.isfinite(value).all(), field
    assert not np.asarray(estimates.valid)[rows].any()
    if offers(observer, LogObserver):
        state, _ = observer.resume(observer.init(), signals["voltage"], signals["current"])
        counts = observer.counts(state)
        bad = {"voltage": counts.bad_voltages, "current": counts.bad_currents}
        assert bad == {"voltage": 0, "current": 0} | {missing: 2}


def test_pickled_observer_and_state_resume_identically(of_logs):
    observer, samples = observer_of(of_logs), samples_of(of_logs)
    state, _ = observer.resume(observer.init(), samples.voltage[:50], samples.current[:50])
    revived, saved = pickle.loads(pickle.dumps((observer, state)))
    assert equal_states(saved, state)
    original = observer.step(state, samples.voltage[50], samples.current[50])
    copied = revived.step(saved, samples.voltage[50], samples.current[50])
    assert equal_states(original[0], copied[0])
    assert_same(original[1], copied[1], (), exact=True)


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
def test_wrong_calls_are_fluxobs_errors(of_logs, call):
    with pytest.raises(FluxobsError):
        CALLS[call](observer_of(of_logs))


@pytest.mark.parametrize("change", [{"memory": 1e-4}, {"memory": np.nan}, {"sample_time": -1.0}])
def test_settings_that_cannot_work_are_fluxobs_errors(of_logs, change):
    observer = observer_of(of_logs)
    plain = getattr(observer, "plain", observer)  # inside the adaptive observer
    with pytest.raises(FluxobsError):
        replace(plain, **change)
