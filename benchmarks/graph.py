# SPDX-License-Identifier: Apache-2.0
"""The nodes as separate processes in real time, for the benchmarks across processes."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from tpgmm_demos.scene.pick_place import random_placement
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.programs import train
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY, Graph, open_graph, own_domain
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

BAGS = Path("bags/pick_place")
START_TIMEOUT = 60.0


class Scene:
    """The running nodes, and objects that are seen 30 times per second where `places` has them."""

    def __init__(self, node: Node, graph: Graph, task: Task) -> None:
        self.node, self.graph = node, graph
        situation = random_placement(np.random.default_rng(0))
        self.places = {"object": situation.object, "target": situation.target}
        self._base_frame = task.base_frame
        self._publishers = {
            name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()
        }
        node.create_timer(1.0 / 30.0, self.show, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._client = ActionClient(node, Reproduce, "reproduce")

    def show(self) -> None:
        """Publish where everything is."""
        for name in self.places:
            self.show_one(name)

    def show_one(self, name: str) -> None:
        stamp = self.node.get_clock().now().nanoseconds
        self._publishers[name].publish(conversions.pose_stamped(self.places[name], stamp, self._base_frame))

    def run_for(self, seconds: float) -> None:
        """Serve the node for this long."""
        end = time.monotonic() + seconds
        self.graph.wait_for(lambda: time.monotonic() >= end, seconds + 60.0, "the time to pass")

    def reproduce(self, duration: float) -> Reproduce.Result:
        """One whole movement of this duration, s."""
        self.graph.wait_for(self._client.server_is_ready, START_TIMEOUT, "the action 'reproduce'")
        sent = self._client.send_goal_async(Reproduce.Goal(duration=duration))
        goal = self.graph.result(sent, START_TIMEOUT, "the goal to be accepted")
        response = self.graph.result(goal.get_result_async(), duration + START_TIMEOUT, "the end of the movement")
        return response.result


@contextlib.contextmanager
def running(blend_time: float = 0.15) -> Iterator[Scene]:
    """All four nodes, up and active, on a ROS domain of their own; `blend_time` is that of `reproduction`, s."""
    task_file, robot_file = config_file("pick_place.yaml"), config_file("baxter.yaml")
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        model_file = directory / "model.tpgmm"
        if train.main(["--task", str(task_file), "--output", str(model_file), str(BAGS)]) != 0:
            raise RuntimeError(f"no model from {BAGS}: see above for the reason")
        with own_domain(ros_log=directory), open_graph("benchmark", directory / "log") as graph:
            start, first = graph.processes.start, {"realtime_priority": REALTIME_PRIORITY}
            start("frame_tracker", task_file=task_file, **first)
            start("reproduction", task_file=task_file, model_file=model_file, blend_time=blend_time, **first)
            start("impedance_controller", robot_file=robot_file, **first)
            start("baxter_simulator", robot_file=robot_file, **first)
            graph.bring_up("impedance_controller", START_TIMEOUT)
            graph.bring_up("reproduction", START_TIMEOUT)
            yield Scene(graph.node, graph, Task.load(task_file))
