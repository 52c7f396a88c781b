# SPDX-License-Identifier: Apache-2.0
"""Two reproductions, one for each hand, and joint_reference: their product in joint space moves both."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState

from ros_graph import ROOT, SECOND, Inbox, result_of, ros_arguments
from ros_testing import STARTUP_TIMEOUT, RunningProcess, StartProcess, spin_until
from tpgmm_core import Demonstration, Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference as CoreReference
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import Reference, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.task.task_file import Task

ROBOT_FILE = ROOT / "config" / "baxter.yaml"
TICK_NS = 10_000_000
DIMENSIONS = ("x", "y", "z", "qx", "qy", "qz", "qw")
#: Of each hand: how far its object is from where it begins, m, and how long it was shown to take, s.
WAYS = {"left": (np.array([0.08, 0.06, 0.05]), 1.0), "right": (np.array([0.05, -0.08, -0.04]), 0.6)}
TASK = (
    "{{name: {0}, base_frame: base, movement: endpoint/{0}/pose, endpoint: {0}, "
    "frames: {{object: {{topic: object/pose}}}}}}"
)


def learn(directory: Path, hand: str, home: np.ndarray) -> tuple[Path, Path]:
    """Task file and model of a hand that goes to its object."""
    task_file = directory / f"{hand}.yaml"
    task_file.write_text(TASK.format(hand))
    space, random, (way, seconds) = Task.load(task_file).space, np.random.default_rng(0), WAYS[hand]
    times, shown = np.linspace(0.0, seconds, 30), []
    s = times / seconds
    share = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]
    for _ in range(5):
        start = home + [*random.uniform(-0.1, 0.1, 3), 0.0, 0.0, 0.0, 0.0]
        steps = np.hstack([share * way, np.zeros((30, 3))]) + random.normal(0.0, 0.002, (30, 6))
        data = np.stack([POSE.exp(start, step) for step in steps])
        frames = {"object": Frame.from_pose(start[:3] + way, home[3:]).with_time()}
        shown.append(Demonstration(times, np.column_stack([times, data]), frames))
    model = Recipe.of({"n_components": 4, "reg_covar": 1e-6}).learn(shown, space.manifold(), space.dimensions())
    model.metadata_ = {**model.metadata_, "duration_s": seconds}
    model_file = directory / f"{hand}.tpgmm"
    model.save(model_file)
    return task_file, model_file


class Robot:
    """Joints that are at each tick where the reference was, as fast as they may; and a camera for its objects."""

    def __init__(self, node: Node) -> None:
        self.node, self.model = node, RobotModel.from_file(ROBOT_FILE)
        self.data, self.q, self.stamp_ns = self.model.create_data(), self.model.home.copy(), 10 * SECOND
        self.data.update(self.q)
        self.homes = {hand: self.data.pose(hand).copy() for hand in WAYS}
        self.inbox = Inbox(node, Reference, "reference")
        self.silent: list[Inbox] = []  # of nodes that are gone
        self._states = node.create_publisher(JointState, "joint_states", STREAM)
        self._poses = {h: node.create_publisher(PoseStamped, f"endpoint/{h}/pose", STREAM) for h in WAYS}
        self._objects = {h: node.create_publisher(TaskParameters, f"{h}/task_parameters", LATCHED) for h in WAYS}
        self.said = {h: Inbox(node, Reference, f"{h}/reference") for h in WAYS}
        self.clients = {h: ActionClient(node, Reproduce, f"{h}/reproduce") for h in WAYS}

    def show(self) -> None:
        """Where the objects are, to each hand its own."""
        for hand, publisher in self._objects.items():
            place = np.concatenate([self.homes[hand][:3] + WAYS[hand][0], self.homes[hand][3:]])
            tracked = TrackedFrame("object", FrameStatus.VISIBLE, 1.0, self.stamp_ns, place)
            publisher.publish(conversions.task_parameters_message([tracked], self.stamp_ns, "base"))

    def begin(self) -> dict[str, Future]:
        """Send a goal to each hand; returns their results, which are to come."""
        self.show()
        sent = {h: client.send_goal_async(Reproduce.Goal()) for h, client in self.clients.items()}
        handles = {hand: result_of(self.node, future, "the goal to be accepted") for hand, future in sent.items()}
        assert all(handle.accepted for handle in handles.values())
        return {hand: handle.get_result_async() for hand, handle in handles.items()}

    @property
    def is_heard(self) -> bool:
        """Whether the nodes listen to all, and are listened to."""
        counts = [p.get_subscription_count() for p in (*self._poses.values(), *self._objects.values())]
        counts += [self.node.count_publishers(topic) for topic in ("reference", *(f"{h}/reference" for h in WAYS))]
        counts += [self.node.count_subscribers(f"{h}/reference") - 1 for h in WAYS]  # one is our own
        servers = all(client.server_is_ready() for client in self.clients.values())
        return servers and all(counts) and self._states.get_subscription_count() == 1 + len(WAYS)

    def tick(self) -> None:
        """A joint state, later ones until one is answered; then the joints move."""
        message, due = JointState(name=list(self.model.joint_names), position=self.q.tolist()), 0.0

        def is_answered() -> bool:
            """By joint_reference, and by whoever moves a hand."""
            asked = [self.inbox, *(said for said in self.said.values() if said.last is not None)]
            return all(
                box.last is not None and conversions.time_to_ns(box.last.header.stamp) == self.stamp_ns
                for box in asked
                if box not in self.silent
            )

        def is_answered_or_told_again() -> bool:
            nonlocal due
            if time.monotonic() >= due:  # best effort may lose a message
                due = time.monotonic() + 0.2
                self.stamp_ns += TICK_NS
                message.header.stamp = conversions.time_from_ns(self.stamp_ns)
                for hand, publisher in self._poses.items():
                    publisher.publish(conversions.pose_stamped(self.data.pose(hand), self.stamp_ns, "base"))
                self._states.publish(message)
            return is_answered()

        spin_until(self.node, is_answered_or_told_again, message="an answer")
        joints = [self.model.joint_names.index(name) for name in self.inbox.last.dimensions]
        self.q[joints] += np.clip(np.array(self.inbox.last.gaussian.mean) - self.q[joints], -0.03, 0.03)
        self.data.update(self.q)


def reproduction(start_process: StartProcess, hand: str, task_file: Path, model_file: Path) -> RunningProcess:
    """As docs/how-to/two-hands.md says."""
    own = [f"{topic}:=/{topic}" for topic in ("joint_states", f"endpoint/{hand}/pose", "controller_state")]
    remaps = [word for topic in (f"__ns:=/{hand}", *own) for word in ("-r", topic)]
    arguments = ros_arguments(task_file=task_file, model_file=model_file, autostart=True, settle_time=0.1)
    return start_process("reproduction", *arguments, *remaps)


def test_each_hand_reaches_its_object_at_its_own_pace_while_the_other_one_moves(
    ros_node: Node, start_process: StartProcess, tmp_path: Path
) -> None:
    robot = Robot(ros_node)
    hands = [reproduction(start_process, hand, *learn(tmp_path, hand, robot.homes[hand])) for hand in WAYS]
    start_process("joint_reference", *ros_arguments(robot_file=ROBOT_FILE, led="[left, right]", blend_time=0.05))
    spin_until(ros_node, lambda: robot.is_heard, message="the nodes to listen")
    robot.tick()
    assert not robot.inbox.last.frames, "nothing leads the robot yet"
    np.testing.assert_allclose(robot.q, robot.model.home, atol=1e-9)
    results, away, led = robot.begin(), [], set[str]()
    deadline = time.monotonic() + STARTUP_TIMEOUT
    while not all(result.done() for result in results.values()):
        robot.tick()
        led |= set(robot.inbox.last.frames)
        away.append([np.linalg.norm(robot.data.pose(h)[:3] - robot.homes[h][:3] - WAYS[h][0]) for h in WAYS])
        assert time.monotonic() < deadline, away[-1]
    for future in results.values():
        assert future.result().status == GoalStatus.STATUS_SUCCEEDED, future.result().result.reason
    assert led == {"left/object", "right/object"}
    distances = np.array(away)
    assert distances[-1].max() < 0.01
    # their goals may be accepted one some ticks after the other
    left, there = np.argmax(distances < distances[0] - 0.005, axis=0), np.argmax(distances < 0.01, axis=0)
    assert 20 < np.diff(left - there)[0] < 60, "the right hand takes less time"
    assert all(distances[there[i] :, i].max() < 0.01 for i in range(2)), "who is there stays"
    for process in hands:
        process.stop()
    robot.silent += robot.said.values()
    for _ in range(60):  # nobody says anything any more
        robot.tick()
    assert not robot.inbox.last.frames


def test_a_reference_of_before_a_restart_counts_no_more_when_time_comes_there_again(
    ros_node: Node, start_process: StartProcess
) -> None:
    robot = Robot(ros_node)
    process = start_process(
        "joint_reference", *ros_arguments(robot_file=ROBOT_FILE, led="[left, right]", blend_time=0.05)
    )
    publisher = ros_node.create_publisher(Reference, "left/reference", STREAM)
    states = ros_node.create_publisher(JointState, "joint_states", STREAM)
    wanted = Gaussian(robot.homes["left"], 1e-4 * np.eye(6), POSE)
    led = CoreReference(0.5, wanted, 0.0, (), np.ones(1), ("object",))

    def state(seconds: float) -> None:
        stamp_ns, n = round(seconds * SECOND), robot.model.nv
        states.publish(conversions.joint_state_message(list(robot.model.joint_names), stamp_ns, robot.q, np.zeros(n)))

    now = [100.0]

    def frames(with_reference: bool = False) -> list[str] | None:
        """The frames of the answer to a joint state of now, which goes on; None where it has not come."""
        now[0] += 0.002
        if with_reference:
            message = conversions.reference_message(led, DIMENSIONS, round(now[0] * SECOND), "base")
            publisher.publish(message)
        state(now[0])
        last = robot.inbox.last
        if last is None or abs(conversions.time_to_ns(last.header.stamp) / SECOND - now[0]) > 0.3:
            return None
        return list(last.frames)

    def wait(condition: Callable[[], bool], what: str) -> None:
        spin_until(ros_node, condition, message=what, processes=(process,))

    wait(lambda: frames(with_reference=True) == ["left/object"], "the reference to be followed")
    there = now[0]
    now[0] = 1.0
    wait(lambda: frames() == [], "time to begin again without a movement")
    now[0] = there
    answered: list[list[str]] = []

    def enough() -> bool:
        if (found := frames()) is not None:
            answered.append(found)
        return len(answered) > 20

    wait(enough, "time to be there again")
    assert not any(answered)
