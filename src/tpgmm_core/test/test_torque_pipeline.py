# SPDX-License-Identifier: Apache-2.0
"""What leaves the pipeline as a whole: the safe torque of a robot that moves, and the blend after it."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robots import BAXTER
from tpgmm_core.control.control_law import DynamicState
from tpgmm_core.control.torque_pipeline import TorqueLimits, TorquePipeline, actions
from tpgmm_core.robot.model import RobotModel

#: So fast that no limit of rates is met
LIMITS = TorqueLimits(torque_rate=1e3)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_file(BAXTER)


def moving(robot: RobotModel, share: float = 0.1) -> DynamicState:
    """At home, each joint that is away from its stops at a share of its speed limit, every second one backwards."""
    free = np.minimum(robot.home - robot.lower_limits, robot.upper_limits - robot.home) > 0.1
    assert free.sum() >= 14
    v = share * robot.velocity_limits * free * np.where(np.arange(robot.nv) % 2, -1.0, 1.0)
    return DynamicState.at(robot.create_data(), robot.home, v)


def safe_torque(moment: DynamicState, limits: TorqueLimits) -> np.ndarray:
    """Gravity and Coriolis torques, less a damping that brakes no joint faster than half of `limit_bandwidth`."""
    felt = 1.0 / np.diagonal(moment.inverse)
    return moment.nonlinear - np.minimum(limits.safe_damping, 0.5 * limits.limit_bandwidth * felt) * moment.v


def test_the_safe_torque_of_a_robot_that_moves_brakes_each_joint(robot: RobotModel) -> None:
    moment = moving(robot)
    light = 0.5 * LIMITS.limit_bandwidth / np.diagonal(moment.inverse) < LIMITS.safe_damping
    assert light[moment.v != 0.0].any() and not light[moment.v != 0.0].all()
    tau, done = TorquePipeline(robot, LIMITS).step(None, moment, 0.001)
    assert actions(done) == ()
    np.testing.assert_allclose(tau, safe_torque(moment, LIMITS), rtol=1e-12)
    assert ((tau - moment.nonlinear) * moment.v <= 0.0).all()


def test_after_a_torque_that_is_not_finite_the_law_fades_in_again(robot: RobotModel) -> None:
    pipeline, moment = TorquePipeline(robot, LIMITS), moving(robot, 0.01)
    safe = safe_torque(moment, LIMITS)
    wanted = safe + 0.01 * robot.effort_limits
    for _ in range(400):
        tau, _ = pipeline.step(wanted, moment, 0.001)
    np.testing.assert_allclose(tau, wanted, rtol=1e-12)
    tau, done = pipeline.step(np.where(np.arange(robot.nv) == 3, np.nan, wanted), moment, 0.001)
    assert actions(done) == ("not finite",)
    np.testing.assert_allclose(tau, safe, rtol=1e-12)
    for k in (1, 2, 3):
        tau, done = pipeline.step(wanted, moment, 0.001)
        s = k * 0.001 / LIMITS.recovery_time
        np.testing.assert_allclose(tau - safe, s**2 * (3.0 - 2.0 * s) * (wanted - safe), rtol=1e-9, atol=1e-12)
        assert actions(done) == ()
