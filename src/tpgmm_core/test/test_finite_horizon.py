# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from tpgmm_core.control.finite_horizon import double_integrator, finite_horizon_gains
from tpgmm_core.control.lqr import double_integrator_gains


def problem(seed: int, n: int = 4, m: int = 2, T: int = 6) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    X, Y = rng.normal(size=(T + 1, n, 2)), rng.normal(size=(m, m))
    return A, B, X @ X.swapaxes(1, 2), Y @ Y.T + np.eye(m), rng.normal(size=(T + 1, n))


def follow(A: np.ndarray, B: np.ndarray, law: object, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    states, controls = [x], []
    for K, k in zip(law.gains, law.feedforward, strict=True):
        controls.append(k - K @ states[-1])
        states.append(A @ states[-1] + B @ controls[-1])
    return np.array(states), np.array(controls)


@pytest.mark.parametrize("seed", range(5))
def test_the_recursion_finds_the_minimum_of_the_whole_sum(seed: int) -> None:
    """Against one least-squares problem over all controls at once."""
    A, B, Q, R, r = problem(seed)
    (n, m), T = B.shape, len(Q) - 1
    x0 = np.arange(n, dtype=float)
    free = np.concatenate([np.linalg.matrix_power(A, t) @ x0 for t in range(T + 1)])
    response = np.zeros(((T + 1) * n, T * m))
    for t in range(1, T + 1):
        for s in range(t):
            response[t * n : (t + 1) * n, s * m : (s + 1) * m] = np.linalg.matrix_power(A, t - 1 - s) @ B
    cost = np.zeros(((T + 1) * n, (T + 1) * n))
    for t in range(T + 1):
        cost[t * n : (t + 1) * n, t * n : (t + 1) * n] = Q[t]
    normal = response.T @ cost @ response + np.kron(np.eye(T), R)
    expected = np.linalg.solve(normal, response.T @ cost @ (r.ravel() - free)).reshape(T, m)
    _, controls = follow(A, B, finite_horizon_gains(A, B, Q, R, r), x0)
    np.testing.assert_allclose(controls, expected, rtol=1e-7, atol=1e-9)


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
        ({"r": np.full((7, 4), np.nan)}, "finite"),
    ],
)
def test_bad_input_is_refused(change: dict, message: str) -> None:
    given = {**dict(zip("ABQRr", problem(0), strict=True)), **change}
    with pytest.raises(ValueError, match=message):
        finite_horizon_gains(given["A"], given["B"], given["Q"], given["R"], given["r"])
