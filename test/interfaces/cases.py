# SPDX-License-Identifier: Apache-2.0
"""The robots, as a user starts each of them: files of config/ and arguments of loop.launch.py; and their stand-ins."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.runtime.loop_description import LoopProcess, loop_processes
from tpgmm_ros.runtime.resources import config_file

TEST = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class Case:
    """One robot.

    `robot` and `task` are files of config/; `loop` holds the arguments of the launch file beside them, the model and
    the end point. `stand_in` is a program in test/ and its words after the robot file; without one: the simulator.
    `silence` is the longest time between two commands while it moves, s: of torques, the robot stops after it; of
    trajectories, it has begun to slow down by then; of targets, it would stand still.
    """

    name: str
    interface: str
    robot: str
    task: str
    endpoint: str
    silence: float
    loop: Mapping[str, str] = field(default_factory=dict)
    stand_in: tuple[str, ...] = ()

    def arguments(self, model: Path) -> dict[str, str]:
        """Of the launch file."""
        files = {"robot": str(config_file(self.robot)), "task": str(config_file(self.task)), "model": str(model)}
        return files | {"endpoint": self.endpoint, **self.loop}

    def processes(self, model: Path, **more: str) -> list[LoopProcess]:
        """What the launch file starts."""
        return loop_processes(self.arguments(model) | more)

    def robot_command(self, rate: float, slower: float) -> list[str]:
        """Starts the stand-in: `rate` is that of a robot that takes torques, Hz; `slower` than real time, 0: in it."""
        file = str(config_file(self.robot))
        if self.stand_in:
            program, *words = self.stand_in
            return [sys.executable, str(TEST / program), file, *words, *([f"--slower={slower:g}"] if slower else [])]
        steps = max(1, round(1000.0 / rate))
        values = {"robot_file": file, "rate": rate, "physics_steps": steps, "lockstep": "true" if slower else "false"}
        given = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
        return [sys.executable, "-m", "tpgmm_ros.nodes.baxter_simulator", "--ros-args", *given]


UR5_JOINTS = tuple(RobotModel.from_file(config_file("ur5.yaml")).joint_groups["arm"])
CASES = (
    # a Panda stops where 20 commands in a row are missing: libfranka, kMaxLostPackets
    Case("panda", "torques", "panda.yaml", "pick_place_panda.yaml", "hand", 0.02),
    Case(
        "ur5",
        "FollowJointTrajectory",
        "ur5.yaml",
        "pick_place_ur5.yaml",
        "tool",
        0.2,
        {
            "controller": "joint_motion", "outputs": "[follow_joint_trajectory]", "command_rate": "20.0",
            "horizon": "0.1", "joint_state_rate": "125.0", "poses": "true",
        },
        ("position_robot.py", *UR5_JOINTS),
    ),
    Case(
        "panda_crisp",
        "target_pose, target_stiffness",
        "panda.yaml",
        "pick_place_panda.yaml",
        "hand",
        0.1,
        {
            "controller": "joint_motion", "outputs": "[target_pose, target_stiffness]", "command_rate": "100.0",
            "joint_state_rate": "100.0", "poses": "true",
        },
        ("impedance_robot.py", "hand"),
    ),
)  # fmt: skip
