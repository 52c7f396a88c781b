# SPDX-License-Identifier: Apache-2.0
"""teach: demonstrations of a scripted teacher and of a robot that is led, recorded from real topics."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ROBOT_FILE, ROOT, TASK_FILE
from ros_testing import StartProcess, executable, spin_until
from tpgmm_core.geometry.pose import pose_error
from tpgmm_demos.scene.pick_place import hand_at
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.recordings.bags import read_recording
from tpgmm_ros.task.task_file import Task

PLACE = np.array([0.6, 0.3, 0.1, 0.0, 0.0, 0.0, 1.0])


def teach(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([executable("teach"), *arguments], cwd=ROOT, capture_output=True, text=True, timeout=200)


@pytest.fixture(scope="module")
def scripted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One demonstration of the scripted teacher."""
    directory = tmp_path_factory.mktemp("scripted")
    run = teach("--scripted", "--count", "1", "--seed", "3", "--output", str(directory), "--robot", str(ROBOT_FILE))
    assert run.returncode == 0, run.stdout + run.stderr
    assert "1 demonstrations recorded" in run.stdout
    return directory


@pytest.mark.long
def test_a_scripted_demonstration_is_a_bag_that_train_reads_and_that_shows_the_task(scripted: Path) -> None:
    recording = read_recording(scripted / "demo_01", Task.load(TASK_FILE))
    assert 5.0 < recording.duration < 30.0 and len(recording.times) > 500
    assert np.isfinite(recording.movement).all()
    end, target = recording.movement[-1], recording.frames["target"][-1]
    position, angle = pose_error(end, hand_at(target))
    assert position < 0.02 and angle < 0.15
    # At some time the hand was where the object lay
    lay = hand_at(recording.frames["object"][0])
    assert min(np.linalg.norm(recording.movement[:, :3] - lay[:3], axis=1)) < 0.015
    assert not (scripted / ".partial").exists()


@pytest.mark.long
def test_demonstrations_that_exist_are_kept_as_they_are(scripted: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in scripted.rglob("*")}
    run = teach("--scripted", "--count", "1", "--seed", "4", "--output", str(scripted))
    assert run.returncode == 0 and "0 demonstrations recorded" in run.stdout
    assert {path: path.stat().st_mtime_ns for path in scripted.rglob("*")} == before


@pytest.mark.long
def test_a_bag_that_exists_is_not_overwritten(scripted: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in scripted.rglob("*")}
    run = teach("--output", str(scripted / "demo_01"))
    assert run.returncode == 1 and "exists" in run.stderr and "Traceback" not in run.stderr
    assert {path: path.stat().st_mtime_ns for path in scripted.rglob("*")} == before


def test_a_live_recording_ends_by_ctrl_c_with_a_complete_bag_of_all_that_came(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    task = Task.load(TASK_FILE)
    bag = tmp_path / "demo_01"
    process = start_process("teach", "--task", str(TASK_FILE), "--output", str(bag))
    topics = [task.movement, *task.topics.values()]
    publishers = [ros_node.create_publisher(PoseStamped, topic, STREAM) for topic in topics]
    states = ros_node.create_publisher(JointState, "joint_states", STREAM)
    spin_until(
        ros_node,
        lambda: all(publisher.get_subscription_count() for publisher in (*publishers, states)),
        message="the recorder to listen",
        processes=(process,),
    )
    sent = 0

    def shown() -> bool:
        nonlocal sent
        sent += 1
        stamp = ros_node.get_clock().now().nanoseconds
        for publisher in publishers:
            publisher.publish(conversions.pose_stamped(PLACE + [1e-3 * sent, 0, 0, 0, 0, 0, 0], stamp, "base"))
        states.publish(conversions.joint_state_message(["left_s0"], stamp, np.zeros(1)))
        return sent >= 60

    spin_until(ros_node, shown, processes=(process,))
    # What is unfinished never looks like a whole bag
    assert not bag.exists()
    process.send_signal(signal.SIGINT)
    assert process.wait(20.0) == 0, process.output
    recording = read_recording(bag, task)
    # Best effort: nearly all of what was sent
    assert 50 <= len(recording.times) <= 60
    assert not (tmp_path / ".partial").exists()
