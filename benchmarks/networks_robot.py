# SPDX-License-Identifier: Apache-2.0
"""The host of the robot in `networks`: simulator and controller, the world around them, and who asks for the movement.

What the camera sees of the world leaves through a pipe, as light does; the network is for messages.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState

from benchmarks.lossy_switch import NETWORK, require_own_network
from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.demo.recording import RunRecord
from tpgmm_demos.demo.report import JUMP, LARGEST_POSITION_ERROR, SILENCE, largest_jump, longest_silence, usual_jump
from tpgmm_demos.demo.world import EXACT_RATE, Disturbances, World
from tpgmm_demos.scene.perception import SimulatedCamera, perception
from tpgmm_demos.scene.pick_place import random_placement
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import EVENTS, STREAM
from tpgmm_ros.runtime.executor import init
from tpgmm_ros.runtime.graph import ASK_AGAIN, Graph, open_graph
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

#: Time that nodes may take to find each other, and the movement to end, s.
START_TIMEOUT, END_TIMEOUT = 120.0, 200.0
#: What a node says of itself once per second is true for so long, s.
FRESH = 3.0
#: Of the movement, s: slow enough for the disturbances and for the time without a camera.
DURATION = 20.0


class Thinned:
    """Publishes every so many messages of a topic of this host once more, for the others: the cables are slow.

    Parameters
    ----------
    node
        subscribes and publishes
    kind
        of the messages
    topic
        of this host; the others get it below `NETWORK`
    every
        so many
    """

    def __init__(self, node: Node, kind: type, topic: str, every: int) -> None:
        self._every, self._count = every, 0
        self._publisher = node.create_publisher(kind, f"{NETWORK}/{topic}", STREAM)
        node.create_subscription(kind, topic, self._take, STREAM, raw=True)

    def _take(self, message: Any) -> None:
        if self._count % self._every == 0:
            self._publisher.publish(message)
        self._count += 1


class Others:
    """What the nodes of another host say: whether they get what they need.

    Counting topics does not tell: DDS finds them one by one in each direction, and where packets are lost this takes
    a while.

    Parameters
    ----------
    node
        listens to their diagnostics
    frames
        that have to be seen
    """

    def __init__(self, node: Node, frames: Sequence[str]) -> None:
        self._node, self._frames = node, frames
        self._said: dict[str, tuple[float, dict[str, str]]] = {}
        self.subscription = node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, EVENTS)

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._said[status.name] = time.monotonic(), {item.key: item.value for item in status.values}

    def _latest(self, node: str) -> dict[str, str]:
        at, values = self._said.get(node, (-math.inf, {}))
        return values if time.monotonic() - at < FRESH else {}

    def are_found(self) -> bool:
        """Whether joint states and frames came there just now, and references can come here."""
        tracked, age = self._latest("frame_tracker"), self._latest("reproduction").get("joint_state_age_s", "inf")
        seen = all(tracked.get(f"status_{name}") in ("VISIBLE", "HELD") for name in self._frames)
        return seen and float(age) < FRESH and self._node.count_publishers("reference") > 0


class Asked:
    """An answer that is asked for again every `ASK_AGAIN` seconds; the last one that was asked for counts.

    Parameters
    ----------
    ask
        asks once
    """

    def __init__(self, ask: Callable[[], Future]) -> None:
        self._ask, self._due = ask, 0.0
        self._asked: Future | None = None

    def has_come(self) -> bool:
        """Whether it is there."""
        if self._asked is not None and self._asked.done():
            return True
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + ASK_AGAIN
            self._asked = self._ask()
        return False

    def answer(self) -> Any:
        """What came."""
        assert self._asked is not None
        return self._asked.result()


def _accepted(graph: Graph, client: ActionClient, feedback: Callable[[Any], object]) -> Any:
    """The goal, once it has been accepted; one that is asked for again replaces the one before."""
    goals = Asked(lambda: client.send_goal_async(Reproduce.Goal(duration=DURATION), feedback))
    graph.wait_for(goals.has_come, START_TIMEOUT, "the goal to be accepted")
    return goals.answer()


def main() -> None:
    """Run the task; says on standard output when the movement starts and what was measured, as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--network-rate", type=float, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--sightings", type=int, required=True, help="the pipe's number")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    task, robot = Task.load(config_file("pick_place.yaml")), RobotModel.from_file(config_file("baxter.yaml"))
    random = np.random.default_rng([arguments.seed, 0xDE, 0x40])
    situation = random_placement(random)
    disturbances = Disturbances.random(random, DURATION)
    require_own_network()
    init([])
    with (
        open_graph("robot_host", arguments.output / "robot", False) as graph,
        os.fdopen(arguments.sightings, "w") as eye,
    ):

        def show(name: str, pose: PoseStamped) -> None:
            stamp_ns = conversions.time_to_ns(pose.header.stamp)
            print(json.dumps((name, stamp_ns, conversions.pose_to_array(pose.pose).tolist())), file=eye, flush=True)

        recorder = Node("robot_recorder")
        recording = RunRecord(recorder, task, list(robot.joint_names), with_other_hosts=False)
        camera = SimulatedCamera(perception("camera", EXACT_RATE), [arguments.seed, 0xDE, 0xCA])
        world = World(graph.node, task, situation, disturbances, camera, publish=show)
        graph.processes.start_all(
            "robot",
            {
                "impedance_controller": {
                    "robot_file": config_file("baxter.yaml"), "joint_state_rate": arguments.rate, "autostart": True,
                    "joint_state_timeout": 5.0 / arguments.rate, "max_time_step": 2.0 / arguments.rate,
                },
                "baxter_simulator": {
                    "robot_file": config_file("baxter.yaml"), "rate": arguments.rate,
                    "physics_steps": math.ceil(1000.0 / arguments.rate),
                },
            },
        )  # fmt: skip
        for kind, topic in ((JointState, "joint_states"), (PoseStamped, task.movement)):
            Thinned(graph.node, kind, topic, round(arguments.rate / arguments.network_rate))
        graph.wait_for(recording.hand_is_known, START_TIMEOUT, "the hand's pose")
        client = ActionClient(graph.node, Reproduce, "reproduce")
        graph.wait_for(client.server_is_ready, START_TIMEOUT, "the action 'reproduce'")
        others = Others(graph.node, list(task.topics))
        graph.wait_for(others.are_found, START_TIMEOUT, "the other hosts to get what this one and the camera publish")
        graph.node.destroy_subscription(others.subscription)
        phases: list[float] = []
        goal = _accepted(graph, client, lambda told: phases.append(told.feedback.phase))
        result = Asked(goal.get_result_async)

        def begins() -> bool:
            recording.poll()
            return result.has_come() or any(phase > 0.0 for phase in phases)

        graph.wait_for(begins, START_TIMEOUT, "the movement to begin")
        world.started_ns = int(recording.hand().stamps_ns[-1])
        print(json.dumps({"started": True}), flush=True)

        def ends() -> bool:
            recording.poll()
            return result.has_come()

        graph.wait_for(ends, END_TIMEOUT, "the end of the movement")
        response = result.answer()
        recorder.destroy_node()
    torque, started = recording.torque().since(world.started_ns), world.started_ns
    end = float(torque.times(started)[-1])
    position, angle = pose_error(world.grasp.object, world.situation.target)
    steps, usual = largest_jump(torque, started, 0.0, end), usual_jump(torque, started, (0.0, 0.0))
    share = float((np.abs(torque.values) / robot.effort_limits).max())
    checks = {
        "the object was grasped": world.grasp.holds,
        "the movement ended well": response.status == GoalStatus.STATUS_SUCCEEDED,
        "the object is on the target": position <= LARGEST_POSITION_ERROR,
        "no torque above its limit": share <= 1.0,
        "torques arrived without a gap": longest_silence(torque, started, end) <= SILENCE,
        "no jump": steps is not None and steps <= max(JUMP, 2.0 * usual),
    }
    print(
        json.dumps(
            {
                "position_error_mm": 1e3 * position, "orientation_error_deg": math.degrees(angle),
                "largest_torque_jump_nm": steps, "usual_torque_jump_nm": usual, "torque_share": share,
                "movement_s": end, "outcome": response.result.reason, "checks": checks, "passed": all(checks.values()),
            }
        ),
        flush=True,
    )  # fmt: skip


if __name__ == "__main__":
    main()
