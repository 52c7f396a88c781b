# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/affine-frames.md as it stands: a tray of another size, from bags with maps to the simulated Baxter."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from affine_bags import maps, write_map_bag
from ros_graph import ROBOT_FILE, ROOT, Inbox
from ros_testing import StartProcess, executable, spin_until
from test_documents import DOCS, commands, snippets
from tpgmm_core import Frame
from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.messages.sources import TaskParametersSource
from tpgmm_ros.recordings.storage.definitions import types_for

PAGE = DOCS / "how-to" / "affine-frames.md"
#: Simulated time, so that a busy machine only takes longer.
FURTHER = {
    "baxter_simulator": ["-p", "lockstep:=true", "-p", "rate:=250.0", "-p", "physics_steps:=4"],
    "frame_tracker": ["-p", "use_sim_time:=true"],
    "impedance_controller": ["-p", "use_sim_time:=true"],
    "reproduction": ["-p", "use_sim_time:=true"],
}
S, Q = np.diag([0.3, 0.2, 1.0]), quaternion.exp([0.0, 0.0, 0.4])
#: Corners of the tray, in shares of its edges, m above it.
NEAR, FAR = np.array([0.0, 0.0, 0.08]), np.array([1.0, 1.0, 0.08])


def show(path: Path, home: np.ndarray, seed: int) -> None:
    """The hand goes to the near corner of a tray, and to the far one; the tray is 10 to 25 cm long and wide."""
    random, times = np.random.default_rng(seed), np.linspace(0.0, 4.0, 120)
    size, yaw = random.uniform(0.1, 0.25, 2), random.uniform(-0.5, 0.5)
    q = quaternion.exp([0.0, 0.0, yaw])
    place = np.array([0.5, 0.1, 0.1]) + random.uniform(-0.1, 0.1, 3)
    tray = Frame.from_pose(place, q, stretch=np.diag([*size, 1.0]))
    near, far = (tray.A[:3, :3] @ corner + place for corner in (NEAR, FAR))
    first, second = (np.clip(part, 0.0, 1.0)[:, None] for part in (times / 2.0, times / 2.0 - 1.0))
    first, second = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2) for s in (first, second))
    path_of_hand = home[:3] + first * (near - home[:3]) + second * (far - near) + random.normal(0.0, 5e-4, (120, 3))
    hand = np.hstack([path_of_hand, np.tile(home[3:], (120, 1))])
    frames = {"/tray/maps": maps("tray", place, q, np.tile(np.diag([*size, 1.0]), (120, 1, 1)))}
    write_map_bag(path, {"/endpoint/left/pose": hand}, frames, times)


def test_what_a_recorder_receives_is_read(ros_node: Node) -> None:
    frames = [*maps("cup", np.zeros(3), quaternion.IDENTITY, np.eye(3)[None]), *maps("tray", np.ones(3), Q, S[None])]
    received: list[bytes] = []
    ros_node.create_subscription(TaskParameters, "tray/maps", received.append, STREAM, raw=True)
    publisher = ros_node.create_publisher(TaskParameters, "tray/maps", 1)
    message = TaskParameters(header=conversions.header_at(7, "base"), frames=frames)

    def is_received() -> bool:
        publisher.publish(message)
        return bool(received)

    spin_until(ros_node, is_received, message="the message")
    (raw, *_), kind = received, "tpgmm_msgs/msg/TaskParameters"
    read = types_for(kind).deserialize_cdr(raw, kind)
    found = TaskParametersSource("tray/maps", "tray").read(read)
    assert found is not None and found.stamp_ns == 7 and found.stretch is not None
    np.testing.assert_allclose(found.pose, [1.0, 1.0, 1.0, *Q])
    np.testing.assert_allclose(found.stretch, S, atol=1e-12)


@pytest.mark.timeout(400)
def test_a_tray_of_another_size_is_followed_to_its_corners(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    robot = RobotModel.from_file(ROBOT_FILE)
    data = robot.create_data()
    data.update(robot.home)
    for seed in range(8):
        show(tmp_path / "mine" / f"demo_{seed}", data.pose("left").copy(), seed)
    (task,) = re.findall(r"^```yaml\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    (tmp_path / "tray.yaml").write_text(task)
    (program,) = snippets(PAGE)
    (tmp_path / "tray.py").write_text(program)

    def local(words: list[str]) -> list[str]:
        changed = (
            word.replace("config/", f"{ROOT}/config/").replace("bags/mine", f"{tmp_path}/mine") for word in words
        )
        return [re.sub(r"\btray\.(yaml|tpgmm|py)", rf"{tmp_path}/tray.\1", word) for word in changed]

    ours = [words for words in commands(PAGE) if words[0].startswith(".venv/lib/tpgmm_ros/")]
    (training,) = (words for words in ours if Path(words[0]).name == "train")
    run = subprocess.run([executable("train"), *local(training[1:])], capture_output=True, text=True, timeout=100)
    assert run.returncode == 0, run.stdout + run.stderr
    nodes = {Path(words[0]).name: words for words in ours if "--ros-args" in words}
    assert list(nodes) == ["baxter_simulator", "frame_tracker", "impedance_controller", "reproduction"]
    seen = Inbox(ros_node, PoseStamped, "endpoint/left/pose", STREAM)
    for name, words in nodes.items():
        start_process(name, *local(words[1:]), *FURTHER[name])
    (asking,) = (words for words in commands(PAGE) if words[:2] == [".venv/bin/python", "tray.py"])
    size = [float(word) for word in asking[2:]]
    assert min(size) > 0.25, "beyond what was shown"
    asked = start_process(sys.executable, *local(asking[1:]), "--ros-args", "-p", "use_sim_time:=true")
    assert asked.wait(240.0) == 0, asked.output
    assert "reached: " in asked.output and "not reached" not in asked.output, asked.output
    spin_until(ros_node, lambda: seen.last is not None, message="a pose of the hand")
    tray = Frame.from_pose([0.5, 0.1, 0.1], [0.0, 0.0, 0.1, 0.995], stretch=np.diag([*size, 1.0]))
    path = np.array([conversions.pose_to_array(message.pose)[:3] for message in seen.messages])
    shares = np.linalg.solve(tray.A[:3, :3], (path - tray.b[:3]).T).T
    away = np.linalg.norm((shares[-1] - FAR) * [*size, 1.0])
    assert away < 0.01, "the far corner of the larger tray"
