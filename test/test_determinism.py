# SPDX-License-Identifier: Apache-2.0
"""Lockstep: the whole graph gives the same torques and poses twice, bit by bit, however busy the machine is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rclpy.action import ActionClient
from rclpy.node import Node

from ros_graph import ROBOT_FILE, ROOT, TASK_FILE, result_of, ros_arguments
from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.demo.recording import RunRecord
from tpgmm_demos.demo.world import Disturbances, World
from tpgmm_demos.scene.perception import CameraConfig, SimulatedCamera
from tpgmm_demos.scene.pick_place import random_placement
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.programs import train
from tpgmm_ros.task.task_file import Task

DURATION = 1.0
TIMEOUT = 120.0
BUSY = "while True: pass"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "model.tpgmm"
    bags = [str(ROOT / "bags" / "pick_place" / f"demo_{i:02d}") for i in (1, 2, 3, 4)]
    assert train.main(["--task", str(TASK_FILE), "--output", str(path), *bags]) == 0
    return path


def movement(
    node: Node, start: StartProcess, model: Path, together: bool = False
) -> tuple[str, np.ndarray, np.ndarray]:
    """Digest of one movement on a graph of its own, its torques' stamps (T,), ns, and the way of the hand (T, 3).

    together : the nodes from pose to torque in one process
    """
    task = Task.load(TASK_FILE)
    random = np.random.default_rng(5)
    situation, disturbances = random_placement(random), Disturbances.random(random, DURATION)
    around = Node("world", context=node.context)
    assert node.executor is not None
    node.executor.add_node(around)
    world = World(around, task, situation, disturbances, SimulatedCamera(CameraConfig(), seed=5), lockstep=True)
    recorder = Node("recorder", context=node.context)
    recording = RunRecord(recorder, task, list(RobotModel.from_file(ROBOT_FILE).joint_names))
    nodes: dict[str, dict[str, object]] = {
        "frame_tracker": {"task_file": TASK_FILE, "lockstep": True},
        "reproduction": {
            "task_file": TASK_FILE,
            "model_file": model,
            "lockstep_rate": 100.0,
            "start_timeout": TIMEOUT,
            "settle_time": 0.05,
            "autostart": True,
        },
        "impedance_controller": {"robot_file": ROBOT_FILE, "lockstep": True, "autostart": True},
    }
    processes: tuple[RunningProcess, ...]
    if together:
        given = {f"{name}:{key}": value for name, parameters in nodes.items() for key, value in parameters.items()}
        processes = (start("compose", *nodes, *ros_arguments(use_sim_time=True, **given)),)
    else:
        processes = tuple(start(name, *ros_arguments(use_sim_time=True, **given)) for name, given in nodes.items())
    client = ActionClient(node, Reproduce, "reproduce")
    spin_until(node, client.server_is_ready, TIMEOUT, "the action", processes)
    goal = result_of(node, client.send_goal_async(Reproduce.Goal(duration=DURATION)), "the goal", TIMEOUT)
    ended = goal.get_result_async()
    spin_until(node, lambda: recording.says("reproduction", "stage"), TIMEOUT, "the movement to wait", processes)
    processes += (start("baxter_simulator", *ros_arguments(robot_file=ROBOT_FILE, lockstep=True)),)

    def is_done() -> bool:
        recording.poll()
        return bool(ended.done())

    spin_until(node, is_done, TIMEOUT, "the end of the movement", processes)
    for process in reversed(processes):
        process.stop()
    client.destroy()
    node.executor.remove_node(around)
    around.destroy_node()
    recorder.destroy_node()
    assert world.started_ns is not None
    torque, hand = recording.torque().since(world.started_ns), recording.hand().since(world.started_ns)
    within = torque.stamps_ns <= world.started_ns + 1e9 * DURATION
    return recording.digest(world.started_ns, DURATION), np.unique(torque.stamps_ns[within]), hand.values[:, :3]


@pytest.mark.timeout(600)
def test_two_runs_are_equal_bit_by_bit_also_in_one_process_while_other_programs_take_the_cores(
    ros_node: Node, start_process: StartProcess, model: Path
) -> None:
    alone = movement(ros_node, start_process, model)
    others = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(os.cpu_count() or 1)]
    try:
        crowded = movement(ros_node, start_process, model, together=True)
    finally:
        for other in others:
            other.kill()
            other.wait()
    for digest, stamps, hand in (alone, crowded):
        assert len(stamps) == 1000 * DURATION + 1, "a torque for each millisecond"
        assert np.linalg.norm(hand - hand[0], axis=1).max() > 0.05, "the hand has moved"
        assert digest == alone[0]
