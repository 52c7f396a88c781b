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
from tpgmm_core.control.control_law import DynamicState, LawTorques
from tpgmm_core.control.controller import Controller
from tpgmm_core.control.impedance import ImpedanceLaw
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.reproduction import Reproduction
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

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


def test_a_driver_that_wraps_the_angles_of_endless_joints_makes_no_difference(tmp_path: Path) -> None:
    robot = load("kinova", tmp_path)
    endless = np.flatnonzero(np.isinf(robot.upper_limits))
    assert len(endless) == 3
    torques = []
    for wrap in (False, True):
        simulator, law = RobotSimulator(robot), ImpedanceLaw(robot, "hand")
        controller, data = Controller(robot, law), robot.create_data()
        data.update(robot.home)
        goal = law.pose_target(
            PoseReference(POSE.exp(data.pose("hand"), [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]), 1e-4 * np.eye(6))
        )
        torques.append([])
        for _ in range(1500):
            q = simulator.state.q.copy()
            if wrap:
                q[endless] = np.arctan2(np.sin(q[endless]), np.cos(q[endless]))
            command = controller.step(q, simulator.state.v, goal, 0.001)
            assert command is not None
            torques[-1].append(command.tau)
            simulator.step(command.tau)
    assert np.abs(simulator.state.q - robot.home)[endless].max() > 0.1
    np.testing.assert_allclose(torques[1], torques[0], atol=1e-6)


def test_joint_gains_are_how_torques_answer_a_displacement() -> None:
    robot = RobotModel.from_file(CONFIG / "ur5.yaml")  # six joints: the hand's pose says where each of them is
    data, law = robot.create_data(), ImpedanceLaw(robot, "tool")
    data.update(robot.home)
    still = law.pose_target(PoseReference(data.pose("tool"), np.diag([1e-4] * 3 + [1e-2] * 3)))
    still_at = {"q": robot.home, "v": np.zeros(robot.nv)}

    def feedback(changes: dict[str, np.ndarray]) -> LawTorques:
        law.reset()
        for _ in range(1000):  # until the reference has full hold
            torques = law.step(DynamicState.at(data, **still_at), still, 0.001)
        torques = law.step(DynamicState.at(data, **{**still_at, **changes}), still, 0.0)
        return torques

    stiffness, damping = feedback({}).joint_gains()
    for name, gains in (("q", stiffness), ("v", damping)):
        for joint in range(robot.nv):
            step = 1e-6 * np.eye(robot.nv)[joint]
            ahead, behind = (feedback({name: still_at[name] + sign * step}).terms["feedback"] for sign in (1, -1))
            np.testing.assert_allclose((behind - ahead) / 2e-6, gains[:, joint], atol=1e-3 * np.abs(gains).max())
