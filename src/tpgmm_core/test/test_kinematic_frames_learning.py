# SPDX-License-Identifier: Apache-2.0
"""Kinematic frames over demonstrations, hierarchies as data, and their product at each step."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from tpgmm_core import TPGMM, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.kinematics.chains import planar_arm, planar_bimanual
from tpgmm_core.kinematics.frames import JointSpace, NullSpace, PreviousConfiguration, SecondaryTaskSpace, TaskSpace
from tpgmm_core.kinematics.hierarchy import hierarchy_frames, level_names
from tpgmm_core.kinematics.moving import STEP, ConfigurationProduct, MovingFrames
from tpgmm_core.kinematics.relevance import directions_determined
from tpgmm_core.kinematics.tasks import KinematicTask

TASKS = {hand: KinematicTask(hand, relative_to=f"{hand} object") for hand in ("left", "right")}
HIERARCHIES: dict[str, Any] = {
    "left before right": ["left", "right"],
    "right before left": ["right", "left"],
    "together": [["left", "right"]],
}
START = np.array([0.0, 1.2, -1.6, -1.2, 1.6])


def bimanual() -> MovingFrames:
    candidates = {**hierarchy_frames(TASKS, HIERARCHIES), "previous": PreviousConfiguration()}
    return MovingFrames(planar_bimanual(), candidates, threshold=0.1)


def objects_at(left: Array, right: Array) -> dict[str, Frame]:
    return {"left object": Frame(np.eye(2), left), "right object": Frame(np.eye(2), right)}


def test_hierarchies_are_data_and_share_levels() -> None:
    tasks = {**TASKS, "elbow": KinematicTask("left")}
    frames = hierarchy_frames(tasks, {**HIERARCHIES, "three levels": ["left", "right", "elbow"]})
    assert list(frames) == [
        "left",
        "right below left",
        "right",
        "left below right",
        "left + right",
        "elbow below left, right",
    ]
    assert frames["left + right"] == TaskSpace((TASKS["left"], TASKS["right"]))
    third = frames["elbow below left, right"]
    assert third == SecondaryTaskSpace((tasks["elbow"],), (TASKS["left"], TASKS["right"]), least_error=True)
    assert level_names([["left", "right"], "elbow"]) == ["left + right", "elbow below left, right"]
    for wrong in ([], [[]], ["left", "left"], ["nose"]):
        with pytest.raises(ValueError, match="hierarchy 'wrong'"):
            hierarchy_frames(tasks, {"wrong": wrong})


def test_frames_without_their_objects_are_left_out() -> None:
    frames = bimanual()
    only_left = {"left object": Frame(np.eye(2), [-1.0, 2.0])}
    # a null space does not depend on where objects are
    assert set(frames.at(START, only_left)) == {"left", "left below right", "previous"}
    with pytest.raises(ValueError, match="frames need the objects"):
        frames.demonstration([0.0], START[None], only_left)
    with pytest.raises(ValueError, match="none of the objects"):
        MovingFrames(planar_bimanual(), {"left": TaskSpace((TASKS["left"],))}).at(START)
    with pytest.raises(ValueError, match="shape .5,. and is finite"):
        frames.at(np.full(5, np.nan), only_left)
    with pytest.raises(ValueError, match="threshold"):
        MovingFrames(planar_bimanual(), {"joints": JointSpace()}, threshold=0.0)
    with pytest.raises(ValueError, match="at least one candidate"):
        MovingFrames(planar_bimanual(), {})


@pytest.mark.parametrize("with_time", [False, True])
def test_demonstrations_are_seen_about_the_step_before(with_time: bool) -> None:
    """Also from objects that move: away from singularities each hand is seen where it is, to second order."""
    frames, robot = bimanual(), planar_bimanual()
    times = np.linspace(0.0, 1.0, 60)
    q = START + 0.3 * np.sin(np.outer(times, [2.0, 3.0, 1.0, -2.0, 3.0]))
    path = np.column_stack([-1.0 - times, 2.0 + 0.0 * times])
    objects = objects_at(path, path * [-1.0, 1.0])
    demonstration = frames.demonstration(times, q, objects, with_time=with_time)
    views = demonstration.projected()
    assert demonstration.data.shape == (60, 5 + with_time)
    for t in range(60):
        robot.update(q[t])
        step = np.abs(q[t] - q[max(t - 1, 0)]).max()
        x = views["left"][t, with_time:]
        np.testing.assert_allclose(x, robot.place("left") - path[t], atol=5.0 * step**2 + 1e-12)
    as_in_a_step = np.diff(q, axis=0) * (STEP / times[1])
    np.testing.assert_allclose(views["previous"][1:, with_time:], as_in_a_step, atol=1e-12)
    with pytest.raises(ValueError, match="increasing times"):
        frames.demonstration(times[::-1], q, objects, with_time=with_time)


def test_how_fast_a_product_goes_depends_on_no_rate() -> None:
    """Neither that of its own steps, nor that at which speeds were seen."""
    frames, robot, times = bimanual(), planar_bimanual(), np.linspace(0.0, 2.0, 801)
    robot.update(START)
    place = robot.place("left")
    target = objects_at(place + [0.1, -0.1], robot.place("right"))
    q = START + 0.3 * np.sin(np.outer(times, [2.0, 3.0, 4.0, 5.0, 6.0]))
    ends, covariances = [], []
    for every, dt in ((1, 0.002), (4, 0.002), (4, 0.01), (4, 0.001)):
        seen = frames.demonstration(times[::every], q[::every], target).projected()["previous"]
        model = model_of(
            {"left": (np.zeros(2), 0.3**2 * np.eye(2)), "previous": (np.zeros(5), seen.T @ seen / len(seen))}
        )
        product, now = ConfigurationProduct(model, frames), START
        first = product.step(now, target, dt=dt)
        for _ in range(round(0.1 / dt)):
            now = product.step(now, target, dt=dt).mean
        ends.append(now - START)
        covariances.append(first.covariance)
    robot.update(START + ends[0])
    done = np.linalg.norm(robot.place("left") - place) / np.linalg.norm([0.1, -0.1])
    assert 0.2 < done < 0.8  # on its way there
    for end, covariance in zip(ends[1:], covariances[1:], strict=True):
        np.testing.assert_allclose(end, ends[0], atol=0.05 * np.abs(ends[0]).max())
        np.testing.assert_allclose(covariance, covariances[0], atol=0.05 * np.abs(covariances[0]).max())


def test_a_damping_that_is_trusted_by_half_is_that_of_a_step_twice_as_long() -> None:
    frames, robot = bimanual(), planar_bimanual()
    robot.update(START)
    target = objects_at(robot.place("left") + [0.1, -0.1], robot.place("right"))
    model = model_of({"left": (np.zeros(2), 0.03**2 * np.eye(2)), "previous": (np.zeros(5), 0.01**2 * np.eye(5))})
    product = ConfigurationProduct(model, frames)
    halved = product.step(START, target, dt=0.01, weights={"previous": 0.5}).mean
    np.testing.assert_allclose(halved, product.step(START, target, dt=0.02).mean, rtol=1e-12)
    assert np.abs(halved - product.step(START, target, dt=0.01).mean).max() > 1e-3


def model_of(frames: dict[str, tuple[Array, Array]]) -> TPGMM:
    """One component, from name → mean and covariance."""
    model = TPGMM(1).fit_projected({name: np.vstack([mean, mean + 1.0]) for name, (mean, _) in frames.items()})
    model.means_ = {name: mean[None] for name, (mean, _) in frames.items()}
    model.covariances_ = {name: covariance[None] for name, (_, covariance) in frames.items()}
    return model


def test_the_product_is_the_weighted_least_squares_step() -> None:
    """Two contradictory tasks, beside a damping: Eq. (6) is the step that minimises the sum of their squares."""
    frames = bimanual()
    target = objects_at(np.array([-0.4, 2.1]), np.array([0.7, 2.4]))
    sure, vague, damping = 0.01, 0.2, 0.05
    model = model_of(
        {
            "left": (np.zeros(2), sure**2 * np.eye(2)),
            "right": (np.zeros(2), vague**2 * np.eye(2)),
            "previous": (np.zeros(5), damping**2 * np.eye(5)),
        }
    )
    found = ConfigurationProduct(model, frames).step(START, target).mean
    robot = planar_bimanual()
    robot.update(START)
    rows = np.concatenate([robot.jacobian("left") / sure, robot.jacobian("right") / vague, np.eye(5) / damping])
    e_left = (target["left object"].b - robot.place("left")) / sure
    e_right = (target["right object"].b - robot.place("right")) / vague
    expected = START + np.linalg.lstsq(rows, np.concatenate([e_left, e_right, np.zeros(5)]), rcond=None)[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_what_no_frame_constrains_stays() -> None:
    """A redundant arm: the hand goes where it is to be, by the least motion; nothing moves in the null space."""
    robot, q = planar_arm([1.0, 0.8, 0.6, 0.4]), np.array([0.3, 0.7, -0.9, 0.5])
    task = KinematicTask("hand", relative_to="ball")
    frames = MovingFrames(robot, {"hand": TaskSpace((task,)), "free": NullSpace((task,))})
    model = model_of({"hand": (np.zeros(2), 1e-4 * np.eye(2))})
    robot.update(q)
    place, J = robot.place("hand"), robot.jacobian("hand")
    ahead = ConfigurationProduct(model, frames).step(q, {"ball": Frame(np.eye(2), place + [0.02, -0.01])}).mean
    np.testing.assert_allclose(ahead - q, np.linalg.pinv(J) @ [0.02, -0.01], atol=1e-6)
    counted = directions_determined(model, {"hand": frames.at(q, {"ball": Frame(np.eye(2), place)})["hand"]})
    assert counted["hand"] == pytest.approx(2.0)


@cache
def shown(order: tuple[str, str]) -> TPGMM:
    """Three demonstrations of an ideal pair of hands, of which `order` says who gives way, as learned."""
    frames, rng = bimanual(), np.random.default_rng(0)
    demonstrations = []
    for _ in range(3):
        paths = object_paths(rng)
        q, configurations = START, []
        for t in range(80):
            for _ in range(20):
                q = q + by_hand(q, order, {name: path[t] for name, path in paths.items()})
            configurations.append(q + 0.003 * rng.normal(size=5))
        objects = objects_at(paths["left"], paths["right"])
        demonstrations.append(frames.demonstration(np.linspace(0.0, 4.0, 80), configurations, objects))
    return TPGMM(1, reg_covar=1e-6).fit(demonstrations)


def object_paths(rng: np.random.Generator) -> dict[str, Array]:
    """Out of reach for both at once in the middle."""
    robot, u = planar_bimanual(), np.linspace(0.0, 1.0, 80)[:, None]
    robot.update(START)
    far = {"left": rng.uniform([-2.7, 0.4], [-2.4, 1.0]), "right": rng.uniform([2.4, 0.4], [2.7, 1.0])}
    out = np.sin(np.pi * u) ** 2
    return {hand: robot.place(hand) + out * (goal - robot.place(hand)) for hand, goal in far.items()}


def by_hand(q: Array, order: tuple[str, str], objects: dict[str, Array]) -> Array:
    """A null-space step, written out: damped where the second hand has nothing left to move with."""
    robot = planar_bimanual()
    robot.update(q)
    (J1, J2), (e1, e2) = zip(*((robot.jacobian(n), objects[n] - robot.place(n)) for n in order), strict=True)
    first = J1.T @ np.linalg.solve(J1 @ J1.T + 1e-4 * np.eye(2), e1)
    free = J2 @ (np.eye(5) - np.linalg.pinv(J1, rcond=1e-3) @ J1)
    second = free.T @ np.linalg.solve(free @ free.T + 0.05 * np.eye(2), e2 - J2 @ first)
    step = first + second * min(1.0, 0.1 / max(float(np.linalg.norm(second)), 1e-9))
    return np.asarray(step * min(1.0, 0.3 / max(float(np.linalg.norm(step)), 1e-9)))


@pytest.mark.parametrize("order", [("left", "right"), ("right", "left")])
def test_who_has_priority_is_found_in_the_demonstrations(order: tuple[str, str]) -> None:
    first, second = order
    model, frames = shown(order), bimanual()
    deviation = {name: np.sqrt(np.trace(S[0])) for name, S in model.covariances_.items()}
    # the first hand is seen to be sure; the second one is surer below the first than for itself
    assert deviation[first] < 0.2 * deviation[second]
    assert deviation[f"{second} below {first}"] < 0.7 * deviation[second]
    product, robot = ConfigurationProduct(model, frames), planar_bimanual()
    paths = object_paths(np.random.default_rng(7))
    q, errors = START, []
    for t in range(80):
        for _ in range(5):
            q = product.step(q, objects_at(paths["left"][t], paths["right"][t]), dt=0.01).mean
        robot.update(q)
        errors.append([np.linalg.norm(paths[hand][t] - robot.place(hand)) for hand in order])
    far = np.array(errors)[35:45].mean(axis=0)
    assert far[1] > 0.3  # both cannot be reached
    assert far[0] < 0.2 * far[1]


def test_models_that_do_not_fit_are_refused_with_the_reason() -> None:
    frames = bimanual()
    with pytest.raises(ValueError, match="not among the candidates"):
        ConfigurationProduct(model_of({"nose": (np.zeros(5), np.eye(5))}), frames)
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="without time has one component"):
        ConfigurationProduct(TPGMM(2).fit_projected({"previous": rng.normal(size=(20, 5))}), frames)
    product = ConfigurationProduct(model_of({"previous": (np.zeros(5), np.eye(5))}), frames)
    with pytest.raises(ValueError, match="not over time"):
        product.step(START, {}, time=1.0)


def test_models_over_time_change_what_counts() -> None:
    """First a posture, then a place of the hand: each determines its directions in its time."""
    robot, rng = planar_arm([1.0, 0.8, 0.6]), np.random.default_rng(3)
    frames = MovingFrames(
        robot, {"joints": JointSpace(), "hand": TaskSpace((KinematicTask("hand", relative_to="ball"),))}
    )
    posture, times, demonstrations = np.array([0.3, 0.9, -0.8]), np.linspace(0.0, 2.0, 100), []
    for _ in range(6):
        ball = rng.uniform([0.9, 0.9], [1.5, 1.5])
        q, configurations = posture, []
        for t in times:
            robot.update(q)
            J = robot.jacobian("hand")
            free = (np.eye(3) - np.linalg.pinv(J) @ J) @ rng.normal(size=3)
            step = posture - q if t < 1.0 else np.linalg.pinv(J) @ (ball - robot.place("hand")) + 0.3 * free
            q = q + 0.3 * step + 0.002 * rng.normal(size=3)
            configurations.append(q)
        demonstrations.append(
            frames.demonstration(times, configurations, {"ball": Frame(np.eye(2), ball)}, with_time=True)
        )
    model = TPGMM(4, reg_covar=1e-5).fit(demonstrations)
    ball = {"ball": Frame(np.eye(2), [1.2, 1.3])}
    early, late = (directions_determined(model, frames.at(posture, ball), t) for t in (0.5, 1.8))
    assert early["joints"] > 2.5 and late["hand"] > 1.5
    assert sum(early.values()) == pytest.approx(3.0)
    product, q = ConfigurationProduct(model, frames), posture + 0.2
    q = product.step(q, ball, 0.5).mean
    np.testing.assert_allclose(q, posture, atol=0.05)
    for t in np.linspace(1.0, 2.0, 30):
        q = product.step(q, ball, t).mean
    robot.update(q)
    np.testing.assert_allclose(robot.place("hand"), [1.2, 1.3], atol=0.03)
    with pytest.raises(ValueError, match="is over time"):
        product.step(q, ball)
