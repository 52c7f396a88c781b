# SPDX-License-Identifier: Apache-2.0
"""Messages of anyone: whatever sizes and numbers they hold, they are refused in words, or become sound arrays.

`make test` tries some messages, `make fuzz` (TPGMM_FUZZ_EXAMPLES=20000) as many as it says.
"""

from __future__ import annotations

import os
from array import array
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Pose, WrenchStamped
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sensor_msgs.msg import JointState

from tpgmm_core.geometry.coordinates import MAX_TEXT
from tpgmm_core.observation.poses import check_pose
from tpgmm_msgs.msg import Gaussian as GaussianMessage
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_msgs.msg import TaskFrame, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import MAX_DIMENSION, MAX_ITEMS, MAX_WRENCH, JointReader, MessageError
from tpgmm_ros.models.task_model import known_frames

FUZZ = settings(
    max_examples=int(os.environ.get("TPGMM_FUZZ_EXAMPLES", "150")),
    suppress_health_check=[HealthCheck.too_slow],
)
NUMBERS = st.floats(width=64) | st.sampled_from([0.0, -0.0, 1.0, 1e-300, 1e300, np.nan, np.inf, -np.inf])
SIZES = st.integers(0, 9) | st.sampled_from([255, 256, 257, 65535, 65536, 2**31, 2**32 - 1])
NAMES = st.sampled_from(["object", "target", "robot", "", "x" * 5000, "\0", "é"])
SOUND, STRANGE = ["euclidean", "R3 x S3", "R7", "S3"], ["R999999999", "R0", "", "R3 x S2", "R-1"]
MANIFOLDS = st.sampled_from([*SOUND, *STRANGE, "R" + "9" * 5000, " x ".join(["R1"] * 10**5)])


def doubles(values: list[float]) -> array[float]:
    return array("d", values)


def arrays_of(*likely: int) -> st.SearchStrategy[array[float]]:
    """Arrays of a likely size, with numbers that are likely or not, or of any size."""
    sound = st.sampled_from(likely).flatmap(lambda n: st.just([1.0 if i % 7 == 0 else 0.0 for i in range(n)]))
    sized = st.sampled_from(likely).flatmap(lambda n: st.lists(NUMBERS, min_size=n, max_size=n))
    return st.builds(doubles, sound | sized | st.lists(NUMBERS, max_size=60))


@st.composite
def task_frames(draw: st.DrawFn) -> TaskFrame:
    side = st.sampled_from([7, 7, 7, 3, 1]) | SIZES
    status = draw(st.sampled_from([0, 0, 1, 2, 3, 255]))
    frame = TaskFrame(name=draw(NAMES), status=status, rows=draw(side), cols=draw(side))
    frame.confidence = draw(st.sampled_from([1.0, 0.5, 0.0]) | NUMBERS)
    frame.a, frame.b = draw(arrays_of(49, 9, 1, 0)), draw(arrays_of(7, 3, 1, 0))
    frame.pose_covariance = draw(arrays_of(0, 36))
    return frame


@st.composite
def gaussians(draw: st.DrawFn) -> GaussianMessage:
    message = GaussianMessage(manifold=draw(st.sampled_from(["R3 x S3", "euclidean"]) | MANIFOLDS))
    message.mean, message.covariance = draw(arrays_of(7, 4, 3)), draw(arrays_of(36, 49, 9))
    return message


@FUZZ
@given(st.lists(task_frames(), max_size=3))
def test_task_parameters_are_refused_or_become_frames_of_finite_numbers(frames: list[TaskFrame]) -> None:
    try:
        states = conversions.task_parameters(TaskParameters(frames=frames))
    except MessageError as error:
        assert str(error)
        return
    for state in states.values():
        assert 0.0 <= state.weight <= 1.0
        assert state.frame is None or (np.isfinite(state.frame.A).all() and np.isfinite(state.frame.b).all())
    try:
        known_frames(states)
    except ValueError as error:
        assert str(error)


@FUZZ
@given(gaussians(), st.lists(gaussians(), max_size=2), NUMBERS, NUMBERS, arrays_of(0, 3))
def test_references_are_refused_or_become_gaussians_of_finite_numbers(
    gaussian: GaussianMessage, horizon: list[GaussianMessage], phase: float, step: float, activations: array[float]
) -> None:
    message = ReferenceMessage(gaussian=gaussian, horizon=horizon, phase=phase, horizon_time_step=step)
    message.activations = activations
    try:
        reference = conversions.reference(message)
    except MessageError as error:
        assert str(error)
        return
    for item in (reference.gaussian, *reference.horizon):
        n = item.manifold.tangent_dim
        assert item.mean.shape == (item.manifold.dim,) and item.covariance.shape == (n, n)
        assert np.isfinite(item.mean).all() and np.isfinite(item.covariance).all()


@FUZZ
@given(st.lists(st.sampled_from(["a", "b", "c", "d", ""]), max_size=5), arrays_of(3, 4), arrays_of(3, 4))
def test_joint_states_are_refused_or_become_finite_numbers_of_all_joints(
    names: list[str], position: array[float], velocity: array[float]
) -> None:
    reader = JointReader(["a", "b", "c"])
    message = JointState(name=names)
    message.position, message.velocity = position, velocity
    for _ in range(2):  # the order of the names is kept from the first to the second
        try:
            q, v = reader.read(message, "position", "velocity")
        except MessageError as error:
            assert str(error)
        else:
            assert q.shape == v.shape == (3,) and np.isfinite(q).all() and np.isfinite(v).all()
            assert q.tolist() == [position[names.index(name)] for name in "abc"]


@FUZZ
@given(st.lists(NUMBERS, min_size=7, max_size=7))
def test_poses_and_wrenches_are_refused_or_finite(values: list[float]) -> None:
    pose = Pose()
    position, orientation = pose.position, pose.orientation
    position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w = values
    with np.errstate(over="ignore"):
        checked, reason = check_pose(conversions.pose_to_array(pose))
    assert (checked is None) == bool(reason)
    assert checked is None or np.isfinite(checked).all()
    message = WrenchStamped()
    message.wrench.force.x, message.wrench.torque.z = values[:2]
    try:
        assert np.isfinite(conversions.wrench_to_array(message)).all()
    except MessageError:
        assert not np.abs(values[:2]).max() <= MAX_WRENCH


def sized(rows: int, cols: int, a: int, b: int) -> TaskParameters:
    frame = TaskFrame(name="object", confidence=1.0, rows=rows, cols=cols)
    frame.a, frame.b = doubles([0.0] * a), doubles([0.0] * b)
    return TaskParameters(frames=[frame])


@pytest.mark.parametrize(
    "message",
    [
        sized(65536, 65536, 0, 0),  # whose product is 0 in 32 bits
        sized(2**31, 2, 0, 0),
        sized(2**32 - 1, 2**32 - 1, 1, 1),
        sized(MAX_DIMENSION + 1, 1, MAX_DIMENSION + 1, MAX_DIMENSION + 1),
        sized(7, 7, 48, 7),
        sized(7, 7, 49, 8),
        TaskParameters(frames=[TaskFrame(name=str(i), status=2) for i in range(MAX_ITEMS + 1)]),
    ],
)
def test_sizes_that_a_message_says_are_not_trusted(message: TaskParameters) -> None:
    with pytest.raises(MessageError, match="expected"):
        conversions.task_parameters(message)


@pytest.mark.parametrize(
    ("what", "complaint"),
    [
        ({"manifold": "R999999999"}, "expected 999999999"),
        ({"manifold": " x ".join(["R1"] * 7) + " " * MAX_TEXT}, "characters"),
        ({"mean": doubles([0.0] * (MAX_DIMENSION + 1))}, "expected 1 to"),
    ],
)
def test_a_gaussian_of_any_size_is_no_gaussian(what: dict[str, Any], complaint: str) -> None:
    message = GaussianMessage(manifold="R7", mean=doubles([0.0] * 7), covariance=doubles(np.eye(7).ravel().tolist()))
    assert conversions.gaussian(message).manifold.dim == 7
    for key, value in what.items():
        setattr(message, key, value)
    with pytest.raises(MessageError, match=complaint):
        conversions.gaussian(message)
    sound = GaussianMessage(manifold="R1", mean=doubles([0.0]), covariance=doubles([1.0]))
    with pytest.raises(MessageError, match="ahead"):
        conversions.reference(ReferenceMessage(gaussian=sound, horizon=[sound] * (MAX_ITEMS + 1)))
