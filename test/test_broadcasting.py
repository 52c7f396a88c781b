# SPDX-License-Identifier: Apache-2.0
"""What viewers are shown on request: the robot with its links, and the frames of a task on /tf."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ros_graph import ALL_LATCHED, ROOT, Inbox, ros_arguments
from ros_testing import StartProcess, spin_until
from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.observation.transforms import TransformTree
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.motion_outputs import OUTPUTS
from tpgmm_ros.messages.qos import STREAM

tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs is not built here: run 'make setup'")
UR5_FILE = ROOT / "config" / "ur5.yaml"
#: As the listeners of tf2 ask for.
LISTENER = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
OBJECT = np.array([0.5, 0.1, 0.2, 0.0, 0.0, 0.6, 0.8])


#: Topic -> reliability and durability that RViz is to ask for.
SHOWN = {
    "robot_description": ("Reliable", "Transient Local"),
    "markers": ("Best Effort", "Volatile"),
    "reference_pose": ("Best Effort", "Volatile"),
    "target_pose": ("Best Effort", "Volatile"),
}


def test_what_rviz_and_foxglove_open_are_topics_of_the_nodes() -> None:
    displays = yaml.safe_load((ROOT / "config" / "tpgmm.rviz").read_text())["Visualization Manager"]["Displays"]
    topics = [item.get("Topic") or item.get("Description Topic") for item in displays]
    asked = {item["Value"]: (item["Reliability Policy"], item["Durability Policy"]) for item in topics if item}
    assert asked == SHOWN
    layout = json.loads((ROOT / "config" / "tpgmm.foxglove.json").read_text())
    assert set(layout["configById"]["3D!tpgmm"]["topics"]) == {f"/{topic}" for topic in SHOWN}
    panels: list[str] = []

    def walk(part: object) -> None:
        if isinstance(part, str):
            panels.append(part)
        elif isinstance(part, dict):
            walk(part["first"])
            walk(part["second"])

    walk(layout["layout"])
    assert set(panels) == set(layout["configById"])
    known = (ROOT / "docs" / "reference" / "topics.md").read_text()
    for topic in ("markers", "reference_pose", "controller_state", "/diagnostics"):
        assert f"| `{topic}` |" in known
    assert OUTPUTS["target_pose"].topic == "target_pose"


class Transforms(dict[str, TransformStamped]):
    """The last one of each child."""

    def hear(self, message: Any) -> None:
        self.update({item.child_frame_id: item for item in message.transforms})


def numbers(message: TransformStamped) -> np.ndarray:
    place, turn = message.transform.translation, message.transform.rotation
    return np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])


def test_links_frames_and_the_description_are_published_on_request(
    tmp_path: Path, ros_node: Node, start_process: StartProcess
) -> None:
    task = tmp_path / "reach.yaml"
    task.write_text(
        "name: reach\nbase_frame: base_link\nmovement: endpoint/tool/pose\nendpoint: tool\n"
        "frames: {object: {topic: object/pose}, other: {topic: other/pose}}\n"
    )
    on_request = {"broadcast_transforms": True}
    robot = start_process("endpoint_poses", *ros_arguments(robot_file=UR5_FILE, **on_request))
    tracker = start_process("frame_tracker", *ros_arguments(task_file=task, **on_request))
    description = Inbox(ros_node, String, "robot_description", ALL_LATCHED)
    moving, fixed = Transforms(), Transforms()
    ros_node.create_subscription(tf2_msgs.TFMessage, "/tf", moving.hear, LISTENER)
    ros_node.create_subscription(tf2_msgs.TFMessage, "/tf_static", fixed.hear, ALL_LATCHED)
    states = ros_node.create_publisher(JointState, "joint_states", STREAM)
    seen = ros_node.create_publisher(PoseStamped, "object/pose", STREAM)
    model = RobotModel.from_file(UR5_FILE)

    def shown() -> bool:
        now_ns = ros_node.get_clock().now().nanoseconds
        states.publish(conversions.joint_state_message(list(model.joint_names), now_ns, model.home))
        seen.publish(conversions.pose_stamped(OBJECT, now_ns, "base_link"))
        return bool({"wrist_3_link", "reach/object"} <= moving.keys() and "tool0" in fixed and description.messages)

    spin_until(ros_node, shown, message="transforms", processes=(robot, tracker))
    assert "<robot" in description.last.data and "wrist_3_joint" in description.last.data
    np.testing.assert_allclose(numbers(moving["reach/object"]), OBJECT, atol=1e-6)
    assert moving.pop("reach/object").header.frame_id == "base_link" and "reach/other" not in moving
    # the tree of the URDF, as viewers read it from robot_description; no frame has two parents
    joints = ElementTree.fromstring(description.last.data).findall("joint")
    for among, is_fixed in ((moving, False), (fixed, True)):
        wanted = {
            (joint.find("child").get("link"), joint.find("parent").get("link"))  # type: ignore[union-attr]
            for joint in joints
            if (joint.get("type") == "fixed") == is_fixed
        }
        assert {(child, item.header.frame_id) for child, item in among.items()} == wanted
    tree, data = TransformTree(), model.create_data()
    data.update(model.home)
    for among, is_static in ((fixed, True), (moving, False)):
        for child, item in among.items():
            assert not tree.add(item.header.frame_id, child, numbers(item), 1, is_static)
    np.testing.assert_allclose(pose_error(tree.pose("tool0", "base_link", 1), data.pose("tool")), 0.0, atol=1e-9)
    assert "publishers on /tf" not in robot.output + tracker.output  # it has several as a rule
