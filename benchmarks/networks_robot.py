# SPDX-License-Identifier: Apache-2.0
"""The host of the robot in `networks`: simulator and controller, the world around them, and who asks for the movement.

What the camera sees of the world leaves through a pipe, as light does; the network is for messages.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from pathlib import Path

import numpy as np
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node

from benchmarks.lossy_switch import require_own_network
from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.demo.recording import RunRecord
from tpgmm_demos.demo.report import JUMP, LARGEST_POSITION_ERROR, SILENCE, largest_step, longest_silence, usual_step
from tpgmm_demos.demo.world import EXACT_RATE, Disturbances, World
from tpgmm_demos.scene.perception import SimulatedCamera, perception
from tpgmm_demos.scene.pick_place import random_placement
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.messages import conversions
from tpgmm_ros.runtime.executor import init
from tpgmm_ros.runtime.graph import open_graph
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

#: Time that nodes may take to find each other, and the movement to end, s.
START_TIMEOUT, END_TIMEOUT = 120.0, 200.0
#: DDS finds topics one by one, and where packets are lost this takes a while, s.
FINDING_TIME = 10.0
#: Of the movement, s: slow enough for the disturbances and for the time without a camera.
DURATION = 20.0


def main() -> None:
    """Run the task; says on standard output when the movement starts and what was measured, as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--sightings", type=int, required=True, help="the pipe's number")
    parser.add_argument("--output", type=Path, required=True)
    arguments = parser.parse_args()
    task, robot = Task.load(config_file("pick_place.yaml")), RobotModel.from_file(config_file("baxter.yaml"))
    random = np.random.default_rng([arguments.seed, 0xDE, 0x40])
    situation = random_placement(random)
    disturbances = Disturbances.random(random, DURATION)
    require_own_network()
    init([])
    with (
        open_graph("robot_host", arguments.output / "robot", False) as graph,
        os.fdopen(arguments.sightings, "w") as eye,
    ):

        def show(name: str, pose: PoseStamped) -> None:
            stamp_ns = conversions.time_to_ns(pose.header.stamp)
            print(json.dumps((name, stamp_ns, conversions.pose_to_array(pose.pose).tolist())), file=eye, flush=True)

        recorder = Node("robot_recorder")
        recording = RunRecord(recorder, task, list(robot.joint_names), with_other_hosts=False)
        camera = SimulatedCamera(perception("camera", EXACT_RATE), [arguments.seed, 0xDE, 0xCA])
        world = World(graph.node, task, situation, disturbances, camera, publish=show)
        graph.processes.start_all(
            "robot",
            {
                "impedance_controller": {
                    "robot_file": config_file("baxter.yaml"), "joint_state_rate": arguments.rate, "autostart": True,
                    "joint_state_timeout": 5.0 / arguments.rate, "max_time_step": 2.0 / arguments.rate,
                },
                "baxter_simulator": {
                    "robot_file": config_file("baxter.yaml"), "rate": arguments.rate,
                    "physics_steps": math.ceil(1000.0 / arguments.rate),
                },
            },
        )  # fmt: skip
        graph.wait_for(recording.hand_is_known, START_TIMEOUT, "the hand's pose")
        client = ActionClient(graph.node, Reproduce, "reproduce")
        graph.wait_for(client.server_is_ready, START_TIMEOUT, "the action 'reproduce'")
        found_by = time.monotonic() + FINDING_TIME
        graph.wait_for(lambda: time.monotonic() > found_by, START_TIMEOUT, "the others to find the topics of this host")
        phases: list[float] = []
        asked = client.send_goal_async(
            Reproduce.Goal(duration=DURATION), lambda told: phases.append(told.feedback.phase)
        )
        goal = graph.result(asked, START_TIMEOUT, "the goal to be accepted")
        result = goal.get_result_async()

        def begins() -> bool:
            recording.poll()
            return result.done() or any(phase > 0.0 for phase in phases)

        graph.wait_for(begins, START_TIMEOUT, "the movement to begin")
        world.started_ns = int(recording.hand().stamps_ns[-1])
        print(json.dumps({"started": True}), flush=True)

        def ends() -> bool:
            recording.poll()
            return result.done()

        graph.wait_for(ends, END_TIMEOUT, "the end of the movement")
        response = result.result()
        recorder.destroy_node()
    torque, started = recording.torque().since(world.started_ns), world.started_ns
    end = float(torque.times(started)[-1])
    position, angle = pose_error(world.grasp.object, world.situation.target)
    steps, usual = largest_step(torque, started, 0.0, end), usual_step(torque, started, (0.0, 0.0))
    share = float((np.abs(torque.values) / robot.effort_limits).max())
    checks = {
        "the object was grasped": world.grasp.holds,
        "the movement ended well": response.status == GoalStatus.STATUS_SUCCEEDED,
        "the object is on the target": position <= LARGEST_POSITION_ERROR,
        "no torque above its limit": share <= 1.0,
        "torques arrived without a gap": longest_silence(torque, started, end) <= SILENCE,
        "no jump": steps is not None and steps <= max(JUMP, 2.0 * usual),
    }
    print(
        json.dumps(
            {
                "position_error_mm": 1e3 * position, "orientation_error_deg": math.degrees(angle),
                "largest_torque_step_nm": steps, "usual_torque_step_nm": usual, "torque_share": share,
                "movement_s": end, "outcome": response.result.reason, "checks": checks, "passed": all(checks.values()),
            }
        ),
        flush=True,
    )  # fmt: skip


if __name__ == "__main__":
    main()
