# SPDX-License-Identifier: Apache-2.0
"""The world of the pick-and-place task: poses, regions, the gripper."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import pose_error
from tpgmm_demos.demo.world import Disturbances
from tpgmm_demos.scene.pick_place import (
    CLEARANCE,
    OBJECT_REGION,
    TARGET_REGION,
    Grasp,
    hand_at,
    random_placement,
)

RANDOM = np.random.default_rng(0)
LIES = np.array([0.6, 0.4, 0.0, *quaternion.exp([0.0, 0.0, 0.5])])
HOME = np.array([0.5, 0.2, 0.3, 0.0, 1.0, 0.0, 0.0])


def test_the_hand_is_above_the_object_and_looks_down() -> None:
    at, above = hand_at(LIES), hand_at(LIES, CLEARANCE)
    np.testing.assert_allclose(above - at, [0, 0, CLEARANCE, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(quaternion.rotation_matrix(at[3:]) @ [0, 0, 1], [0, 0, -1], atol=1e-12)


def test_situations_lie_in_their_regions_and_follow_from_the_seed() -> None:
    for seed in range(50):
        situation = random_placement(np.random.default_rng(seed))
        for pose, region in ((situation.object, OBJECT_REGION), (situation.target, TARGET_REGION)):
            assert (pose[:3] >= region.lower).all() and (pose[:3] <= region.upper).all()
            up = quaternion.rotation_matrix(pose[3:])[2, 2]
            assert np.arccos(np.clip(up, -1.0, 1.0)) <= region.tilt + 1e-6
    again = random_placement(np.random.default_rng(49))
    np.testing.assert_array_equal(again.object, situation.object)


def test_the_gripper_closes_only_when_the_hand_has_rested_at_the_object() -> None:
    grasp = Grasp(LIES)
    grasp.update(HOME, 0.0)
    grasp.update(hand_at(LIES), 1.0)
    grasp.update(hand_at(LIES), 1.0 + 0.9 * Grasp.DWELL)
    assert not grasp.holds
    grasp.update(HOME, 1.5)  # it went away again
    grasp.update(hand_at(LIES), 2.0)
    assert not grasp.holds
    grasp.update(hand_at(LIES), 2.01 + Grasp.DWELL)
    assert grasp.holds


@pytest.mark.parametrize("speed", [0.02, 0.05])
def test_the_gripper_does_not_close_while_the_hand_moves_or_turns_past_the_object(speed: float) -> None:
    """As in a run whose arm came with a motor at its limit: 8 to 14 mm off, and still moving. Speeds in m/s."""
    grasp = Grasp(LIES)
    for tick in range(200):
        time = 0.01 * tick
        off = -0.02 + speed * time
        grasp.update(hand_at(LIES + [off, 0, 0, 0, 0, 0, 0]), time)
        assert not grasp.holds
    turning = Grasp(LIES)
    for tick in range(100):
        turn = quaternion.multiply(quaternion.exp([0.0, 0.0, 0.13 * np.sin(0.2 * tick)]), LIES[3:])
        turning.update(hand_at(np.concatenate([LIES[:3], turn])), 0.01 * tick)
    assert not turning.holds


def test_a_hand_that_trembles_as_references_with_noise_do_rests() -> None:
    grasp, random = Grasp(LIES), np.random.default_rng(2)
    for tick in range(40):
        off = np.clip(random.normal(0.0, 0.0005, 3), -0.001, 0.001)
        grasp.update(hand_at(LIES + np.append(off, np.zeros(4))), 0.01 * tick)
    assert grasp.holds


def test_a_held_object_moves_and_turns_with_the_hand_and_cannot_be_pushed() -> None:
    grasp = Grasp(LIES)
    for time in (0.0, 1.0):
        grasp.update(hand_at(LIES), time)
    place = np.array([0.6, 0.1, 0.1, *quaternion.exp([0.1, 0.0, -0.5])])
    grasp.update(hand_at(place), 2.0)
    assert pose_error(grasp.object, place) == pytest.approx((0.0, 0.0), abs=1e-7)
    grasp.move_object(LIES)
    assert pose_error(grasp.object, place) == pytest.approx((0.0, 0.0), abs=1e-7)


def test_an_object_that_lies_can_be_pushed() -> None:
    grasp = Grasp(LIES)
    moved = LIES + [0.05, 0, 0, 0, 0, 0, 0]
    grasp.move_object(moved)
    np.testing.assert_array_equal(grasp.object, moved)


def test_disturbances_push_smoothly_by_4_to_6_cm_and_hide_a_frame_for_a_second() -> None:
    disturbances = Disturbances.random(np.random.default_rng(1), duration=10.0)
    times = np.linspace(0.0, 10.0, 2001)
    path = np.array([disturbances.pushed(LIES, time) for time in times])
    np.testing.assert_allclose(path[0], LIES, atol=1e-12)
    assert 0.04 <= np.linalg.norm(path[-1, :3] - path[0, :3]) <= 0.06
    assert np.abs(np.diff(path[:, :3], axis=0)).max() < 1e-3
    hidden = [disturbances.hides("target", time) for time in times]
    assert sum(hidden) * 0.005 == pytest.approx(1.0, abs=0.01)
    assert not any(disturbances.hides("object", time) for time in times)
