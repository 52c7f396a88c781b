# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/your-robot.md as it stands, with real processes; poses of robots whose drivers publish joints alone."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ROOT, Inbox, result_of, ros_arguments
from ros_testing import RunningProcess, StartProcess, executable, spin_until
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.programs import check_robot

PAGE = (ROOT / "docs" / "how-to" / "your-robot.md").read_text()
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
#: The page's nodes in lockstep, so that a busy machine gives the same, and with few steps, so that it gets there.
LOCKSTEP = {
    "baxter_simulator": ["-p", "lockstep:=true", "-p", "rate:=200.0"],
    "frame_tracker": ["-p", "use_sim_time:=true", "-p", "lockstep:=true"],
    "impedance_controller": ["-p", "use_sim_time:=true", "-p", "lockstep:=true"],
    "reproduction": ["-p", "use_sim_time:=true", "-p", "lockstep_rate:=100.0", "-p", "start_timeout:=60.0"],
}
#: Where the page's program has the object, and which way it is turned.
OBJECT = np.array([0.40, 0.13, 0.32, 0.0, 0.296, 0.0, 0.955])


def write_files(folder: Path) -> None:
    """The files of the page."""
    for _, text in BLOCKS:
        head, _, body = text.partition("\n")
        if found := re.match(r"# (file|append): (\S+)", head):
            with (folder / found[2]).open("w" if found[1] == "file" else "a") as file:
                file.write(body)


def commands(kind: str = "") -> list[list[str]]:
    """The commands of the page's shell blocks with the first line `# kind`, or without one."""
    found = []
    for language, text in BLOCKS:
        lines = text.splitlines()
        named = lines[0].removeprefix("# ") if lines[0].startswith("# ") else ""
        if language == "sh" and named == kind:
            found += [shlex.split(line) for line in lines if not line.startswith("#")]
    return found


def run(command: list[str], folder: Path) -> str:
    """What a program of the page prints."""
    program = Path(command[0])
    assert program in (Path(".venv/bin/python"), Path(".venv/lib/tpgmm_ros", program.name)), command
    installed = sys.executable if program.name == "python" else executable(program.name)
    done = subprocess.run([installed, *command[1:]], cwd=folder, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    return done.stdout


def start(command: list[str], folder: Path, start_process: StartProcess) -> RunningProcess:
    """A node of the page, in a folder."""
    program = Path(command[0])
    assert program.parent == Path(".venv/lib/tpgmm_ros")
    arguments = [re.sub(r":=(\w+\.(yaml|tpgmm))$", rf":={folder}/\1", word) for word in command[1:]]
    return start_process(program.name, *arguments, *LOCKSTEP.get(program.name, []))


def test_a_newcomer_comes_from_a_urdf_to_a_movement(
    tmp_path: Path, ros_node: Node, start_process: StartProcess
) -> None:
    write_files(tmp_path)
    checked, taught, _ = commands()
    whole = (tmp_path / "z1.yaml").read_text()
    (tmp_path / "z1.yaml").write_text(whole.partition("armature:")[0])
    before = run(checked, tmp_path)
    (tmp_path / "z1.yaml").write_text(whole)
    shown = re.search(r"^    6 joints.*?(?=^\S)", PAGE, re.MULTILINE | re.DOTALL)
    assert shown is not None
    for line in shown[0].splitlines():
        assert line.strip().removesuffix("...") in before
    assert "nothing suspicious" in run(checked, tmp_path)
    run(taught, tmp_path)

    robot = RobotModel.from_file(tmp_path / "z1.yaml")
    torques = Inbox(ros_node, JointState, "joint_torques")
    poses = Inbox(ros_node, PoseStamped, "endpoint/hand/pose")
    seen = ros_node.create_publisher(PoseStamped, "object/pose", STREAM)

    def see(hand: PoseStamped) -> None:
        """Perception: where the object is, at the moment of each pose of the hand."""
        stamp_ns = conversions.time_to_ns(hand.header.stamp)
        seen.publish(conversions.pose_stamped(OBJECT, stamp_ns, robot.base_frame))

    ros_node.create_subscription(PoseStamped, "endpoint/hand/pose", see, STREAM)
    simulator, *others = commands("nodes")
    processes = [start(command, tmp_path, start_process) for command in others]
    client = ActionClient(ros_node, Reproduce, "reproduce")
    spin_until(ros_node, client.server_is_ready, 60.0, "the action", tuple(processes))
    goal = result_of(ros_node, client.send_goal_async(Reproduce.Goal()), "the goal to be accepted")
    processes.append(start(simulator, tmp_path, start_process))  # simulated time begins with the movement
    asked = goal.get_result_async()
    spin_until(ros_node, asked.done, 120.0, "the end of the movement", tuple(processes))
    answer = asked.result().result
    assert answer.success, answer.reason
    print(answer.reason)
    pose = conversions.pose_to_array(poses.last.pose)
    np.testing.assert_allclose(pose[:3], OBJECT[:3], atol=0.01)
    efforts = np.array([message.effort for message in torques.messages])
    assert len(efforts) > 200
    assert (np.abs(efforts) <= robot.effort_limits + 1e-9).all()


def test_poses_of_the_end_points_come_from_joint_states(
    tmp_path: Path, ros_node: Node, start_process: StartProcess
) -> None:
    write_files(tmp_path)
    ((*command,),) = commands("node")
    process = start([*command, "-p", "pose_rate:=50.0"], tmp_path, start_process)
    robot = RobotModel.from_file(tmp_path / "z1.yaml")
    states = ros_node.create_publisher(JointState, "joint_states", STREAM)
    poses = Inbox(ros_node, PoseStamped, "endpoint/hand/pose")
    names = ["gripper", *robot.joint_names[::-1]]  # more joints, in another order
    q = robot.home + 0.1
    stamp_ns = 0

    def publish(step_ns: int) -> None:
        nonlocal stamp_ns
        stamp_ns += step_ns
        states.publish(conversions.joint_state_message(names, stamp_ns, np.array([9.0, *q[::-1]])))

    def heard() -> bool:
        publish(5_000_000)
        return len(poses.messages) >= 20

    spin_until(ros_node, heard, message="poses", processes=(process,))
    data = robot.create_data()
    data.update(q)
    np.testing.assert_allclose(conversions.pose_to_array(poses.last.pose), data.pose("hand"), atol=1e-12)
    assert poses.last.header.frame_id == "link00"
    stamps = np.array([conversions.time_to_ns(message.header.stamp) for message in poses.messages])
    # One in each period that was asked for, though four times as many states come; some of them may be lost
    assert np.diff(stamps // 20_000_000).min() >= 1
    stamp_ns = 0

    def set_back() -> bool:
        publish(20_000_000)
        stamps = [conversions.time_to_ns(message.header.stamp) for message in poses.messages]
        return bool((np.diff(stamps) < 0).any())

    spin_until(ros_node, set_back, message="poses after the clock was set back", processes=(process,))


def test_that_only_joints_of_others_come_is_said_in_the_log(
    tmp_path: Path, ros_node: Node, start_process: StartProcess
) -> None:
    process = start_process("endpoint_poses", *ros_arguments(robot_file=ROOT / "config" / "ur5.yaml"))
    states = ros_node.create_publisher(JointState, "joint_states", STREAM)

    def said() -> bool:
        states.publish(conversions.joint_state_message(["wheel"], 1, np.zeros(1)))
        return "no joint states yet: none of its joints arrived; the last message names wheel" in process.output

    spin_until(ros_node, said, message="words", processes=(process,))


@pytest.mark.parametrize(("content", "reason"), [("urdf: a.urdf", "lacks the key"), (None, "cannot read|No such file")])
def test_a_robot_file_that_cannot_be_used_is_one_line_and_status_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str | None, reason: str
) -> None:
    if content is not None:
        (tmp_path / "robot.yaml").write_text(content)
    assert check_robot.main([str(tmp_path / "robot.yaml")]) == 1
    written = capsys.readouterr()
    assert re.fullmatch(f"error: .*({reason}).*\n", written.err), written.err
    assert not written.out
