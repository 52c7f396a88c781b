# SPDX-License-Identifier: Apache-2.0
"""Joint positions that follow references: within all limits whatever comes, and what matters little gives way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tpgmm_core import Gaussian
from tpgmm_core.control.joint_motion import MAX_STEP, JointMotion, JointStep, MotionConfig
from tpgmm_core.control.motion_aims import Aim
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel

CONFIG = Path(__file__).resolve().parents[3] / "config"
UR5 = RobotModel.from_file(CONFIG / "ur5.yaml")
ARM = UR5.indices("arm")
DT = 0.01


def pose_of(robot: RobotModel, q: np.ndarray, endpoint: str = "tool") -> np.ndarray:
    data = robot.create_data()
    data.update(q)
    return data.pose(endpoint)


def moved(*offset: float) -> np.ndarray:
    """The pose of the hand at home, aside by an offset, m."""
    return pose_of(UR5, UR5.home) + np.array([*offset, 0.0, 0.0, 0.0, 0.0])


def aim_at(pose: np.ndarray, covariance: np.ndarray | None = None, twist: np.ndarray | None = None) -> Aim:
    covariance = 1e-4 * np.eye(6) if covariance is None else covariance
    return Aim.of_pose("tool", PoseReference(pose, covariance, np.zeros(6) if twist is None else twist))


def started(config: MotionConfig | None = None) -> JointMotion:
    motion = JointMotion(UR5, ARM, config)
    motion.start(UR5.home)
    return motion


def test_it_reaches_a_pose_and_rests_there() -> None:
    motion, there = started(), moved(0.1, 0.1, 0.1)
    for _ in range(400):
        step = motion.step([aim_at(there)], DT)
    np.testing.assert_allclose(motion.pose("tool")[:3], there[:3], atol=1e-3)
    assert not step.lags and np.abs(step.v).max() < 1e-2


def test_it_keeps_up_with_a_pose_that_moves() -> None:
    motion, twist = started(), np.array([0.05, -0.05, 0.02, 0.0, 0.0, 0.0])
    for i in range(200):
        motion.step([aim_at(moved(*(DT * i * twist[:3])), 1e-6 * np.eye(6), twist)], DT)
    np.testing.assert_allclose(motion.twist("tool"), twist, atol=2e-3)
    np.testing.assert_allclose(motion.pose("tool")[:3], moved(*(2.0 * twist[:3]))[:3], atol=2e-3)


def test_limits_hold_for_any_aims_and_any_time_steps() -> None:
    random = np.random.default_rng(1)
    config = MotionConfig(speed_share=0.8, max_acceleration=4.0, approach_speed=5.0, approach_turn=10.0)
    motion = started(config)
    fastest, last, at = 0.8 * UR5.velocity_limits[ARM], np.zeros(6), motion.q.copy()
    # limits that are near, so that they act
    lower, upper = UR5.home - 0.5, UR5.home + 0.3
    motion._range = lambda: (lower[ARM], upper[ARM])  # type: ignore[method-assign]
    reached = False
    aims: list[Aim] = []
    for i in range(400):
        if i % 50 == 0:
            aims = [aim_at(moved(*random.normal(0.0, 0.7, 3)), np.diag(10.0 ** random.uniform(-6, 0, 6)))]
        aims = aims if random.uniform() < 0.98 else []
        dt = float(10.0 ** random.uniform(-3, -0.9))
        step = motion.step(aims, dt)
        used = min(dt, MAX_STEP)
        assert (np.abs(step.v) <= fastest + 1e-9).all()
        assert (np.abs(step.v - last) <= 4.0 * used + 1e-9).all()
        np.testing.assert_allclose(step.q, at[ARM] + used * step.v, atol=1e-12)
        rest, time = motion.stop_point()
        for q in (step.q, rest):
            assert (q >= lower[ARM] - 1e-9).all() and (q <= upper[ARM] + 1e-9).all()
        assert (np.abs(step.v) <= 4.0 * time + 1e-9).all()
        last, at = step.v, motion.q.copy()
        reached = reached or bool(min((step.q - lower[ARM]).min(), (upper[ARM] - step.q).min()) < 0.02)
    assert reached


def test_what_matters_little_gives_way_out_of_reach_and_the_limits_are_named() -> None:
    motion, covariance = started(), np.diag([1.0, 1e-6, 1e-6, 1.0, 1.0, 1.0])
    there = moved(2.0, 0.0, 0.1)
    for _ in range(600):
        step = motion.step([aim_at(there, covariance)], DT)
    np.testing.assert_allclose(motion.pose("tool")[1:3], there[1:3], atol=0.02)
    assert not step.lags  # 2 m are two standard deviations of x
    precise = aim_at(there)
    for _ in range(300):
        step = motion.step([precise], DT)
    (lag,) = step.lags
    assert lag.distance > 1.0


def test_two_aims_share_by_their_precision() -> None:
    """What two frames want of one hand: the product of their Gaussians."""
    motion = started()
    wide, narrow = 4e-4 * np.eye(6), 1e-4 * np.eye(6)
    for _ in range(400):
        motion.step([aim_at(moved(0.05, 0.0, 0.0), wide), aim_at(moved(0.0, 0.05, 0.0), narrow)], DT)
    np.testing.assert_allclose(motion.pose("tool")[:3], moved(0.01, 0.04, 0.0)[:3], atol=1e-3)


def test_two_hands_move_at_once() -> None:
    baxter = RobotModel.from_file(CONFIG / "baxter.yaml")
    joints = np.concatenate([baxter.indices(baxter.endpoints[hand].joints) for hand in ("left", "right")])
    motion = JointMotion(baxter, joints)
    motion.start(baxter.home)
    there = {hand: pose_of(baxter, baxter.home, hand) + 0.05 * np.eye(7)[2] for hand in ("left", "right")}
    aims = [Aim.of_pose(hand, PoseReference(pose, 1e-4 * np.eye(6))) for hand, pose in there.items()]
    for _ in range(300):
        motion.step(aims, DT)
    for hand, pose in there.items():
        np.testing.assert_allclose(motion.pose(hand)[:3], pose[:3], atol=1e-3)


def test_references_of_poses_and_of_joints_are_aims() -> None:
    horizon = (Gaussian(moved(0.01, 0.0, 0.0), 1e-4 * np.eye(6), POSE),)
    reference = Reference(0.0, Gaussian(moved(0.0, 0.0, 0.0), 1e-4 * np.eye(6), POSE), 0.1, horizon, np.ones(1), ())
    aim = Aim.of_reference(UR5, "tool", reference)
    np.testing.assert_allclose(aim.velocity, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], atol=1e-9)
    names = ("elbow_joint", "wrist_3_joint")
    gaussian = Gaussian(np.array([1.8, 0.3]), 1e-4 * np.eye(2), Manifold.euclidean(2))
    motion = started()
    for _ in range(300):
        motion.step([Aim.of_reference(UR5, "tool", Reference(0.0, gaussian, 0.0, (), np.ones(1), (), names))], DT)
    np.testing.assert_allclose(motion.q[UR5.indices(names)], [1.8, 0.3], atol=1e-3)
    with pytest.raises(ValueError, match="expected a pose on 'R3 x S3', or a Gaussian over joints"):
        Aim.of_reference(UR5, "tool", Reference(0.0, gaussian, 0.0, (), np.ones(1), (), ("a", "b")))


def test_without_aims_it_slows_down_and_stays() -> None:
    motion = started()
    for _ in range(20):
        step: JointStep = motion.step([aim_at(moved(0.2, 0.0, 0.0))], DT)
    rest, time = motion.stop_point()
    assert not step.at_rest and time > 0.0
    for _ in range(100):
        step = motion.step([], DT)
    assert step.at_rest and not step.limits
    assert np.abs(step.q - rest).max() < 0.05


def test_lowered_speeds_are_met_without_a_jump() -> None:
    motion = started()
    for _ in range(50):
        before = motion.step([aim_at(moved(0.4, 0.3, 0.2))], DT)
    motion.configure(MotionConfig(speed_share=0.01))
    after = motion.step([aim_at(moved(0.4, 0.3, 0.2))], DT)
    assert (np.abs(after.v - before.v) <= 5.0 * DT + 1e-9).all()
    for _ in range(100):
        after = motion.step([aim_at(moved(0.4, 0.3, 0.2))], DT)
    assert (np.abs(after.v) <= 0.01 * UR5.velocity_limits[ARM] + 1e-9).all()


@pytest.mark.parametrize("dt", [0.0, -0.01, np.nan, np.inf])
def test_a_time_step_that_is_none_is_refused(dt: float) -> None:
    with pytest.raises(ValueError, match="time step .*expected more than 0"):
        started().step([], dt)


def test_a_start_outside_the_limits_is_refused_and_one_by_noise_moves_inwards() -> None:
    motion = JointMotion(UR5, ARM)
    with pytest.raises(ValueError, match="outside the joint limits: shoulder_pan_joint at 7 of"):
        motion.start(UR5.home + np.array([7.0, 0, 0, 0, 0, 0]))
    q = UR5.home.copy()
    q[0] = UR5.upper_limits[0] + 0.01
    motion.start(q)
    assert motion.step([], DT).q == pytest.approx(q)
    assert motion.step([aim_at(moved(0.1, 0.0, 0.0))], DT).q[0] <= q[0]


@pytest.mark.parametrize("covariance", [np.zeros((6, 6)), np.full((6, 6), np.nan)])
def test_a_covariance_that_is_none_is_refused(covariance: np.ndarray) -> None:
    with pytest.raises(ValueError, match="covariance is not finite, or not positive definite"):
        aim_at(moved(0.1, 0.0, 0.0), covariance)
