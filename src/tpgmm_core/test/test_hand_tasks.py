# SPDX-License-Identifier: Apache-2.0
"""Tasks of hands in joint space: the map from joints to what a body sees of a hand, the product, and what it moves."""

from __future__ import annotations

import numpy as np
import pytest

from robots import BAXTER
from tpgmm_core import TPGMM, Frame
from tpgmm_core.control.controller import Controller
from tpgmm_core.control.joint_impedance import JointImpedanceLaw
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.hand_tasks import ActiveTasks, HandTask, HandTasks, deviation
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

ARMS = ("left_arm", "right_arm")
WORLD = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_file(BAXTER)


def taught(robot: RobotModel, held: tuple[int, ...], observer: str, seed: int = 0) -> HandTask:
    """A task of one hand about the robot's home: held in some directions of what an observer sees, free in others."""
    rng = np.random.default_rng(seed)
    data = robot.create_data()
    data.update(robot.home)
    hand, other = ("left", "right") if observer == "world" else ("right", "left")
    body = WORLD if observer == "world" else data.pose(other)
    frame = Frame.from_pose(body[:3], body[3:])
    spread = np.array([0.06, 0.06, 0.06, 0.2, 0.2, 0.2])
    spread[list(held)] = 0.002
    steps = rng.standard_normal((300, 6)) * spread
    steps -= steps.mean(axis=0)  # the mean is the home, to a second order of the turns
    mean = frame.project(data.pose(hand))
    seen = np.stack([POSE.exp(mean, step) for step in steps])
    model = TPGMM(n_components=1, manifold=str(POSE), init="kmeans", reg_covar=1e-6).fit_projected({observer: seen})
    return HandTask(model, hand, {observer: WORLD if observer == "world" else other})


def test_the_jacobian_of_what_a_hand_sees_of_the_other_is_that_of_finite_differences(robot: RobotModel) -> None:
    rng = np.random.default_rng(1)
    data, joints = robot.create_data(), np.concatenate([robot.indices(group) for group in ARMS])
    q = robot.home.copy()
    q[joints] += 0.2 * rng.standard_normal(14)
    mean = np.concatenate([[0.1, 0.2, 0.3], quaternion.exp(np.array([0.5, -0.4, 1.0]))])

    def at(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data.update(q)
        error, J = np.empty(6), np.empty((6, 14))
        maps = [np.ascontiguousarray(data.jacobian(hand)[:, joints]) for hand in ("right", "left")]
        deviation(data.pose("right"), maps[0], data.pose("left"), maps[1], mean, error, J)
        return error, J

    _, J = at(q)
    for k, joint in enumerate(joints):
        step = np.zeros(robot.nv)
        step[joint] = 1e-6
        slope = (at(q + step)[0] - at(q - step)[0]) / 2e-6
        np.testing.assert_allclose(-J[:, k], slope, atol=1e-8)


def test_a_hand_seen_from_its_own_mean_asks_for_no_motion_and_from_elsewhere_for_the_way_there(
    robot: RobotModel,
) -> None:
    tasks = HandTasks(robot, {"level": taught(robot, (3, 4), "world")}, ARMS)
    joints = tasks.joints
    assert tasks.joint_names[0] == robot.joint_names[joints[0]]
    q = robot.home.copy()
    np.testing.assert_allclose(tasks.at(q, q).mean, q[joints], atol=0.02)
    q[joints[:7]] += 0.1
    data = robot.create_data()
    for _ in range(20):  # Gauss-Newton in as many steps as there are
        q[joints] = tasks.at(q, q).mean
    data.update(q)
    there = POSE.log(tasks._views[0].mean, data.pose("left"))
    np.testing.assert_allclose(there, 0.0, atol=1e-4)


def test_a_product_of_tasks_is_as_precise_as_the_sum_and_weights_scale_it(robot: RobotModel) -> None:
    hands = {"level": taught(robot, (3, 4), "world"), "above": taught(robot, (0, 1, 2), "left")}
    both = HandTasks(robot, hands, ARMS)
    q = robot.home
    prior = np.eye(14)
    alone = [both.at(q, q, {"level": a, "above": b}).precision - prior for a, b in ((1.0, 0.0), (0.0, 1.0))]
    np.testing.assert_allclose(both.at(q, q).precision - prior, sum(alone), rtol=1e-6, atol=1e-3)
    half = both.at(q, q, {"level": 0.5, "above": 0.0}).precision - prior
    np.testing.assert_allclose(half, 0.5 * alone[0], rtol=1e-6, atol=1e-3)
    nobody = both.at(q, q + 0.1, {"level": 0.0, "above": 0.0})
    np.testing.assert_allclose(nobody.mean, q[both.joints] + 0.1)  # the rest posture alone
    np.testing.assert_allclose(nobody.covariance, np.eye(14), atol=1e-9)


def test_tasks_take_hold_and_let_go_gradually_about_the_posture_in_which_the_first_one_began(robot: RobotModel) -> None:
    hands = {"level": taught(robot, (3, 4), "world"), "above": taught(robot, (0, 1, 2), "left")}
    active = ActiveTasks(HandTasks(robot, hands, ARMS), blend_time=0.1)
    q = robot.home
    free = active.step(q, 0.01)
    np.testing.assert_array_equal(free.mean, q[active.tasks.joints])  # it stays where it is, wherever that is
    assert free.precision.max() < 1e-3
    with pytest.raises(ValueError, match="no tasks .'tea'.; there are .'level', 'above'."):
        active.choose(["tea"])
    active.choose(["level"])
    precisions = [active.step(q, 0.01).precision for _ in range(11)]
    traces = np.array([np.trace(precision) for precision in precisions])
    assert active.holding == ("level",)
    assert np.all(np.diff(traces[:10]) > 0.0) and traces[10] == pytest.approx(traces[9])
    assert traces[0] < 0.1 * traces[10]
    active.choose([])
    last = [active.step(q, 0.01) for _ in range(11)][-1]
    assert active.holding == () and last.precision.max() < 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"places": {}}, "the poses of the frames .* are not known"),
        ({"places": {"world": "left"}}, "cannot be the frame of its own task"),
    ],
)
def test_a_task_that_cannot_be_is_refused_with_the_reason(
    robot: RobotModel, change: dict[str, dict[str, str]], message: str
) -> None:
    task = taught(robot, (3, 4), "world")
    with pytest.raises(ValueError, match=message):
        HandTask(task.model, task.endpoint, **change)


def test_a_pushed_hand_gives_way_where_the_task_leaves_freedom_and_stays_level(robot: RobotModel) -> None:
    tasks = HandTasks(robot, {"level": taught(robot, (3, 4), "world")}, ARMS)
    law = JointImpedanceLaw(robot, ARMS)
    controller, simulator = Controller(robot, law), RobotSimulator(robot, time_step=0.002)
    data, frame, force = robot.create_data(), robot.endpoints["left"].frame, np.zeros(6)
    ways, tilts = [], []
    data.update(robot.home)
    begin = data.pose("left")
    for step in range(900):
        state = simulator.state
        reference = Reference(0.0, tasks.at(state.q, robot.home), 0.0, (), np.ones(1), (), tasks.joint_names)
        command = controller.step(state.q, state.v, law.target(reference, True), 0.002)
        assert command is not None and np.all(np.abs(command.tau) <= robot.effort_limits)
        force[1] = 15.0 * min(1.0, max(0.0, step - 300) / 300)
        simulator.step(command.tau, {frame: force})
        data.update(simulator.state.q)
        way = POSE.log(begin, data.pose("left"))
        ways.append(np.linalg.norm(way[:3]))
        tilts.append(np.degrees(np.linalg.norm(way[3:5])))
    assert ways[-1] > 0.03
    assert max(tilts[300:]) < 2.0


def test_movements_of_both_hands_and_a_task_are_one_product_in_joint_space(robot: RobotModel) -> None:
    """Each hand is where its movement wants it; a task that holds the left one's height too moves it half way."""
    tasks = HandTasks(robot, {}, ARMS, led=("left", "right"))
    data, q, wanted = robot.create_data(), robot.home.copy(), {}
    data.update(q)
    for hand, way in (("left", [0.03, -0.05, 0.04, 0.0, 0.1, 0.0]), ("right", [0.0, 0.05, -0.03, 0.1, 0.0, 0.1])):
        wanted[hand] = Gaussian(POSE.exp(data.pose(hand), way), np.diag([1e-6] * 3 + [1e-5] * 3), POSE)
    for _ in range(6):  # Gauss-Newton
        q[tasks.joints] = tasks.at(q, robot.home, references=wanted).mean
        data.update(q)
    for hand, gaussian in wanted.items():
        np.testing.assert_allclose(POSE.log(gaussian.mean, data.pose(hand)), 0.0, atol=1e-3)
    alone = tasks.at(q, robot.home, references={"left": wanted["left"]})
    right = robot.indices("right_arm")
    np.testing.assert_allclose(alone.covariance[7:, 7:], np.eye(len(right)), atol=1e-9)

    lower = wanted["left"].mean - np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    model = TPGMM(n_components=1, manifold=str(POSE), init="kmeans", reg_covar=1e-6)
    steps = np.random.default_rng(0).normal(size=(400, 6)) * [1.0, 1.0, 1e-9, 1.0, 1.0, 1.0]
    model.fit_projected({"world": np.stack([POSE.exp(lower, 0.1 * (step - steps.mean(axis=0))) for step in steps])})
    both = HandTasks(robot, {"low": HandTask(model, "left", {"world": WORLD})}, ARMS, led=("left",))
    for _ in range(6):
        q[both.joints] = both.at(q, robot.home, references={"left": wanted["left"]}).mean
        data.update(q)
    # the task's spread of the height is that of `reg_covar`, 1e-6, as that of the movement
    assert data.pose("left")[2] == pytest.approx(wanted["left"].mean[2] - 0.01, abs=2e-3)


def test_a_movement_fades_in_and_out_and_an_unknown_end_point_is_refused(robot: RobotModel) -> None:
    data = robot.create_data()
    data.update(robot.home)
    wanted = {"left": Gaussian(POSE.exp(data.pose("left"), [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]), 1e-4 * np.eye(6), POSE)}
    active = ActiveTasks(HandTasks(robot, {}, ARMS, led=("left",)), blend_time=0.1)
    course = [active.step(robot.home, 0.01, wanted if i < 20 else None) for i in range(40)]
    held = np.array([np.linalg.eigvalsh(gaussian.precision)[-1] for gaussian in course])
    assert held[0] < 0.05 * held[15] and (np.diff(held[:10]) > 0.0).all() and (np.diff(held[20:29]) < 0.0).all()
    assert held[35] < 1e-3, "nothing is left of it"
    assert np.abs(np.diff(held)).max() < 0.2 * held[15]
    with pytest.raises(ValueError, match=r"no end points \['middle'\]"):
        HandTasks(robot, {}, ARMS, led=("middle",))


def test_a_hand_whose_movement_is_lost_stays_where_it_is_while_the_other_one_goes_on(robot: RobotModel) -> None:
    data, q = robot.create_data(), robot.home.copy()
    data.update(q)
    wanted = {
        hand: Gaussian(POSE.exp(data.pose(hand), [0.04, 0.0, 0.04, 0.0, 0.0, 0.0]), 1e-5 * np.eye(6), POSE)
        for hand in ("left", "right")
    }
    active = ActiveTasks(HandTasks(robot, {}, ARMS, led=("left", "right")), blend_time=0.05)
    for i in range(80):
        q[active.tasks.joints] = active.step(q, 0.01, wanted if i < 40 else {"right": wanted["right"]}).mean
        data.update(q)
    for hand, gaussian in wanted.items():
        np.testing.assert_allclose(POSE.log(gaussian.mean, data.pose(hand)), 0.0, atol=2e-3)
