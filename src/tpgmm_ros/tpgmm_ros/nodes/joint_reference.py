# SPDX-License-Identifier: Apache-2.0
"""joint_reference: joint states and the taught tasks of the hands in, references over the joints out.

Each joint state is answered by the product of the Gaussians of all tasks that hold at present, in joint space. Which
ones hold is the parameter `active`, at any time. Movements of hands are factors beside them: a `reproduction` for each
hand publishes `<end point>/reference`, and has its own phase. While there is neither, the references are wherever the
robot is: it may be led, as in gravity compensation.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from tpgmm_core import TPGMM
from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.hand_tasks import ActiveTasks, HandTask, HandTasks
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.streams import Stamp
from tpgmm_core.robot.model import RobotModel
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.nodes.joint_states import JOINT_STATE_RATE, SPREAD, Heard, JointStateStream
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.monitor import Monitor
from tpgmm_ros.runtime.parameters import Declared, Parameters
from tpgmm_ros.task.task_file import Task

PARAMETERS = [
    Declared("robot_file", "", "Robot file (YAML): URDF, end points, limits", fixed=True),
    Declared("task_files", [""], "Task files (YAML), one per hand task", fixed=True),
    Declared("model_files", [""], "Model files (.tpgmm) of these tasks, in the same order", fixed=True),
    Declared("joints", ["left_arm", "right_arm"], "Joints or joint groups that the references are for", fixed=True),
    Declared("led", [""], "End points that also follow movements, from the topics <end point>/reference", fixed=True),
    Declared("active", "", "Names of the active tasks, separated by commas; empty: none"),
    Declared(
        "rest_deviation",
        1.0,
        "Allowed deviation (standard deviation) from the posture at the start where no task constrains it, rad",
        0.1,
        10.0,
        fixed=True,
    ),
    Declared("blend_time", 0.5, "Time over which a task fades in or out, s", 0.001, 60.0, fixed=True),
    JOINT_STATE_RATE,
    SPREAD,
]
#: A longer pause between two joint states counts as this long, s.
MAX_PAUSE = 0.02
#: A movement's reference that is older than this, by the stamps of joint states, no longer counts, s.
MAX_AGE = 0.5


def hand_task(task: Task, model: TPGMM, endpoints: list[str]) -> HandTask:
    """The task of hands that a model holds.

    Parameters
    ----------
    task
        of the task file
    model
        fitted to it
    endpoints
        of the robot

    Returns
    -------
    HandTask
        by end points and fixed places

    Raises
    ------
    ValueError
        for frames that are observed elsewhere than on the robot, and a model that does not fit
    """
    topics = {f"endpoint/{name}/pose": name for name in endpoints}
    places: dict[str, str | np.ndarray] = {}
    for name, frame in task.frames.items():
        topic = task.topics.get(name)
        if frame.pose is not None:
            places[name] = np.array(frame.pose)
        elif topic in topics:
            places[name] = topics[topic]
        else:
            raise ValueError(
                f"{task.name}: frame '{name}' is on {shown(topic)}; expected one of {listed(sorted(topics))}"
            )
    return HandTask(model, task.endpoint, places)


class JointReferenceNode(Node):
    """Publishes the product of the active tasks for each joint state."""

    def __init__(self) -> None:
        super().__init__("joint_reference")
        self.active: ActiveTasks | None = None
        self.parameters = Parameters(self, PARAMETERS, check=self._check, changed=self._choose)
        self.robot = RobotModel.from_file(self.parameters.file("robot_file"))
        # ROS has no empty arrays on the command line
        files = [self.parameters.files(name) for name in ("task_files", "model_files")]
        if len(files[0]) != len(files[1]):
            raise ValueError(f"expected one model file for each task file, got {shown(files[0])} and {shown(files[1])}")
        tasks = [(Task.load(task), TPGMM.load(model)) for task, model in zip(*files, strict=True)]
        hands = {task.name: hand_task(task, model, list(self.robot.endpoints)) for task, model in tasks}
        led = [name for name in self.parameters["led"] if name]
        product = HandTasks(self.robot, hands, self.parameters["joints"], self.parameters["rest_deviation"], led)
        self.active = ActiveTasks(product, self.parameters["blend_time"])
        self._choose()
        self._frames = {
            name: tuple(f"{name}/{frame}" for frame in hand.model.frame_names_) for name, hand in hands.items()
        }
        spread = self.parameters[SPREAD.name]
        self._joint_states = JointStateStream(
            self, "joint_states", self._answer, self.robot.joint_names, ("position",), spread
        )
        self._heard: dict[str, tuple[int, Reference]] = {}  # by end point
        for name in led:
            self.create_subscription(ReferenceMessage, f"{name}/reference", partial(self._follow, name), STREAM)
        self._last_ns: int | None = None
        self._last: ReferenceMessage | None = None
        self.monitor = Monitor(self, self._status, self.parameters["joint_state_rate"], self._joint_states.silence)
        self._references = self.create_publisher(ReferenceMessage, "reference", STREAM)

    def _check(self, values: Mapping[str, Any]) -> None:
        if self.active is not None:
            self.active.check(_names(values["active"]))

    def _choose(self) -> None:
        if self.active is not None:
            self.active.choose(_names(self.parameters["active"]))

    def _follow(self, endpoint: str, message: ReferenceMessage) -> None:
        """What a movement wants of an end point."""
        try:
            reference = conversions.reference(message)
            frame_id = message.header.frame_id
            if reference.gaussian.manifold != POSE or frame_id != self.robot.base_frame:
                raise ValueError(
                    f"it is on {reference.gaussian.manifold} in {shown(frame_id)}; expected a pose in "
                    f"{shown(self.robot.base_frame)}"
                )
            _ = reference.gaussian.precision
        except (ValueError, np.linalg.LinAlgError) as error:
            text = f"reference of {endpoint} refused: {one_line(error)}"
            self.get_logger().error(text, throttle_duration_sec=1.0)
        else:
            self._heard[endpoint] = conversions.time_to_ns(message.header.stamp), reference

    def _movements(self, stamp_ns: int) -> dict[str, Reference]:
        """Those whose last reference is not older than MAX_AGE."""
        return {name: r for name, (ns, r) in self._heard.items() if abs(stamp_ns - ns) <= MAX_AGE * 1e9}

    def _answer(self, heard: Heard) -> None:
        assert self.active is not None
        start = time.perf_counter()
        if heard.kind is Stamp.REPEATED:  # it comes again, since an answer was lost
            if self._last is not None:
                self._references.publish(self._last)
            return
        stamp_ns, (q,) = heard.stamp_ns, heard.values
        if heard.kind is Stamp.RESTARTED:  # else a movement of before would count once time comes there again
            self._heard = {name: item for name, item in self._heard.items() if item[0] <= stamp_ns}
        self.monitor.tick(stamp_ns)
        dt = 0.0 if self._last_ns is None else 1e-9 * (stamp_ns - self._last_ns)
        movements = self._movements(stamp_ns)
        wanted = {name: reference.gaussian for name, reference in movements.items()}
        gaussian = self.active.step(q, min(max(0.0, dt), MAX_PAUSE), wanted)
        self._last_ns = stamp_ns
        frames = tuple(frame for name in self.active.holding for frame in self._frames[name])
        frames += tuple(f"{name}/{frame}" for name, reference in movements.items() for frame in reference.frames)
        reference = Reference(0.0, gaussian, 0.0, (), np.ones(1), frames)
        names = self.active.tasks.joint_names
        self._last = conversions.reference_message(reference, names, stamp_ns, self.robot.base_frame)
        self._references.publish(self._last)
        self.monitor.done += 1
        self.monitor.step.add(time.perf_counter() - start)

    def _status(self) -> tuple[bytes, str, dict[str, str]]:
        holding = () if self.active is None else self.active.holding
        text = f"active tasks: {', '.join(holding)}" if holding else "no active task"
        movements = {} if self._last_ns is None else self._movements(self._last_ns)
        return DiagnosticStatus.OK, text, {f"{name} phase": f"{r.phase:.3f}" for name, r in movements.items()}


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def main() -> int:
    """Run the node; returns the exit status."""
    return run(JointReferenceNode)


if __name__ == "__main__":
    sys.exit(main())
