# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/two-hands.md as it stands: two hands that see each other, from bags to the simulated Baxter."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from ros_graph import ROBOT_FILE, ROOT, Inbox
from ros_testing import StartProcess, executable, spin_until
from synthetic_bags import Topic, write_bag
from test_documents import DOCS, commands, snippets
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM

PAGE = DOCS / "how-to" / "two-hands.md"
#: Where the spoon is, seen from the bowl, beside how far the hands are apart at home, m.
CLOSER = np.array([0.02, 0.08, 0.05])
#: Simulated time, so that a busy machine only takes longer; it waits for each reference, and runs ahead of nobody.
FURTHER = {
    "baxter_simulator": [
        *("-p", "lockstep:=true", "-p", "rate:=250.0", "-p", "physics_steps:=4", "-p", "real_time_factor:=0.5")
    ],
    "impedance_controller": ["-p", "use_sim_time:=true", "-p", "lockstep:=true"],
    "joint_reference": ["-p", "use_sim_time:=true"],
    "frame_tracker": ["-p", "use_sim_time:=true"],
    "reproduction": ["-p", "use_sim_time:=true"],
}


@pytest.fixture(scope="module")
def homes() -> dict[str, np.ndarray]:
    robot = RobotModel.from_file(ROBOT_FILE)
    data = robot.create_data()
    data.update(robot.home)
    return {hand: data.pose(hand).copy() for hand in ("left", "right")}


def show(homes: dict[str, np.ndarray], seed: int) -> dict[str, Topic]:
    """The left hand goes to its place, and the right one to where it holds the spoon above the left one."""
    random = np.random.default_rng(seed)
    times = np.linspace(0.0, 3.0, 90)
    s = times / times[-1]
    share = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]
    starts = {hand: home[:3] + random.uniform(-0.04, 0.04, 3) for hand, home in homes.items()}
    place = homes["left"][:3] + random.uniform(-0.1, 0.1, 3)
    left = (1.0 - share) * starts["left"] + share * place
    spoon = left + homes["right"][:3] - homes["left"][:3] + CLOSER
    paths = {"left": left, "right": (1.0 - share) * starts["right"] + share * spoon}
    topics = {"/place/pose": Topic(np.tile([*place, 0.0, 0.0, 0.0, 1.0], (90, 1)), times)}
    for hand, path in paths.items():
        turned = np.tile(homes[hand][3:], (90, 1)) + random.normal(0.0, 0.002, (90, 4))
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        topics[f"/endpoint/{hand}/pose"] = Topic(np.hstack([path + random.normal(0.0, 0.001, (90, 3)), turned]), times)
    return topics


@pytest.mark.timeout(400)
def test_two_hands_that_see_each_other_do_what_both_were_shown_and_follow_each_other(
    homes: dict[str, np.ndarray], ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    for seed in range(8):
        write_bag(tmp_path / "mine" / f"demo_{seed}", show(homes, seed))
    words_of_page = [words for words in commands(PAGE) if words[0].startswith(".venv/lib/tpgmm_ros/")]

    def local(words: list[str]) -> list[str]:
        changed = (
            word.replace("config/", f"{ROOT}/config/").replace("bags/mine", f"{tmp_path}/mine") for word in words
        )
        return [
            word.replace("left.tpgmm", f"{tmp_path}/left.tpgmm").replace("right.tpgmm", f"{tmp_path}/right.tpgmm")
            for word in changed
        ]

    trained = [words for words in words_of_page if Path(words[0]).name == "train"]
    assert len(trained) == 2
    for words in trained:
        run = subprocess.run([executable("train"), *local(words[1:])], capture_output=True, text=True, timeout=100)
        assert run.returncode == 0, run.stdout + run.stderr
    nodes = [words for words in words_of_page if "--ros-args" in words]
    assert sorted({Path(words[0]).name for words in nodes}) == sorted(FURTHER) and len(nodes) == 7
    seen = {hand: Inbox(ros_node, PoseStamped, f"endpoint/{hand}/pose", STREAM) for hand in homes}
    processes = []
    for words in nodes:
        name = Path(words[0]).name
        processes.append(start_process(name, *local(words[1:]), *FURTHER[name]))
    place = homes["left"][:3] + [0.09, -0.06, 0.04]
    (program,) = snippets(PAGE)
    (tmp_path / "both_hands.py").write_text(program)
    where = [f"{number:.4f}" for number in place]
    asked = start_process(
        sys.executable, str(tmp_path / "both_hands.py"), *where, "--ros-args", "-p", "use_sim_time:=true"
    )
    assert asked.wait(240.0) == 0, asked.output
    assert all(f"{hand}: reached: " in asked.output for hand in homes), asked.output

    def hand(name: str) -> np.ndarray:
        return np.array(conversions.pose_to_array(seen[name].last.pose))[:3]

    def spoon_above_bowl() -> float:
        return float(np.linalg.norm(hand("right") - hand("left") - (homes["right"] - homes["left"])[:3] - CLOSER))

    def are_there(at: np.ndarray) -> bool:
        known = all(box.last is not None for box in seen.values())
        return bool(known and np.linalg.norm(hand("left") - at) < 0.015 and spoon_above_bowl() < 0.015)

    spin_until(ros_node, lambda: are_there(place), message="both hands to be there", processes=tuple(processes))

    # The place moves. The model of the right hand knows nothing of it: it sees the left hand alone
    moved, right = place + [-0.06, 0.05, 0.03], hand("right")
    publisher = ros_node.create_publisher(PoseStamped, "place/pose", STREAM)

    def has_followed() -> bool:
        stamp_ns = conversions.time_to_ns(seen["left"].last.header.stamp)
        publisher.publish(conversions.pose_stamped(np.array([*moved, 0.0, 0.0, 0.0, 1.0]), stamp_ns, "base"))
        return are_there(moved)

    spin_until(ros_node, has_followed, message="both hands to follow", processes=tuple(processes))
    assert np.linalg.norm(hand("right") - right) > 0.05
