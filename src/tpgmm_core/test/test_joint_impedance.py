# SPDX-License-Identifier: Apache-2.0
"""The joint-space law: stiffness and damping that belong together, references refused, motors that are too weak."""

from __future__ import annotations

import numpy as np
import pytest

from robots import BAXTER
from tpgmm_core import Gaussian
from tpgmm_core.control.control_law import RobotMoment
from tpgmm_core.control.joint_impedance import JointImpedanceConfig, JointImpedanceLaw
from tpgmm_core.control.kernels_joint import joint_torques
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel

ARMS = ("left_arm", "right_arm")
AT_ONCE = 1e3


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_file(BAXTER)


@pytest.fixture(scope="module")
def law(robot: RobotModel) -> JointImpedanceLaw:
    return JointImpedanceLaw(robot, ARMS)


def reference(mean: np.ndarray, precision: np.ndarray, dimensions: tuple[str, ...] = ()) -> Reference:
    covariance = np.linalg.inv(precision)
    return Reference(0.0, Gaussian(mean, 0.5 * (covariance + covariance.T)), 0.0, (), np.ones(1), (), dimensions)


def some_precision(n: int) -> np.ndarray:
    A = np.random.default_rng(4).standard_normal((n, 3))
    return 1e3 * A @ A.T + np.eye(n)  # three directions held, the others hardly


def test_stiffness_and_damping_are_symmetric_and_solve_the_lqr_with_the_inertia_as_control_cost(
    robot: RobotModel, law: JointImpedanceLaw
) -> None:
    moment = RobotMoment.at(robot.create_data(), robot.home, np.zeros(robot.nv))
    joints = np.concatenate([robot.indices(group) for group in ARMS])
    Q, r = some_precision(14), law.config.joint_control_cost
    law.reset()
    answer = law.step(moment, law.target(reference(robot.home[joints] + 0.01, Q), False), AT_ONCE)
    K, D, M = answer.stiffness, answer.damping, moment.inertia[np.ix_(joints, joints)]
    np.testing.assert_allclose(K, K.T, atol=1e-8 * np.abs(K).max())
    np.testing.assert_allclose(D, D.T, atol=1e-8 * np.abs(D).max())
    np.testing.assert_allclose(K, 0.5 * D @ np.linalg.solve(M, D), rtol=1e-6, atol=1e-6)
    # of the Riccati equation with R = r M: K M^-1 K = Q / r, where the bounds do not cut
    lowest = np.linalg.eigvals(np.linalg.solve(M, K)).real.min()
    assert lowest > law.config.joint_min_stiffness
    np.testing.assert_allclose(K @ np.linalg.solve(M, K), Q / r, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(answer.terms["feedback"][joints], K @ np.full(14, 0.01), rtol=1e-6)


def test_a_motor_that_is_too_weak_gives_what_it_can_and_the_others_do_not_let_go(
    robot: RobotModel, law: JointImpedanceLaw
) -> None:
    moment = RobotMoment.at(robot.create_data(), robot.home, np.zeros(robot.nv))
    joints = np.concatenate([robot.indices(group) for group in ARMS])
    mean = robot.home[joints].copy()
    mean[3], mean[10] = mean[3] + 5.0, mean[10] + 0.05  # out of all reach on the left, near on the right
    law.reset()
    answer = law.step(moment, law.target(reference(mean, 100.0 * np.eye(14)), False), AT_ONCE)
    assert answer.shortened
    assert np.all(np.abs(answer.tau) <= robot.effort_limits * (1.0 + 1e-12))
    right = joints[7:]
    np.testing.assert_allclose(answer.terms["feedback"][right], (answer.stiffness @ answer.error)[7:], rtol=1e-9)
    assert np.abs(answer.terms["feedback"][right]).max() > 0.1


@pytest.mark.parametrize("weak", [1.0, 0.2, 0.02])
def test_what_brakes_never_drives_however_weak_the_motors_are(robot: RobotModel, weak: float) -> None:
    random = np.random.default_rng(8)
    n = robot.nv
    joints, nothing = np.arange(n), np.zeros(n)
    shortened = 0
    for _ in range(200):
        A = random.standard_normal((n, 2)) * np.exp(random.normal(scale=2.0, size=(n, 1)))
        D = A @ A.T + 0.1 * np.eye(n)
        v = random.standard_normal(n) * np.exp(random.normal(scale=2.0, size=n))
        given = random.uniform(-1.2, 1.2, n) * weak * robot.effort_limits
        feedback, stiffness, damping = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
        shortened += joint_torques(
            joints, np.eye(n), np.eye(n), nothing, nothing, v, D, 0.5 * np.eye(n), nothing, 1.0, 1.0,
            weak * robot.effort_limits, given, feedback, stiffness, damping,
        )  # fmt: skip
        assert feedback @ v <= 1e-9 * np.abs(feedback) @ np.abs(v)
    assert shortened > 0


@pytest.mark.parametrize(("mass", "start"), [(1.0, 1.0), (0.1, 1.0), (0.1, 0.3)])
def test_a_pull_beyond_the_motor_leaves_room_for_what_brakes(mass: float, start: float) -> None:
    """One joint far from its reference, whose torque changes no faster than motors may: it comes to rest there."""
    D, L, one = np.array([[mass * np.sqrt(2.0 * 9000.0)]]), np.array([[np.sqrt(mass)]]), np.zeros(1)
    q, v, tau, last = start, 0.0, 0.0, []
    for step in range(6000):
        feedback, stiffness, damping = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1))
        joint_torques(
            np.arange(1), L, 1.0 / L, np.array([-q]), one, np.array([v]), D, 0.5 * np.eye(1), one, 1.0, 1.0,
            np.array([50.0]), one, feedback, stiffness, damping,
        )  # fmt: skip
        tau += np.clip(feedback[0] - tau, -1.5, 1.5)
        v += 0.001 * tau / mass
        q += 0.001 * v
        if step > 5500:
            last.append(abs(q))
    assert max(last) < 1e-3 * start


def test_references_over_other_joints_are_refused_with_the_reason(robot: RobotModel, law: JointImpedanceLaw) -> None:
    with pytest.raises(ValueError, match="expected positions of 14 joints"):
        law.target(reference(np.zeros(3), np.eye(3)), False)
    with pytest.raises(ValueError, match="expected .'left_s0'"):
        law.target(reference(np.zeros(14), np.eye(14), tuple(reversed(law.joint_names))), False)
    with pytest.raises(ValueError, match="joint_min_stiffness 5.0 is above joint_max_stiffness 2.0"):
        JointImpedanceConfig(joint_min_stiffness=5.0, joint_max_stiffness=2.0)
    with pytest.raises(ValueError, match="each named once"):
        JointImpedanceLaw(robot, ("left_arm", "left_s0"))
