# SPDX-License-Identifier: Apache-2.0
"""Each robot of `config/` follows a movement that was learned in its workspace; so does one with endless joints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("pinocchio")

from reaching import DURATION, frames_at, reaching_near
from robots import CONFIG, KINOVA
from tpgmm_core import quaternion
from tpgmm_core.controller import Controller
from tpgmm_core.impedance import ImpedanceLaw
from tpgmm_core.reproduction import Reproduction
from tpgmm_core.robot import RobotModel
from tpgmm_core.simulation import RobotSimulator

ROBOTS = ["baxter", "panda", "ur5", "xarm7"]
MS = 1_000_000
STEPS = round(1000 * (DURATION + 1.0))
"""The movement, and a second to come to rest."""


def load(name: str, folder: Path) -> RobotModel:
    if name != "kinova":
        return RobotModel.from_file(CONFIG / f"{name}.yaml")
    (folder / "kinova.yaml").write_text(yaml.safe_dump(KINOVA))
    return RobotModel.from_file(folder / "kinova.yaml")


@pytest.mark.parametrize("name", [*ROBOTS, "kinova"])
def test_a_robot_follows_a_movement_learned_in_its_workspace(name: str, tmp_path: Path) -> None:
    robot = load(name, tmp_path)
    endpoint = next(iter(robot.endpoints))
    simulator, data = RobotSimulator(robot), robot.create_data()
    data.update(robot.home)
    model, places = reaching_near(data.pose(endpoint))
    reproduction, frames = Reproduction(model, horizon_steps=1), frames_at(**places)
    law = ImpedanceLaw(robot, endpoint)
    controller = Controller(robot, law)
    reproduction.start(0)
    distances, shares = [], []
    for ms in range(STEPS):
        state = simulator.state
        target = law.target(reproduction.step(ms * MS, frames), True)
        command = controller.step(state.q, state.v, target, 0.001)
        assert command is not None and not command.reason
        state = simulator.step(command.tau)
        assert not state.clamped
        shares.append(np.abs(command.tau / robot.effort_limits).max())
        data.update(state.q)
        hand = data.pose(endpoint)
        distances.append(np.linalg.norm(hand[:3] - target.reference.pose[:3]))
    turn = quaternion.log(quaternion.multiply(hand[3:], quaternion.conjugate(target.reference.pose[3:])))
    assert np.linalg.norm(hand[:3] - places["object"][:3]) < 0.01
    assert distances[-1] < 0.002
    assert max(distances) < 0.03
    assert np.linalg.norm(turn) < 0.01
    assert max(shares) <= 1.0
