# SPDX-License-Identifier: Apache-2.0
"""teach: record demonstrations of a task, from the topics of a robot that is led by hand, or all by itself.

Without ``--scripted`` it records what is on the topics of the task file until Ctrl-C: lead the arm of your robot.
With ``--scripted`` it starts ``baxter_simulator`` and ``impedance_controller`` (gravity compensation), and a scripted
teacher leads the simulated robot by forces through a lesson, in another situation for each recording: pick-and-place
with one hand, or a bar between both hands whose targets cannot both be reached, with priority for one of them.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy
from domain_coordinator import domain_id
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from tqdm import tqdm

from tpgmm_core.robot.model import RobotModel
from tpgmm_core.text import one_line
from tpgmm_demos.scene.perception import PERCEPTIONS, Camera, perception
from tpgmm_demos.scene.pick_place import Array, Grasp, Situation, random_situation
from tpgmm_demos.teaching import bar_lesson
from tpgmm_demos.teaching.bar_lesson import BarLesson
from tpgmm_demos.teaching.teacher import Intention, Teacher, TeacherConfig
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.recordings.bag_recorder import BagRecorder
from tpgmm_ros.runtime.executor import StopFlag, init
from tpgmm_ros.runtime.processes import Graph, GraphError, NodeProcesses
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task, TaskError

#: Joint states come at up to 1 kHz; a demonstration needs no more than the poses' rate, Hz.
JOINT_STATE_RATE = 50.0
#: Exact perception sees the objects this often, Hz: at every third pose of the hand.
EXACT_RATE = 100.0 / 3.0
#: The arm comes to rest before the teacher takes the hand, s.
SETTLE = 0.3
#: After Ctrl-C, s
DRAIN_TIME = 0.3


def topics_of(task: Task) -> dict[str, type]:
    """The topics that a recording of a task holds."""
    return {task.movement: PoseStamped, **dict.fromkeys(task.topics.values(), PoseStamped), "joint_states": JointState}


class ScriptedLesson:
    """One demonstration: the teacher's forces and the objects' poses, answered to each pose of the hand.

    The object is seen as long as it lies; in the hand it is hidden.
    """

    def __init__(
        self, node: Node, task: Task, link: str, situation: Situation, camera: Camera, random: np.random.Generator
    ) -> None:
        self.done = False
        self._node = node
        self._task = task
        self._link = link
        self._situation = situation
        self._camera = camera
        self._random = random
        self._grasp = Grasp(situation.object)
        self._start: float | None = None
        self._teacher: Teacher[Intention] | None = None
        self._stamp_ns = -1
        self._wrench = np.zeros(6)
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self._places = {name: node.create_publisher(PoseStamped, topic, STREAM) for name, topic in task.topics.items()}
        self._subscription = node.create_subscription(PoseStamped, task.movement, self._answer, STREAM)
        self.duration = 0.0
        self.time = 0.0

    @property
    def failure(self) -> str:
        """What the teacher did not manage; empty if all went well."""
        return "" if self._grasp.holds else "the scripted teacher did not bring the hand to the object"

    def close(self) -> None:
        self._node.destroy_subscription(self._subscription)
        for publisher in (self._wrenches, *self._places.values()):
            self._node.destroy_publisher(publisher)

    def _answer(self, message: PoseStamped) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns > self._stamp_ns:
            self._stamp_ns = stamp_ns
            self._advance(1e-9 * stamp_ns, conversions.pose_to_array(message.pose))
        # The simulation waits for this; a pose that comes again did not get its answer.
        self._wrenches.publish(conversions.wrench_from_array(self._wrench, stamp_ns, self._link))

    def _advance(self, now: float, hand: Array) -> None:
        self._start = now if self._start is None else self._start
        self.time = now - self._start - SETTLE
        self._grasp.update(hand, now)
        places = {"target": self._situation.target}
        if not self._grasp.holds:
            places["object"] = self._grasp.object
        sighting = self._camera.look(self._stamp_ns, places)
        if sighting is not None:
            for name, pose in sighting.poses.items():
                message = conversions.pose_stamped(pose, sighting.stamp_ns, self._task.base_frame)
                self._places[name].publish(message)
        if self.time < 0.0 or self.done:
            return
        if self._teacher is None:
            config = TeacherConfig()
            self._teacher = Teacher(Intention(hand, self._situation, config, self._random), config)
            self.duration = self._teacher.intention.duration
        self._wrench = self._teacher.wrench(self.time, hand)
        self.done = self.time >= self.duration


@dataclass(frozen=True, slots=True)
class LessonKind:
    """How a lesson is made, and what it asks of the simulation.

    Attributes:
        make: the lesson, from the program's node, the task, the robot file, the camera and where variation comes from.
        exact_rate: exact perception sees the objects this often, Hz.
        rate: steps of the simulation per second, Hz.
        pose_rate: it publishes poses and waits for a wrench this often, Hz.
        keep_every: one of so many poses of the hand is recorded.
    """

    make: Callable[[Node, Task, Path, Camera, np.random.Generator], ScriptedLesson | BarLesson]
    exact_rate: float = EXACT_RATE
    rate: float = 1000.0
    pose_rate: float = 100.0
    keep_every: int = 1


def _pick_place(
    node: Node, task: Task, robot_file: Path, camera: Camera, random: np.random.Generator
) -> ScriptedLesson:
    link = RobotModel.from_file(robot_file).endpoints[task.endpoint].frame
    return ScriptedLesson(node, task, link, random_situation(random), camera, random)


def _bar(first: str) -> LessonKind:
    def make(node: Node, task: Task, robot_file: Path, camera: Camera, random: np.random.Generator) -> BarLesson:
        return BarLesson(node, task, robot_file, first, camera, random)

    exact_rate = bar_lesson.TOUCH_RATE / bar_lesson.KEEP_EVERY
    return LessonKind(make, exact_rate, bar_lesson.RATE, bar_lesson.TOUCH_RATE, bar_lesson.KEEP_EVERY)


#: By the name of their task file in config/.
LESSONS = {"pick_place": LessonKind(_pick_place), "left_first": _bar("left"), "right_first": _bar("right")}


def record_scripted(
    task: Task,
    robot_file: Path,
    output: Path,
    count: int,
    seed: int,
    lesson: str = "pick_place",
    perceived: str = "camera",
) -> list[Path]:
    """Record ``count`` demonstrations of one of LESSONS; existing ones are kept and not made again.

    Args:
        perceived: how the objects are seen, one of PERCEPTIONS.

    Raises:
        GraphError: a node failed, or the scripted teacher did not manage what it is to show.
    """
    made = []
    with domain_id() as domain, tempfile.TemporaryDirectory() as logs:
        # Nodes started here talk to each other and to nobody else.
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", ROS_LOG_DIR=logs)
        init([])
        stop = StopFlag()
        with tqdm(total=count, unit="demonstration", desc="teaching") as progress:
            for index in range(count):
                path = output / f"demo_{index + 1:02d}"
                if path.exists():
                    progress.write(f"{path}: exists, kept")
                else:
                    random = np.random.default_rng([seed, index])
                    # numbers of its own: the teacher does the same whatever perception is like
                    camera = Camera(perception(perceived, LESSONS[lesson].exact_rate), [seed, index, 0xCA])
                    words = _record_lesson(task, robot_file, LESSONS[lesson], path, camera, random, Path(logs), stop)
                    progress.write(f"{path}: {words}")
                    made.append(path)
                progress.update()
        rclpy.shutdown()
    return made


def _record_lesson(
    task: Task,
    robot_file: Path,
    kind: LessonKind,
    path: Path,
    camera: Camera,
    random: np.random.Generator,
    logs: Path,
    stop: StopFlag,
) -> str:
    node = Node("teach", parameter_overrides=[Parameter("use_sim_time", value=True)])
    executor = EventsExecutor()
    executor.add_node(node)
    with NodeProcesses(logs) as processes:
        processes.start(
            "impedance_controller",
            robot_file=robot_file,
            endpoint=task.endpoint,
            joint_state_rate=kind.rate,
            use_sim_time=True,
            autostart=True,
        )
        processes.start(
            "baxter_simulator",
            robot_file=robot_file,
            lockstep=True,
            lockstep_wrench=True,
            rate=kind.rate,
            pose_rate=kind.pose_rate,
        )
        graph = Graph(node, executor, processes)
        graph.wait_for(lambda: node.count_publishers("joint_torques") > 0, 30.0, "the controller")
        keep_every = {"joint_states": round(kind.rate / JOINT_STATE_RATE), task.movement: kind.keep_every}
        with BagRecorder(node, path, topics_of(task), keep_every=keep_every) as recorder:
            lesson = kind.make(node, task, robot_file, camera, random)
            graph.wait_for(lambda: lesson.done or stop.set, 300.0, "the end of the demonstration")
            lesson.close()
            if stop.set:
                raise GraphError(f"interrupted; the unfinished recording of {path} is not kept")
            if lesson.failure:
                raise GraphError(f"{path}: {lesson.failure}")
    executor.remove_node(node)
    node.destroy_node()
    return f"{lesson.duration:.1f} s, {recorder.counts[task.movement] // kind.keep_every} poses"


def record_live(task: Task, output: Path) -> dict[str, int]:
    """Record the task's topics until SIGINT or SIGTERM; returns the number of messages by topic."""
    init([])
    stop = StopFlag()
    node = Node("teach")
    executor = EventsExecutor()
    executor.add_node(node)
    told = time.monotonic()
    with BagRecorder(node, output, topics_of(task)) as recorder:
        print(f"recording {', '.join(topics_of(task))}\nCtrl-C ends the demonstration", file=sys.stderr)
        while not stop.set:
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() - told > 1.0:
                told = time.monotonic()
                counts = ", ".join(f"{topic} {count}" for topic, count in recorder.counts.items())
                print(f"\r{counts} ", end="", file=sys.stderr, flush=True)
        # On a busy machine the end is known before all that came earlier was looked at
        end = time.monotonic() + DRAIN_TIME
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.01)
    print(file=sys.stderr)
    rclpy.shutdown()
    return recorder.counts


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="teach",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="examples:\n"
        "  teach --task config/pick_place.yaml --output bags/mine/demo_01\n"
        "  teach --scripted --count 16 --output bags/pick_place\n"
        "  teach --scripted --lesson left_first --count 3 --output bags/priorities/left_first",
    )
    shown = "(default: %(default)s)"
    parser.add_argument("--task", type=Path, help="task file (default: that of the lesson in config/)")
    parser.add_argument(
        "--output", type=Path, required=True, help="the new bag; with --scripted, the directory of the bags"
    )
    parser.add_argument("--scripted", action="store_true", help="a scripted teacher on a simulated Baxter")
    parser.add_argument("--lesson", choices=LESSONS, default="pick_place", help=f"what --scripted teaches {shown}")
    parser.add_argument("--count", type=int, default=16, help=f"demonstrations to record with --scripted {shown}")
    parser.add_argument("--seed", type=int, default=0, help=f"of the scripted teacher's variation {shown}")
    parser.add_argument(
        "--perception",
        choices=PERCEPTIONS,
        default="camera",
        help=f"how --scripted sees the objects: 30 Hz, late and with noise, or without a fault {shown}",
    )
    parser.add_argument(
        "--robot", type=Path, default=config_file("baxter.yaml"), help=f"robot file, with --scripted {shown}"
    )
    arguments = parser.parse_args()
    if arguments.count < 1:
        parser.error(f"--count {arguments.count}: give 1 or more")
    try:
        task = Task.load(arguments.task or config_file(f"{arguments.lesson}.yaml"))
        if arguments.scripted:
            count, seed = arguments.count, arguments.seed
            made = record_scripted(
                task, arguments.robot, arguments.output, count, seed, arguments.lesson, arguments.perception
            )
            print(f"{len(made)} demonstrations recorded in {arguments.output}")
        else:
            counts = record_live(task, arguments.output)
            silent = [topic for topic, count in counts.items() if not count]
            if silent:
                print(f"warning: nothing came on {', '.join(silent)}", file=sys.stderr)
            print(f"{arguments.output}: " + ", ".join(f"{topic} {count}" for topic, count in counts.items()))
    except (TaskError, GraphError, OSError, ValueError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
