# SPDX-License-Identifier: Apache-2.0
"""The scripted teacher: human-like variation, smooth intentions, bounded forces."""

from __future__ import annotations

import numpy as np

from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.geometry.pose import pose_error
from tpgmm_demos.scene.pick_place import hand_at, random_placement
from tpgmm_demos.teaching.teacher import Intention, Teacher, TeacherConfig

HOME = np.array([0.58, 0.18, 0.11, 0.0, 1.0, 0.0, 0.0])
SITUATION = random_placement(np.random.default_rng(0))


def intention(seed: int = 0) -> Intention:
    return Intention(HOME, SITUATION, TeacherConfig(), np.random.default_rng(seed))


def test_it_begins_at_home_rests_at_the_object_and_ends_at_the_target() -> None:
    wanted = intention()
    assert pose_error(wanted.at(0.0)[0], HOME)[0] < 0.01
    end, resting = wanted.at(wanted.duration)
    assert resting
    position, angle = pose_error(end, hand_at(SITUATION.target))
    assert position < 0.01 and angle < 0.05
    rests = [wanted.at(time)[0] for time in np.linspace(0, wanted.duration, 500) if wanted.at(time)[1]]
    assert min(pose_error(pose, hand_at(SITUATION.object))[0] for pose in rests) < 0.01


def test_it_moves_smoothly_and_without_haste() -> None:
    wanted = intention()
    times = np.arange(0.0, wanted.duration, 0.005)
    path = [wanted.at(time)[0] for time in times]
    speed = np.array([np.linalg.norm(POSE.log(a, b)[:3]) for a, b in zip(path, path[1:], strict=False)]) / 0.005
    assert 0.2 < speed.max() < 0.4
    assert np.abs(np.diff(speed)).max() / 0.005 < 1.0  # m/s²


def test_no_demonstration_is_like_another_and_a_seed_gives_the_same_again() -> None:
    durations = [intention(seed).duration for seed in range(8)]
    assert len(set(durations)) == 8 and max(durations) / min(durations) < 1.7
    np.testing.assert_array_equal(intention(3).at(4.0)[0], intention(3).at(4.0)[0])
    assert pose_error(intention(1).at(5.0)[0], intention(2).at(5.0)[0])[0] > 1e-3


def test_forces_pull_towards_the_intention_and_are_bounded() -> None:
    config = TeacherConfig()
    teacher = Teacher(intention(), config)
    left = HOME - [0.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert teacher.wrench(0.0, left)[1] > 0.0
    far = HOME + [2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    for time in (0.01, 0.02, 5.0):
        wrench = teacher.wrench(time, far)
        assert np.isfinite(wrench).all()
        assert np.abs(wrench[:3]).max() <= config.max_force and np.abs(wrench[3:]).max() <= config.max_torque


def test_an_offset_that_is_seen_at_rest_is_corrected_more_and_more() -> None:
    wanted = intention()
    times = np.arange(0.0, wanted.duration, 0.01)
    resting = [time for time in times if wanted.at(time)[1]]
    begin = resting[0]
    during = [time for time in resting if time < begin + 0.5]
    teacher = Teacher(wanted, TeacherConfig())
    goal = wanted.at(begin)[0]
    hand = goal + [0.005, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    pulls = [teacher.wrench(time, hand)[0] for time in during]
    assert pulls[-1] < 1.5 * pulls[2] < 0.0
