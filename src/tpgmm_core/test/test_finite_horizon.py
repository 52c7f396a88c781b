# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from tpgmm_core.lqr.batch import batch_gains, condense
from tpgmm_core.lqr.continuous_horizon import continuous_horizon_gains
from tpgmm_core.lqr.double_integrator import double_integrator, double_integrator_gains
from tpgmm_core.lqr.finite_horizon import FiniteHorizonGains, finite_horizon_gains


def problem(seed: int, n: int = 4, m: int = 2, T: int = 6) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    X, Y = rng.normal(size=(T + 1, n, 2)), rng.normal(size=(m, m))
    return A, B, X @ X.swapaxes(1, 2), Y @ Y.T + np.eye(m), rng.normal(size=(T + 1, n))


def follow(A: np.ndarray, B: np.ndarray, law: FiniteHorizonGains, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    states, controls = [x], []
    A, B = np.broadcast_to(A, (len(law.gains), *A.shape[-2:])), np.broadcast_to(B, (len(law.gains), *B.shape[-2:]))
    for K, k, A_t, B_t in zip(law.gains, law.feedforward, A, B, strict=True):
        controls.append(k - K @ states[-1])
        states.append(A_t @ states[-1] + B_t @ controls[-1])
    return np.array(states), np.array(controls)


@pytest.mark.parametrize("seed", range(5))
def test_the_recursion_and_the_batch_form_agree(seed: int) -> None:
    A, B, Q, R, r = problem(seed)
    x0 = np.arange(A.shape[-1], dtype=float)
    _, controls = follow(A, B, finite_horizon_gains(A, B, Q, R, r), x0)
    np.testing.assert_allclose(batch_gains(A, B, Q, R, r).controls(x0), controls, rtol=1e-9, atol=1e-9)


def test_both_forms_take_systems_and_costs_that_vary() -> None:
    rng = np.random.default_rng(7)
    A, B, Q, R, r = problem(7)
    A, B = A + 0.3 * rng.normal(size=(6, 4, 4)), B + 0.3 * rng.normal(size=(6, 4, 2))
    R = R + np.arange(6.0)[:, None, None] * np.eye(2)
    x0 = np.array([1.0, -2.0, 0.5, 0.0])
    law = finite_horizon_gains(A, B, Q, R, r)
    _, controls = follow(A, B, law, x0)
    batch = batch_gains(A, B, Q, R, r)
    np.testing.assert_allclose(batch.controls(x0), controls, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(batch.gain[0], law.gains[0], rtol=1e-9, atol=1e-9)
    condensed = condense(A, B, 6)
    states, _ = follow(A, B, law, x0)
    np.testing.assert_allclose(condensed.states(x0, controls.ravel()), states, rtol=1e-9, atol=1e-9)


def test_no_other_controls_cost_less() -> None:
    """The cost itself, summed up as it is defined, is least at the batch solution."""
    A, B, Q, R, r = problem(2)
    x0 = np.ones(4)

    def cost(controls: np.ndarray) -> float:
        x, total = x0, 0.0
        for t, u in enumerate(controls):
            total += (x - r[t]) @ Q[t] @ (x - r[t]) + u @ R @ u
            x = A @ x + B @ u
        return total + (x - r[-1]) @ Q[-1] @ (x - r[-1])

    best = batch_gains(A, B, Q, R, r).controls(x0)
    changes = 1e-3 * np.random.default_rng(0).normal(size=(50, *best.shape))
    assert all(cost(best + change) > cost(best) for change in changes)


def test_stiffness_damping_and_feedforward_are_the_same_law() -> None:
    D, dt = 3, 0.02
    A, B = double_integrator(D, dt)
    rng = np.random.default_rng(0)
    X, r, x = rng.normal(size=(21, 6, 6)), rng.normal(size=(21, 6)), rng.normal(size=6)
    law = finite_horizon_gains(A, B, X @ X.swapaxes(1, 2), 0.1, r)
    u = law.stiffness[4] @ (r[4] - x)[:D] + law.damping[4] @ (r[4] - x)[D:] + law.feedforward_at(r)[4]
    np.testing.assert_allclose(u, law.feedforward[4] - law.gains[4] @ x, rtol=1e-9, atol=1e-9)


def test_short_steps_have_the_gains_of_continuous_time() -> None:
    D, T, dt = 2, 400, 2e-3
    rng = np.random.default_rng(1)
    X = rng.normal(size=(D, D))
    A, B = np.block([[np.zeros((D, D)), np.eye(D)], [np.zeros((D, 2 * D))]]), np.vstack([np.zeros((D, D)), np.eye(D)])
    Q = np.zeros((T + 1, 2 * D, 2 * D))
    Q[:, :D, :D] = 50.0 * (X @ X.T + np.eye(D)) * (1.0 + np.linspace(0.0, 1.0, T + 1))[:, None, None]
    Q[:, D:, D:] = 0.5 * np.eye(D)
    r = np.zeros((T + 1, 2 * D))
    r[:, :D] = np.sin(np.linspace(0.0, 2.0, T + 1))[:, None]
    noise = 1e-3 * np.eye(2 * D)
    for risk in (0.0, 0.5):
        exact = continuous_horizon_gains(A, B, Q, 0.2, r, dt, noise=noise, risk=risk)
        steps = np.concatenate([dt * Q[:-1], Q[-1:]])
        sampled = finite_horizon_gains(*double_integrator(D, dt), steps, 0.2 * dt, r, noise=dt * noise, risk=risk)
        np.testing.assert_allclose(sampled.gains, exact.gains, rtol=0.03, atol=0.03 * np.abs(exact.gains).max())
        largest = np.abs(exact.feedforward).max()
        np.testing.assert_allclose(sampled.feedforward, exact.feedforward, rtol=0.03, atol=0.03 * largest)


def test_continuous_time_with_a_long_horizon_is_the_closed_form() -> None:
    precision = np.array([[30.0, 5.0], [5.0, 4.0]])
    A, B = np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 4))]]), np.vstack([np.zeros((2, 2)), np.eye(2)])
    Q = np.zeros((101, 4, 4))
    Q[:-1, :2, :2] = precision
    r = np.tile([0.3, -0.2, 0.0, 0.0], (101, 1))
    law = continuous_horizon_gains(A, B, Q, 0.1, r, 0.1)
    gains = double_integrator_gains(precision, 0.1)
    np.testing.assert_allclose(law.gains[0], np.hstack([gains.stiffness, gains.damping]), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(law.feedforward_at(r)[0], 0.0, atol=1e-8)


@pytest.mark.parametrize("risk", [-0.02, 0.004, 0.02])
def test_risk_sensitive_gains_minimise_the_risk_they_name(risk: float) -> None:
    """Against the definition: the logarithm of the expected exponential, as a determinant over all noise at once."""
    A, B, Q, R, r = problem(3, T=4)
    W = 0.02 * np.eye(4)
    x0 = np.array([0.3, -0.1, 0.2, 0.0])

    def objective(law: FiniteHorizonGains) -> float:
        # states are affine in the noise: x = c + G w; the cost is q + 2 g^T w + w^T H w
        c, G = x0, np.zeros((4, 16))
        q, g, H = 0.0, np.zeros(16), np.zeros((16, 16))
        for t in range(5):
            e = c - r[t]
            q, g, H = q + e @ Q[t] @ e, g + G.T @ Q[t] @ e, H + G.T @ Q[t] @ G
            if t < 4:
                u, U = law.feedforward[t] - law.gains[t] @ c, -law.gains[t] @ G
                q, g, H = q + u @ R @ u, g + U.T @ R @ u, H + U.T @ R @ U
                c, G = A @ c + B @ u, A @ G + B @ U
                G[:, 4 * t : 4 * t + 4] += np.eye(4)
        S = np.linalg.inv(np.kron(np.eye(4), W)) - risk * H
        assert np.linalg.eigvalsh(S)[0] > 0.0
        sign, logarithm = np.linalg.slogdet(np.kron(np.eye(4), W) @ S)
        return float(q + risk * g @ np.linalg.solve(S, g) - logarithm / risk)

    best = finite_horizon_gains(A, B, Q, R, r, noise=W, risk=risk)
    rng = np.random.default_rng(0)
    least = objective(best)
    for _ in range(30):
        other = FiniteHorizonGains(
            best.gains + 1e-3 * rng.normal(size=best.gains.shape),
            best.feedforward + 1e-3 * rng.normal(size=best.feedforward.shape),
        )
        assert objective(other) > least


def test_without_risk_noise_changes_nothing_and_little_risk_little() -> None:
    A, B, Q, R, r = problem(4)
    plain = finite_horizon_gains(A, B, Q, R, r)
    W = 0.01 * np.eye(4)
    np.testing.assert_array_equal(finite_horizon_gains(A, B, Q, R, r, noise=W).gains, plain.gains)
    slight = finite_horizon_gains(A, B, Q, R, r, noise=W, risk=1e-9)
    np.testing.assert_allclose(slight.gains, plain.gains, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(slight.feedforward, plain.feedforward, rtol=1e-5, atol=1e-5)


def test_risk_aversion_stiffens_where_noise_enters() -> None:
    A, B = double_integrator(2, 0.05)
    Q, r = np.zeros((21, 4, 4)), np.zeros((21, 4))
    Q[:, :2, :2] = np.eye(2)
    noise = np.diag([0.0, 0.0, 0.05, 0.0])
    neutral = finite_horizon_gains(A, B, Q, 1.0, r)
    averse = finite_horizon_gains(A, B, Q, 1.0, r, noise=noise, risk=0.5)
    assert averse.stiffness[0, 0, 0] > 1.1 * neutral.stiffness[0, 0, 0]
    assert averse.stiffness[0, 1, 1] == pytest.approx(neutral.stiffness[0, 1, 1], rel=1e-9)


def test_risk_beyond_the_breakdown_is_refused() -> None:
    A, B = double_integrator(1, 0.05)
    Q, r, noise = np.tile(np.eye(2), (41, 1, 1)), np.zeros((41, 2)), 0.1 * np.eye(2)
    with pytest.raises(ValueError, match="beyond the breakdown: from step 39 of 40 on"):
        finite_horizon_gains(A, B, Q, 1.0, r, noise=noise, risk=10.1)  # 1 / (noise * terminal cost) = 10
    with pytest.raises(ValueError, match="beyond the breakdown"):
        finite_horizon_gains(A, B, Q, 1.0, r, noise=noise, risk=9.9)  # later: what has still to come adds up
    with pytest.raises(ValueError, match="beyond the breakdown"):
        continuous_horizon_gains([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], Q, 1.0, r, 0.05, noise=noise, risk=30.0)


@pytest.mark.parametrize(
    ("A", "B", "Q"),
    [([[2.0]], [[0.0]], np.ones((601, 1, 1))), ([[1.0]], [[1.0]], np.array([[[0.0]], [[-1.0]]]))],
    ids=["a value that grows beyond all numbers", "a cost of an end that is a gain"],
)
def test_a_step_without_gains_is_told(A: list, B: list, Q: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"not semidefinite, or grow beyond all numbers: step \d+ of \d+ has no gains"):
        finite_horizon_gains(A, B, Q, 1.0, np.zeros((len(Q), 1)))


def test_a_long_horizon_has_the_gains_of_the_infinite_one() -> None:
    D, dt, r = 2, 1e-3, 0.1
    precision = np.array([[30.0, 5.0], [5.0, 4.0]])
    A, B = double_integrator(D, dt)
    Q = np.zeros((6000, 2 * D, 2 * D))
    Q[:, :D, :D] = precision * dt
    law = finite_horizon_gains(A, B, Q, r * dt, np.zeros((6000, 2 * D)))
    gains = double_integrator_gains(precision, r)
    np.testing.assert_allclose(law.gains[0], np.hstack([gains.stiffness, gains.damping]), rtol=0.01, atol=0.01)


def test_precise_references_are_met_and_vague_ones_are_not_cared_for() -> None:
    A, B = double_integrator(1, 0.05)
    Q, r = np.zeros((41, 2, 2)), np.zeros((41, 2))
    Q[20, 0, 0], r[20, 0] = 1e8, 1.0
    Q[40, 0, 0], r[40, 0] = 1e-8, 50.0
    states, _ = follow(A, B, finite_horizon_gains(A, B, Q, 1.0, r), np.zeros(2))
    assert states[20, 0] == pytest.approx(1.0, abs=1e-4)
    assert states[40, 0] < 5.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": np.eye(3)}, "A has shape"),
        ({"Q": np.zeros((7, 3, 3))}, "state_costs have shape"),
        ({"Q": np.zeros((1, 4, 4)), "r": np.zeros((1, 4))}, "state_costs have shape"),
        ({"r": np.zeros((6, 4))}, "references"),
        ({"R": np.eye(3)}, "control_cost has shape"),
        ({"R": 0.0}, "positive definite"),
        ({"A": np.zeros((3, 4, 4))}, "A has 3 time steps"),
        ({"r": np.full((7, 4), np.nan)}, "finite"),
    ],
)
def test_bad_input_is_refused(change: dict, message: str) -> None:
    given = {**dict(zip("ABQRr", problem(0), strict=True)), **change}
    with pytest.raises(ValueError, match=message):
        finite_horizon_gains(given["A"], given["B"], given["Q"], given["R"], given["r"])
