# SPDX-License-Identifier: Apache-2.0
"""The demo's program: train, start, disturb, report."""

from __future__ import annotations

import argparse
import math
import os
import time
from pathlib import Path

import numpy as np
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future

import tpgmm_demos.demo as package
from tpgmm_core import TPGMM, Frame
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.demo.causes import cause_of_waiting_in_vain
from tpgmm_demos.demo.pictures import draw
from tpgmm_demos.demo.recording import RunRecord
from tpgmm_demos.demo.report import evaluate, table
from tpgmm_demos.demo.world import EXACT_RATE, Disturbances, World
from tpgmm_demos.scene.perception import PERCEPTIONS, SimulatedCamera, perception
from tpgmm_demos.scene.pick_place import random_placement
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.programs import train
from tpgmm_ros.programs.reporting import run_with_report, write_report
from tpgmm_ros.runtime.arguments import DOMAIN, SEED, whole_number
from tpgmm_ros.runtime.entry import INTERRUPTED, a_path
from tpgmm_ros.runtime.graph import Graph, open_graph, own_domain
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY, GraphError, GraphTimeoutError, Value
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

#: How long nodes may take to start, and the movement to end, s: in real time, and in lockstep, where a busy machine is
#: allowed to take its time.
START_TIMEOUT = {False: 60.0, True: 600.0}
END_TIMEOUT = {False: 300.0, True: 1800.0}
#: Of the simulated robot at least, Hz: its dynamics are the same for controllers of all rates.
PHYSICS_RATE = 1000.0


def main() -> int:
    """Run the demo; returns the exit status, 0 where all criteria are met."""
    arguments = _parser().parse_args()

    def cause_of(error: Exception) -> str:
        if not isinstance(error, GraphTimeoutError):  # nothing else is a matter of time
            return ""
        return cause_of_waiting_in_vain(os.getloadavg()[0], os.cpu_count() or 1, arguments.lockstep)

    return run_with_report(arguments.output, lambda: _train_and_run(arguments), (GraphError,), cause_of)


def _train_and_run(arguments: argparse.Namespace) -> bool:
    # What is wrong with them is said before anything is trained
    task, robot = Task.load(arguments.task), RobotModel.from_file(arguments.robot)
    model_file = arguments.model or arguments.output / "pick_place.tpgmm"
    if arguments.model:
        print(f"1. using the model {model_file}")
        return _run(arguments, task, robot, model_file)
    print(f"1. training from {arguments.bags}")
    status = train.main(["--task", str(arguments.task), "--output", str(model_file), str(arguments.bags)])
    if status == INTERRUPTED:
        raise KeyboardInterrupt
    if status:
        raise GraphError("training failed")
    return _run(arguments, task, robot, model_file)


def _run(arguments: argparse.Namespace, task: Task, robot: RobotModel, model_file: Path) -> bool:
    model = TPGMM.load(model_file)
    # The seeds of the demonstrations are drawn otherwise: no situation here was in one of them.
    random = np.random.default_rng([arguments.seed, 0xDE, 0x40])
    situation = random_placement(random)
    disturbances = Disturbances.random(random, demonstrated_duration(model))
    lockstep, log = arguments.lockstep, arguments.output / "log"
    with own_domain(arguments.domain), open_graph("demo", log, use_sim_time=lockstep) as graph:
        recorder = Node("demo_recorder")
        recording = RunRecord(recorder, task, list(robot.joint_names))
        # numbers of its own: the situation is the same whatever perception is like
        camera = SimulatedCamera(perception(arguments.perception, EXACT_RATE), [arguments.seed, 0xDE, 0xCA])
        world = World(graph.node, task, situation, disturbances, camera, lockstep)
        print(f"2. starting the nodes (logs: {log})")
        _start(graph, arguments, model_file)
        print("3. reproducing in a new situation; the object is pushed and the target hidden on the way")
        if lockstep:  # simulated time begins with the movement, so that it is the same each time
            result = _ask(graph, recording, START_TIMEOUT[lockstep])
        _start_simulator(graph, arguments)
        graph.wait_for(recording.hand_is_known, START_TIMEOUT[lockstep], "the hand's pose")
        begun = time.monotonic()
        if not lockstep:
            result = _ask(graph, recording, START_TIMEOUT[lockstep])
        outcome = _outcome(graph, recording, world, result, END_TIMEOUT[lockstep])
        took = time.monotonic() - begun
        recorder.destroy_node()
    report = evaluate(recording, world, robot.effort_limits, outcome, arguments.lockstep)
    assert world.started_ns is not None
    report["rate_hz"] = arguments.rate
    report["seed"] = arguments.seed
    report["perception"]["kind"] = arguments.perception
    report["real_time_factor"] = report["movement_time_s"] / took
    report["digest"] = recording.digest(world.started_ns, demonstrated_duration(model))
    pushed = disturbances.pushed(situation.object, np.inf)
    frames = {name: np.array(spec.pose) for name, spec in task.frames.items() if spec.pose is not None}
    frames |= {"object": pushed, "target": situation.target}
    mixture = model.adapt({name: Frame.from_pose(pose[:3], pose[3:]).with_time() for name, pose in frames.items()})
    draw(recording, world, mixture, robot.effort_limits, arguments.output)
    path = write_report(arguments.output, report)
    print(table(report))
    print(f"report and pictures: {path.parent}")
    return bool(report["passed"])


def _start(graph: Graph, arguments: argparse.Namespace, model_file: Path) -> None:
    """All nodes but the simulator."""
    processes, simulated = graph.processes, arguments.lockstep
    both: dict[str, Value] = {"use_sim_time": simulated, "realtime_priority": _priority(arguments)}
    answering: dict[str, Value] = {"joint_state_rate": arguments.rate, **both}
    # near 100 Hz, a whole number of joint states apart: nobody answers between two of them
    frames_rate = arguments.rate / max(1, round(arguments.rate / 100.0))
    waiting: dict[str, Value] = {"lockstep_rate": frames_rate, "start_timeout": 60.0} if simulated else {}
    nodes: dict[str, dict[str, Value]] = {
        "frame_tracker": {"task_file": arguments.task, "lockstep": simulated, **both},
        "reproduction": {"task_file": arguments.task, "model_file": model_file, **waiting, **answering},
        "impedance_controller": {"robot_file": arguments.robot, "lockstep": simulated, **answering},
    }
    processes.start_all("from_pose_to_torque", nodes, together=not arguments.separate)
    graph.bring_up("impedance_controller", START_TIMEOUT[simulated])
    graph.bring_up("reproduction", START_TIMEOUT[simulated])


def _start_simulator(graph: Graph, arguments: argparse.Namespace) -> None:
    graph.processes.start(
        "baxter_simulator",
        robot_file=arguments.robot,
        lockstep=arguments.lockstep,
        rate=arguments.rate,
        physics_steps=math.ceil(PHYSICS_RATE / arguments.rate),
        realtime_priority=_priority(arguments),
    )


def _priority(arguments: argparse.Namespace) -> int:
    return 0 if arguments.lockstep else REALTIME_PRIORITY


def _ask(graph: Graph, recording: RunRecord, timeout: float) -> Future:
    """Ask for the movement; returns its result to come once the movement waits for nothing but the robot."""
    client = ActionClient(graph.node, Reproduce, "reproduce")
    graph.wait_for(client.server_is_ready, timeout, "the action 'reproduce'")
    goal = graph.result(client.send_goal_async(Reproduce.Goal()), timeout, "the goal to be accepted")
    if not goal.accepted:
        raise GraphError("reproduction refused the goal")
    result = goal.get_result_async()
    graph.wait_for(lambda: result.done() or recording.says("reproduction", "stage"), timeout, "the movement to begin")
    return result


def _outcome(graph: Graph, recording: RunRecord, world: World, result: Future, timeout: float) -> tuple[bool, str]:
    """Whether the movement succeeded, and what the action said."""

    def ended() -> bool:
        recording.poll()
        if world.started_ns is None:
            world.started_ns = recording.first_reference_ns()
        return result.done()

    graph.wait_for(ended, timeout, "the end of the movement")
    if world.started_ns is None:
        raise GraphError(f"the movement never started: {result.result().result.reason}")
    response = result.result()
    return response.status == GoalStatus.STATUS_SUCCEEDED, response.result.reason


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="demo", description=package.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seed", type=whole_number(0, SEED), default=1, help="number of the situation (default: %(default)s)"
    )
    parser.add_argument(
        "--bags", type=a_path, default=Path("bags/pick_place"), help="the demonstrations (default: %(default)s)"
    )
    parser.add_argument("--model", type=a_path, help="use this model file of the task, instead of training one")
    parser.add_argument(
        "--output", type=a_path, default=Path("out/demo"), help="report, pictures, model, logs (default: %(default)s)"
    )
    parser.add_argument(
        "--task", type=a_path, default=config_file("pick_place.yaml"), help="task file (default: %(default)s)"
    )
    parser.add_argument(
        "--robot", type=a_path, default=config_file("baxter.yaml"), help="robot file (default: %(default)s)"
    )
    parser.add_argument(
        "--perception",
        choices=PERCEPTIONS,
        default="camera",
        help="camera: object and target are observed 30 times per second, 30 ms late, with noise of 1 mm and 0.5 deg; "
        "exact: where they are, at once (default: %(default)s)",
    )
    parser.add_argument(
        "--lockstep", action="store_true", help="run on simulated time, as fast as possible, not in real time"
    )
    parser.add_argument(
        "--separate",
        action="store_true",
        help="run each node in its own process, instead of all nodes from pose to torque in one",
    )
    parser.add_argument(
        "--rate",
        type=float,
        default=1000.0,
        help="rate of joint states and torques, Hz, 100 to 2000 (default: %(default)s)",
    )
    parser.add_argument(
        "--domain",
        type=whole_number(0, DOMAIN),
        help="ROS domain to run on, to watch with RViz (default: a free one, this machine only)",
    )
    return parser
