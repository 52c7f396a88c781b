# SPDX-License-Identifier: Apache-2.0
"""Nodes in one process do what they do in processes of their own, and one that fails does not take the others along."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.msg import Transition
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Int64
from std_srvs.srv import Trigger

from faults.graph_bench import trained
from long_tests import mostly_long
from ros_graph import (
    ACTIVATE,
    ALL_LATCHED,
    DEACTIVATE,
    ROBOT_FILE,
    TASK_FILE,
    Inbox,
    call,
    change_state,
    result_of,
    ros_arguments,
    set_parameters,
)
from ros_testing import RunningProcess, StartProcess, executable, spin_until
from simulated_hand import NAMES, SimulatedHand, pose_reference
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import ControllerState, Reference, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM

LOOP = ("frame_tracker", "reproduction", "impedance_controller")
FAILING = Path(__file__).with_name("failing_nodes.py")


def stamps_of(messages: list[Any]) -> list[int]:
    return [conversions.time_to_ns(message.header.stamp) for message in messages]


class Loop:
    """The nodes from pose to torque in one process, and a robot whose time the test controls."""

    def __init__(self, node: Node, start: StartProcess, directory: Path) -> None:
        model = trained(directory / "model.tpgmm")
        arguments = ros_arguments(
            task_file=TASK_FILE, robot_file=ROBOT_FILE, autostart=True, **{"reproduction:model_file": model}
        )
        self.node = node
        self.process: RunningProcess = start("compose", *LOOP, *arguments)
        self.hand = SimulatedHand(node, self.process)
        self.torques = Inbox(node, JointState, "joint_torques")
        self.modes = Inbox(node, ControllerState, "controller_state", ALL_LATCHED)
        self.poses = {name: node.create_publisher(PoseStamped, f"{name}/pose", STREAM) for name in ("object", "target")}
        self.client = ActionClient(node, Reproduce, "reproduce")
        self.wait(self.client.server_is_ready, "the action")
        self.wait(lambda: all(item.get_subscription_count() for item in self.poses.values()), "the tracker")

    def wait(self, condition: Any, what: str, timeout: float = 60.0) -> None:
        spin_until(self.node, condition, timeout, what, (self.process,))

    def live(self) -> None:
        """A tick of the robot, with poses of what is around it."""
        self.hand.stamp_ns = self.node.get_clock().now().nanoseconds
        for name, place in (("object", [0.65, 0.4, 0.0]), ("target", [0.62, 0.1, 0.03])):
            pose = np.array([*place, 0.0, 0.0, 0.0, 1.0])
            self.poses[name].publish(conversions.pose_stamped(pose, self.hand.stamp_ns, "base"))
        self.hand.states.publish(self.hand.state())

    def live_until(self, condition: Any, what: str) -> None:
        def check() -> bool:
            self.live()
            return bool(condition())

        self.wait(check, what)

    def move(self) -> None:
        """Ask for a movement, and go on until it is followed."""
        goal = result_of(self.node, self.client.send_goal_async(Reproduce.Goal(duration=600.0)), "the goal")
        assert goal.accepted
        self.live_until(lambda: self.mode == ControllerMode.ACTIVE, "the controller to follow")

    @property
    def mode(self) -> int | None:
        return None if self.modes.last is None else self.modes.last.state


@pytest.fixture
def loop(ros_node: Node, start_process: StartProcess, tmp_path: Path) -> Loop:
    return Loop(ros_node, start_process, tmp_path)


def test_what_nodes_hand_over_is_on_the_topics_too_each_message_once(loop: Loop) -> None:
    references = Inbox(loop.node, Reference, "reference")
    frames = Inbox(loop.node, TaskParameters, "task_parameters", ALL_LATCHED)
    loop.move()
    for inbox in (references, frames, loop.torques):
        inbox.clear()
    loop.live_until(lambda: min(map(len, (references.messages, loop.torques.messages))) > 50, "messages")
    for inbox in (references, frames):
        assert max(Counter(stamps_of(inbox.messages)).values()) == 1
    # a state is answered once more when frames have changed since, and again while the next one is late
    states = {"object", "target", "robot"}
    assert {item.name for message in frames.messages for item in message.frames} == states
    # each state is answered, with the reference that belongs to it
    assert set(stamps_of(references.messages)) & set(stamps_of(loop.torques.messages))


def test_frames_that_change_between_two_joint_states_are_answered_before_the_next_one_and_once(loop: Loop) -> None:
    """Joint states are never late here, so that what answers one of them twice is not what silence calls for."""
    never_late = {"joint_state_timeout": 5.0, "reference_timeout": 5.0, "max_age": 5.0}
    assert set_parameters(loop.node, "impedance_controller", **never_late).successful
    loop.move()
    loop.torques.clear()
    answers: Counter[int] = Counter()

    def is_answered_again() -> bool:
        answers.update(stamps_of(loop.torques.messages))
        loop.torques.clear()
        return sum(count == 2 for count in answers.values()) >= 3

    loop.live_until(is_answered_again, "joint states to be answered once more")  # the frames change at each tick
    assert max(answers.values()) == 2


def test_a_reference_of_another_process_is_heard(loop: Loop) -> None:
    loop.live_until(lambda: loop.mode == ControllerMode.DAMPING, "the controller to wait for a reference")
    place = loop.hand.pose

    def check() -> bool:
        loop.hand.references.publish(pose_reference(place, loop.hand.stamp_ns))
        loop.live()
        return loop.mode == ControllerMode.ACTIVE

    loop.wait(check, "the controller to follow")


def test_each_node_has_its_own_life_cycle_and_parameters(loop: Loop) -> None:
    loop.move()
    assert set_parameters(loop.node, "reproduction", blend_time=0.2).successful
    assert not set_parameters(loop.node, "impedance_controller", torque_rate=-1.0).successful
    value = call(
        loop.node, GetParameters, "reproduction/get_parameters", GetParameters.Request(names=["blend_time"])
    ).values[0]
    assert value.double_value == 0.2
    assert change_state(loop.node, "impedance_controller", DEACTIVATE)
    loop.torques.clear()
    references = Inbox(loop.node, Reference, "reference")
    loop.live_until(lambda: len(references.messages) > 20, "references, with the controller at rest")
    assert not loop.torques.messages
    assert change_state(loop.node, "impedance_controller", ACTIVATE)
    loop.live_until(lambda: loop.mode == ControllerMode.ACTIVE, "the controller to follow again")
    loop.live_until(lambda: loop.torques.messages, "torques")
    # the end of one node is that of its movement, not of the others
    assert change_state(loop.node, "reproduction", Transition.TRANSITION_ACTIVE_SHUTDOWN)
    loop.live_until(lambda: loop.mode == ControllerMode.DAMPING, "the controller to miss references")
    references.clear()
    loop.torques.clear()
    loop.live_until(lambda: len(loop.torques.messages) > 20, "torques")
    assert not references.messages


def test_told_to_stop_the_loop_ends_with_the_safe_torque(loop: Loop) -> None:
    loop.move()
    loop.process.send_signal(signal.SIGTERM)
    assert loop.process.wait(20.0) == 0
    spin_until(loop.node, lambda: loop.mode == ControllerMode.WAITING, message="the last word of the controller")
    assert "Traceback" not in loop.process.output


def test_killed_no_torque_comes_any_more(loop: Loop) -> None:
    loop.move()
    loop.process.send_signal(signal.SIGKILL)
    loop.process.wait(20.0)
    killed_ns = loop.hand.stamp_ns  # answers to earlier states may still be on their way
    for _ in range(20):
        loop.live()
        loop.node.executor.spin_once(timeout_sec=0.01)  # type: ignore[union-attr]
    assert loop.hand.stamp_ns > killed_ns
    assert max(stamps_of(loop.torques.messages)) <= killed_ns


# -- a node that fails


class Pair:
    """Two nodes in one process, of which one fails."""

    def __init__(self, node: Node, start: StartProcess) -> None:
        self.node = node
        self.process: RunningProcess = start(sys.executable, str(FAILING))
        self.process.is_made_to_fail = True
        self.counts = Inbox(node, Int64, "count", 10)  # type: ignore[arg-type]
        self.given = node.create_publisher(Int64, "given", 10)
        self.number = node.create_publisher(Int64, "number", 10)
        self.wait(lambda: self.given.get_subscription_count() and self.number.get_subscription_count(), "both nodes")

    def wait(self, condition: Any, what: str) -> None:
        spin_until(self.node, condition, message=what, processes=(self.process,))

    @property
    def count(self) -> int:
        return 0 if self.counts.last is None else self.counts.last.data

    def ends_alone(self, counted: int) -> None:
        """Of the two only the one that failed is gone, after its last word; the status says that it failed."""
        self.wait(lambda: "failing" not in self.node.get_node_names(), "the node that failed to leave")
        self.wait(lambda: self.count == counted + 1, "its last word to be counted")
        self.number.publish(Int64(data=1))
        self.wait(lambda: self.count == counted + 2, "the other node to go on")
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(20.0) == 1
        assert "Traceback" in self.process.output and "RuntimeError" in self.process.output


@pytest.fixture
def failing(ros_node: Node, start_process: StartProcess) -> Pair:
    return Pair(ros_node, start_process)


def test_what_is_handed_over_does_not_come_again_where_others_listen_too(failing: Pair) -> None:
    numbers = Inbox(failing.node, Int64, "number", 10)  # type: ignore[arg-type]
    failing.wait(lambda: failing.number.get_subscription_count() > 1, "this test to hear itself")
    for i in range(20):
        failing.given.publish(Int64(data=100 + i))
        failing.wait(lambda i=i: len(numbers.messages) == i + 1, "the number to be passed on")
    failing.number.publish(Int64(data=3))  # not from within: it is counted after all that came before
    failing.wait(lambda: failing.count >= 21, "all to be counted")
    assert [message.data for message in numbers.messages] == [*range(100, 120), 3]
    assert [message.data for message in failing.counts.messages] == [*range(1, 22)]


@pytest.mark.parametrize("number", [7, 8])
def test_a_message_that_a_node_fails_at_ends_that_node_alone_also_where_it_fails_at_its_end_too(
    failing: Pair, number: int
) -> None:
    failing.given.publish(Int64(data=number))
    failing.ends_alone(0)
    # its end is over, and is not tried again when the process ends
    assert failing.process.output.count("\nRuntimeError") == {7: 1, 8: 2}[number], failing.process.output
    assert "InvalidHandle" not in failing.process.output


def test_a_goal_that_a_node_fails_at_ends_that_node_alone(failing: Pair) -> None:
    client = ActionClient(failing.node, Reproduce, "reproduce")
    failing.wait(client.server_is_ready, "the action")
    client.send_goal_async(Reproduce.Goal())
    failing.ends_alone(0)


def test_failing_at_what_was_handed_over_does_not_reach_the_node_that_handed_it_over(failing: Pair) -> None:
    failing.number.publish(Int64(data=2))
    failing.ends_alone(1)


def test_a_request_that_a_node_fails_at_is_answered_and_ends_that_node_alone(failing: Pair) -> None:
    assert not call(failing.node, Trigger, "fail", Trigger.Request()).success
    failing.ends_alone(0)


# -- the command line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "NODE"),
        (["frame_trackers"], "frame_tracker"),
        (["frame_tracker", "frame_tracker"], "given twice"),
        (["frame_tracker", "--rate", "5"], "--rate"),
    ],
)
def test_a_wrong_command_line_is_refused_with_the_reason(arguments: list[str], words: str) -> None:
    ended = subprocess.run([executable("compose"), *arguments], capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2 and words in ended.stderr and "Traceback" not in ended.stderr


def test_a_node_that_cannot_start_keeps_all_from_starting(ros_domain: int) -> None:
    command = [executable("compose"), *LOOP, *ros_arguments(task_file=TASK_FILE, autostart=True)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1 and "robot_file" in ended.stderr and "Traceback" not in ended.stderr


def test_a_process_takes_the_cores_and_the_memory_that_its_parameters_say(
    ros_node: Node, start_process: StartProcess
) -> None:
    core = min(os.sched_getaffinity(0))
    given = {"task_file": TASK_FILE, "reproduction:cpu_cores": core, "frame_tracker:lock_memory": True}
    process = start_process("compose", "frame_tracker", "reproduction", *ros_arguments(**given))
    spin_until(ros_node, lambda: "reproduction" in ros_node.get_node_names(), processes=(process,))
    threads = list(Path(f"/proc/{process.pid}/task").iterdir())
    spin_until(ros_node, lambda: all(os.sched_getaffinity(int(item.name)) == {core} for item in threads))

    def is_locked() -> bool:
        status = Path(f"/proc/{process.pid}/status").read_text()
        return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmLck:"))) > 1000

    spin_until(ros_node, lambda: is_locked() or "memory is not locked" in process.output, processes=(process,))


@pytest.mark.parametrize("cores", mostly_long(["999", "a", "1-", "3-x", "-1"], "999", "a"))
def test_cores_that_there_are_not_keep_a_node_from_starting(cores: str, ros_domain: int) -> None:
    command = [executable("frame_tracker"), *ros_arguments(task_file=TASK_FILE), "-p", f"cpu_cores:='{cores}'"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 1 and "cpu_cores" in ended.stderr and "Traceback" not in ended.stderr


def test_joint_names_are_those_of_the_robot(loop: Loop) -> None:
    """What goes out over topics is whole, also when it was handed over as values inside."""
    loop.move()
    assert list(loop.torques.last.name) == NAMES


# -- more joint states than can be answered


@pytest.mark.alone
def test_where_joint_states_come_faster_than_they_are_answered_other_topics_get_their_turn(loop: Loop) -> None:
    """Poses reach the task parameters at once, although the node was flooded for seconds."""
    loop.move()
    frames = Inbox(loop.node, TaskParameters, "task_parameters", ALL_LATCHED)
    loop.torques.clear()
    began = time.monotonic()
    waits: list[float] = []

    def flood() -> None:
        for _ in range(5):
            loop.hand.stamp_ns = loop.node.get_clock().now().nanoseconds
            loop.hand.states.publish(loop.hand.state())

    while time.monotonic() < began + 6.0:
        stamp_ns = loop.node.get_clock().now().nanoseconds
        pose = np.array([0.65, 0.4, 0.0, 0.0, 0.0, 0.0, 1.0])
        loop.poses["object"].publish(conversions.pose_stamped(pose, stamp_ns, "base"))
        sent = time.monotonic()

        def is_seen(stamp_ns: int = stamp_ns) -> bool:
            flood()
            seen = [item.stamp for message in frames.messages[-5:] for item in message.frames if item.name == "object"]
            return any(conversions.time_to_ns(stamp) >= stamp_ns for stamp in seen)

        loop.wait(is_seen, "the pose to be in the task parameters", 20.0)
        waits.append(time.monotonic() - sent)
    answered = len(set(stamps_of(loop.torques.messages)))
    print(f"{len(waits)} poses, at most {1e3 * max(waits):.0f} ms late, {answered} states answered")
    # each pose waits for few answers, however fast the machine is: 1.6 of them; 18 where each state had its own event
    assert len(waits) > 20 and answered < 10 * len(waits)
