# SPDX-License-Identifier: Apache-2.0
"""Frames that move with the hand while nobody sees them: only those that were seen to, live as in recordings."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse, pose_error
from tpgmm_core.observation.in_hand import carried_poses
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame, TrackingConfig
from tpgmm_core.observation.tracking import FrameTracker

CONFIG = TrackingConfig(visible_timeout=0.2, hold_time=1.0, fade_time=0.5)
IN_HAND = np.array([0.02, 0.0, 0.1, 0.0, math.sin(0.2), 0.0, math.cos(0.2)])
PERIOD = 0.02
DURATION = 4.0
HIDDEN = 2.0
TIMES = np.arange(0.0, DURATION, PERIOD)
LAST = TIMES[TIMES < HIDDEN][-1]


def hand_at(t: float) -> Array:
    """It goes 0.1 m/s and turns 0.3 rad/s."""
    return np.array([0.1 * t, 0.2, 0.3, 0.0, 0.0, math.sin(0.15 * t), math.cos(0.15 * t)])


def in_hand(t: float) -> Array:
    return compose(hand_at(t), IN_HAND)


def at_rest(t: float) -> Array:
    """Where the hand is as long as it is seen."""
    return in_hand(HIDDEN)


def put_down(t: float) -> Array:
    return in_hand(min(t, 0.45))


def picked_up(t: float) -> Array:
    return in_hand(max(t, 1.0))


def slipping(t: float) -> Array:
    return compose(hand_at(t), [0.02 + 0.03 * t, *IN_HAND[1:]])


def pushed_by_others(t: float) -> Array:
    return np.array([0.5, 0.1 * t, *IN_HAND[2:]])


def noisy_in_hand(t: float) -> Array:
    random = np.random.default_rng(round(t / PERIOD))
    turn = quaternion.multiply(quaternion.exp(random.normal(scale=0.009, size=3)), in_hand(t)[3:])
    return np.concatenate([in_hand(t)[:3] + random.normal(scale=0.001, size=3), turn])


def pose_of(frame: TrackedFrame) -> Array:
    assert frame.pose is not None
    return frame.pose


def tracked(
    thing: Callable[[float], Array],
    delay: float = 0.0,
    hand_until: float = DURATION,
    gripper: Callable[[float], bool] | None = None,
) -> list[TrackedFrame]:
    """What a tracker says at TIMES of a thing that is not seen from HIDDEN on; a camera tells it late."""
    tracker = FrameTracker(["thing"], config=CONFIG, unknown_after={"thing": math.inf}, with_hand=["thing"])
    found = []
    for t in TIMES:
        now, seen = round(SECOND * (100 + t)), round(SECOND * (100 + t - delay))
        if gripper is not None:  # told before the hand's pose of this time
            tracker.observe_gripper("thing", gripper(t), now, now)
        if 0.0 <= t - delay < HIDDEN:  # told before the hand's pose of this time
            assert tracker.observe("thing", thing(t - delay), seen, now, now) is None
        if t < hand_until:
            assert tracker.observe_hand(hand_at(t), now, now) == ""
        found += tracker.update(now)
    return found


@pytest.mark.parametrize("delay", [0.0, 0.07])
@pytest.mark.parametrize("thing", [in_hand, noisy_in_hand, picked_up])
def test_what_was_seen_to_move_with_the_hand_moves_with_it_and_is_known_worse(
    thing: Callable[[float], Array], delay: float
) -> None:
    last = tracked(thing, delay)[-1]
    assert last.status is FrameStatus.HELD and last.confidence == 1.0
    way, turn = pose_error(pose_of(last), in_hand(TIMES[-1]))
    assert way < 0.005 and turn < 0.04
    assert last.covariance is not None
    gone, turned = pose_error(in_hand(TIMES[-1]), in_hand(LAST))
    deviations = [0.01 + 0.1 * gone] * 3 + [0.1 + 0.1 * turned] * 3
    np.testing.assert_allclose(np.sqrt(np.diag(last.covariance)), deviations, rtol=0.1)


@pytest.mark.parametrize("thing", [at_rest, put_down, slipping, pushed_by_others])
def test_what_was_not_seen_to_move_with_the_hand_stays(thing: Callable[[float], Array]) -> None:
    last = tracked(thing)[-1]
    assert last.status is FrameStatus.HELD
    np.testing.assert_allclose(pose_of(last), thing(LAST), atol=1e-12)
    assert (last.covariance is None) == (thing in (at_rest, put_down)), "what was in motion may have gone on"


def test_a_hand_that_is_not_seen_any_more_takes_its_things_along_into_the_unknown() -> None:
    found = tracked(in_hand, hand_until=2.8)
    assert found[int(2.7 / PERIOD)].status is FrameStatus.HELD
    assert found[-1].status is FrameStatus.MISSING


def test_a_frame_is_followed_again_as_soon_as_it_is_seen_and_a_time_that_jumps_back_is_forgotten() -> None:
    tracker = FrameTracker(["thing"], config=CONFIG, unknown_after={"thing": math.inf}, with_hand=["thing"])

    def live(t: float, place: Array | None) -> TrackedFrame:
        now = round(SECOND * (100 + t))
        tracker.observe_hand(hand_at(t), now, now)
        if place is not None:
            assert tracker.observe("thing", place, now, now, now) is None
        return tracker.update(now)[0]

    for t in TIMES:
        live(t, in_hand(t) if t < HIDDEN else None)
    assert "moves with the hand" in tracker.health(round(SECOND * (100 + DURATION)))["thing"].notes[-1]
    found = live(DURATION, at_rest(0.0))
    np.testing.assert_array_equal(pose_of(found), at_rest(0.0))
    assert found.status is FrameStatus.VISIBLE and found.covariance is None
    tracker.forget()
    assert live(0.0, None).status is FrameStatus.MISSING
    live(0.1, in_hand(0.1))
    np.testing.assert_allclose(pose_of(live(3.0, None)), in_hand(0.1), atol=1e-12)


@pytest.mark.parametrize("thing", [in_hand, noisy_in_hand, picked_up, at_rest, put_down, slipping, pushed_by_others])
def test_a_recording_says_the_same_as_the_tracker(thing: Callable[[float], Array]) -> None:
    at = np.round(SECOND * (100 + TIMES)).astype(np.int64)
    seen = TIMES < HIDDEN
    things = np.array([thing(t) for t in TIMES])
    held = np.where(seen[:, None], things, things[np.flatnonzero(seen)[-1]])
    hand = np.array([hand_at(t) for t in TIMES])
    poses, moved = carried_poses(at, hand, at[seen], things[seen], held, CONFIG.visible_timeout)
    live = tracked(thing)
    hidden = TIMES > LAST + CONFIG.visible_timeout + 1e-6
    assert moved.any() == (thing in (in_hand, noisy_in_hand, picked_up))
    np.testing.assert_array_equal(moved, hidden & moved.any())
    np.testing.assert_array_equal(poses[~hidden], held[~hidden])
    tolerance = 0.005 if thing is noisy_in_hand else 1e-9  # the tracker's filter
    np.testing.assert_allclose(poses[hidden], np.array([pose_of(frame) for frame in live])[hidden], atol=tolerance)


def test_only_frames_that_stay_can_move_with_the_hand() -> None:
    with pytest.raises(ValueError, match="with_hand names some of"):
        FrameTracker(["thing"], with_hand=["thing"])


def test_the_hand_may_be_anywhere_before_and_a_thing_keeps_its_place_in_it() -> None:
    last = tracked(in_hand)[-1]
    np.testing.assert_allclose(compose(inverse(hand_at(TIMES[-1])), pose_of(last)), IN_HAND, atol=1e-9)


# -- a gripper that tells whether it holds something

CLOSES, OPENS = 2.3, 3.2


def gripper(t: float) -> bool:
    return CLOSES - 1e-6 <= t < OPENS - 1e-6


def beside_the_hand(t: float) -> Array:
    """Near enough to be taken, where the hand is when its gripper closes."""
    return compose(hand_at(CLOSES), [0.03, 0.0, 0.04, *IN_HAND[3:]])


def far_from_the_hand(t: float) -> Array:
    return compose(hand_at(CLOSES), [0.2, 0.0, 0.04, *IN_HAND[3:]])


def test_what_the_gripper_closed_around_unseen_moves_with_the_hand_until_it_opens() -> None:
    found = tracked(beside_the_hand, gripper=gripper)
    poses = dict(zip(TIMES.round(6), map(pose_of, found), strict=True))
    np.testing.assert_allclose(poses[2.2], beside_the_hand(0.0), atol=1e-12)
    place = compose(inverse(hand_at(CLOSES)), beside_the_hand(0.0))
    np.testing.assert_allclose(poses[3.0], compose(hand_at(3.0), place), atol=1e-9)
    left = compose(hand_at(OPENS), place)
    np.testing.assert_allclose(pose_of(found[-1]), left, atol=1e-9)
    assert found[-1].covariance is not None and found[-1].covariance[0, 0] > 0.01**2, "it is known worse"
    steps = [pose_error(a, b)[0] for a, b in zip(list(poses.values())[1:], list(poses.values())[:-1], strict=True)]
    assert max(steps) < 0.004, "it never leaps"


@pytest.mark.parametrize(
    ("thing", "closed"),
    [(far_from_the_hand, gripper), (beside_the_hand, lambda t: True), (in_hand, lambda t: False)],
    ids=["too far", "closed all the time", "seen to move, but the gripper is open"],
)
def test_what_the_gripper_does_not_hold_stays(thing: Callable[[float], Array], closed: Callable[[float], bool]) -> None:
    np.testing.assert_allclose(pose_of(tracked(thing, gripper=closed)[-1]), thing(LAST), atol=1e-9)


def test_a_gripper_that_was_closed_before_does_not_hide_what_was_seen() -> None:
    last = tracked(in_hand, gripper=lambda t: True)[-1]
    np.testing.assert_allclose(pose_of(last), in_hand(TIMES[-1]), atol=0.005)


@pytest.mark.parametrize("thing", [beside_the_hand, far_from_the_hand, in_hand])
def test_a_recording_says_the_same_as_the_tracker_of_a_gripper(thing: Callable[[float], Array]) -> None:
    at = np.round(SECOND * (100 + TIMES)).astype(np.int64)
    seen = TIMES < HIDDEN
    things, hand = np.array([thing(t) for t in TIMES]), np.array([hand_at(t) for t in TIMES])
    held = np.where(seen[:, None], things, things[np.flatnonzero(seen)[-1]])
    signal = at, np.array([gripper(t) for t in TIMES])
    poses, moved = carried_poses(at, hand, at[seen], things[seen], held, CONFIG.visible_timeout, signal)
    hidden = TIMES > LAST + CONFIG.visible_timeout + 1e-6
    live = np.array([pose_of(frame) for frame in tracked(thing, gripper=gripper)])
    # at the very time of a change, the tracker hears of it before it knows where the hand is
    still = np.array([gripper(t) == gripper(t - PERIOD) for t in TIMES])
    np.testing.assert_allclose(poses[hidden & still], live[hidden & still], atol=1e-9)
    np.testing.assert_array_equal(moved, signal[1] & (thing is beside_the_hand))


@pytest.mark.parametrize(
    ("said_for", "status", "words"),
    [
        (0.0, FrameStatus.HELD, "the gripper spoke last 20 s ago"),
        (6.0, FrameStatus.MISSING, "has stopped saying so: silent for 14 s"),
        (20.0, FrameStatus.HELD, "whose gripper holds it"),
    ],
    ids=["said once", "said all the time, and then no more", "said all the time"],
)
def test_what_a_gripper_holds_is_lost_where_it_stops_saying_so(
    said_for: float, status: FrameStatus, words: str
) -> None:
    tracker = FrameTracker(["thing"], config=CONFIG, unknown_after={"thing": math.inf}, with_hand=["thing"])
    for t in np.arange(0.0, 20.02, PERIOD):
        now = round(SECOND * (100 + t))
        if t < 0.1:
            assert tracker.observe("thing", beside_the_hand(0.0), now, now, now) is None
        assert tracker.observe_hand(hand_at(CLOSES), now, now) == ""
        if t == 0.0:
            tracker.observe_gripper("thing", False, now, now)
        elif PERIOD <= t <= PERIOD + said_for:
            tracker.observe_gripper("thing", True, now, now)
        (last,) = tracker.update(now)
    assert last.status is status
    assert any(words in note for note in tracker.health(now)["thing"].notes)
