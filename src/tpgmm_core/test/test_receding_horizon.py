# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from tpgmm_core.lqr.continuous_horizon import continuous_horizon_gains
from tpgmm_core.lqr.double_integrator import double_integrator_gains, double_integrator_value
from tpgmm_core.lqr.receding_horizon import LARGEST_SHARE, receding_horizon_gains
from tpgmm_core.lqr.riccati import continuous_regulator

CONTROL_COST = 0.02


def random_course(steps: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (steps, n) and covariances (steps, n, n)."""
    rng = np.random.default_rng(5)
    roots = rng.normal(size=(steps, n, n))
    return 0.1 * rng.normal(size=(steps, n)).cumsum(axis=0), 0.01 * (roots @ roots.mT + 0.1 * np.eye(n))


def double_integrator(n: int) -> tuple[np.ndarray, np.ndarray]:
    """A (2n, 2n) and B (2n, n), in continuous time."""
    zero, eye = np.zeros((n, n)), np.eye(n)
    return np.block([[zero, eye], [zero, zero]]), np.vstack([zero, eye])


@pytest.mark.parametrize("steps", [1, 2, 30])
def test_a_gaussian_that_stays_has_the_gains_of_the_infinite_horizon(steps: int) -> None:
    positions, covariances = random_course(1, 4)
    gains = receding_horizon_gains(
        np.tile(positions, (steps, 1)), np.tile(covariances, (steps, 1, 1)), 0.05, CONTROL_COST
    )
    expected = double_integrator_gains(np.linalg.inv(covariances[0]), CONTROL_COST)
    np.testing.assert_allclose(gains.stiffness, expected.stiffness, atol=1e-9)
    np.testing.assert_allclose(gains.damping, expected.damping, atol=1e-9)
    np.testing.assert_allclose(gains.acceleration, 0.0, atol=1e-9)


def test_long_and_short_intervals_agree_whatever_the_fastest_mode() -> None:
    """A long interval of stiff and soft directions is what exponentials are bad at."""
    basis = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    firm_and_soft = basis @ np.diag([1e-8, 1e-2, 1.0]) @ basis.T
    soft = np.diag([1.0, 1e-2, 0.3])
    one = receding_horizon_gains(np.zeros((2, 3)), [firm_and_soft, soft], 2.0, CONTROL_COST)
    many = receding_horizon_gains(np.zeros((201, 3)), [*[firm_and_soft] * 200, soft], 0.01, CONTROL_COST)
    np.testing.assert_allclose(one.stiffness, many.stiffness, rtol=1e-6, atol=1e-6 * np.abs(many.stiffness).max())
    np.testing.assert_allclose(one.damping, many.damping, rtol=1e-6, atol=1e-6 * np.abs(many.damping).max())


def test_it_agrees_with_the_riccati_differential_equation_along_a_course_that_bends() -> None:
    (positions, covariances), n, steps, parts, dt = random_course(6, 3), 3, 5, 200, 0.05
    Q, r = np.zeros((steps * parts + 1, 2 * n, 2 * n)), np.zeros((steps * parts + 1, 2 * n))
    for t in range(steps):
        interval = slice(t * parts, (t + 1) * parts)
        shares = (np.arange(parts)[:, None] + 0.5) / parts
        Q[interval, :n, :n] = np.linalg.inv(covariances[t])
        r[interval, :n] = positions[t] + shares * (positions[t + 1] - positions[t])
    Q[-1] = double_integrator_value(np.linalg.inv(covariances[-1]), CONTROL_COST)
    r[-1] = np.concatenate([positions[-1], (positions[-1] - positions[-2]) / dt])
    expected = continuous_horizon_gains(*double_integrator(n), Q, CONTROL_COST, r, dt / parts)
    gains = receding_horizon_gains(positions, covariances, dt, CONTROL_COST)
    now = np.concatenate([positions[0], (positions[1] - positions[0]) / dt])
    np.testing.assert_allclose(gains.stiffness, expected.stiffness[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(gains.damping, expected.damping[0], rtol=1e-9, atol=1e-9)
    # the lines are stairs there
    np.testing.assert_allclose(gains.acceleration, expected.feedforward[0] - expected.gains[0] @ now, rtol=1e-4)


@pytest.mark.parametrize("risk", [0.4, -0.7])
def test_risk_is_that_of_the_riccati_equation_with_the_covariance_as_noise(risk: float) -> None:
    (positions, covariances), n, risk_stiffness = random_course(1, 3), 3, 25.0
    noise, Q = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    noise[n:, n:], Q[:n, :n] = covariances[0], np.linalg.inv(covariances[0])
    theta = risk * risk_stiffness**2  # of which the share is r theta sigma^2 = risk (risk_stiffness / K_P)^2
    expected = continuous_regulator(*double_integrator(n), Q, CONTROL_COST, noise=noise, risk=theta).gain
    gains = receding_horizon_gains(positions, covariances, 1.0, CONTROL_COST, risk=risk, risk_stiffness=risk_stiffness)
    np.testing.assert_allclose(np.hstack([gains.stiffness, gains.damping]), expected, rtol=1e-6)


def test_risk_along_a_course_agrees_with_the_riccati_differential_equation() -> None:
    (positions, covariances), n, dt, risk, risk_stiffness = random_course(2, 2), 2, 0.1, 0.3, 30.0
    noise, Q = np.zeros((2 * n, 2 * n)), np.zeros((2, 2 * n, 2 * n))
    noise[n:, n:], Q[0, :n, :n] = covariances[0], np.linalg.inv(covariances[0])
    theta, after = risk * risk_stiffness**2, np.zeros((2 * n, 2 * n))
    A, B = double_integrator(n)
    later, end_noise = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    later[:n, :n], end_noise[n:, n:] = np.linalg.inv(covariances[1]), covariances[1]
    after[:] = continuous_regulator(A, B, later, CONTROL_COST, noise=end_noise, risk=theta).value
    Q[1] = after
    expected = continuous_horizon_gains(A, B, Q, CONTROL_COST, np.zeros((2, 2 * n)), dt, noise=noise, risk=theta)
    gains = receding_horizon_gains(
        np.tile(positions[:1], (2, 1)), covariances, dt, CONTROL_COST, risk=risk, risk_stiffness=risk_stiffness
    )
    np.testing.assert_allclose(np.hstack([gains.stiffness, gains.damping]), expected.gains[0], rtol=1e-6)


def test_fear_is_stiffer_hope_softer_and_no_risk_breaks_down() -> None:
    positions, covariances = random_course(4, 3)

    def firmness(risk: float) -> float:
        gains = receding_horizon_gains(positions, covariances, 0.1, CONTROL_COST, risk=risk, risk_stiffness=100.0)
        return float(np.trace(gains.stiffness))

    values = [firmness(risk) for risk in (-10.0, -0.2, 0.0, 0.2, 1e6)]
    assert values == sorted(values)
    alone = receding_horizon_gains(positions[:1], covariances[:1], 0.1, CONTROL_COST)
    feared = receding_horizon_gains(positions[:1], covariances[:1], 0.1, CONTROL_COST, risk=1e6)
    np.testing.assert_allclose(feared.stiffness, alone.stiffness / np.sqrt(1.0 - LARGEST_SHARE))


def test_what_comes_counts_before_it_is_there() -> None:
    """Before it is to be held firmly the hand is stiffer than its Gaussian asks for, and it turns before the corner."""
    soft, firm = np.eye(1) * 0.1**2, np.eye(1) * 0.003**2
    still = np.zeros((4, 1))
    alone = receding_horizon_gains(still, [soft] * 4, 0.05, CONTROL_COST).stiffness
    soon = receding_horizon_gains(still, [soft, soft, soft, firm], 0.05, CONTROL_COST).stiffness
    sooner = receding_horizon_gains(still, [soft, firm, firm, firm], 0.05, CONTROL_COST).stiffness
    assert alone < soon < sooner < 1.0 / (0.003 * np.sqrt(CONTROL_COST))
    turning = receding_horizon_gains([[0.0], [0.0], [0.01]], [firm] * 3, 0.01, CONTROL_COST)
    assert turning.acceleration > 0.0


def test_gains_are_within_the_bounds_that_gaussians_may_ask_for() -> None:
    positions, covariances = random_course(5, 3)
    loose = receding_horizon_gains(np.zeros_like(positions), covariances * 1e9, 0.1, CONTROL_COST, min_stiffness=10.0)
    np.testing.assert_allclose(loose.stiffness, 10.0 * np.eye(3), atol=1e-6)
    tight = receding_horizon_gains(np.zeros_like(positions), covariances * 1e-9, 0.1, CONTROL_COST, max_stiffness=900.0)
    np.testing.assert_allclose(tight.stiffness, 900.0 * np.eye(3), atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"positions": np.zeros((2, 2))}, "covariances"),
        ({"positions": np.full((3, 3), np.nan)}, "finite"),
        ({"time_step": 0.0}, "time step"),
        ({"control_cost": -1.0}, "control cost"),
        ({"min_stiffness": 10.0, "max_stiffness": 1.0}, "min_stiffness"),
    ],
)
def test_what_makes_no_problem_is_refused(change: dict[str, object], words: str) -> None:
    given = {"positions": np.zeros((3, 3)), "covariances": np.tile(np.eye(3), (3, 1, 1)), "time_step": 0.1}
    with pytest.raises(ValueError, match=words):
        receding_horizon_gains(**{**given, "control_cost": CONTROL_COST, **change})  # type: ignore[arg-type]
