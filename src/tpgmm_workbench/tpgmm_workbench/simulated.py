# SPDX-License-Identifier: Apache-2.0
"""simulated_workbench: the workbench with a simulated robot; starts the nodes, and prints the address of the page.

Starts ``baxter_simulator``, and ``frame_tracker``, ``reproduction`` and ``impedance_controller`` in one process, on a
free ROS domain. All of them end with this program. The simulation waits for the controller, so that simulated time
passes more slowly on a busy machine.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from contextlib import ExitStack
from pathlib import Path

from domain_coordinator import domain_id

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.arguments import DOMAIN, whole_number
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.runtime.executor import run
from tpgmm_ros.runtime.processes import GraphError, NodeProcesses, Value
from tpgmm_ros.runtime.resources import config_file
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.from_urdf import create_from_urdf
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.workbench import WorkbenchNode

#: Of the simulated robot at least, Hz: its dynamics are the same for controllers of all rates.
PHYSICS_RATE = 1000.0
#: Joint states per second on machines of few cores, where a browser draws beside the nodes, and on others, Hz.
FEW_CORES, FEW_CORES_RATE, RATE = 4, 250.0, 1000.0
#: Task parameters per second, besides those that tell of changes, Hz.
TRACKER_RATE = 20.0
#: From this force on a correction begins by itself, N: the simulator's torques are exact.
COACH_FORCE = 15.0
#: How often it is looked whether the nodes still run, s.
CHECK_PERIOD = 1.0


def main() -> int:
    """Start the nodes and serve the page until told to stop; returns the exit status."""
    arguments = _parser().parse_args()
    try:
        project = _project(arguments)
    except (ValueError, OSError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 1
    log = arguments.log
    with ExitStack() as stack:
        domain = arguments.domain if arguments.domain is not None else stack.enter_context(domain_id())
        os.environ |= {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(log)}
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        processes = stack.enter_context(NodeProcesses(log))
        print(f"starting the nodes (logs: {log})")
        start_nodes(processes, project, arguments.rate, arguments.coach_force)
        given: dict[str, Value] = {
            "project": project.folder,
            "simulated": True,
            "use_sim_time": True,
            "host": arguments.host,
            "port": arguments.port,
            "meshes": not arguments.no_meshes,
            "seed": arguments.seed,
            "frame_rate": arguments.frame_rate,
            "coach_force": arguments.coach_force,
        }
        words = ["workbench", "--ros-args"]
        for name, value in given.items():
            words += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
        return run(lambda: _announced(processes), words)


def _announced(processes: NodeProcesses) -> WorkbenchNode:
    """The node, which tells where its page is, and when another one has ended."""
    node = WorkbenchNode()
    told: list[str] = []

    def check() -> None:
        try:
            processes.check()
        except GraphError as error:
            if not told:
                print(f"error: {error}", file=sys.stderr)
            told.append(str(error))
            node.desk.say(one_line(error, 200))

    node.create_timer(CHECK_PERIOD, check)
    print(f"\n    the page is at {node.page.address}\n\nCtrl-C ends it", flush=True)
    return node


def _project(arguments: argparse.Namespace) -> Project:
    folder: Path = arguments.project
    if folder.is_dir() and any(folder.iterdir()):
        project = Project.open(folder)
        if (arguments.task, arguments.robot, arguments.urdf) != (None, None, None):
            raise ProjectError(
                f"{folder} is a project with a task and a robot of its own: leave --task, --robot and --urdf out, or "
                "give another folder"
            )
        return project
    if arguments.urdf is not None:
        if (arguments.task, arguments.robot) != (None, None):
            raise ProjectError("--urdf proposes a robot file and a task file: leave --task and --robot out")
        project, found = create_from_urdf(folder, arguments.urdf)
        print(f"{project.robot_file} is proposed from the URDF; before a real robot uses it, look at each line:")
        for words in (*found.words, *(f"suspicious: {words}" for words in found.suspicions)):
            print(f"- {words}")
        return project
    task = arguments.task or config_file("pick_place.yaml")
    return Project.create(folder, task, arguments.robot or config_file("baxter.yaml"))


def start_nodes(processes: NodeProcesses, project: Project, rate: float, yield_force: float = 0.0) -> None:
    """Start all nodes but the page's.

    Parameters
    ----------
    processes
        starts them
    project
        its task and its robot
    rate
        joint states per second of simulated time, Hz
    yield_force
        on the hand, from which on the arm is soft until it is let go of, N; 0: never
    """
    processes.start(
        "baxter_simulator",
        robot_file=project.robot_file,
        lockstep=True,
        real_time_factor=1.0,
        rate=rate,
        physics_steps=math.ceil(PHYSICS_RATE / rate),
        wrench_timeout=1.0,
    )
    answering: dict[str, Value] = {"joint_state_rate": rate, "autostart": True, "use_sim_time": True}
    nodes: dict[str, dict[str, Value]] = {
        "frame_tracker": {"task_file": project.task_file, "rate": TRACKER_RATE, "use_sim_time": True},
        "reproduction": {"task_file": project.task_file, **answering},
        "impedance_controller": {
            "robot_file": project.robot_file,
            "endpoint": project.task.endpoint,
            "hold_time": 0.5,
            "yield_force": yield_force,
            **answering,
        },
    }
    processes.start_all("from_pose_to_torque", nodes)


def _parser() -> argparse.ArgumentParser:
    few = (os.cpu_count() or 1) < FEW_CORES
    parser = argparse.ArgumentParser(
        prog="simulated_workbench", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    shown = "(default: %(default)s)"
    parser.add_argument(
        "--project",
        type=a_path,
        default=Path("out/workbench/project"),
        help=f"folder of the project; it is created if it does not exist {shown}",
    )
    parser.add_argument("--task", type=a_path, help="task file of a new project (default: config/pick_place.yaml)")
    parser.add_argument("--robot", type=a_path, help="robot file of a new project (default: config/baxter.yaml)")
    parser.add_argument(
        "--urdf",
        help="URDF of a robot without a robot file, package://NAME/PATH or a path: robot file and task are proposed",
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help=f"address of the page; 0.0.0.0: also for other machines, with a token {shown}",
    )
    parser.add_argument("--port", type=whole_number(0, 65535), default=8080, help=f"port of the page {shown}")
    parser.add_argument(
        "--rate", type=float, default=FEW_CORES_RATE if few else RATE, help=f"rate of joint states, Hz {shown}"
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=-1,
        help=f"random seed of the objects' places; -1: different places each time {shown}",
    )
    parser.add_argument(
        "--no-meshes", action="store_true", help="draw simple shapes instead of meshes, which is faster"
    )
    parser.add_argument("--frame-rate", type=float, default=30.0, help=f"update rate of the page, Hz {shown}")
    parser.add_argument(
        "--coach-force",
        type=float,
        default=COACH_FORCE,
        help="force on the hand from which on the arm is soft, and a correction begins by itself while the skill runs, "
        f"N; 0: never {shown}",
    )
    parser.add_argument(
        "--domain", type=whole_number(0, DOMAIN), help="ROS domain, to watch with RViz (default: a free one)"
    )
    parser.add_argument("--log", type=a_path, default=Path("out/workbench/log"), help=f"logs of the nodes {shown}")
    return parser


if __name__ == "__main__":
    sys.exit(main())
