# SPDX-License-Identifier: Apache-2.0
"""One robot does the pick-and-place task: what was reached, and what broke the contract of its interface."""

from __future__ import annotations

import json
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String

from interfaces.cases import Case
from interfaces.contract import broken_by_torques
from interfaces.stand_in import KEPT
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import compose, pose_error
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.demo.recording import RunRecord
from tpgmm_demos.demo.world import EXACT_RATE, Disturbances, World
from tpgmm_demos.scene.perception import SimulatedCamera, perception
from tpgmm_demos.scene.pick_place import Placement, random_placement
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.runtime.graph import Graph, open_graph, own_domain
from tpgmm_ros.runtime.processes import GraphError
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

START_TIMEOUT, END_TIMEOUT = 90.0, 240.0
#: The object is to lie so near to its target, m.
LARGEST_ERROR = 0.01
#: How long a robot is watched once its nodes have ended, s, and how far the hand may go meanwhile, m.
WATCHED, LARGEST_REST = 1.0, 0.005
#: Nobody pushes or hides anything.
UNDISTURBED = Disturbances(0.0, 1.0, np.zeros(6), "", 0.0, 0.0)


class Hand:
    """Where the hand is."""

    def __init__(self, node: Node, topic: str) -> None:
        self.pose: Array | None = None
        node.create_subscription(PoseStamped, topic, self._take, STREAM)

    def _take(self, message: PoseStamped) -> None:
        self.pose = conversions.pose_to_array(message.pose)


def placed(task: Task, seed: int) -> Placement:
    """A situation in front of this robot: one of the demonstrating robot, which stands where the task's `robot` is."""
    there = random_placement(np.random.default_rng([seed, 0xDE, 0x40]))
    base = np.array(task.frames["robot"].pose)
    return Placement(compose(base, there.object), compose(base, there.target))


#: Of the nodes, where a simulator waits for their answers: time then passes as fast as they can.
LOCKSTEP = """\
frame_tracker: {{ros__parameters: {{lockstep: true}}}}
reproduction: {{ros__parameters: {{lockstep_rate: {rate:f}, start_timeout: 60.0}}}}
impedance_controller: {{ros__parameters: {{lockstep: true}}}}
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """Under which conditions a robot does the task.

    `seed` is that of the situation, `rate` that of a robot that takes torques, Hz, `duration` that of the movement, s
    (0: as demonstrated), `priority` that of the nodes. `slower`: on simulated time, so many times slower than real;
    a robot that takes torques then waits for each answer.
    """

    seed: int = 1
    rate: float = 1000.0
    duration: float = 0.0
    priority: int = 0
    slower: float = 0.0

    def arguments(self, case: Case, output: Path) -> dict[str, str]:
        """Of the launch file, for these conditions."""
        given = {"realtime_priority": str(self.priority), "use_sim_time": "true" if self.slower else "false"}
        if case.stand_in:
            return given
        given["joint_state_rate"] = str(self.rate)
        if self.slower:
            path = output / "lockstep.yaml"
            # poses come near 100 Hz, a whole number of joint states apart
            path.write_text(LOCKSTEP.format(rate=self.rate / max(1, round(self.rate / 100.0))))
            given["parameters"] = str(path)
        return given


def run(case: Case, model: Path, output: Path, under: Conditions) -> dict[str, Any]:
    """Start the robot's stand-in and the nodes, ask for the movement, end the nodes; returns what was measured."""
    task, robot = Task.load(config_file(case.task)), RobotModel.from_file(config_file(case.robot))
    output.mkdir(parents=True, exist_ok=True)
    waits = bool(under.slower) and not case.stand_in
    with own_domain(ros_log=output / "ros"), open_graph(f"{case.name}_bench", output / "log") as graph:
        camera = SimulatedCamera(perception("camera", EXACT_RATE), [under.seed, 0xDE, 0xCA])
        world = World(graph.node, task, placed(task, under.seed), UNDISTURBED, camera, lockstep=waits)
        hand, texts, reports = Hand(graph.node, task.movement), Counter[str](), [""]
        examples: dict[str, str] = {}

        def hear(message: String) -> None:
            kind = message.data.partition(":")[0]
            texts[kind] += 1
            examples.setdefault(kind, message.data)

        def hear_report(message: String) -> None:
            reports[0] = message.data

        graph.node.create_subscription(String, "violations", hear, KEPT)
        graph.node.create_subscription(String, "robot_report", hear_report, KEPT)
        recorder = Node("robot_recorder")
        record = RunRecord(recorder, task, list(robot.joint_names), with_other_hosts=False)
        loop = case.processes(model, **under.arguments(case, output))
        for process in loop:
            graph.processes.start_command(process.executable, process.command())
        robot_command = case.robot_command(under.rate, under.slower)
        if not waits:
            graph.processes.start_command("robot", robot_command)
            graph.wait_for(lambda: hand.pose is not None, START_TIMEOUT, "the hand's pose")
        result = _ask(graph, under.duration)
        if waits:  # simulated time begins with the movement
            graph.processes.start_command("robot", robot_command)
        success, reason = _outcome(graph, record, result, END_TIMEOUT * max(1.0, under.slower))
        error, angle = pose_error(world.grasp.object, world.situation.target)
        rest = 0.0 if waits else _end(graph, record, hand, loop[0].executable, WATCHED * max(1.0, under.slower))
        recorder.destroy_node()
    if case.stand_in:
        told = json.loads(reports[0])
        commands, gap = told["commands"], told["longest_gap_s"]
    else:
        torque = record.torque()
        broken = broken_by_torques(robot, torque.stamps_ns, torque.values, case.silence, 1.0 / under.rate)
        texts.update(text.partition(":")[0] for text in broken)
        examples |= {text.partition(":")[0]: text for text in reversed(broken)}
        commands, gap = len(torque.values), 1e-9 * float(np.diff(torque.stamps_ns).max())
    if commands == 0:
        texts["nothing"] += 1
    if gap > case.silence:
        texts["silence"] += 1
        examples.setdefault("silence", f"silence: {1e3 * gap:.0f} ms without a command")
    if rest > LARGEST_REST:
        texts["end"] += 1
        examples.setdefault("end", f"end: the hand goes on for {1e3 * rest:.0f} mm")
    checks = {
        "the object was grasped": world.grasp.holds, "the movement ended well": success,
        "the object is on its target": error <= LARGEST_ERROR, "the contract was kept": not texts,
    }  # fmt: skip
    return {
        "robot": case.name, "interface": case.interface, "error_mm": 1e3 * error, "error_deg": np.degrees(angle),
        "commands": commands, "longest_gap_ms": 1e3 * gap, "after_the_end_mm": 1e3 * rest,
        "violations": dict(texts), "examples": examples, "said": reason, "checks": checks,
        "passed": all(checks.values()),
    }  # fmt: skip


def _ask(graph: Graph, duration: float) -> Future:
    """Ask for the movement; its result is to come."""
    client = ActionClient(graph.node, Reproduce, "reproduce")
    graph.wait_for(client.server_is_ready, START_TIMEOUT, "the action 'reproduce'")
    goal = graph.result(client.send_goal_async(Reproduce.Goal(duration=duration)), START_TIMEOUT, "the goal's answer")
    if not goal.accepted:
        raise GraphError("reproduction refused the goal")
    return goal.get_result_async()


def _outcome(graph: Graph, record: RunRecord, result: Future, timeout: float) -> tuple[bool, str]:
    """Whether the movement ended well, and what the action said."""

    def has_ended() -> bool:
        record.poll()
        return result.done()

    graph.wait_for(has_ended, timeout, "the end of the movement")
    answer: Any = result.result()
    return answer.status == GoalStatus.STATUS_SUCCEEDED, answer.result.reason


def _end(graph: Graph, record: RunRecord, hand: Hand, name: str, watched: float) -> float:
    """End the process that gives the commands, as a user does; how far the hand goes from then on, m."""
    assert hand.pose is not None
    before, farthest = hand.pose, 0.0
    ending = graph.processes.end(name)
    until = time.monotonic() + watched

    def has_passed() -> bool:
        nonlocal farthest
        record.poll()
        assert hand.pose is not None
        farthest = max(farthest, pose_error(hand.pose, before)[0])
        return ending.poll() is not None and time.monotonic() > until

    graph.wait_for(has_passed, 30.0 + watched, f"{name} to end")
    return farthest
