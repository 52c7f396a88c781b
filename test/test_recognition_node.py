# SPDX-License-Identifier: Apache-2.0
"""The node `recognition` on its topics: poses in, probabilities and where the hand goes out."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from ros_graph import ALL_LATCHED, Inbox, ros_arguments
from ros_testing import StartProcess, spin_until
from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.programs import train


@pytest.fixture
def model(tmp_path: Path) -> Path:
    (tmp_path / "task.yaml").write_text(REACH_TASK)
    for seed in range(6):
        write_bag(tmp_path / "bags" / f"demo_{seed}", reach(seed, 60))
    arguments = ["--task", str(tmp_path / "task.yaml"), "--output", str(tmp_path / "reach.tpgmm")]
    assert train.main([*arguments, str(tmp_path / "bags")]) == 0
    return tmp_path / "reach.tpgmm"


def test_a_hand_that_reaches_is_recognised_and_another_one_is_not(
    model: Path, ros_node: Node, start_process: StartProcess
) -> None:
    task = model.parent / "task.yaml"
    process = start_process(
        sys.executable, "-m", "tpgmm_ros.nodes.recognition", *ros_arguments(task_file=task, skills=f"['reach={model}']")
    )
    shown = reach(50, 60)
    hand, object_pose = shown["/endpoint/pose"].poses, shown["/object/pose"].poses[0]
    frames = [
        TrackedFrame("object", FrameStatus.VISIBLE, 1.0, 1, object_pose),
        TrackedFrame("robot", FrameStatus.VISIBLE, 1.0, 1, np.array([0.0, 0, 0, 0, 0, 0, 1])),
    ]
    task_parameters = ros_node.create_publisher(TaskParameters, "task_parameters", LATCHED)
    task_parameters.publish(conversions.task_parameters_message(frames, 1, "base"))
    poses = ros_node.create_publisher(PoseStamped, "endpoint/pose", STREAM)
    probabilities = Inbox(ros_node, Float64MultiArray, "recognition/probabilities", STREAM)
    skill = Inbox(ros_node, String, "recognition/skill", ALL_LATCHED)
    end = Inbox(ros_node, PoseWithCovarianceStamped, "recognition/end", STREAM)
    restart = ros_node.create_client(Trigger, "recognition/restart")
    spin_until(
        ros_node,
        lambda: (
            poses.get_subscription_count() and task_parameters.get_subscription_count() and restart.service_is_ready()
        ),
        message="the node",
        processes=(process,),
    )

    def show(path: np.ndarray, begin_s: float) -> list[float]:
        """Poses one by one, each once the one before is answered; the last probabilities."""
        for i, pose in enumerate(path):
            answered = len(probabilities.messages)

            def send(i: int = i, pose: np.ndarray = pose, answered: int = answered) -> bool:
                if len(probabilities.messages) == answered:
                    poses.publish(conversions.pose_stamped(pose, round(1e9 * (begin_s + 0.085 * i)), "base"))
                return len(probabilities.messages) > answered

            spin_until(ros_node, send, message=f"an answer to pose {i}", processes=(process,))
        return list(probabilities.messages[-1].data)

    def knows_the_frames() -> bool:
        """A prediction of where the movement ends needs them."""
        poses.publish(conversions.pose_stamped(hand[0], 50_000_000_000, "base"))
        return bool(end.messages)

    spin_until(ros_node, knows_the_frames, message="a prediction", processes=(process,))
    seen = len(probabilities.messages)
    found = show(hand[:40], 100.0)  # after a pause: another movement
    assert len(probabilities.messages) >= seen + 40
    assert probabilities.messages[-1].layout.dim[0].label == "reach,unknown"
    assert found[0] > 0.9 and sum(found) == pytest.approx(1.0)
    assert skill.messages[-1].data == "reach"
    goal = conversions.pose_to_array(end.messages[-1].pose.pose)
    assert np.linalg.norm(goal[:3] - hand[-1, :3]) < 0.05
    assert np.linalg.eigvalsh(np.array(end.messages[-1].pose.covariance).reshape(6, 6))[0] > 0.0

    answer = restart.call_async(Trigger.Request())
    spin_until(ros_node, answer.done, message="the service", processes=(process,))
    assert answer.result().success
    strange = hand[:30] + np.outer(np.linspace(0.0, 1.0, 30), [-1.0, 0.5, 0.5, 0, 0, 0, 0])
    assert show(strange, 200.0)[-1] > 0.9
    spin_until(ros_node, lambda: skill.messages[-1].data == "unknown", message="unknown", processes=(process,))
