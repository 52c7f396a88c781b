# SPDX-License-Identifier: Apache-2.0
"""The program: teach, learn, push, report."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np
from tqdm import tqdm

import tpgmm_demos.figure5 as package
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.figure5.graph import open_session, start_controller, start_joint_reference
from tpgmm_demos.figure5.pictures import draw
from tpgmm_demos.figure5.report import evaluate, table
from tpgmm_demos.figure5.sequences import CUP, SEQUENCES, SUGAR, SequenceResult, random_pushes, run_sequence
from tpgmm_demos.figure5.teaching import learn, record_lesson
from tpgmm_ros.programs.reporting import run_with_report, write_report
from tpgmm_ros.runtime.arguments import SEED, whole_number
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.runtime.processes import GraphError
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

TASKS = (CUP, SUGAR)


def main() -> int:
    """Run the experiment; returns the exit status, 0 where all criteria are met."""
    arguments = _parser().parse_args()
    return run_with_report(arguments.output, lambda: _run(arguments), (GraphError,))


def _run(arguments: argparse.Namespace) -> bool:
    robot = RobotModel.from_file(arguments.robot)
    tasks = {name: Task.load(config_file(f"{name}.yaml")) for name in TASKS}
    bags = {name: arguments.bags / name if arguments.bags else arguments.output / "bags" / name for name in TASKS}
    if arguments.bags is None:
        print("1. teaching, each task by one demonstration")
        for number, (name, task) in enumerate(tasks.items()):
            shutil.rmtree(bags[name], ignore_errors=True)
            log = arguments.output / "log" / f"teach_{name}"
            # in lockstep, whatever follows: a teacher who is late by a few ms shakes the arm, and teaches that
            with open_session(robot, log, lockstep=True) as session:
                start_controller(session, arguments.robot)
                start_joint_reference(session, arguments.robot, (), arguments.output)
                session.start_simulator(arguments.robot)
                record_lesson(session, task, bags[name], np.random.default_rng([arguments.seed, number]))
    print("2. learning: a single Gaussian in each frame")
    models = {name: learn(task, bags[name]) for name, task in tasks.items()}
    for name, model in models.items():
        model.save(arguments.output / f"{name}.tpgmm")
    print(f"3. the four sequences, {arguments.pushes} random pushes of each kind")
    courses = _sequences(arguments, robot)
    report = evaluate(robot, tasks, models, courses)
    report["real_time"] = arguments.real_time
    draw(robot, courses, arguments.output)
    path = write_report(arguments.output, report)
    print(table(report))
    print(f"report and pictures: {path.parent}")
    return bool(report["passed"])


def _sequences(arguments: argparse.Namespace, robot: RobotModel) -> list[SequenceResult]:
    pushes = random_pushes(arguments.pushes, np.random.default_rng([arguments.seed, 5]))
    kinds = sum(len(sequence.kinds) + len(sequence.repeats) for sequence in SEQUENCES)
    log = arguments.output / "log" / "sequences"
    with (
        open_session(robot, log, not arguments.real_time) as session,
        tqdm(total=kinds * arguments.pushes, unit="push", desc="pushing") as progress,
    ):
        start_controller(session, arguments.robot)
        choose = start_joint_reference(session, arguments.robot, TASKS, arguments.output)
        session.start_simulator(arguments.robot)
        courses: dict[str, SequenceResult] = {}
        for sequence in SEQUENCES:
            courses[sequence.name] = run_sequence(session, sequence, pushes, courses, choose, progress.update)
        return list(courses.values())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="figure5", description=package.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shown = "(default: %(default)s)"
    parser.add_argument(
        "--seed", type=whole_number(0, SEED), default=1, help=f"random seed of demonstrations and pushes {shown}"
    )
    parser.add_argument("--pushes", type=whole_number(1), default=20, help=f"random pushes of each kind {shown}")
    parser.add_argument(
        "--bags", type=a_path, help="directory of recorded demonstrations; without it they are recorded again"
    )
    parser.add_argument("--output", type=a_path, default=Path("out/figure5"), help=f"report, pictures, models {shown}")
    parser.add_argument("--robot", type=a_path, default=config_file("baxter.yaml"), help=f"robot file {shown}")
    parser.add_argument(
        "--real-time", action="store_true", help="run the sequences at 1 kHz in real time, not in lockstep"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
