# SPDX-License-Identifier: Apache-2.0
"""Joint positions that follow pose references: start, limits, weights, stale references."""

import numpy as np
import pytest

from robots import CONFIG
from tpgmm_core.control.joint_stream import JointStream
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.robot.model import RobotModel

DT = 0.01


@pytest.fixture(scope="module")
def robot():
    return RobotModel.from_file(CONFIG / "ur5.yaml")


def pose(robot, q):
    data = robot.create_data()
    data.update(q)
    return data.pose("tool")


def moved(robot, offset):
    place = pose(robot, robot.home)
    place[:3] += offset
    return place


def test_reaches_without_a_jump_and_within_speeds(robot):
    stream, last = JointStream(robot, "tool", robot.home), robot.home[:6].copy()
    reference, speed = PoseReference(moved(robot, [0.1, 0.1, 0.1]), 1e-4 * np.eye(6)), np.zeros(6)
    for _ in range(400):
        step = stream.step(reference, 0.0, DT)
        assert (abs(step.q - last) <= robot.velocity_limits * DT + 1e-9).all()
        assert (abs(step.v - speed) <= 10.0 * DT + 1e-6).all()
        last, speed = step.q, step.v
    assert np.linalg.norm(pose(robot, last)[:3] - reference.pose[:3]) < 1e-3
    assert step.state == "follows"


def test_holds_without_a_fresh_reference(robot):
    stream = JointStream(robot, "tool", robot.home)
    step = stream.step(None, 0.0, DT)
    assert step.q == pytest.approx(robot.home) and step.state == "holds: no reference yet"
    reference = PoseReference(moved(robot, [0.2, 0.0, 0.0]), 1e-4 * np.eye(6))
    for _ in range(20):
        stream.step(reference, 0.0, DT)
    for _ in range(100):
        step = stream.step(reference, 1.0, DT)
    assert step.v == pytest.approx(np.zeros(6)) and "1.00 s old" in step.state


def test_what_matters_little_gives_way_out_of_reach(robot):
    covariance = np.diag([1.0, 1e-6, 1e-6, 1.0, 1.0, 1.0])
    stream, reference = JointStream(robot, "tool", robot.home), PoseReference(moved(robot, [2.0, 0, 0.1]), covariance)
    for _ in range(600):
        step = stream.step(reference, 0.0, DT)
        assert (step.q >= robot.lower_limits).all() and (step.q <= robot.upper_limits).all()
    assert abs(pose(robot, step.q)[1:3] - reference.pose[1:3]).max() < 0.02


def test_start_outside_the_limits_is_refused(robot):
    with pytest.raises(ValueError, match="outside the joint limits: shoulder_pan_joint"):
        JointStream(robot, "tool", robot.home + np.array([7.0, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), np.full((6, 6), np.nan)])
def test_a_reference_that_cannot_be_used_is_not_followed(robot, covariance):
    step = JointStream(robot, "tool", robot.home).step(PoseReference(moved(robot, [0.1, 0, 0]), covariance), 0.0, DT)
    assert step.q == pytest.approx(robot.home) and step.state.startswith("holds: the reference is not finite")
