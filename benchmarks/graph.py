# SPDX-License-Identifier: Apache-2.0
"""The running nodes in real time, in one process or in several, for the benchmarks of the whole loop."""

from __future__ import annotations

import contextlib
import subprocess
import sys
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
from tpgmm_ros.runtime.graph import Graph, open_graph, own_domain
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY, Value
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
        """Publish where one object is, with the stamp of this moment."""
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
def running(together: bool, load: int = 0, blend_time: float = 0.15) -> Iterator[Scene]:
    """All four nodes, up and active, on a ROS domain of their own.

    Parameters
    ----------
    together : bool
        The nodes from pose to torque in one process, not each in its own. The robot always has a process.
    load : int
        How many busy programs run beside them, as ordinary ones.
    blend_time : float
        Of `reproduction`, s.
    """
    task_file, robot_file = config_file("pick_place.yaml"), config_file("baxter.yaml")
    with tempfile.TemporaryDirectory() as name, busy(load):
        directory = Path(name)
        model_file = directory / "model.tpgmm"
        if train.main(["--task", str(task_file), "--output", str(model_file), str(BAGS)]) != 0:
            raise RuntimeError(f"no model from {BAGS}: see above for the reason")
        with own_domain(ros_log=directory), open_graph("benchmark", directory / "log") as graph:
            first: dict[str, Value] = {"realtime_priority": REALTIME_PRIORITY, "lock_memory": True}
            nodes: dict[str, dict[str, Value]] = {
                "frame_tracker": {"task_file": task_file, **first},
                "reproduction": {"task_file": task_file, "model_file": model_file, "blend_time": blend_time, **first},
                "impedance_controller": {"robot_file": robot_file, **first},
            }
            graph.processes.start_all("loop", nodes, together)
            graph.processes.start("baxter_simulator", robot_file=robot_file, **first)
            graph.bring_up("impedance_controller", START_TIMEOUT)
            graph.bring_up("reproduction", START_TIMEOUT)
            yield Scene(graph.node, graph, Task.load(task_file))


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Ordinary programs that want a core each."""
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


#: What the benchmarks of the loop compare: in how many processes, and beside how many busy programs.
CASES = [("apart", False, 0), ("one process", True, 0), ("apart, load", False, 2), ("one process, load", True, 2)]
