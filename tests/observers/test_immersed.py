"""The immersed observer equals the C core; its additional unknowns and relations."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fluxobs import Immersion, ImmersionObserver, LeastSquaresObserver, QuadraticConstraint
from fluxobs.observers import ImmersionEstimate
from fluxobs.research import discover_constraint
from fluxobs.research.energies.library import (
    differential_actuator,
    differential_relation,
    doubly_fed,
    four_pole_bearing,
    wound_field,
)
from fluxobs.research.paper.levitation import SCENARIOS, record
from fluxobs.research.paper.section_v import LS_SAMPLE_TIME, least_squares, thinned
from fluxobs.research.paper.studies import noisy
from support.records import CURRENTS, MACHINES, steady


@pytest.mark.parametrize("source", ["volt_seconds", "voltage"])
@pytest.mark.parametrize("name", MACHINES)
def test_it_equals_the_c_core(name, source):
    """The estimates agree to 1e-10 relative from the first sample on."""
    machine = MACHINES[name]
    rated = machine.rated_current
    samples = steady(
        machine,
        2e-4,
        350 + 150 * np.sin(np.arange(1500) / 40),
        1500,
        CURRENTS[name],
        current_bias=0.01 * rated * (1 + 0.5j),
        voltage_bias=0.05,
        noise=0.002 * rated,
    )
    core = LeastSquaresObserver.for_machine(
        machine, sample_time=2e-4, memory=0.02, drift_prior=5.0, held=False
    )
    core = replace(core, flux_map=None)  # the immersed observer has no map
    readable = ImmersionObserver(
        Immersion(machine.constraint),
        machine.R,
        machine.B,
        2e-4,
        0.02,
        core.flux_base,
        core.constraint_noise,
        core.drift_prior,
    )
    source_samples = {source: getattr(samples, source)}
    compiled = core.run(current=samples.current, **source_samples)
    readable_estimate = readable.run(current=samples.current, **source_samples)
    for expected, actual in (
        (compiled.flux, readable_estimate.flux),
        (compiled.drift, readable_estimate.drift),
    ):
        assert np.abs(expected - actual).max() < 1e-10 * np.abs(expected).max()


def test_run_equals_a_loop_of_steps():
    drive = record(SCENARIOS["S5"], quick=True)
    observer = maglev_observer(drive, 1e-2)
    rows, v = thinned(drive, 1e-2)
    rows, v = rows[:60], v[:60]
    record_estimate = observer.run(current=drive.current[rows], volt_seconds=v)
    state = observer.init()
    for k in range(60):
        state, estimate = observer.step(state, current=drive.current[rows[k]], volt_seconds=v[k])
    np.testing.assert_array_equal(estimate.flux, record_estimate.flux[-1])


def maglev_observer(drive, sample_time, unknowns=("drift", "current-bias")):
    machine, typical = drive.machine, 3.33e-5
    return ImmersionObserver(
        Immersion(machine.constraint, unknowns, machine.R),
        machine.R,
        machine.B,
        sample_time,
        0.1,
        typical,
        1e-6 * machine.g * typical**2,
        1e-5,
        5e-3,
    )


@cache
def levitation():
    drive = record(SCENARIOS["S5"], quick=True)
    return drive, least_squares(drive)


def test_levitation_converges_and_reconverges():
    """After the start and after a jump, the error is below 2 % within 0.3 s and 1e-6 within 2 s."""
    drive, estimate = levitation()
    rows, _ = thinned(drive, LS_SAMPLE_TIME)
    t = drive.t[rows]
    error = np.linalg.norm(estimate.flux - drive.flux[rows], axis=1) / drive.flux.max()
    for start in (0.0, drive.jump):
        end = t < start + 14.9
        assert error[(t > start + 0.3) & end].max() < 0.02
        assert error[(t > start + 2.0) & end].max() < 1e-6
    settled = slice(-10, None)
    np.testing.assert_allclose(
        estimate.current_bias[settled], drive.current_bias[rows][settled], rtol=1e-6
    )
    np.testing.assert_allclose(estimate.drift[settled], drive.drift[rows][settled], atol=1e-11)


def test_a_jump_restarts_and_interrupts_validity():
    drive, estimate = levitation()
    t = drive.t[thinned(drive, LS_SAMPLE_TIME)[0]]
    assert not estimate.valid[(t > drive.jump + 0.05) & (t < drive.jump + 0.1)].any()
    assert estimate.valid[t > drive.jump + 3.0].all()
    error = np.linalg.norm(estimate.flux - drive.flux[thinned(drive, LS_SAMPLE_TIME)[0]], axis=1)
    certain = estimate.valid & (np.abs(t - drive.jump) > 0.05)
    assert error[certain].max() < 0.02 * drive.flux.max()


def test_current_bias_alone():
    """With θ = R δ, everything is identifiable for a PMSM, even at constant speed."""
    machine = MACHINES["servo-400w"]
    samples = steady(machine, 1e-4, 500.0, 3000, 4j, current_bias=0.2 - 0.1j)
    observer = ImmersionObserver(
        Immersion(machine.constraint, ("current-bias",), machine.R),
        machine.R,
        machine.B,
        1e-4,
        0.03,
        machine.psi_f,
        1e-4 * machine.psi_f**2,
        0.1,
        0.5,
    )
    estimate = observer.run(current=samples.current, volt_seconds=samples.volt_seconds)
    np.testing.assert_allclose(estimate.current_bias[-1], [0.2, -0.1], atol=1e-6)
    np.testing.assert_allclose(estimate.flux[-1], samples.flux[-1], atol=1e-7 * machine.psi_f)
    np.testing.assert_allclose(estimate.drift[-1], machine.R_s * np.array([0.2, -0.1]), atol=1e-6)


@pytest.mark.parametrize(
    "make",
    [
        *(pytest.param(m, marks=pytest.mark.slow) for m in (wound_field, doubly_fed)),
        four_pole_bearing,
    ],
)
def test_several_relations(make):
    """The relations are derived from the energies, for any number of ports."""
    system = make()
    relations = discover_constraint(system).relations
    n, h, rows = system.n_E, 1e-3, 1500
    lower, upper = np.asarray(system.flux_range)
    rng = np.random.default_rng(4)
    t = jnp.arange(rows) * h
    speeds, phases = rng.uniform(10, 60, (2, n)), rng.uniform(0, 6, (2, n))
    waves = [jnp.sin(speeds[k] * t[:, None] + phases[k]) for k in (0, 1)]
    flux = np.asarray((lower + upper) / 2 + (upper - lower) * (0.3 * waves[0] + 0.15 * waves[1]))
    turning = 0.6 * jnp.sin(25 * t) if make is four_pole_bearing else 40 * t
    position_limit = np.asarray(system.position_range)[1]
    position = turning[:, None] * (position_limit if make is four_pole_bearing else 1.0)
    if system.n_M == 2:
        position = jnp.column_stack([position[:, 0], 0.6 * jnp.cos(31 * t) * position_limit[1]])
    current = np.asarray(jax.vmap(system.current)(jnp.asarray(flux), position))
    size = np.abs(flux).max(axis=0)
    drift = 0.1 * size
    v = np.diff(flux, axis=0, prepend=flux[:1]) - h * drift
    sigma = [
        1e-6 * size @ np.abs(relation.Q1) @ size
        + 1e-6 * size @ np.abs(relation.Q2) @ np.abs(current).max(axis=0)
        for relation in relations
    ]
    observer = ImmersionObserver(
        Immersion(relations),
        np.asarray(system.R),
        np.asarray(system.B),
        h,
        0.2,
        size,
        np.array(sigma),
        0.3 * size,
    )
    estimate = observer.run(current=current, volt_seconds=v)
    np.testing.assert_allclose(estimate.flux[-1], flux[-1], atol=1e-5 * size.max())
    np.testing.assert_allclose(estimate.drift[-1], drift, atol=1e-4 * size.max())
    assert estimate.valid[-1]


def test_the_electrostatic_dual_with_the_same_observer():
    system, relation = differential_actuator(), differential_relation()
    h, rows = 1e-6, 2000
    lower, upper = np.asarray(system.flux_range)
    t = jnp.arange(rows)[:, None] * h
    charge = lower + (upper - lower) * (0.5 + 0.3 * jnp.sin(jnp.array([9e3, 13e3]) * t))
    position = 1e-6 * jnp.sin(2e4 * t)
    voltage = np.asarray(jax.vmap(system.current)(charge, position))
    bias = np.array([0.02, -0.01])  # bias of the source voltages [V]
    drift = -np.asarray(system.B) @ bias
    v = np.diff(charge, axis=0, prepend=charge[:1]) - h * drift
    size = np.asarray(upper)
    observer = ImmersionObserver(
        Immersion(relation),
        np.asarray(system.R),
        np.asarray(system.B),
        h,
        2e-4,
        size,
        np.array([1e-6 * 2e-6 * size[0] ** 2]),
        np.abs(np.asarray(system.B)).max() * 0.1,
    )
    estimate = observer.run(current=voltage, volt_seconds=v)
    np.testing.assert_allclose(estimate.flux[-1], np.asarray(charge)[-1], atol=1e-6 * size.max())
    np.testing.assert_allclose(estimate.drift[-1], drift, rtol=1e-4)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_information_equals_the_dense_sum(seed):
    """R equals the sum of all measured rows, propagated and weighted; two relations, with bias."""
    rng = np.random.default_rng(seed)
    n = 2
    relations = tuple(
        QuadraticConstraint(*rng.standard_normal((3, n, n)), *rng.standard_normal((2, n)))
        for _ in range(2)
    )
    immersion = Immersion(relations, ("drift", "current-bias"))
    h, memory = 0.1, 2.0
    observer = ImmersionObserver(
        immersion, np.eye(n), np.eye(n), h, memory, 1.0, np.array([1e3, 2e3]), 1.0, 1.0
    )
    state, rho, size = observer.init(), 1 - h / memory, immersion.size
    prior = np.diag(state.R).copy()
    dense = np.diag(prior)
    for k in range(12):
        i, v = rng.standard_normal((2, n))
        if k > 0:
            dense = np.sqrt(rho) * dense @ immersion.transition(-h, -v)
        state, _ = observer.step(state, current=i, volt_seconds=v)
        dense = np.vstack([dense, immersion.output_rows(i)[0] / np.array([[1e3], [2e3]])])
        if k % 2 == 0:
            row = np.zeros(size)
            row[k // 2 % size] = np.sqrt(1 - rho ** (2 * size)) * prior[k // 2 % size]
            dense = np.vstack([dense, row])
    expected = dense.T @ dense
    np.testing.assert_allclose(state.R.T @ state.R, expected, atol=1e-9 * np.abs(expected).max())


def test_missing_samples_are_bridged():
    drive = record(SCENARIOS["S5"], quick=True)
    observer = maglev_observer(drive, 1e-2)
    rows, v = thinned(drive, 1e-2)
    rows, v = rows[:300], v[:300]
    current = drive.current[rows].copy()
    current[150] = np.nan
    state = observer.init()
    state, estimate = observer.resume(state, current=current, volt_seconds=v)
    assert (state.bad_currents, state.bad_voltages) == (1, 0)
    assert np.isfinite(estimate.flux).all()
    error = np.linalg.norm(estimate.flux - drive.flux[rows], axis=1)
    assert error[200:].max() < 1e-5 * drive.flux.max()


@cache
def first_half_of_motor():
    """Return estimates for the first 3000 rows of the servo at 500 rad/s with 0.2 % noise."""
    machine = MACHINES["servo-400w"]
    samples = steady(machine, 1e-4, 500.0, 6000, 6j, noise=0.024)
    observer = ImmersionObserver(
        Immersion(machine.constraint),
        machine.R,
        machine.B,
        1e-4,
        0.03,
        machine.psi_f,
        2 * machine.L_s * machine.psi_f * 0.024,
        0.2,
    )
    half = slice(0, 3000)
    state, estimate = observer.resume(observer.init(), samples.voltage[half], samples.current[half])
    return machine, samples, observer, state, estimate


def motor(disturb):
    """Return state, estimates and errors of 6000 rows; `disturb` changes currents from row 3000."""
    machine, samples, observer, state, first_half = first_half_of_motor()
    measured = samples.current.copy()
    disturb(measured)
    assert np.array_equal(measured[:3000], samples.current[:3000])
    state, second_half = observer.resume(state, samples.voltage[3000:], measured[3000:])
    estimate = ImmersionEstimate(
        **{
            name: np.concatenate([values, vars(second_half)[name]])
            for name, values in vars(first_half).items()
        }
    )
    error = np.linalg.norm(estimate.flux - samples.flux, axis=1) / machine.psi_f
    return state, estimate, error


@pytest.mark.parametrize("rows", [50, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 600))])
def test_no_row_is_valid_while_samples_are_missing(rows):
    def gap(current):
        current[3000 : 3000 + rows] = np.nan

    state, estimate, error = motor(gap)
    assert (state.bad_currents, state.bad_voltages) == (rows, 0)
    assert not estimate.valid[3000 : 3000 + rows].any()
    assert error[estimate.valid].max() < 0.1
    assert estimate.valid[4500:].all()
    assert np.isfinite(estimate.flux_std).all()


@pytest.mark.parametrize(("rows", "lost"), [(3, False), (4, True)])
def test_three_missing_samples_are_bridged_and_more_erase_the_information(rows, lost):
    def gap(current):
        current[3000 : 3000 + rows] = np.nan

    _, estimate, _ = motor(gap)
    growth = estimate.flux_std[3000 + rows].max() / estimate.flux_std[2999].max()
    assert (growth > 1000) == lost
    assert (growth < 1.1) == (not lost)


@pytest.mark.parametrize(
    "size", [10.0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1e3, 1e6))]
)
def test_a_spike_is_ignored(size):
    def spike(current):
        current[3000, 0] += size

    state, estimate, error = motor(spike)
    assert state.restarts == 0
    assert error[estimate.valid].max() < 0.1
    assert error[3001:].max() < 0.1
    assert estimate.valid[3400:].all()


def test_outputs_are_finite_after_long_gaps():
    observer = maglev_observer(record(SCENARIOS["S5"], quick=True), 1e-2)
    current = np.full((5000, 2), np.nan)
    current[0] = 0.5
    _, estimate = observer.resume(observer.init(), np.zeros((5000, 2)), current)
    assert np.isfinite(estimate.flux_std).all()
    assert not estimate.valid.any()


def test_a_current_bias_caused_by_noise_is_not_valid():
    """In S5 with noise of 1 mA and 10 mV, the bias is not identifiable and corrupts the flux."""
    drive = record(SCENARIOS["S5"], quick=True)
    machine, rng = drive.machine, np.random.default_rng(0)
    rows = slice(0, 8001, 4)
    v = np.diff(np.cumsum(drive.volt_seconds, axis=0)[rows], axis=0, prepend=np.zeros((1, 2)))
    v[1:] += 4e-3 * 5e-3 / machine.N * rng.standard_normal((len(v) - 1, 2))
    current = drive.current[rows] + 1e-3 * rng.standard_normal((len(v), 2))
    observer = ImmersionObserver(
        Immersion(machine.constraint, ("drift", "current-bias")),
        machine.R,
        machine.B,
        4e-3,
        0.5,
        3.3e-5,
        3e-3 * machine.g * 3.3e-5**2,
        5e-5,
        0.02,
        voltage_noise=5e-3,
    )
    estimate = observer.run(current=current, volt_seconds=v)
    error = np.linalg.norm(estimate.flux - drive.flux[rows], axis=1) / drive.flux.max()
    assert error.max() > 0.2
    assert not estimate.valid.any()


def test_a_small_port_is_judged_by_its_own_flux_base():
    """The second of two opposed pairs, at rest with 1 % of the flux, is never valid and wrong."""
    k, g, h, rows = 1e-5, 1e-3, 1e-3, 2000
    t = np.arange(rows)[:, None] * h
    size = np.array([1.0, 1.0, 0.01, 0.01])
    flux = 5e-3 * size * (1 + np.array([0.3, 0.3, 0, 0]) * np.sin(np.array([20, 31, 1, 1]) * t))
    gaps = g + 3e-4 * np.array([-1, 1, 0, 0]) * np.sin(17 * t)
    current = flux * gaps / k
    relations = []
    for port in (0, 2):
        Q1, Q2 = np.zeros((4, 4)), np.zeros((4, 4))
        Q1[port, port + 1] = Q1[port + 1, port] = g
        Q2[port, port + 1] = Q2[port + 1, port] = -k
        relations.append(QuadraticConstraint(Q1, Q2, np.zeros((4, 4))))
    base = 5e-3 * size
    sigma = np.array([1e-4 * g * base[0] ** 2, 1e-4 * g * base[2] ** 2])
    observer = ImmersionObserver(
        Immersion(tuple(relations)), np.eye(4), np.eye(4), h, 0.2, base, sigma, 0.01 * base
    )
    estimate = observer.run(current=current, volt_seconds=np.diff(flux, axis=0, prepend=flux[:1]))
    wrong = (np.abs(estimate.flux - flux) > 0.3 * base).any(axis=1)
    assert not (wrong & estimate.valid).any()


def test_information_from_noise_is_detected():
    """S3 hardly excites one direction: half of its flux is wrong, and almost no row is valid."""
    weak = noisy(record(SCENARIOS["S3"], quick=True), 4.0, 0.15)
    assert weak.error > 0.2
    assert weak.claimed < 0.1  # by the covariance alone
    assert weak.noise_share > 0.5
    assert weak.valid < 0.05
    strong = noisy(record(SCENARIOS["S5"], quick=True), 6.0, 0.5)
    assert strong.error < 0.06
    assert strong.noise_share < 0.15


def test_noise_above_the_assumed_one_does_not_restart_for_ever():
    machine = MACHINES["servo-400w"]
    samples = steady(machine, 1e-4, 500.0, 4000, 4j, noise=0.05)
    observer = ImmersionObserver(
        Immersion(machine.constraint),
        machine.R,
        machine.B,
        1e-4,
        0.03,
        machine.psi_f,
        1e-6 * machine.psi_f**2,  # 300 times too small
        0.1,
    )
    state, estimate = observer.resume(
        observer.init(), current=samples.current, volt_seconds=samples.volt_seconds
    )
    halfway = observer.resume(
        observer.init(), current=samples.current[:2000], volt_seconds=samples.volt_seconds[:2000]
    )[0]
    assert state.restarts == halfway.restarts
    assert np.linalg.norm(estimate.flux[-1] - samples.flux[-1]) < 0.05 * machine.psi_f


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"unknowns": ("drift", "current-bias")},
            r"estimated together: an offset of \(0.0006, 0\) Wb in the flux with \(1, 0\) A",
        ),
        ({"flux_base": 0.0}, "flux_base must be positive"),
        ({"memory": 5e-4}, "memory must be at least ten samples, 0.001 s here"),
        ({"sample_time": np.nan}, "sample_time must be positive"),
        ({"R": np.eye(3)}, r"R must have shape \(2, 2\)"),
        *(
            ({name: value}, f"{name} must be finite and not negative, got {value}")
            for name in ("current_noise", "voltage_noise")
            for value in (-1e-9, np.inf, np.nan)
        ),
    ],
)
def test_unusable_settings_are_refused(change, message):
    machine = MACHINES["servo-400w"]
    fields = {
        "immersion": Immersion(machine.constraint, change.pop("unknowns", ("drift",))),
        "R": machine.R,
        "B": machine.B,
        "sample_time": 1e-4,
        "memory": 0.03,
        "flux_base": 0.01,
        "constraint_noise": 1e-6,
        "drift_prior": 0.1,
        "current_bias_prior": 0.1,
    }
    with pytest.raises(ValueError, match=message):
        ImmersionObserver(**(fields | change))


@pytest.mark.parametrize("assumed", [1.0, 100.0])
def test_an_unidentifiable_drift_is_as_uncertain_as_its_prior(assumed):
    """At rest the drift is not identifiable; its standard deviation stays at the prior's value.

    Innovations far below the assumed noise must not reduce the standard deviation.
    """
    machine = MACHINES["servo-400w"]
    h, rows, prior = 2e-4, 600, 0.5
    observer = ImmersionObserver(
        Immersion(machine.constraint),
        machine.R,
        machine.B,
        h,
        0.02,
        np.full(2, machine.psi_f),
        np.array([assumed * 1e-3 * machine.psi_f**2]),
        prior,
    )
    i = np.tile([3.0, 1.0], (rows, 1))
    estimate = observer.run(i @ machine.R.T, i)
    assert not estimate.valid.any()
    # One direction, along the flux, is identifiable.
    drift_std = np.linalg.norm(estimate.drift_std[-1])
    assert 0.5 * prior < drift_std < 2 * prior
    assert estimate.flux_std[-1].max() > 0.3 * machine.psi_f
