# SPDX-License-Identifier: Apache-2.0
"""Movements that bags hold as joint states: the pose of a link of the robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from source_messages import TYPES, Message, header, of_type, pose_stamped, task_with, write
from synthetic_bags import REACH_TASK, reach
from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.recordings.bags import BagError, read_recording
from tpgmm_ros.task.task_file import Task

CONFIG = Path(__file__).resolve().parents[3] / "config"


def test_a_movement_is_the_pose_of_a_link_by_the_robots_joints(tmp_path: Path) -> None:
    robot = RobotModel.from_file(CONFIG / "panda.yaml")
    data, joints = robot.create_data(), list(robot.joint_names)
    thing, times = reach(0)["/object/pose"], np.linspace(0.0, 5.0, 100)
    positions = robot.home + 0.3 * np.sin(times)[:, None] * np.arange(1, robot.nv + 1) / robot.nv
    messages = of_type("geometry_msgs/PoseStamped", "/object/pose", thing.poses, thing.recorded, "cup")
    kind = "sensor_msgs/msg/JointState"
    expected = []
    for q, t in zip(positions, times, strict=True):
        state = TYPES[kind](
            header(t, ""), [*joints[::-1], "finger"], np.append(q[::-1], 0.02), np.zeros(0), np.zeros(0)
        )
        messages.append((t, "/joint_states", kind, state))
        data.update(q)
        expected.append(data.pose("hand"))
    entry = {"joint_states": "joint_states", "robot": str(CONFIG / "panda.yaml"), "link": "hand"}
    task = task_with(movement=entry)
    path = write(tmp_path / "demo", messages)
    with pytest.raises(BagError, match="the task has 'base': name the same base_frame"):
        read_recording(path, task)
    for item in messages:
        if item[1] == "/object/pose":
            item[3].header.frame_id = "panda_link0"
    text = yaml.safe_dump(yaml.safe_load(REACH_TASK) | {"base_frame": "panda_link0", "recordings": {"movement": entry}})
    recording = read_recording(write(tmp_path / "right", messages), Task.from_text(text))
    np.testing.assert_allclose(recording.movement[:, :3], np.array(expected)[:, :3], atol=1e-9)
    np.testing.assert_allclose(
        quaternion.angle_between(recording.movement[:, 3:], np.array(expected)[:, 3:]), 0, atol=1e-6
    )
    assert not recording.doubts and not recording.notes
    states = [item[3].position for item in messages if item[1] == "/joint_states"]
    usual = states[40][0]
    states[40][0] = np.nan
    recording = read_recording(write(tmp_path / "gap", messages), Task.from_text(text))
    assert len(recording.times) == 99 and "1 of 100 messages left out, the first is number 40" in recording.notes[0]
    states[40][0] = usual + 9.0
    recording = read_recording(write(tmp_path / "beyond", messages), Task.from_text(text))
    assert any("the joint panda_joint7 is at" in doubt.text for doubt in recording.doubts)
    for position in states:
        position[:] = np.degrees(position)
    with pytest.raises(BagError, match="the joint panda_joint.* seems to be in degrees"):
        read_recording(write(tmp_path / "degrees", messages), Task.from_text(text))


@pytest.mark.parametrize("names", [1, 0])
def test_joint_states_that_name_their_joints_once_or_never_are_called_so(names: int, tmp_path: Path) -> None:
    robot, kind = RobotModel.from_file(CONFIG / "panda.yaml"), "sensor_msgs/msg/JointState"
    thing, none = reach(0)["/object/pose"], np.zeros(0)
    messages: list[Message] = [
        (t, "/object/pose", "geometry_msgs/msg/PoseStamped", pose_stamped(pose, t, robot.base_frame))
        for t, pose in zip(thing.recorded, thing.poses, strict=True)
    ]
    for i, t in enumerate(np.linspace(0.0, 5.0, 100)):
        state = TYPES[kind](header(t, ""), list(robot.joint_names) if i < names else [], robot.home, none, none)
        messages.append((t, "/joint_states", kind, state))
    entry = {"joint_states": "joint_states", "robot": str(CONFIG / "panda.yaml"), "link": "hand"}
    text = yaml.safe_dump(yaml.safe_load(REACH_TASK) | {"base_frame": "panda_link0", "recordings": {"movement": entry}})
    with pytest.raises(BagError, match=f"has {100 - names} of 100 messages.* it has 7 positions and names no joints"):
        read_recording(write(tmp_path / "demo", messages), Task.from_text(text))
