# SPDX-License-Identifier: Apache-2.0
"""A robot and a camera beside a running reproduction node: `Player`, and the fixtures of its tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import (
    ACTIVATE,
    ALL,
    CONFIGURE,
    DEACTIVATE,
    ROOT,
    SECOND,
    TASK_FILE,
    change_state,
    result_of,
    ros_arguments,
)
from ros_testing import STARTUP_TIMEOUT, RunningProcess, StartProcess, spin_until
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import Reference, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.programs import train

NODE = "reproduction"
TICK_NS = 5_000_000
DURATION = 1.0
POSE = Manifold.parse("R3 x S3")
PLACES = {
    "object": np.array([0.65, 0.40, 0.0, *quaternion.exp([0.0, 0.0, 0.3])]),
    "target": np.array([0.62, 0.10, 0.03, *quaternion.exp([0.0, 0.0, -0.4])]),
    "robot": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
}


def trained(path: Path, *options: str, task: Path = TASK_FILE) -> Path:
    """A small model of the recorded demonstrations."""
    few = ["--components", "5", "--every", "20", *options]
    assert train.main(["--task", str(task), "--output", str(path), *few, str(ROOT / "bags" / "pick_place")]) == 0
    return path


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a model for each retrieval method."""
    directory = tmp_path_factory.mktemp("models")
    for method in METHODS:
        trained(directory / f"{method}.tpgmm", "--retrieval", method)
    return directory


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The model that the node is configured with."""
    return trained(tmp_path_factory.mktemp("model") / "adapt_regress.tpgmm")


class Player:
    """The other side of the node: frames, and a robot that is at once where the reference was."""

    def __init__(self, node: Node, process: RunningProcess) -> None:
        self.node, self.process = node, process
        self.stamp_ns = 10 * SECOND
        self.references: list[Reference] = []
        self.feedback: list[Reproduce.Feedback] = []
        self.client = ActionClient(node, Reproduce, "reproduce")
        self._states = node.create_publisher(JointState, "joint_states", STREAM)
        self._poses = node.create_publisher(PoseStamped, "endpoint/left/pose", STREAM)
        self._frames = node.create_publisher(TaskParameters, "task_parameters", LATCHED)
        node.create_subscription(Reference, "reference", self.references.append, ALL)

    def wait_until_heard(self) -> None:
        publishers = (self._states, self._poses, self._frames)
        spin_until(
            self.node,
            lambda: self.client.server_is_ready() and all(p.get_subscription_count() for p in publishers),
            message="the node to listen",
            processes=(self.process,),
        )

    def show(self, places: Mapping[str, np.ndarray | None]) -> None:
        """Publish task parameters: a pose for each frame that is seen, None for one that is missing."""
        frames = [
            TrackedFrame(name, FrameStatus.MISSING, 0.0, 0, None)
            if pose is None
            else TrackedFrame(name, FrameStatus.VISIBLE, 1.0, self.stamp_ns, pose)
            for name, pose in places.items()
        ]
        self._frames.publish(conversions.task_parameters_message(frames, self.stamp_ns, "base"))

    def show_wrong(self) -> None:
        """Publish task parameters of a planar task."""
        message = conversions.task_parameters_message([], self.stamp_ns, "base")
        for name, pose in PLACES.items():
            tracked = TrackedFrame(name, FrameStatus.VISIBLE, 1.0, self.stamp_ns, pose)
            (item,) = conversions.task_parameters_message([tracked], self.stamp_ns, "base").frames
            item.rows, item.cols, item.a, item.b = 2, 2, [1.0, 0.0, 0.0, 1.0], [0.0, 0.0]
            message.frames.append(item)
        self._frames.publish(message)

    def put(self, pose: np.ndarray) -> None:
        """Publish where the hand is."""
        self._poses.publish(conversions.pose_stamped(pose, self.stamp_ns, "base"))

    def send(self, model: str = "", duration: float = DURATION, **more: object) -> object:
        self.references.clear()
        self.feedback.clear()
        goal = Reproduce.Goal(model=model, duration=duration, **more)
        sent = self.client.send_goal_async(
            goal, feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        handle = result_of(self.node, sent, "the goal to be accepted")
        assert handle.accepted
        return handle

    def tick(
        self,
        answered: bool = True,
        unless: Callable[[], bool] = lambda: False,
        names: tuple[str, ...] = (),
        pose: np.ndarray | None = None,
    ) -> Reference | None:
        """One joint state; returns the reference that answers it, if one has to, unless something else happens.

        The robot is at a pose, or else where the reference was.
        """
        self.stamp_ns += TICK_NS
        message = JointState(name=list(names))
        message.header.stamp = conversions.time_from_ns(self.stamp_ns)
        if self.references:
            self.put(np.array(self.references[-1].gaussian.mean) if pose is None else pose)
        due, before = 0.0, len(self.references)

        def is_answered() -> bool:
            nonlocal due
            if time.monotonic() >= due:  # best effort may lose a message
                due = time.monotonic() + 0.2
                self._states.publish(message)
            # frames that change may be answered a little later than the state, before anyone looks here
            stamps = [conversions.time_to_ns(item.header.stamp) for item in self.references[before:]]
            return unless() or any(stamp >= self.stamp_ns for stamp in stamps)

        if not answered:
            is_answered()
            self.node.executor.spin_once(timeout_sec=0.01)  # type: ignore[union-attr]
            return None
        spin_until(self.node, is_answered, message="a reference", processes=(self.process,))
        return self.references[-1] if self.references else None

    def start(self, model: str = "", duration: float = DURATION, **more: object) -> object:
        """Send a goal, with more fields by name, and wait until it moves."""
        handle = self.send(model, duration, **more)

        def moving() -> bool:
            self.show(PLACES)
            self.tick(answered=False)
            return bool(self.references)

        spin_until(self.node, moving, message="the first reference", processes=(self.process,))
        return handle

    def result(self, handle: object, ticks: bool = True) -> tuple[int, Reproduce.Result]:
        """The status and the result of a goal."""
        future = handle.get_result_async()  # type: ignore[attr-defined]
        deadline = time.monotonic() + STARTUP_TIMEOUT
        while ticks and not future.done():
            self.tick(answered=bool(self.references), unless=future.done)
            assert time.monotonic() < deadline, "no result"
        spin_until(self.node, future.done, message="the result", processes=(self.process,))
        return future.result().status, future.result().result


@pytest.fixture(scope="module")
def process(start_module_process: StartProcess, model_file: Path) -> RunningProcess:
    return start_module_process(
        NODE, *ros_arguments(task_file=TASK_FILE, model_file=model_file, start_timeout=STARTUP_TIMEOUT, settle_time=0.1)
    )


@pytest.fixture(scope="module")
def inactive(module_node: Node, process: RunningProcess) -> Player:
    assert change_state(module_node, NODE, CONFIGURE), process.output
    player = Player(module_node, process)
    player.wait_until_heard()
    return player


@pytest.fixture
def player(module_node: Node, inactive: Player) -> Iterator[Player]:
    assert change_state(module_node, NODE, ACTIVATE)
    yield inactive
    assert change_state(module_node, NODE, DEACTIVATE)


def means(references: list[Reference]) -> np.ndarray:
    return np.array([reference.gaussian.mean for reference in references])
