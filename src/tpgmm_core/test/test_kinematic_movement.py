# SPDX-License-Identifier: Apache-2.0
"""Kinematic frames in a loop: hands that see each other, aims that are known, references for joints."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core import TPGMM, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.kinematics.aims import aim_at_origins
from tpgmm_core.kinematics.chains import planar_bimanual
from tpgmm_core.kinematics.frames import JointSpace, NullSpace, PreviousConfiguration, TaskSpace
from tpgmm_core.kinematics.hierarchy import hierarchy_frames
from tpgmm_core.kinematics.movement import KinematicMovement
from tpgmm_core.kinematics.moving import MovingFrames
from tpgmm_core.kinematics.tasks import Task
from tpgmm_core.kinematics.urdf import UrdfKinematics
from tpgmm_core.robot.model import RobotModel

ROBOT_FILE = "config/baxter.yaml"
MS = 1_000_000


@pytest.fixture(scope="module")
def baxter(request: pytest.FixtureRequest) -> UrdfKinematics:
    robot = RobotModel.from_file(request.config.rootpath / ROBOT_FILE)
    return UrdfKinematics(robot, ("left_arm", "right_arm"))


def seen(baxter: UrdfKinematics, q: Array) -> Array:
    """The right hand's pose in the axes of the left one: position, rotation vector."""
    baxter.update(q)
    left, right = baxter.place("left"), baxter.place("right")
    back = quaternion.conjugate(left[3:])
    turned = quaternion.log(quaternion.multiply(back, right[3:]))
    return np.concatenate([quaternion.rotation_matrix(left[3:]).T @ (right[:3] - left[:3]), turned])


@pytest.mark.parametrize("part", ["position", "orientation", "pose"])
def test_a_hand_sees_the_other_one_as_finite_differences_say(baxter: UrdfKinematics, part: str) -> None:
    rng = np.random.default_rng(3)
    home = np.array([-0.08, -1.0, -1.19, 1.94, 0.67, 1.03, -0.5, 0.08, -1.0, 1.19, 1.94, -0.67, 1.03, 0.5])
    q = home + 0.2 * rng.normal(size=14)
    frame = TaskSpace((Task("right", part, relative_to="left"),))  # type: ignore[arg-type]
    frames = MovingFrames(baxter, {"between": frame}, threshold=1e-4)
    assert frames.objects == frozenset()  # a point of the robot is always there
    between = frames.at(q)["between"]
    rows = {"position": slice(0, 3), "orientation": slice(3, 6), "pose": slice(0, 6)}[part]
    np.testing.assert_allclose(between.project(q), seen(baxter, q)[rows], atol=1e-9)
    dq = 1e-6 * rng.normal(size=14)
    np.testing.assert_allclose(
        between.project(q + dq) - between.project(q), (seen(baxter, q + dq) - seen(baxter, q))[rows], atol=1e-10
    )


def test_hands_of_a_planar_robot_see_each_other_too() -> None:
    robot, q = planar_bimanual(), np.array([0.1, 1.2, -1.6, -1.2, 1.5])
    between = MovingFrames(robot, {"between": TaskSpace((Task("right", relative_to="left"),))}).at(q)["between"]
    moved = q + 1e-6 * np.array([1.0, -2.0, 0.5, 1.0, 2.0])
    places = []
    for configuration in (q, moved):
        robot.update(configuration)
        places.append(robot.place("right") - robot.place("left"))
    np.testing.assert_allclose([between.project(c) for c in (q, moved)], places, atol=1e-10)


def test_what_is_seen_counts_as_deviation_from_the_object() -> None:
    rng = np.random.default_rng(0)
    data = rng.normal([0.4, -0.2], [0.1, 0.3], size=(200, 2))
    model = TPGMM(1, reg_covar=1e-9).fit_projected({"a": data, "b": data})
    aim_at_origins(model, ["a"])
    np.testing.assert_allclose(model.means_["a"][0], 0.0)
    np.testing.assert_allclose(model.covariances_["a"][0], data.T @ data / len(data), atol=1e-8)
    np.testing.assert_allclose(model.means_["b"][0], data.mean(axis=0))
    timed = TPGMM(1, reg_covar=1e-9, manifold="R3").fit_projected({"a": np.column_stack([np.arange(200.0), data])})
    time_mean = timed.means_["a"][0, 0]
    aim_at_origins(timed, ["a"], over_time=True)
    seen = spread_at(timed, 20.0)
    assert timed.means_["a"][0, 0] == time_mean
    np.testing.assert_allclose(seen, data.T @ data / len(data), atol=1e-8)
    with pytest.raises(ValueError, match="no frames .'c'."):
        aim_at_origins(model, ["c"])


def spread_at(model: TPGMM, time: float) -> Array:
    now = GaussianMixture(model.priors_, model.means_["a"], model.covariances_["a"]).condition([0], [time])
    np.testing.assert_allclose(now.mean, 0.0, atol=1e-12)
    return np.asarray(now.covariance)


HOME = np.array([-0.08, -1.0, -1.19, 1.94, 0.67, 1.03, -0.5, 0.08, -1.0, 1.19, 1.94, -0.67, 1.03, 0.5])
TASKS = {
    "bar": Task("right", relative_to="left"),
    "left": Task("left", relative_to="left_target"),
    "right": Task("right", relative_to="right_target"),
}


def movement_of(baxter: UrdfKinematics, **settings: float) -> KinematicMovement:
    """Learned: hands keep their distance, the left one is at its target, the right one gives way."""
    candidates = hierarchy_frames(TASKS, {"left first": ["bar", "left", "right"]})
    candidates |= {
        "habit": NullSpace(tuple(TASKS.values())),
        "joints": JointSpace(),
        "previous": PreviousConfiguration(),
    }
    frames = MovingFrames(baxter, candidates)
    rng = np.random.default_rng(1)
    baxter.update(HOME)
    places = {name: baxter.place(name)[:3] for name in ("left", "right")}
    there = np.array([places["right"] - places["left"]]) @ quaternion.rotation_matrix(baxter.place("left")[3:])
    spreads = {
        "bar": 1e-3,
        "left below bar": 1e-3,
        "right below bar, left": 1e-2,
        "habit": 0.05,
        "joints": 1.0,
        "previous": 0.02,
    }
    centres = {"bar": there[0], "habit": HOME, "joints": HOME}
    views = {}
    for name, spread in spreads.items():
        n = 3 if name in ("bar", "left below bar", "right below bar, left") else 14
        views[name] = centres.get(name, np.zeros(n)) + spread * rng.normal(size=(400, n))
    model = TPGMM(1, reg_covar=1e-8).fit_projected(views)
    aim_at_origins(model, ["left below bar", "right below bar, left", "previous"])
    model.metadata_ = {"duration_s": 1.0}
    return KinematicMovement(model, frames, **settings)


def targets(baxter: UrdfKinematics, left: Array, right: Array) -> dict[str, Frame]:
    baxter.update(HOME)
    frames = {}
    for name, offset in (("left", left), ("right", right)):
        place = baxter.place(name)
        frames[f"{name}_target"] = Frame.from_pose(place[:3] + offset, place[3:]).with_time()
    return frames


def run(movement: KinematicMovement, q: Array, frames: dict[str, Frame], seconds: float) -> tuple[Array, list[Array]]:
    """A robot that is at once where the reference is, at 200 Hz; from where it starts."""
    movement.start(0, q)
    means = []
    for i in range(1, round(200 * seconds)):
        reference = movement.step(5 * i * MS, frames, q)
        means.append(reference.gaussian.mean)
        q = reference.gaussian.mean
    return q, means


def test_references_go_on_without_jumps_from_where_the_robot_is_and_priority_is_kept(baxter: UrdfKinematics) -> None:
    movement = movement_of(baxter, max_joint_speed=0.5)
    assert movement.frame_names == ("left_target", "right_target") and movement.manifold.dim == 14
    frames = targets(baxter, np.array([0.05, 0.0, 0.05]), np.array([0.05, -0.20, 0.05]))
    q, means = run(movement, HOME, frames, 3.0)
    assert np.abs(np.diff([HOME, *means], axis=0)).max() <= 0.5 * 0.005 + 1e-12
    baxter.update(q)
    errors = {
        name: float(np.linalg.norm(baxter.place(name)[:3] - frames[f"{name}_target"].b[1:4]))
        for name in ("left", "right")
    }
    assert errors["left"] < 0.2 * errors["right"] and errors["right"] > 0.1
    np.testing.assert_allclose(np.linalg.norm(seen(baxter, q)[:3]), np.linalg.norm(seen(baxter, HOME)[:3]), atol=3e-3)


def test_the_habit_of_the_elbows_comes_back_while_hands_hold(baxter: UrdfKinematics) -> None:
    movement = movement_of(baxter)
    frames = targets(baxter, np.zeros(3), np.zeros(3))
    task = MovingFrames(baxter, {"free": NullSpace(tuple(TASKS.values()))})
    pushed = HOME + 0.4 * task.at(HOME)["free"].A @ np.sign(HOME)
    q, _ = run(movement, pushed, frames, 3.0)
    elbows = [2, 9]  # e0 of both arms
    assert np.abs(q - HOME)[elbows].max() < 0.2 * np.abs(pushed - HOME)[elbows].max()


def test_a_reference_does_not_lag_behind_as_the_robot_does_and_waits_for_one_that_is_held(
    baxter: UrdfKinematics,
) -> None:
    movement = movement_of(baxter, leash=0.1)
    frames = targets(baxter, np.array([0.1, 0.0, 0.1]), np.array([0.1, 0.0, 0.1]))
    ideal, _ = run(movement, HOME, frames, 2.0)
    movement.start(0, HOME)
    slow, apart = HOME, []
    for i in range(1, 600):
        reference = movement.step(5 * i * MS, frames, slow).gaussian.mean
        if i >= 200:  # held for a second
            slow = slow + 0.03 * (reference - slow)
        apart.append(np.abs(reference - slow).max())
    # one step from where the leash ends
    assert 0.1 - 1e-9 <= max(apart) <= 0.1 + 0.005 * 1.0 + 1e-9
    np.testing.assert_allclose(reference, ideal, atol=2e-3)
    pushed = ideal + 0.3 * np.sign(HOME)
    movement.step(600 * 5 * MS, frames, pushed)
    followed = movement.step(601 * 5 * MS, frames, pushed).gaussian.mean
    assert np.abs(followed - pushed).max() <= 0.1 + 0.005 * 1.0 + 1e-9
    with pytest.raises(ValueError, match="leash"):
        movement_of(baxter, leash=0.0)


def test_a_target_that_is_not_seen_counts_for_nothing_and_a_robot_that_is_not_known_is_refused(
    baxter: UrdfKinematics,
) -> None:
    movement = movement_of(baxter)
    frames = targets(baxter, np.zeros(3), np.array([0.0, -0.2, 0.0]))
    movement.start(0)
    with pytest.raises(ValueError, match="joint states"):
        movement.step(0, frames)
    q, _ = run(movement, HOME, {"left_target": frames["left_target"]}, 1.0)
    np.testing.assert_allclose(q, HOME, atol=0.01)
    weightless = {"right_target": 0.0}
    movement.start(0, HOME)
    for i in range(1, 100):
        reference = movement.step(5 * i * MS, frames, HOME, weightless)
    np.testing.assert_allclose(reference.gaussian.mean, HOME, atol=0.01)
    assert reference.phase == pytest.approx(0.495) and reference.frames == ("left_target", "right_target")
    with pytest.raises(ValueError, match="max_joint_speed"):
        movement_of(baxter, max_joint_speed=0.0)
