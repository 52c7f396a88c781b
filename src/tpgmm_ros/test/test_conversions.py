# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back; what is no proper message is refused with the reason."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import JointState

from tpgmm_core import Frame, Gaussian
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_msgs.msg import Gaussian as GaussianMessage
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader, MessageError

POSE = np.array([0.5, -0.1, 0.2, *quaternion.exp([0.1, -0.2, 0.3])])
COVARIANCE = np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]) + 0.01


@given(st.integers(min_value=-(2**31) * 10**9, max_value=2**31 * 10**9 - 1))
def test_times_survive_both_ways_to_the_nanosecond(nanoseconds: int) -> None:
    assert conversions.time_to_ns(conversions.time_from_ns(nanoseconds)) == nanoseconds


def test_a_time_has_its_seconds_and_nanoseconds() -> None:
    assert conversions.time_from_ns(3_000_000_007) == Time(sec=3, nanosec=7)


def test_poses_and_wrenches_survive_both_ways() -> None:
    message = conversions.pose_stamped(POSE, 1_500_000_000, "base")
    assert message.header.frame_id == "base" and message.header.stamp == Time(sec=1, nanosec=500_000_000)
    np.testing.assert_array_equal(conversions.pose_to_array(message.pose), POSE)
    wrench = conversions.wrench_from_array(np.arange(6.0), 0, "left_gripper")
    assert wrench.wrench.force.z == 2.0 and wrench.wrench.torque.x == 3.0
    np.testing.assert_array_equal(conversions.wrench_to_array(wrench), np.arange(6.0))


def test_a_wrench_that_is_not_finite_is_refused_and_names_its_link() -> None:
    with pytest.raises(MessageError, match="left_gripper"):
        conversions.wrench_to_array(conversions.wrench_from_array([np.inf, 0, 0, 0, 0, 0], 0, "left_gripper"))


def test_a_gaussian_of_a_pose_has_the_covariance_of_pose_with_covariance() -> None:
    message = conversions.pose_with_covariance(Gaussian(POSE, COVARIANCE, Manifold.parse("R3 x S3")), 0, "base")
    np.testing.assert_array_equal(np.reshape(message.pose.covariance, (6, 6)), COVARIANCE)
    np.testing.assert_allclose(conversions.pose_to_array(message.pose.pose), POSE, atol=1e-15)


def tracked(status: FrameStatus = FrameStatus.VISIBLE, confidence: float = 1.0) -> TaskParameters:
    pose = None if status is FrameStatus.MISSING else POSE
    frames = [
        TrackedFrame("object", status, confidence, 42, pose, None if pose is None else COVARIANCE),
        TrackedFrame("far", FrameStatus.MISSING, 0, 0, None),
    ]
    return conversions.task_parameters_message(frames, 7, "base")


def test_task_parameters_survive_both_ways() -> None:
    message = tracked(FrameStatus.HELD, 0.5)
    assert message.header.frame_id == "base" and conversions.time_to_ns(message.frames[0].stamp) == 42
    states = conversions.task_parameters(message)
    assert states["object"].weight == 0.5 and states["object"].status is FrameStatus.HELD
    assert states["far"].frame is None and states["far"].weight == 0.0
    assert states["object"].frame == Frame.from_pose(POSE[:3], POSE[3:], COVARIANCE)


def change(name: str, value: object) -> Callable[[TaskParameters], None]:
    return lambda message: setattr(message.frames[0], name, value)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (change("rows", 0), "0 x 7"),
        (change("cols", 100_000), "100000"),
        (change("rows", 6), "expected 42 and 6"),
        (change("b", array("d")), "0 in b"),
        (change("a", array("d", [np.nan] * 49)), "finite"),
        (change("pose_covariance", array("d", [1.0])), "1 numbers in pose_covariance"),
        (change("pose_covariance", array("d", [1e12] * 36)), "36 of 1e"),
        (change("pose_covariance", array("d", -np.eye(6).ravel())), "no negative eigenvalue"),
        (change("status", 9), "status 9"),
        (change("confidence", 1.5), "confidence 1.5"),
        (change("confidence", -0.1), "confidence -0.1"),
        (change("confidence", np.nan), "confidence nan"),
        (change("name", "far"), "twice"),
    ],
)
def test_task_parameters_that_contradict_themselves_are_refused_with_the_reason(
    spoil: Callable[[TaskParameters], None], reason: str
) -> None:
    message = tracked()
    spoil(message)
    with pytest.raises(MessageError, match=reason):
        conversions.task_parameters(message)


def reference() -> Reference:
    gaussian = Gaussian(POSE, COVARIANCE, Manifold.parse("R3 x S3"))
    return Reference(0.25, gaussian, 0.02, (gaussian, gaussian), np.array([0.25, 0.75]), ("object", "robot"))


def test_references_survive_both_ways() -> None:
    message = conversions.reference_message(reference(), ("x", "y", "z", "qx", "qy", "qz", "qw"), 7, "base")
    assert message.header.frame_id == "base" and list(message.dimensions)[-1] == "qw"
    back = conversions.reference(message)
    assert back.phase == 0.25 and back.frames == ("object", "robot") and back.horizon_time_step == 0.02
    assert len(back.horizon) == 2 and str(back.gaussian.manifold) == "R3 x S3"
    np.testing.assert_allclose(back.gaussian.mean, POSE, atol=1e-15)
    np.testing.assert_array_equal(back.gaussian.covariance, COVARIANCE)
    np.testing.assert_array_equal(back.activations, [0.25, 0.75])


def test_a_euclidean_gaussian_of_any_size_survives_both_ways() -> None:
    back = conversions.gaussian(conversions.gaussian_message(Gaussian([1.0, 2.0], np.eye(2))))
    np.testing.assert_array_equal(back.mean, [1.0, 2.0])
    assert back.manifold.dim == 2


@pytest.mark.parametrize(
    ("manifold", "mean", "covariance", "reason"),
    [
        ("R3 x S9", np.ones(7), np.eye(6), "S9"),
        ("R3 x S3", np.ones(6), np.eye(6), "expected 7 and 36"),
        ("R3 x S3", np.ones(7), np.eye(7), "expected 7 and 36"),
        ("R3 x S3", np.r_[np.nan, np.ones(6)], np.eye(6), "finite"),
        ("R3 x S3", np.zeros(7), np.eye(6), "quaternion"),
        ("R3 x S3", np.ones(7), np.triu(np.ones((6, 6))), "symmetric"),
        ("euclidean", np.ones(0), np.ones((0, 0)), "0 numbers"),
        ("euclidean", np.ones(1000), np.ones((1, 1)), "1000 numbers"),
    ],
)
def test_a_gaussian_that_is_none_is_refused_with_the_reason(
    manifold: str, mean: np.ndarray, covariance: np.ndarray, reason: str
) -> None:
    message = GaussianMessage(manifold=manifold, mean=array("d", mean), covariance=array("d", covariance.ravel()))
    with pytest.raises(MessageError, match=reason):
        conversions.gaussian(message)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["phase", "horizon_time_step"])
def test_a_reference_whose_times_are_not_finite_is_refused(name: str, value: float) -> None:
    message = conversions.reference_message(reference(), (), 0, "base")
    setattr(message, name, value)
    with pytest.raises(MessageError, match="not finite"):
        conversions.reference(message)


def joint_state(names: list[str], position: list[float]) -> JointState:
    return conversions.joint_state_message(names, 0, position=np.array(position))


def test_joints_are_read_by_name_in_any_order_and_among_others() -> None:
    reader = JointReader(["a", "b"])
    for names, position in ((["a", "b"], [1, 2]), (["b", "a"], [2, 1]), (["x", "b", "y", "a"], [8, 2, 9, 1])):
        np.testing.assert_array_equal(reader.read(joint_state(names, position), "position")[0], [1.0, 2.0])


@pytest.mark.parametrize(
    ("names", "position", "reason"),
    [
        (["a"], [1.0], "joints missing: b"),
        (["a", "b", "a"], [1.0, 2.0, 3.0], "twice"),
        (["a", "b"], [1.0], "1 numbers for 2 joint names"),
        (["a", "b"], [1.0, np.nan], "position of b is not finite"),
    ],
)
def test_joint_states_that_cannot_be_read_are_refused_with_the_reason_and_the_next_one_is_read(
    names: list[str], position: list[float], reason: str
) -> None:
    reader = JointReader(["a", "b"])
    with pytest.raises(MessageError, match=reason):
        reader.read(joint_state(names, position), "position")
    np.testing.assert_array_equal(reader.read(joint_state(["b", "a"], [2, 1]), "position")[0], [1.0, 2.0])


def test_a_joint_that_is_not_asked_for_may_be_anything() -> None:
    reader = JointReader(["a"])
    np.testing.assert_array_equal(reader.read(joint_state(["a", "b"], [1.0, np.nan]), "position")[0], [1.0])
