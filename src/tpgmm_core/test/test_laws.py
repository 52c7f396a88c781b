# SPDX-License-Identifier: Apache-2.0
"""Every law of minimal intervention control on the simulated Baxter, for references of poses and of joints."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pinocchio")
pytest.importorskip("daqp")

from reaching import DURATION, frames_at, reaching_near
from robots import BAXTER
from tpgmm_core import Gaussian
from tpgmm_core.control.controller import Controller, TorqueCommand
from tpgmm_core.control.laws import LAWS, ReferenceLaw
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.reproduction import Reproduction
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

MS = 1_000_000


@pytest.fixture(scope="module")
def baxter() -> RobotModel:
    return RobotModel.from_file(BAXTER)


def lasting(gaussian: Gaussian, dimensions: tuple[str, ...] = (), steps: int = 10) -> Reference:
    """A reference that stays, with a horizon of 0.05 s between its Gaussians."""
    return Reference(0.0, gaussian, 0.05, (gaussian,) * steps, np.ones(1), (), dimensions)


class Loop:
    """Controller and simulator in lockstep at 1 kHz."""

    def __init__(self, robot: RobotModel, name: str) -> None:
        self.law, self.simulator = ReferenceLaw(name, robot), RobotSimulator(robot)
        self.controller = Controller(robot, self.law)

    def step(self, reference: Reference | None) -> TorqueCommand:
        state = self.simulator.state
        target = None if reference is None else self.law.target(reference, True)
        command = self.controller.step(state.q, state.v, target, 0.001)
        assert command is not None and not command.reason
        np.testing.assert_allclose(sum(command.terms.values()), command.tau, atol=1e-9)
        self.simulator.step(command.tau)
        return command


@pytest.mark.parametrize("name", LAWS)
def test_a_learned_movement_is_followed_within_the_torques(baxter: RobotModel, name: str) -> None:
    data = baxter.create_data()
    data.update(baxter.home)
    model, places = reaching_near(data.pose("left"))
    reproduction, frames = Reproduction(model, horizon_steps=10, horizon_time_step=0.05), frames_at(**places)
    reproduction.start(0)
    loop, taus, distances = Loop(baxter, name), [], []
    for ms in range(round(1000 * DURATION) + 300):
        reference = reproduction.step(ms * MS, frames)
        taus.append(loop.step(reference).tau)
        data.update(loop.simulator.state.q)
        distances.append(np.linalg.norm(data.pose("left")[:3] - reference.gaussian.mean[:3]))
    assert max(distances) < 0.03 and distances[-1] < 0.003
    shares = np.abs(taus) / baxter.effort_limits
    assert shares.max() <= 1.0
    # stiffness and feedforward go over from one plan to the next: no torque moves by more from one ms to the next
    assert (np.abs(np.diff(taus, axis=0)) / baxter.effort_limits).max() < 0.025


@pytest.mark.parametrize("name", LAWS)
def test_references_of_poses_and_of_joints_take_turns_without_a_jump(baxter: RobotModel, name: str) -> None:
    data, arm = baxter.create_data(), baxter.indices("left_arm")
    data.update(baxter.home)
    pose = data.pose("left").copy()
    pose[2] += 0.02
    moved = baxter.home.copy()
    moved[arm] += 0.03
    of_pose = lasting(Gaussian(pose, np.diag([0.01**2] * 3 + [0.05**2] * 3), POSE))
    names = tuple(baxter.joint_names[i] for i in arm)
    of_joints = lasting(Gaussian(moved[arm], 0.02**2 * np.eye(7)), names)
    loop = Loop(baxter, name)
    taus = [loop.step(of_pose if ms < 700 else of_joints).tau for ms in range(2200)]
    assert (np.abs(np.diff(taus, axis=0)) / baxter.effort_limits).max() < 0.02
    np.testing.assert_allclose(loop.simulator.state.q[arm], moved[arm], atol=0.02)
    assert loop.step(of_joints).law.stiffness.shape == (7, 7)  # type: ignore[union-attr]


@pytest.mark.parametrize("joints", [False, True])
def test_the_finite_horizon_of_a_reference_that_stays_is_the_infinite_one(baxter: RobotModel, joints: bool) -> None:
    data, arm = baxter.create_data(), baxter.indices("left_arm")
    data.update(baxter.home)
    root = np.random.default_rng(2).normal(size=(7, 7))
    if joints:
        names = tuple(baxter.joint_names[i] for i in arm)
        reference = lasting(Gaussian(baxter.home[arm] + 0.01, 0.003 * (root @ root.T + np.eye(7))), names)
    else:
        reference = lasting(Gaussian(data.pose("left").copy(), 1e-3 * (root @ root.T + np.eye(7))[:6, :6], POSE))
    asked = [Loop(baxter, name).step(reference).law for name in ("infinite_horizon", "finite_horizon")]
    infinite, finite = (law for law in asked if law is not None)
    np.testing.assert_allclose(finite.stiffness, infinite.stiffness, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(finite.tau, infinite.tau, rtol=1e-9, atol=1e-9)


def test_what_cannot_be_followed_is_refused_with_the_reason(baxter: RobotModel) -> None:
    law = ReferenceLaw("finite_horizon", baxter)
    pose = Gaussian(np.r_[0.5, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0], np.eye(6), POSE)
    with pytest.raises(ValueError, match="no horizon.*horizon_steps"):
        law.target(lasting(pose, steps=0), True)
    with pytest.raises(ValueError, match="names of joints|dimensions name"):
        law.target(lasting(Gaussian(np.zeros(2), np.eye(2)), ("left_s0", "elbow")), True)
    with pytest.raises(ValueError, match="no law 'best'.*infinite_horizon"):
        ReferenceLaw("best", baxter)
