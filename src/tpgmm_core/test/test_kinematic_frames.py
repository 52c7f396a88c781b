# SPDX-License-Identifier: Apache-2.0
"""Eqs. (7) to (12), one by one: against finite differences and the textbook step of inverse kinematics."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from robots import BAXTER
from tpgmm_core import Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.kinematics.chains import Kinematics, PlanarRobot, planar_arm, planar_bimanual
from tpgmm_core.kinematics.frames import (
    JointSpace,
    KinematicFrame,
    NullSpace,
    PreviousConfiguration,
    SecondaryTaskSpace,
    TaskSpace,
)
from tpgmm_core.kinematics.inverse import THRESHOLD, damped_pseudo_inverse, null_space
from tpgmm_core.kinematics.tasks import KinematicState, KinematicTask
from tpgmm_core.kinematics.urdf import UrdfKinematics
from tpgmm_core.robot.model import RobotModel

BASE_Q = np.array([0.1, -1.0, -0.5, 1.6, 0.4, 1.0, -0.3])
CUP = Frame.from_pose([0.7, 0.3, 0.2], quaternion.exp([0.4, 0.9, -0.2]))
DISC = Frame(np.array([[0.8, -0.9], [0.5, 0.6]]), np.array([1.2, 1.4]))  # turned, sheared and scaled


@cache
def baxter() -> RobotModel:
    return RobotModel.from_file(BAXTER)


def left_arm() -> UrdfKinematics:
    return UrdfKinematics(baxter(), "left_arm", ["left", "left_lower_elbow"])


def both_arms() -> UrdfKinematics:
    joints = [*baxter().joint_groups["left_arm"], *baxter().joint_groups["right_arm"]]
    return UrdfKinematics(baxter(), joints)


ROBOTS: dict[str, tuple[Callable[[], Kinematics], Array]] = {
    "planar": (lambda: planar_arm([1.0, 0.8, 0.6, 0.4]), np.array([0.3, 0.7, -0.9, 0.5])),
    "bimanual": (planar_bimanual, np.array([0.1, 0.9, 0.7, -0.8, -0.6])),
    "baxter": (left_arm, BASE_Q),
}


def differences(f: Callable[[Array], Array], q: Array, step: float = 1e-6) -> Array:
    """Central differences (m, n)."""
    return np.stack([(f(q + e) - f(q - e)) / (2.0 * step) for e in step * np.eye(len(q))], axis=1)


@pytest.mark.parametrize("name", ROBOTS)
def test_jacobians_are_the_derivatives_of_places(name: str) -> None:
    robot, q = ROBOTS[name][0](), ROBOTS[name][1]
    for point in robot.points:

        def position(q: Array, point: str = point) -> Array:
            robot.update(q)
            return robot.place(point)[:3].copy()

        expected = differences(position, q)
        robot.update(q)
        J = robot.jacobian(point)
        np.testing.assert_allclose(J[: len(expected)], expected, atol=1e-8)
        if len(J) == 6:
            here = robot.place(point)[3:].copy()

            def turn(q: Array, point: str = point, here: Array = here) -> Array:
                robot.update(q)
                return quaternion.log(quaternion.multiply(robot.place(point)[3:], quaternion.conjugate(here)))

            expected = differences(turn, q)
            robot.update(q)
            np.testing.assert_allclose(robot.jacobian(point)[3:], expected, atol=1e-8)


def seen(robot: Kinematics, q: Array, task: KinematicTask, target: Frame | None) -> Array:
    """What Eqs. (8), (9) mean by x: the place of the point, from the world or from the object."""
    robot.update(q)
    place = robot.place(task.point)
    if len(place) < 7:
        return place if target is None else np.linalg.solve(target.A, place - target.b)
    if target is None:
        target = Frame.from_pose(np.zeros(3), [0.0, 0.0, 0.0, 1.0])
    R = target.A[:3, :3]
    both = np.r_[
        R.T @ (place[:3] - target.b[:3]),
        R.T @ quaternion.log(quaternion.multiply(place[3:], quaternion.conjugate(target.A[3:, 6]))),
    ]
    return {"position": both[:3], "orientation": both[3:], "pose": both}[task.part]


CASES = [
    ("planar", KinematicTask("hand"), None),
    ("planar", KinematicTask("hand", relative_to="disc"), DISC),
    ("bimanual", KinematicTask("left", relative_to="disc"), DISC),
    ("baxter", KinematicTask("left"), None),
    ("baxter", KinematicTask("left", "position", "cup"), CUP),
    ("baxter", KinematicTask("left", "orientation", "cup"), CUP),
    ("baxter", KinematicTask("left", "pose", "cup"), CUP),
    ("baxter", KinematicTask("left", "orientation"), None),
    ("baxter", KinematicTask("left", "pose"), None),
]


@pytest.mark.parametrize(("name", "task", "target"), CASES)
def test_equations_8_and_9_are_the_inverse_kinematics_of_what_is_seen(
    name: str, task: KinematicTask, target: Frame | None
) -> None:
    robot, q = ROBOTS[name][0](), ROBOTS[name][1]
    frame = TaskSpace((task,)).at(KinematicState(robot, q, {"disc": DISC, "cup": CUP}, threshold=1e-3))
    x = seen(robot, q, task, target)
    # the step before is seen where it is
    np.testing.assert_allclose(frame.project(q), x, atol=1e-9)
    # a configuration nearby is seen where it is, to first order: the derivative of x is the frame's inverse
    expected = differences(lambda q: seen(robot, q, task, target), q)
    assert frame.inverse is not None
    np.testing.assert_allclose(frame.inverse, expected, atol=1e-7)
    # to be at mu is the textbook step: least joint motion that takes x to mu
    mu = x + 1e-3 * np.arange(1, len(x) + 1)
    step = np.linalg.lstsq(expected, mu - x, rcond=None)[0]
    np.testing.assert_allclose(frame.A @ mu + frame.b, q + step, atol=1e-9)
    np.testing.assert_allclose(frame.inverse, np.linalg.pinv(frame.A), atol=1e-7)


def test_equation_7_is_the_configuration() -> None:
    robot, q = planar_bimanual(), np.arange(5.0)
    frame = JointSpace().at(KinematicState(robot, q))
    np.testing.assert_array_equal(frame.A, np.eye(5))
    np.testing.assert_array_equal(frame.b, np.zeros(5))
    np.testing.assert_allclose(PreviousConfiguration().at(KinematicState(robot, q)).project(q + 0.1), 0.1, atol=1e-15)


@pytest.mark.parametrize("name", ROBOTS)
def test_equation_10_moves_nothing_that_is_above(name: str) -> None:
    robot, q = ROBOTS[name][0](), ROBOTS[name][1]
    task = KinematicTask("left" if name != "planar" else "hand")
    frame = NullSpace((task,)).at(KinematicState(robot, q))
    robot.update(q)
    J = robot.jacobian(task.point)[: 2 if name != "baxter" else 3]
    np.testing.assert_allclose(J @ frame.A, 0.0, atol=1e-12)
    np.testing.assert_allclose(frame.A, np.eye(len(q)) - np.linalg.pinv(J) @ J, atol=1e-12)
    np.testing.assert_allclose(frame.b, np.linalg.pinv(J) @ J @ q, atol=1e-12)
    # textbook: qdot = J^+ 0 + N qdot_0, toward a posture
    posture = q + np.linspace(-0.5, 0.5, len(q))
    np.testing.assert_allclose(frame.A @ posture + frame.b, q + frame.A @ (posture - q), atol=1e-12)
    assert frame.inverse is not None
    np.testing.assert_allclose(frame.inverse, np.linalg.pinv(frame.A, rcond=1e-9), atol=1e-9)


@pytest.mark.parametrize("least_error", [False, True])
@pytest.mark.parametrize(
    ("name", "above", "below"),
    [
        ("planar", KinematicTask("joint1"), KinematicTask("hand")),
        ("bimanual", KinematicTask("left"), KinematicTask("right", relative_to="disc")),
        ("baxter", KinematicTask("left"), KinematicTask("left", "orientation", "cup")),
        ("baxter", KinematicTask("left", "orientation"), KinematicTask("left")),
    ],
)
def test_equations_11_and_12_move_below_what_is_above(
    name: str, above: KinematicTask, below: KinematicTask, least_error: bool
) -> None:
    robot, q = ROBOTS[name][0](), ROBOTS[name][1]
    moment = KinematicState(robot, q, {"disc": DISC, "cup": CUP}, threshold=1e-3)
    frame = SecondaryTaskSpace((below,), (above,), least_error).at(moment)
    J_above, J, A_object = moment.view((above,)).J, moment.view((below,)).J, moment.view((below,)).A
    N = np.eye(len(q)) - np.linalg.pinv(J_above) @ J_above
    operator = np.linalg.pinv(J @ N, rcond=1e-9) if least_error else N @ np.linalg.pinv(J)
    np.testing.assert_allclose(frame.A, operator @ A_object, atol=1e-8)
    np.testing.assert_allclose(J_above @ frame.A, 0.0, atol=1e-8)
    assert frame.inverse is not None
    np.testing.assert_allclose(frame.inverse, np.linalg.pinv(frame.A, rcond=1e-9), atol=1e-5)
    # textbook: qdot = J_1^+ xdot_1 + N Jtilde^+ xdot_2; the frame sees the xdot_2 that was asked for
    rng = np.random.default_rng(0)
    asked, other = 1e-3 * rng.normal(size=len(J)), 1e-3 * rng.normal(size=len(J_above))
    moved = q + np.linalg.pinv(J_above) @ other + operator @ A_object @ asked
    reachable = frame.inverse @ frame.A  # I, unless the tasks have directions in common
    np.testing.assert_allclose(frame.project(moved) - frame.project(q), reachable @ asked, atol=1e-8)
    np.testing.assert_allclose(
        frame.A @ frame.project(moved) + frame.b,
        q
        + operator @ A_object @ asked
        + frame.A @ (frame.project(q) - np.linalg.solve(A_object, -moment.view((below,)).offset)),
        atol=1e-8,
    )


def test_lower_levels_leave_all_levels_above_alone() -> None:
    robot = both_arms()
    q = np.r_[BASE_Q, -BASE_Q[0], BASE_Q[1], -BASE_Q[2], BASE_Q[3], -BASE_Q[4], BASE_Q[5], -BASE_Q[6]]
    first, second, third = KinematicTask("left"), KinematicTask("left", "orientation"), KinematicTask("right", "pose")
    moment = KinematicState(robot, q)
    fourth = SecondaryTaskSpace((KinematicTask("right"),), (first, second)).at(moment)
    lowest = NullSpace((first, second, third)).at(moment)
    for task in (first, second):
        np.testing.assert_allclose(moment.view((task,)).J @ fourth.A, 0.0, atol=1e-11)
        np.testing.assert_allclose(moment.view((task,)).J @ lowest.A, 0.0, atol=1e-11)
    np.testing.assert_allclose(moment.view((third,)).J @ lowest.A, 0.0, atol=1e-11)
    assert np.trace(lowest.A) == pytest.approx(14 - 12)  # one turn of each elbow is left


@pytest.mark.parametrize("m", [2, 4, 7])
def test_damping_is_the_stated_law(m: int) -> None:
    """Redundant, square and over-constrained; with singular values above and below the threshold, and zero."""
    rng = np.random.default_rng(m)
    U, V = np.linalg.qr(rng.normal(size=(m, m)))[0], np.linalg.qr(rng.normal(size=(4, 4)))[0]
    k = min(m, 4)
    s = np.array([2.0, 0.5 * THRESHOLD, 0.0, 0.3])[:k]
    J = (U[:, :k] * s) @ V[:, :k].T
    expected = (V[:, :k] * (s / np.maximum(s, THRESHOLD) ** 2)) @ U[:, :k].T
    np.testing.assert_allclose(damped_pseudo_inverse(J, THRESHOLD), expected, atol=1e-9)
    np.testing.assert_allclose(null_space(J, THRESHOLD), np.eye(4) - expected @ J, atol=1e-9)


CANDIDATES: dict[str, KinematicFrame] = {
    "8": TaskSpace((KinematicTask("left"),)),
    "9": TaskSpace((KinematicTask("left", relative_to="disc"), KinematicTask("right", relative_to="disc"))),
    "10": NullSpace((KinematicTask("left"),)),
    "11": SecondaryTaskSpace((KinematicTask("right"),), (KinematicTask("left"),)),
    "12": SecondaryTaskSpace((KinematicTask("right", relative_to="disc"),), (KinematicTask("left"),), least_error=True),
}


def path_through_singularities() -> tuple[PlanarRobot, Array]:
    """Both elbows pass through straight, one exactly together with the other, and the torso through the left arm."""
    robot = planar_bimanual()
    u = np.linspace(-1.0, 1.0, 4001)[:, None]
    return robot, u * np.array([0.0, 0.3, 1.0, -0.2, -1.0]) + np.array([0.2, 0.0, 0.0, -0.4, 0.0])


@pytest.mark.parametrize("name", CANDIDATES)
def test_frames_are_finite_and_continuous_through_singularities(name: str) -> None:
    robot, path = path_through_singularities()
    frames = [CANDIDATES[name].at(KinematicState(robot, q, {"disc": DISC})) for q in path]
    precision = np.diag(np.arange(1.0, frames[0].A.shape[1] + 1.0))
    for values in (
        [f.A for f in frames],
        [f.b for f in frames],
        [f.inverse for f in frames if f.inverse is not None],
        [f.inverse.T @ precision @ f.inverse for f in frames if f.inverse is not None],
    ):
        values_ = np.stack(values)
        assert np.all(np.isfinite(values_)) and np.abs(values_).max() < 10.0 / THRESHOLD**2
        # a step half as long makes a change about half as large: no jump hides between two samples
        coarse, fine = (np.abs(np.diff(values_[::k], axis=0)).max() for k in (2, 1))
        assert fine < 0.75 * coarse


def test_a_frame_says_nothing_of_what_the_robot_cannot_do() -> None:
    """A straight arm, pulled along itself: no step, no deviation, no precision; across itself as ever."""
    robot, q = planar_arm([1.0, 1.0]), np.zeros(2)
    outside = Frame(np.eye(2), np.array([3.0, 0.0]))
    frame = TaskSpace((KinematicTask("hand", relative_to="ball"),)).at(KinematicState(robot, q, {"ball": outside}))
    np.testing.assert_allclose(frame.A @ np.zeros(2) + frame.b, q, atol=1e-12)
    np.testing.assert_allclose(frame.project(q), 0.0, atol=1e-12)
    assert frame.inverse is not None
    np.testing.assert_allclose(frame.inverse[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(frame.inverse[1], [2.0, 1.0], atol=1e-12)


def test_bad_tasks_are_refused_with_the_reason() -> None:
    robot = planar_bimanual()
    with pytest.raises(ValueError, match="unknown point 'nose'"):
        TaskSpace((KinematicTask("nose"),)).at(KinematicState(robot, np.zeros(5)))
    with pytest.raises(ValueError, match="object 'disc' is not known"):
        TaskSpace((KinematicTask("left", relative_to="disc"),)).at(KinematicState(robot, np.zeros(5)))
    with pytest.raises(ValueError, match="has a position only"):
        TaskSpace((KinematicTask("left", "pose"),)).at(KinematicState(robot, np.zeros(5)))
    with pytest.raises(ValueError, match="got A of shape"):
        TaskSpace((KinematicTask("left", relative_to="cup"),)).at(KinematicState(robot, np.zeros(5), {"cup": CUP}))
    with pytest.raises(ValueError, match="at least one KinematicTask"):
        TaskSpace(())
    with pytest.raises(ValueError, match="the part of a task"):
        KinematicTask("left", "smell")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="positive length"):
        planar_arm([1.0, -1.0])
    with pytest.raises(ValueError, match="joints 0 to 1"):
        PlanarRobot([1.0, 1.0], {"hand": (0, 2)})
    with pytest.raises(ValueError, match="there are 7 joints"):
        left_arm().update(np.zeros(3))
