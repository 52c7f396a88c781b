# SPDX-License-Identifier: Apache-2.0
"""No message ends a node: every subscription of every running node, and all that its type permits.

What a node subscribes to is asked of the ROS graph and what its messages hold of their types, so that a new
subscription is tried without a word here. After it, good inputs are answered as before, and the log is one that a
person can read. `make test` sends some messages, more with TPGMM_FUZZ_EXAMPLES.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from faults.graph_bench import trained
from message_fuzz import Fuzz, subscriptions
from ros_graph import ALL, ALL_LATCHED, ROBOT_FILE, TASK_FILE, Inbox, ros_arguments
from ros_testing import RunningProcess, StartProcess, spin_until
from simulated_hand import NAMES, ROBOT, pose_reference
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import Reference, TaskParameters
from tpgmm_ros.messages import conversions

MESSAGES = int(os.environ.get("TPGMM_FUZZ_EXAMPLES", "120"))
#: Fits to all who subscribe.
ANYONE = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: A log of lines that are longer is for nobody.
LONGEST_LINE = 4000
#: Whose subscription of /clock is tried too.
ON_CLOCK = ("frame_tracker", "impedance_controller")
ROBOT_ARGUMENTS: dict[str, object] = {"robot_file": ROBOT_FILE}
NODES: dict[str, dict[str, object]] = {
    "frame_tracker": {"task_file": TASK_FILE},
    "reproduction": {"task_file": TASK_FILE, "autostart": True, "start_timeout": 600.0},
    "impedance_controller": {**ROBOT_ARGUMENTS, "autostart": True},
    # states and references come in bursts, each of which is a movement: what was spoiled ends with it
    "joint_motion": {**ROBOT_ARGUMENTS, "autostart": True, "joint_state_timeout": 10.0, "reference_timeout": 0.05},
    "baxter_simulator": ROBOT_ARGUMENTS,
    "joint_reference": ROBOT_ARGUMENTS,
    "endpoint_poses": ROBOT_ARGUMENTS,
}


@dataclass
class Bench:
    """A node, publishers on all that it subscribes to, and what it answers."""

    node: Node
    process: RunningProcess
    name: str
    publishers: dict[str, Any] = field(default_factory=dict)
    inboxes: dict[str, Inbox] = field(default_factory=dict)

    def now_ns(self) -> int:
        return self.node.get_clock().now().nanoseconds

    def good(self, kind: Any) -> Any:
        """A message of this moment; of a type that is not known here an empty one."""
        now_ns = self.now_ns()
        pose = np.array([0.6, 0.2, 0.1, 0.0, 0.0, 0.0, 1.0])
        still = np.zeros(len(NAMES))
        if kind is JointState:
            return conversions.joint_state_message(NAMES, now_ns, ROBOT.home, still, still)
        if kind is PoseStamped:
            return conversions.pose_stamped(pose, now_ns, "base")
        if kind is WrenchStamped:
            return conversions.wrench_from_array([0.0] * 6, now_ns, "left_gripper")
        if kind is TaskParameters:
            frames = [TrackedFrame(n, FrameStatus.VISIBLE, 1.0, now_ns, pose) for n in ("object", "target", "robot")]
            return conversions.task_parameters_message(frames, now_ns, "base")
        if kind is Reference:
            return pose_reference(pose, now_ns)
        if kind is Clock:
            return Clock(clock=conversions.time_from_ns(now_ns))
        return kind()

    def meet(self) -> None:
        """A publisher for each subscription that the node has made since: a node that starts makes them one by one."""
        for topic, kind in subscriptions(self.node, self.name).items():
            if topic not in self.publishers:
                self.publishers[topic] = self.node.create_publisher(kind, topic, ANYONE)

    def is_at_work(self) -> bool:
        """Whether it answers good inputs, all of which are sent anew."""
        self.meet()
        sent = {}
        for topic, publisher in self.publishers.items():
            message = self.good(publisher.msg_type)
            sent[topic] = message
            publisher.publish(message)
        began = time.monotonic()
        while time.monotonic() - began < 0.1:
            self.node.executor.spin_once(timeout_sec=0.01)  # type: ignore[union-attr]
        return ANSWERED[self.name](self, sent)


def answers_with_the_stamp(topic: str, of: str) -> Callable[[Bench, dict[str, Any]], bool]:
    def answered(bench: Bench, sent: dict[str, Any]) -> bool:
        return any(item.header.stamp == sent[of].header.stamp for item in bench.inboxes[topic].messages)

    return answered


def frames_are_seen(bench: Bench, sent: dict[str, Any]) -> bool:
    items = [item for message in bench.inboxes["task_parameters"].messages for item in message.frames]
    stamps = {conversions.time_to_ns(item.stamp) for item in items}
    return all(
        conversions.time_to_ns(message.header.stamp) in stamps
        for topic, message in sent.items()
        if isinstance(message, PoseStamped) and not topic.startswith("/endpoint/")  # the hand is no frame
    )


def goes_on(bench: Bench, sent: dict[str, Any]) -> bool:
    """The simulated robot, driven by torques that are none: its states go on, finite."""
    last = bench.inboxes["joint_states"].messages[-5:]
    return len(last) == 5 and all(
        np.isfinite(item.position).all() and np.isfinite(item.velocity).all() for item in last
    )


def tells_joints(bench: Bench, sent: dict[str, Any]) -> bool:
    """Trajectories that begin after good inputs, of finite numbers."""
    inbox = bench.inboxes["joint_trajectory_controller/joint_trajectory"]
    told = [point for message in inbox.messages for point in message.points]
    inbox.clear()
    assert all(np.isfinite([*point.positions, *point.velocities]).all() for point in told)
    return bool(told)


ANSWERED: dict[str, Callable[[Bench, dict[str, Any]], bool]] = {
    "frame_tracker": frames_are_seen,
    "reproduction": answers_with_the_stamp("reference", "/joint_states"),
    "impedance_controller": answers_with_the_stamp("joint_torques", "/joint_states"),
    "joint_motion": tells_joints,
    "baxter_simulator": goes_on,
    "joint_reference": answers_with_the_stamp("reference", "/joint_states"),
    "endpoint_poses": answers_with_the_stamp("endpoint/left/pose", "/joint_states"),
}
OUTPUTS: dict[str, tuple[type, str, QoSProfile]] = {
    "frame_tracker": (TaskParameters, "task_parameters", ALL_LATCHED),
    "reproduction": (Reference, "reference", ALL),
    "impedance_controller": (JointState, "joint_torques", ALL),
    "joint_motion": (JointTrajectory, "joint_trajectory_controller/joint_trajectory", ALL),
    "baxter_simulator": (JointState, "joint_states", ALL),
    "joint_reference": (Reference, "reference", ALL),
    "endpoint_poses": (PoseStamped, "endpoint/left/pose", ALL),
}


def opened(node: Node, start: StartProcess, name: str, **more: object) -> Bench:
    process = start(name, *ros_arguments(**{**NODES[name], **more}))
    bench = Bench(node, process, name)
    kind, topic, qos = OUTPUTS[name]
    bench.inboxes[topic] = Inbox(node, kind, topic, qos)
    spin_until(
        node,
        lambda: name in node.get_node_names() and subscriptions(node, name),
        message=f"{name} to subscribe",
        processes=(process,),
    )
    bench.meet()
    spin_until(node, lambda: all(item.get_subscription_count() for item in bench.publishers.values()))
    return bench


@pytest.mark.parametrize("on_clock", [False, True], ids=["", "use_sim_time"])
@pytest.mark.parametrize("name", NODES)
def test_whatever_message_comes_the_node_goes_on_and_answers_good_ones_as_before(
    ros_node: Node, start_process: StartProcess, tmp_path: Path, name: str, on_clock: bool
) -> None:
    if on_clock and name not in ON_CLOCK:
        pytest.skip("the clock is the same code in all nodes")
    more: dict[str, object] = {"use_sim_time": on_clock}
    if name == "reproduction":
        more |= {"model_file": trained(tmp_path / "model.tpgmm")}
    bench = opened(ros_node, start_process, name, **more)

    def at_work() -> bool:
        ask()
        return bench.is_at_work()

    client = ActionClient(ros_node, Reproduce, "reproduce") if name == "reproduction" else None
    asked: list[Any] = []

    def ask() -> None:
        """A movement goes on, or one is asked for."""
        if client is None or not client.server_is_ready():
            return
        if not asked or (asked[-1].done() and asked[-1].result().get_result_async().done()):
            asked.append(client.send_goal_async(Reproduce.Goal(duration=100.0)))

    spin_until(ros_node, at_work, 60.0, f"{name} to be at work", (bench.process,))
    fuzz = Fuzz(len(name))
    rng = np.random.default_rng(0)
    topics = sorted(bench.publishers)
    for _ in range(MESSAGES):
        topic = topics[int(rng.integers(len(topics)))]
        publisher = bench.publishers[topic]
        good = bench.good(publisher.msg_type)
        publisher.publish(fuzz.damaged(good) if rng.random() < 0.3 else fuzz.spoiled(good))
        ros_node.executor.spin_once(timeout_sec=0.002)  # type: ignore[union-attr]
        assert bench.process.returncode is None, bench.process.output[-4000:]
    bench.inboxes[OUTPUTS[name][1]].clear()
    spin_until(ros_node, at_work, 60.0, f"{name} to be at work again", (bench.process,))
    output = bench.process.output
    assert "Traceback" not in output, output[output.index("Traceback") :][:4000]
    longest = max(map(len, output.splitlines()), default=0)
    assert longest < LONGEST_LINE, f"a line of {longest} characters: {output[:300]}"


@pytest.mark.parametrize("name", ["frame_tracker", "impedance_controller", "endpoint_poses"])
def test_names_of_a_megabyte_make_neither_the_log_nor_the_diagnostics_long(
    ros_node: Node, start_process: StartProcess, name: str
) -> None:
    long = "x" * 1_000_000
    bench = opened(ros_node, start_process, name)
    told = Inbox(ros_node, DiagnosticArray, "/diagnostics", ALL)
    spin_until(ros_node, bench.is_at_work, 60.0, f"{name} to be at work", (bench.process,))
    for _ in range(3):
        for publisher in bench.publishers.values():
            foreign = bench.good(publisher.msg_type)
            named = [foreign]
            if hasattr(foreign, "header"):
                foreign.header.frame_id = long
            if isinstance(foreign, JointState):
                joint = bench.good(JointState)
                joint.name = [long, *joint.name[1:]]
                named.append(joint)
            for message in named:
                publisher.publish(message)
                ros_node.executor.spin_once(timeout_sec=0.05)  # type: ignore[union-attr]
    wish = SetParameters.Request(parameters=[Parameter(long, value=long).to_parameter_msg()])
    client = ros_node.create_client(SetParameters, f"/{name}/set_parameters")
    assert client.wait_for_service(30.0)
    answer = client.call_async(wish)
    spin_until(ros_node, answer.done, 60.0, "the parameter to be refused", (bench.process,))
    assert not answer.result().results[0].successful
    told.clear()
    bench.inboxes[OUTPUTS[name][1]].clear()
    spin_until(ros_node, bench.is_at_work, 60.0, f"{name} to be at work again", (bench.process,))
    spin_until(ros_node, lambda: len(told.messages) > 2, 60.0, "diagnostics", (bench.process,))
    texts = [
        text
        for array in told.messages
        for status in array.status
        for text in (status.message, *(value.value for value in status.values))
    ]
    assert max(map(len, [*texts, *bench.process.output.splitlines()])) < LONGEST_LINE
