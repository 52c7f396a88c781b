# SPDX-License-Identifier: Apache-2.0
"""The hand that is led, the objects of a simulation, the refusals of a tracker, the tube: without ROS and page."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE
from tpgmm_workbench.scene.tube import SIDES, THINNEST, tube
from tpgmm_workbench.session.arrangement import Arrangement, hand_over, regions_of
from tpgmm_workbench.session.leading import MAX_SPEED, SPRING, Leading
from tpgmm_workbench.session.refusals import LASTS, Refusals
from tpgmm_workbench.session.view import FrameView

HOME = np.array([0.6, 0.2, 0.1, 0.0, 1.0, 0.0, 0.0])


def led(leading: Leading, delay: int, seconds: float, mass: float = 3.0, friction: float = 2.0) -> tuple[Array, float]:
    """A mass that is led, seen late by some poses (100 Hz): where it ends, and its largest speed."""
    pose, velocity, top = HOME.copy(), np.zeros(6), 0.0
    inertia = np.repeat([mass, 0.05], 3)
    seen = [pose] * (delay + 1)
    for i in range(round(100 * seconds)):
        wrench = leading.wrench(0.01 * i, seen[-1 - delay])
        force = np.zeros(6) if wrench is None else wrench
        for _ in range(10):
            speed = float(np.linalg.norm(velocity[:3]))
            brake = np.repeat([friction / max(speed, 0.02), 0.3], 3) * velocity
            velocity = velocity + 0.001 * (force - brake) / inertia
            pose = POSE.exp(pose, 0.001 * velocity)
        top = max(top, float(np.linalg.norm(velocity[:3])))
        seen.append(pose)
    return pose, top


@pytest.mark.parametrize("delay", [0, 3])
def test_a_hand_is_led_to_the_gizmo_no_faster_than_a_person_leads_it(delay: int) -> None:
    leading = Leading()
    aim = POSE.exp(HOME, np.array([0.2, -0.15, 0.1, 0.0, 0.0, 0.5]))
    leading.lead(aim)
    end, top = led(leading, delay, 6.0)
    error = POSE.log(end, aim)
    assert np.linalg.norm(error[:3]) < 0.01 and np.linalg.norm(error[3:]) < 0.09
    assert leading.is_there(end)
    assert top < 1.6 * MAX_SPEED


def test_a_hand_that_nobody_leads_gets_no_force_and_one_that_is_far_away_no_blow() -> None:
    leading = Leading()
    assert leading.wrench(0.0, HOME) is None
    leading.lead(POSE.exp(HOME, np.array([3.0, 0.0, 0.0, 0.0, 0.0, 3.0])))
    forces = [leading.wrench(0.01 * i, HOME) for i in range(300)]
    assert all(force is not None for force in forces)
    assert np.abs(forces).max() <= SPRING.max_force
    assert np.abs(forces[0]).max() < 1.0  # it begins where the hand is
    leading.let_go()
    assert leading.wrench(3.0, HOME) is None


def test_after_a_pause_the_spring_begins_where_the_hand_is_by_then() -> None:
    leading = Leading()
    leading.lead(POSE.exp(HOME, np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])))
    for i in range(100):
        leading.wrench(0.01 * i, HOME)
    force = leading.wrench(5.0, HOME)
    assert force is not None and np.abs(force).max() < 1.0


def test_objects_lie_in_their_regions_elsewhere_each_time_and_can_be_hidden() -> None:
    regions = regions_of("anything", ["left", "right"], HOME)
    arrangement = Arrangement(regions, seed=1)
    first = dict(arrangement.places)
    arrangement.shuffle()
    for name, region in regions.items():
        place = arrangement.places[name]
        assert np.all(place[:3] >= region.lower) and np.all(place[:3] <= region.upper)
        assert not np.allclose(place, first[name])
    assert arrangement.places["left"][1] > arrangement.places["right"][1]
    arrangement.hide("left", True)
    assert set(arrangement.in_sight()) == {"right"}
    arrangement.hide("left", False)
    assert set(arrangement.in_sight()) == {"left", "right"}
    with pytest.raises(ValueError, match="no object 'cup'"):
        arrangement.move("cup", HOME)


def test_the_hand_over_an_object_turns_with_it() -> None:
    turn = quaternion.exp([0.0, 0.0, 0.7])
    place = np.concatenate([[0.5, 0.1, 0.0], turn])
    at, above = hand_over(place, HOME, above=False), hand_over(place, HOME, above=True)
    np.testing.assert_allclose(above[:3] - at[:3], [0.0, 0.0, 0.1], atol=1e-12)
    assert quaternion.angle_between(at[3:], HOME[3:]) == pytest.approx(0.7)


def test_a_refusal_is_of_now_for_a_while_and_those_of_before_do_not_count() -> None:
    refusals = Refusals()
    refusals.take({"refused_cup: stamp too old": "7", "age_cup_s": "0.1"}, 0.0)
    assert refusals.of("cup", 0.0) is None
    refusals.take({"refused_cup: stamp too old": "9"}, 1.0)
    assert refusals.of("cup", 1.5) == "stamp too old"
    assert refusals.of("plate", 1.5) is None
    assert refusals.of("cup", 1.0 + LASTS + 0.1) is None


@pytest.mark.parametrize(
    ("view", "words"),
    [
        (FrameView("cup", "seen", 0.02), "seen"),
        (FrameView("cup", "held", 1.25), "held, seen 1.2 s ago"),
        (FrameView("cup", "missing"), "missing"),
        (FrameView("cup", "missing", 300.0), "missing for 5 min"),
        (FrameView("cup", "refused", 0.1, why="not finite"), "refused: not finite"),
    ],
)
def test_a_frame_says_what_is_known_of_it(view: FrameView, words: str) -> None:
    assert view.words == words


def test_a_tube_is_as_wide_as_two_deviations_across_the_way() -> None:
    path = np.column_stack([np.linspace(0.0, 1.0, 20), np.zeros(20), np.zeros(20)])
    covariance = np.diag([9.0, 0.01**2, 0.03**2])
    vertices, faces = tube(path, np.broadcast_to(covariance, (20, 3, 3)))
    assert vertices.shape == (20 * SIDES, 3) and faces.shape == (19 * SIDES * 2, 3)
    assert faces.min() == 0 and faces.max() == len(vertices) - 1
    np.testing.assert_allclose(np.abs(vertices).max(axis=0), [1.0, 0.02, 0.06], rtol=0.05)


def test_a_tube_along_a_path_that_rests_and_turns_is_finite_and_never_thinner_than_seen() -> None:
    path = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    vertices, _ = tube(path, np.zeros((5, 3, 3)))
    away = np.linalg.norm(vertices.reshape(5, SIDES, 3) - path[:, None], axis=2)
    np.testing.assert_allclose(away, THINNEST)
    with pytest.raises(ValueError, match="two points or more"):
        tube(path[:1], np.zeros((1, 3, 3)))
