# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import solve_continuous_are, solve_discrete_are

from tpgmm_core.lqr.double_integrator import (
    double_integrator,
    double_integrator_gains,
    double_integrator_value,
    riccati_gains,
)
from tpgmm_core.lqr.finite_horizon import finite_horizon_gains
from tpgmm_core.lqr.riccati import continuous_regulator, discrete_regulator


@st.composite
def precisions(draw: st.DrawFn, max_dimensions: int = 7) -> np.ndarray:
    """Symmetric positive definite with a condition number that the Riccati solver can still take."""
    D = draw(st.integers(1, max_dimensions))
    X = draw(arrays(float, (D, D), elements=st.floats(-1, 1)))
    scale = draw(st.sampled_from([1e-2, 1.0, 1e4]))
    return scale * (X @ X.T + 0.1 * np.eye(D))


@given(precisions(), st.sampled_from([1e-2, 0.3, 5.0]))
def test_closed_form_solves_the_riccati_equation(precision: np.ndarray, control_cost: float) -> None:
    gains = double_integrator_gains(precision, control_cost)
    D = len(precision)
    A, B = np.eye(2 * D, k=D), np.eye(2 * D)[:, D:]
    Q = np.zeros((2 * D, 2 * D))
    Q[:D, :D] = precision
    P = scipy.linalg.solve_continuous_are(A, B, Q, control_cost * np.eye(D))
    exact = riccati_gains(precision, np.zeros_like(precision), control_cost)
    for found in (gains, exact):
        for part, expected in ((found.stiffness, P[D:, :D]), (found.damping, P[D:, D:])):
            expected = expected / control_cost
            np.testing.assert_allclose(part, expected, rtol=1e-7, atol=1e-7 * np.abs(expected).max())


def test_control_cost_may_differ_between_dimensions() -> None:
    rng = np.random.default_rng(3)
    X = rng.normal(size=(6, 6))
    precision, cost = X @ X.T + np.eye(6), np.array([0.1, 0.1, 0.1, 2.0, 3.0, 4.0])
    gains = double_integrator_gains(precision, cost)
    exact = riccati_gains(precision, np.zeros((6, 6)), np.diag(cost))
    np.testing.assert_allclose(gains.stiffness, exact.stiffness, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gains.damping, exact.damping, rtol=1e-9, atol=1e-9)


def test_stacked_precisions_give_the_gains_of_each() -> None:
    X = np.random.default_rng(0).normal(size=(2, 5, 3, 3))
    stack = X @ X.swapaxes(-1, -2)
    gains = double_integrator_gains(stack, 0.5)
    assert gains.stiffness.shape == stack.shape
    np.testing.assert_array_equal(gains.damping[1, 4], double_integrator_gains(stack[1, 4], 0.5).damping)


def test_bounds_hold_in_every_direction_and_keep_the_damping_ratio() -> None:
    Q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(4, 4)))
    precision = (Q * [0.0, 1.0, 100.0, 1e12]) @ Q.T
    gains = double_integrator_gains(precision, 1.0, min_stiffness=2.0, max_stiffness=50.0)
    np.testing.assert_allclose(np.linalg.eigvalsh(gains.stiffness), [2.0, 2.0, 10.0, 50.0], rtol=1e-3)
    np.testing.assert_allclose(gains.damping @ gains.damping, 2.0 * gains.stiffness, rtol=1e-9, atol=1e-9)


def test_direction_without_cost_gets_no_gain() -> None:
    gains = double_integrator_gains(np.diag([4.0, 0.0]))
    np.testing.assert_allclose(gains.stiffness, np.diag([2.0, 0.0]), atol=1e-12)


def test_velocity_cost_adds_damping() -> None:
    plain = riccati_gains(np.eye(2), np.zeros((2, 2)), 1.0)
    damped = riccati_gains(np.eye(2), np.eye(2), 1.0)
    np.testing.assert_allclose(damped.damping, np.sqrt(3.0) * np.eye(2), rtol=1e-9)
    assert (np.diag(damped.damping) > np.diag(plain.damping)).all()


@pytest.mark.parametrize("control_cost", [0.3, np.array([0.3, 2.0, 5.0])])
def test_the_value_is_what_the_riccati_equation_says(control_cost: float | np.ndarray) -> None:
    X = np.random.default_rng(2).normal(size=(3, 3))
    zero, precision = np.zeros((3, 3)), X @ X.T + np.eye(3)
    A, B = np.block([[zero, np.eye(3)], [zero, zero]]), np.vstack([zero, np.eye(3)])
    Q = np.block([[precision, zero], [zero, zero]])
    exact = continuous_regulator(A, B, Q, np.diag(np.broadcast_to(control_cost, 3)))
    np.testing.assert_allclose(double_integrator_value(precision, control_cost), exact.value, rtol=1e-9, atol=1e-9)


def test_short_time_steps_have_the_gains_of_continuous_time_and_long_ones_less() -> None:
    X = np.random.default_rng(5).normal(size=(3, 3))
    Qx, Qv = X @ X.T + np.eye(3), 0.3 * np.eye(3)
    continuous, short, long = (riccati_gains(Qx, Qv, 0.5, step) for step in (None, 1e-4, 0.1))
    np.testing.assert_allclose(short.stiffness, continuous.stiffness, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(short.damping, continuous.damping, rtol=1e-3, atol=1e-3)
    assert np.trace(long.stiffness) < np.trace(continuous.stiffness)


def test_discrete_gains_are_the_fixed_point_of_the_recursion() -> None:
    A, B = double_integrator(2, 0.05)
    Q, R, W = np.diag([4.0, 2.0, 0.1, 0.2]), np.array([[0.3, 0.1], [0.1, 0.4]]), np.diag([0.0, 0.0, 0.02, 0.01])
    for risk in (0.0, 0.3, -0.3):
        regulator = discrete_regulator(A, B, Q, R, noise=W, risk=risk)
        long = finite_horizon_gains(A, B, np.tile(Q, (2001, 1, 1)), R, np.zeros((2001, 4)), noise=W, risk=risk)
        np.testing.assert_allclose(regulator.gain, long.gains[0], rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_regulators_of_any_system_solve_their_equations_as_well_as_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 9)), int(rng.integers(1, 4))
    A, B, X = rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(n, n))
    Q, R = 10.0 ** rng.uniform(-3, 3) * (X @ X.T + 0.01 * np.eye(n)), np.diag(10.0 ** rng.uniform(-2, 2, size=m))

    def continuous(P: np.ndarray) -> float:
        residual = A.T @ P + P @ A + Q - P @ B @ np.linalg.solve(R, B.T @ P)
        return float(np.abs(residual).max() / np.abs(P).max())

    def discrete(P: np.ndarray) -> float:
        residual = Q + A.T @ P @ A - P - A.T @ P @ B @ np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        return float(np.abs(residual).max() / np.abs(P).max())

    regulator = continuous_regulator(A, B, Q, R)
    assert continuous(regulator.value) <= max(1e-9, 10.0 * continuous(solve_continuous_are(A, B, Q, R)))
    assert np.linalg.eigvals(A - B @ regulator.gain).real.max() < 0.0
    regulator = discrete_regulator(A, B, Q, R)
    assert discrete(regulator.value) <= max(1e-9, 10.0 * discrete(solve_discrete_are(A, B, Q, R)))
    assert np.abs(np.linalg.eigvals(A - B @ regulator.gain)).max() < 1.0


def test_risk_in_continuous_time_is_known_for_one_dimension() -> None:
    """xdot = u + w: P^2 (1/r - theta W) = q, so that the breakdown is at theta W = 1/r."""
    gains = [
        continuous_regulator([[0.0]], [[1.0]], [[4.0]], 0.25, noise=[[0.5]], risk=risk).gain[0, 0]
        for risk in (0.0, 6.0, -2.0)
    ]
    np.testing.assert_allclose(gains, [4.0, 4.0 * np.sqrt(4.0 / (4.0 - 3.0)), 4.0 * np.sqrt(4.0 / 5.0)], rtol=1e-9)


def test_beyond_the_breakdown_no_gains_are_given_however_near_it_is() -> None:
    """xdot = -x + u + w, all costs and the noise 1: P = (sqrt(1 + g) - 1) / g with g = 1 - theta, up to g = -1."""

    def solve(theta: float) -> float:
        regulator = continuous_regulator([[-1.0]], [[1.0]], [[1.0]], 1.0, noise=[[1.0]], risk=theta)
        return float(regulator.value[0, 0])

    beyond = 2.0 + np.logspace(-8, 1, 91)
    for theta in beyond:
        with pytest.raises(ValueError, match="breakdown"):
            solve(theta)
    for g in -1.0 + np.logspace(-6, -0.1, 20):
        assert solve(1.0 - g) == pytest.approx((np.sqrt(1.0 + g) - 1.0) / g, rel=1e-6)


@pytest.mark.parametrize("regulator", [continuous_regulator, discrete_regulator])
def test_risk_beyond_the_breakdown_and_bad_systems_are_refused(regulator: Callable[..., object]) -> None:
    A, B = np.array([[0.5]]), np.array([[1.0]])
    with pytest.raises(ValueError, match="breakdown"):
        regulator(A, B, [[4.0]], 0.25, noise=[[0.5]], risk=9.0)
    with pytest.raises(ValueError, match="A has shape"):
        regulator(np.eye(2), B, [[4.0]], 0.25)
    with pytest.raises(ValueError, match="positive definite"):
        regulator(A, B, [[4.0]], 0.0)
    with pytest.raises(ValueError, match="finite"):
        regulator(A, B, [[np.nan]], 1.0)
    with pytest.raises(ValueError, match="semidefinite"):
        regulator(A, B, [[4.0]], 0.25, noise=[[-0.5]], risk=0.1)
    with pytest.raises(ValueError, match="no stabilising"):
        regulator(np.diag([0.5, 2.0]), [[1.0], [0.0]], np.eye(2), 1.0)


@pytest.mark.parametrize(
    ("precision", "control_cost", "bounds", "message"),
    [
        (np.ones((2, 3)), 1.0, {}, "square"),
        (np.full((2, 2), np.nan), 1.0, {}, "not finite"),
        (np.diag([1.0, -1.0]), 1.0, {}, "semidefinite"),
        (np.eye(2), 0.0, {}, "positive"),
        (np.eye(2), [1.0, 1.0, 1.0], {}, "shape"),
        (np.eye(2), 1.0, {"min_stiffness": 3.0, "max_stiffness": 1.0}, "min_stiffness"),
    ],
)
def test_bad_input_is_refused(precision: np.ndarray, control_cost: object, bounds: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        double_integrator_gains(precision, control_cost, **bounds)
    if message == "square":
        with pytest.raises(ValueError, match="shape"):
            riccati_gains(np.eye(2), np.eye(3), 1.0)


def test_riccati_without_position_cost_is_refused() -> None:
    with pytest.raises(ValueError, match="stabilising"):
        riccati_gains(np.zeros((2, 2)), np.zeros((2, 2)), 1.0)
