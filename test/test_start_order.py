# SPDX-License-Identifier: Apache-2.0
"""A graph in lockstep goes on whichever node starts last, is started again, or is deactivated meanwhile."""

from __future__ import annotations

import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from long_tests import mostly_long
from ros_graph import ACTIVATE, DEACTIVATE, ROBOT_FILE, SECOND, TASK_FILE, change_state, ros_arguments
from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task

RATE, POSE_RATE = 250.0, 50.0
Nodes = dict[str, dict[str, object]]
LOOP: Nodes = {
    "baxter_simulator": {
        "robot_file": ROBOT_FILE,
        "lockstep": True,
        "rate": RATE,
        "physics_steps": 4,
        "pose_rate": POSE_RATE,
    },
    "impedance_controller": {"robot_file": ROBOT_FILE, "lockstep": True, "use_sim_time": True, "autostart": True},
}

GRAPHS: dict[str, Nodes] = {
    "poses": {
        **LOOP,
        "frame_tracker": {"task_file": TASK_FILE, "lockstep": True, "use_sim_time": True},
        "reproduction": {"task_file": TASK_FILE, "lockstep_rate": POSE_RATE, "use_sim_time": True, "autostart": True},
    },
    "joints": {**LOOP, "joint_reference": {"robot_file": ROBOT_FILE, "led": "[left, right]", "use_sim_time": True}},
}
ORDERS = [(kind, name) for kind, nodes in GRAPHS.items() for name in nodes]
LIFECYCLE = "impedance_controller", "reproduction"


class Graph:
    """The nodes, and a camera that answers each pose of the hand with what it sees of each frame."""

    def __init__(self, node: Node, nodes: Nodes, start: StartProcess) -> None:
        self.node, self._nodes, self._start = node, nodes, start
        self.processes = dict[str, RunningProcess]()
        self.stamp_ns = 0
        task = Task.load(TASK_FILE)
        self._seen = [node.create_publisher(PoseStamped, topic, STREAM) for topic in task.topics.values()]
        node.create_subscription(PoseStamped, task.movement, self._see, STREAM)
        node.create_subscription(JointState, "joint_states", self._take, STREAM)

    def _see(self, hand: PoseStamped) -> None:
        for publisher in self._seen:
            publisher.publish(PoseStamped(header=hand.header, pose=hand.pose))

    def _take(self, state: JointState) -> None:
        self.stamp_ns = conversions.time_to_ns(state.header.stamp)

    def start(self, name: str) -> None:
        self.processes[name] = self._start(name, *ros_arguments(**self._nodes[name]))

    def goes_on(self, what: str) -> None:
        """Wait until time has gone on by half a second."""
        begin = self.stamp_ns
        processes = tuple(self.processes.values())

        def has_gone_on() -> bool:
            return begin > 0 and self.stamp_ns > begin + SECOND // 2

        def has_begun() -> bool:
            nonlocal begin
            begin = self.stamp_ns
            return begin > 0

        spin_until(self.node, has_begun, message=f"a joint state {what}", processes=processes)
        spin_until(self.node, has_gone_on, message=f"time to go on {what}", processes=processes)


@pytest.mark.parametrize(("kind", "last"), mostly_long(ORDERS, *(one for one in ORDERS if one[0] == "poses")))
def test_time_goes_on_whoever_comes_last_and_comes_again(
    kind: str, last: str, ros_node: Node, start_process: StartProcess
) -> None:
    nodes = GRAPHS[kind]
    graph = Graph(ros_node, nodes, start_process)
    others = [name for name in nodes if name != last]
    for name in others:
        graph.start(name)
    spin_until(
        ros_node,
        lambda: set(others) <= set(ros_node.get_node_names()),
        message="the other nodes",
        processes=tuple(graph.processes.values()),
    )
    graph.start(last)
    graph.goes_on(f"with {last} as the last to start")
    graph.processes.pop(last).stop()
    graph.stamp_ns = 0
    graph.start(last)
    graph.goes_on(f"with {last} started again")
    for name in (name for name in LIFECYCLE if name in nodes):
        assert change_state(ros_node, name, DEACTIVATE, ACTIVATE)
        graph.goes_on(f"with {name} activated again")
