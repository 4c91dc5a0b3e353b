"""The quadratic relation: residual, null space, and the machines that satisfy it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fluxobs import QuadraticConstraint, SurfacePMSM, SynchronousReluctance
from support.records import CURRENTS, MACHINES, steady

positive = st.floats(1e-4, 1e2)
angle = st.floats(-10, 10)
current = st.floats(-100, 100)


def matrices(seed, n):
    rng = np.random.default_rng(seed)
    return [rng.standard_normal((n, n)) for _ in range(3)] + [
        rng.standard_normal(n) for _ in range(2)
    ]


@given(L=positive, psi=positive, theta=angle, a=current, b=current)
def test_surface_pmsm_satisfies_its_relation(L, psi, theta, a, b):
    machine = SurfacePMSM(R_s=1, L_s=L, n_p=1, psi_f=psi)
    i = np.array([a, b])
    flux = L * i + psi * np.array([np.cos(theta), np.sin(theta)])
    size = psi**2 + (L * np.hypot(a, b)) ** 2
    assert abs(machine.constraint.residual(flux, i)) <= 1e-13 * size


@given(L_q=positive, ratio=st.floats(1.1, 20), theta=angle, i_d=current, i_q=current)
def test_synchronous_reluctance_satisfies_its_relation(L_q, ratio, theta, i_d, i_q):
    L_d = ratio * L_q
    machine = SynchronousReluctance(R_s=1, L_d=L_d, L_q=L_q, n_p=1)
    turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
    flux, i = turn @ [L_d * i_d, L_q * i_q], turn @ [i_d, i_q]
    assert abs(machine.constraint.residual(flux, i)) <= 1e-12 * (L_d * np.hypot(i_d, i_q)) ** 2


@pytest.mark.parametrize("name", MACHINES)
def test_machines_on_a_trajectory(name):
    machine = MACHINES[name]
    samples = steady(machine, 1e-4, 400.0, 200, CURRENTS[name])
    residual = machine.constraint.residual(samples.flux, samples.current)
    spread = residual - residual.mean()  # d of the interior PMSM depends on i_d, so ignore d
    assert np.abs(spread).max() < 1e-12 * np.abs(samples.flux).max() ** 2


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 4))
def test_only_symmetric_parts_matter_and_the_hessian_is_the_second_difference(seed, n):
    Q1, Q2, Q3, E, C = matrices(seed, n)
    constraint = QuadraticConstraint(Q1, Q2, Q3, E, C, d=0.3)
    rng = np.random.default_rng(seed + 1)
    flux, i = rng.standard_normal((2, n))
    direct = flux @ Q1 @ flux + flux @ Q2 @ i + i @ Q3 @ i + E @ flux + C @ i + 0.3
    assert constraint.residual(flux, i) == pytest.approx(direct, rel=1e-10, abs=1e-10)
    x, step = np.r_[flux, i], rng.standard_normal(2 * n)

    def w(z):
        return constraint.residual(z[:n], z[n:])

    second = w(x + step) - 2 * w(x) + w(x - step)
    assert second == pytest.approx(step @ constraint.hessian() @ step, rel=1e-8, abs=1e-8)


@given(L=positive, psi=positive)
def test_a_current_bias_of_a_pmsm_is_invisible(L, psi):
    machine = SurfacePMSM(R_s=1, L_s=L, n_p=1, psi_f=psi)
    invisible = machine.constraint.invisible_offsets()
    assert invisible.shape == (4, 2)
    # Every invisible offset is (L s, s), which leaves the position vector λ - L i unchanged.
    np.testing.assert_allclose(invisible[:2], L * invisible[2:], rtol=1e-9, atol=1e-12 * L)


def test_a_reluctance_machine_has_no_invisible_offsets():
    assert MACHINES["synrm-6kw7"].constraint.invisible_offsets().shape == (4, 0)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 3))
def test_invisible_offsets_are_the_null_space(seed, n):
    Q1, Q2, Q3, E, C = matrices(seed, n)
    constraint = QuadraticConstraint(Q1, Q2, Q3, E, C)
    assert constraint.invisible_offsets().shape == (2 * n, 0)  # random matrices are regular
    rng = np.random.default_rng(seed)
    S = rng.standard_normal((n, n))
    hidden = QuadraticConstraint(Q1, -(Q1 + Q1.T) @ S, S.T @ Q1 @ S)  # (λ - S i)ᵀQ1(λ - S i)
    offsets = hidden.invisible_offsets()
    assert offsets.shape == (2 * n, n)
    size = np.abs(hidden.hessian()).max() * np.abs(offsets).max()
    np.testing.assert_allclose(hidden.hessian() @ offsets, 0, atol=1e-9 * size)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.eye(2), np.eye(3), np.eye(2)), r"Q2 must have shape \(2, 2\), got \(3, 3\)"),
        ((np.eye(2), np.full((2, 2), np.nan), np.eye(2)), "Q2 must be finite"),
        ((np.eye(2), np.eye(2), np.eye(2), [1.0]), r"E must have shape \(2,\)"),
    ],
)
def test_wrong_matrices_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        QuadraticConstraint(*arguments)
