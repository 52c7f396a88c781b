# SPDX-License-Identifier: Apache-2.0
"""The objects of a simulation, a run that is watched, the refusals of a tracker, the tube: without ROS and page."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_workbench.scene import stiffness_display
from tpgmm_workbench.scene.tube import SIDES, THINNEST, tube
from tpgmm_workbench.session.arrangement import Arrangement, hand_over, regions_of
from tpgmm_workbench.session.refusals import LASTS, Refusals
from tpgmm_workbench.session.view import FrameView, GraphView, NodeView, StiffnessView
from tpgmm_workbench.session.watched_run import WatchedRun

HOME = np.array([0.6, 0.2, 0.1, 0.0, 1.0, 0.0, 0.0])


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


def test_the_ellipsoid_of_a_hand_is_long_where_it_is_stiff_and_stands_at_the_hand() -> None:
    turn = quaternion.rotation_matrix(quaternion.exp([0.3, -0.2, 0.9]))
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = turn @ np.diag([900.0, 300.0, 100.0]) @ turn.T
    pose, size = stiffness_display.ellipsoid(HOME[:3], StiffnessView(matrix))
    np.testing.assert_allclose(pose[:3], HOME[:3])
    np.testing.assert_allclose(size[2] / size[:2], [9.0, 3.0], rtol=1e-9)
    axes = quaternion.rotation_matrix(pose[3:])
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert abs(axes[:, 2] @ turn[:, 0]) == pytest.approx(1.0)


def test_figures_of_a_node_say_how_long_steps_take_and_may_take_and_nothing_that_is_no_number() -> None:
    steps = {"step_p50_ms": "0.2", "step_p99_ms": "0.5", "step_max_ms": "1.3"}
    told = NodeView(True, "", {"tick_rate_hz": "1000.0", **steps}).figures
    assert told == "1000 Hz, step 0.20 ms, 1 of 100 over 0.50 ms, longest 1.30 ms of 1.0 ms"
    assert NodeView(True, "", {"tick_rate_hz": "many", "step_p50_ms": "nan"}).figures == ""


def test_a_run_that_goes_back_counts_as_it_went_the_last_time_and_a_frame_out_of_sight_stays_where_it_was() -> None:
    def pose(x: float) -> Array:
        return np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    watched = WatchedRun()
    steps = [
        (0.1, False),
        (0.2, True),
        (0.3, True),
        (0.3, True),
        (0.25, False),
        (0.15, False),
        (0.2, False),
        (0.4, False),
    ]
    for number, (phase, is_led) in enumerate(steps):
        frame = FrameView("object", "seen", 0.0, pose(7.0)) if number == 0 else FrameView("object", "missing")
        late = FrameView("target", "missing" if number == 0 else "seen", 0.0, None if number == 0 else pose(8.0))
        watched.take(float(number), phase, GraphView(hand=pose(number), frames=(frame, late)), is_led)
    run = watched.run(feels=True)
    assert run.phases is not None and run.is_led is not None
    np.testing.assert_array_equal(run.phases, [0.1, 0.15, 0.2, 0.4])
    np.testing.assert_array_equal(run.times, [0.0, 5.0, 6.0, 7.0])
    np.testing.assert_array_equal(run.hand[:, 0], [0.0, 5.0, 6.0, 7.0])
    assert not run.is_led.any() and list(run.frames) == ["object"]  # what was led on the first way is gone
    np.testing.assert_array_equal(run.frames["object"][:, 0], 7.0)
    assert watched.run(feels=False).is_led is None and WatchedRun().run(feels=True).hand.shape == (0, 7)
