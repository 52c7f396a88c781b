# SPDX-License-Identifier: Apache-2.0
"""scripted_lessons: record demonstrations by a scripted teacher on a simulated Baxter. `teach --scripted` is the same.

Starts ``baxter_simulator`` and ``impedance_controller`` (gravity compensation). A scripted teacher guides the simulated
robot by forces, in another situation for each recording: pick-and-place with one hand, or a bar between both hands
whose targets cannot both be reached, with priority for one of them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rclpy.node import Node
from tqdm import tqdm

from tpgmm_core.common.text import one_line
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.scene.perception import PERCEPTIONS, SimulatedCamera, perception
from tpgmm_demos.scene.pick_place import random_placement
from tpgmm_demos.teaching import bar_lesson
from tpgmm_demos.teaching.bar_lesson import BarLesson
from tpgmm_demos.teaching.pick_place_lesson import ScriptedLesson
from tpgmm_ros.recordings.bag_recorder import BagRecorder
from tpgmm_ros.recordings.recorded_topics import JOINT_STATE, needed_topics
from tpgmm_ros.runtime.arguments import SEED, whole_number
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.runtime.executor import StopFlag
from tpgmm_ros.runtime.graph import open_graph, own_domain
from tpgmm_ros.runtime.processes import GraphError
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task, TaskError

#: Joint states come at up to 1 kHz; a demonstration needs no more than the poses' rate, Hz.
JOINT_STATE_RATE = 50.0
#: Exact perception sees the objects this often, Hz: at every third pose of the hand.
EXACT_RATE = 100.0 / 3.0


@dataclass(frozen=True, slots=True)
class LessonKind:
    """How a lesson is made, and what it asks of the simulation.

    Attributes
    ----------
    make
        the lesson, from the program's node, the task, the robot file, the camera and where variation comes from
    exact_rate
        exact perception sees the objects this often, Hz
    rate
        steps of the simulation per second, Hz
    pose_rate
        it publishes poses and waits for a wrench this often, Hz
    keep_every
        one of so many poses of the hand is recorded
    """

    make: Callable[[Node, Task, Path, SimulatedCamera, np.random.Generator], ScriptedLesson | BarLesson]
    exact_rate: float = EXACT_RATE
    rate: float = 1000.0
    pose_rate: float = 100.0
    keep_every: int = 1


def _pick_place(
    node: Node, task: Task, robot_file: Path, camera: SimulatedCamera, random: np.random.Generator
) -> ScriptedLesson:
    link = RobotModel.from_file(robot_file).endpoints[task.endpoint].frame
    return ScriptedLesson(node, task, link, random_placement(random), camera, random)


def _bar(first: str) -> LessonKind:
    def make(
        node: Node, task: Task, robot_file: Path, camera: SimulatedCamera, random: np.random.Generator
    ) -> BarLesson:
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

    Parameters
    ----------
    perceived
        how the objects are seen, one of PERCEPTIONS

    Returns
    -------
    list[Path]
        the bags

    Raises
    ------
    GraphError
        a node failed, or the scripted teacher did not manage what it is to show.
    """
    made = []
    # Nodes started here talk to each other and to nobody else.
    with tempfile.TemporaryDirectory() as logs, own_domain(ros_log=Path(logs)):
        stop = StopFlag()
        with tqdm(total=count, unit="demonstration", desc="teaching") as progress:
            for index in range(count):
                path = output / f"demo_{index + 1:02d}"
                if path.exists():
                    progress.write(f"{path}: exists, kept")
                else:
                    random = np.random.default_rng([seed, index])
                    # numbers of its own: the teacher does the same whatever perception is like
                    camera = SimulatedCamera(perception(perceived, LESSONS[lesson].exact_rate), [seed, index, 0xCA])
                    words = _record_lesson(task, robot_file, LESSONS[lesson], path, camera, random, Path(logs), stop)
                    progress.write(f"{path}: {words}")
                    made.append(path)
                progress.update()
    return made


def _record_lesson(
    task: Task,
    robot_file: Path,
    kind: LessonKind,
    path: Path,
    camera: SimulatedCamera,
    random: np.random.Generator,
    logs: Path,
    stop: StopFlag,
) -> str:
    with open_graph("teach", logs, use_sim_time=True) as graph:
        node, processes = graph.node, graph.processes
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
        graph.wait_for(lambda: node.count_publishers("joint_torques") > 0, 30.0, "the controller")
        keep_every = {"joint_states": round(kind.rate / JOINT_STATE_RATE), task.movement: kind.keep_every}
        topics = {**needed_topics(task), "joint_states": JOINT_STATE}
        with BagRecorder(node, topics, keep_every, drop_repeated=True).into(path) as recorder:
            lesson = kind.make(node, task, robot_file, camera, random)
            graph.wait_for(lambda: lesson.done or stop.set, 300.0, "the end of the demonstration")
            lesson.close()
            if stop.set:
                raise GraphError(f"interrupted; the unfinished recording of {path} is not kept")
            if lesson.failure:
                raise GraphError(f"{path}: {lesson.failure}")
    return f"{lesson.duration:.1f} s, {recorder.counts[task.movement] // kind.keep_every} poses"


def main() -> int:
    """Record the lessons; returns the exit status."""
    scripted = "--scripted" in sys.argv[1:]
    parser = argparse.ArgumentParser(
        prog="teach --scripted" if scripted else "scripted_lessons",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="examples:\n"
        "  teach --scripted --count 16 --output bags/pick_place\n"
        "  teach --scripted --lesson left_first --count 3 --output bags/priorities/left_first",
    )
    shown = "(default: %(default)s)"
    parser.add_argument("--scripted", action="store_true", help=argparse.SUPPRESS)  # how `teach` hands over
    parser.add_argument("--lesson", choices=LESSONS, default="pick_place", help=f"what is demonstrated {shown}")
    parser.add_argument("--task", type=a_path, help="task file (default: that of the lesson in config/)")
    parser.add_argument("--output", type=a_path, required=True, help="the directory of the bags")
    parser.add_argument("--count", type=whole_number(1), default=16, help=f"demonstrations to record {shown}")
    parser.add_argument(
        "--seed", type=whole_number(0, SEED), default=0, help=f"random seed of the scripted teacher's variation {shown}"
    )
    parser.add_argument(
        "--perception",
        choices=PERCEPTIONS,
        default="camera",
        help=f"how the objects are observed: camera (30 Hz, late and with noise), or exact {shown}",
    )
    parser.add_argument("--robot", type=a_path, default=config_file("baxter.yaml"), help=f"robot file {shown}")
    arguments = parser.parse_args()
    count, seed, lesson = arguments.count, arguments.seed, arguments.lesson
    if count < 1:
        parser.error(f"--count {count}: give 1 or more")
    try:
        task = Task.load(arguments.task or config_file(f"{lesson}.yaml"))
        made = record_scripted(task, arguments.robot, arguments.output, count, seed, lesson, arguments.perception)
        print(f"{len(made)} demonstrations recorded in {arguments.output}")
    except (TaskError, GraphError, OSError, ValueError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
