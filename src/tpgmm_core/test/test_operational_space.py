# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from tpgmm_core.operational_space import OperationalSpace, bounded_twist


@pytest.fixture
def arm() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(7, 7))
    return rng.normal(size=(6, 7)), X @ X.T + np.eye(7)


def test_away_from_singularities_the_inertia_is_exact(arm: tuple[np.ndarray, np.ndarray]) -> None:
    J, M = arm
    hand = OperationalSpace.at(J, M, length=0.3, max_inertia=1e9)
    np.testing.assert_allclose(np.linalg.inv(hand.inertia), J @ np.linalg.inv(M) @ J.T, rtol=1e-7, atol=1e-9)
    acceleration = np.arange(6.0)
    np.testing.assert_allclose(J @ np.linalg.solve(M, hand.torques @ acceleration), acceleration, atol=1e-8)


def test_null_space_torques_do_not_accelerate_the_hand(arm: tuple[np.ndarray, np.ndarray]) -> None:
    J, M = arm
    hand = OperationalSpace.at(J, M, length=0.3, max_inertia=1e9)
    tau = hand.null_space(np.arange(7.0))
    assert np.abs(tau).max() > 0.1
    np.testing.assert_allclose(J @ np.linalg.solve(M, tau), 0.0, atol=1e-9)


def test_in_a_singular_direction_the_inertia_stays_bounded(arm: tuple[np.ndarray, np.ndarray]) -> None:
    J, M = arm
    J[0] = 0.0  # nothing moves the hand along x
    hand = OperationalSpace.at(J, M, length=1.0, max_inertia=50.0)
    assert hand.inertia[0, 0] == pytest.approx(50.0)
    assert np.linalg.eigvalsh(hand.inertia)[-1] <= 50.0 * (1 + 1e-9)


def test_a_twist_is_shortened_in_its_own_direction() -> None:
    twist = np.array([3.0, 0.0, 4.0, 0.0, 0.5, 0.0])
    np.testing.assert_allclose(bounded_twist(twist, 1.0, 1.0), [0.6, 0.0, 0.8, 0.0, 0.5, 0.0])
    np.testing.assert_allclose(bounded_twist(twist, 9.0, 0.1), [3.0, 0.0, 4.0, 0.0, 0.1, 0.0])
    assert bounded_twist(twist, 9.0, 1.0) is twist
