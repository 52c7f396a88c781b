# SPDX-License-Identifier: Apache-2.0
from dataclasses import dataclass

import numpy as np
import pytest

from tpgmm_core.control.operational_space import bound_twist, operational_space


@dataclass
class Hand:
    inertia: np.ndarray
    torques: np.ndarray
    accelerations: np.ndarray


def hand_of(J: np.ndarray, M: np.ndarray, length: float, max_inertia: float) -> Hand:
    hand = Hand(np.empty((6, 6)), np.empty((len(M), 6)), np.empty((6, len(M))))
    assert operational_space(J, M, length, max_inertia, hand.inertia, hand.torques, hand.accelerations)
    return hand


@pytest.fixture
def arm() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    X = rng.normal(size=(7, 7))
    return rng.normal(size=(6, 7)), X @ X.T + np.eye(7)


def test_away_from_singularities_the_inertia_is_exact(arm: tuple[np.ndarray, np.ndarray]) -> None:
    J, M = arm
    hand = hand_of(J, M, length=0.3, max_inertia=1e9)
    np.testing.assert_allclose(np.linalg.inv(hand.inertia), J @ np.linalg.inv(M) @ J.T, rtol=1e-7, atol=1e-9)
    acceleration = np.arange(6.0)
    np.testing.assert_allclose(J @ np.linalg.solve(M, hand.torques @ acceleration), acceleration, atol=1e-8)


def test_null_space_torques_do_not_accelerate_the_hand(arm: tuple[np.ndarray, np.ndarray]) -> None:
    J, M = arm
    hand = hand_of(J, M, length=0.3, max_inertia=1e9)
    wanted = np.arange(7.0)
    tau = wanted - hand.torques @ (hand.accelerations @ wanted)
    assert np.abs(tau).max() > 0.1
    np.testing.assert_allclose(J @ np.linalg.solve(M, tau), 0.0, atol=1e-9)


def test_in_a_singular_direction_the_inertia_stays_bounded(arm: tuple[np.ndarray, np.ndarray]) -> None:
    J, M = arm
    J[0] = 0.0  # nothing moves the hand along x
    hand = hand_of(J, M, length=1.0, max_inertia=50.0)
    assert hand.inertia[0, 0] == pytest.approx(50.0)
    assert np.linalg.eigvalsh(hand.inertia)[-1] <= 50.0 * (1 + 1e-9)


@pytest.mark.parametrize(
    ("bounds", "shortened"),
    [
        ((1.0, 1.0), [0.6, 0.0, 0.8, 0.0, 0.5, 0.0]),
        ((9.0, 0.1), [3.0, 0.0, 4.0, 0.0, 0.1, 0.0]),
        ((9.0, 1.0), [3.0, 0.0, 4.0, 0.0, 0.5, 0.0]),
    ],
)
def test_a_twist_is_shortened_in_its_own_direction(bounds: tuple[float, float], shortened: list[float]) -> None:
    twist = np.array([3.0, 0.0, 4.0, 0.0, 0.5, 0.0])
    bound_twist(twist, *bounds)
    np.testing.assert_allclose(twist, shortened)


def test_a_twist_that_is_too_large_to_be_squared_is_shortened_all_the_same() -> None:
    twist = np.full(6, 1e300)
    bound_twist(twist, 3.0, 3.0)
    np.testing.assert_allclose(twist, np.sqrt(3.0))


def test_an_inertia_that_is_none_is_told_and_not_computed_with(arm: tuple[np.ndarray, np.ndarray]) -> None:
    J, M = arm
    out = np.empty((6, 6)), np.empty((7, 6)), np.empty((6, 7))
    assert not operational_space(J, -M, 0.3, 100.0, *out)
    assert not operational_space(J * np.nan, M, 0.3, 100.0, *out)
