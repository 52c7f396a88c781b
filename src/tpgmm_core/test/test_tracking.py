# SPDX-License-Identifier: Apache-2.0
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpgmm_core.common.blending import minimum_jerk
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.poses import check_pose
from tpgmm_core.observation.tracked import FrameStatus, TrackingConfig
from tpgmm_core.observation.tracking import FrameTracker

POSE = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]
CONFIG = TrackingConfig(visible_timeout=0.2, hold_time=1.0, fade_time=0.5)
SECOND = 1_000_000_000


def ns(seconds: float) -> int:
    return round(seconds * SECOND)


def tracker() -> FrameTracker:
    return FrameTracker(["object"], fixed={"robot": [0, 0, 0, 0, 0, 0, 1]}, config=CONFIG)


def see(frames: FrameTracker, seconds: float, pose=POSE) -> str | None:
    return frames.observe("object", pose, ns(100 + seconds), ns(100 + seconds), ns(seconds))


def state(frames: FrameTracker, seconds: float):
    return {item.name: item for item in frames.update(ns(seconds))}


def test_a_frame_that_was_never_seen_is_missing_and_a_fixed_one_never_is():
    now = state(tracker(), 1.0)
    assert now["object"].status is FrameStatus.MISSING
    assert now["object"].pose is None and now["object"].confidence == 0.0
    assert now["robot"].status is FrameStatus.VISIBLE and now["robot"].confidence == 1.0


def test_a_lost_frame_is_held_at_its_last_pose_then_fades_then_is_missing():
    frames = tracker()
    assert see(frames, 0.0) is None
    course = [state(frames, t)["object"] for t in np.arange(0.0, 2.5, 0.01)]
    by_time = dict(zip(np.arange(0.0, 2.5, 0.01).round(2).tolist(), course, strict=True))
    assert by_time[0.1].status is FrameStatus.VISIBLE
    assert by_time[0.5].status is FrameStatus.HELD and by_time[0.5].confidence == 1.0
    assert by_time[1.45].status is FrameStatus.HELD and 0.3 < by_time[1.45].confidence < 0.7
    assert by_time[2.0].status is FrameStatus.MISSING
    np.testing.assert_array_equal(by_time[2.0].pose, POSE)


def test_a_frame_that_stays_is_held_for_ever_and_known_worse_only_where_it_was_seen_to_move():
    frames = FrameTracker(["object", "cart"], config=CONFIG, unknown_after={"object": math.inf, "cart": math.inf})
    for step in range(100):  # for 2 s; the cart goes 0.1 m/s and turns 0.2 rad/s
        t = 0.02 * step
        cart = [0.1 * t, 1.0, 0.0, 0.0, 0.0, math.sin(0.1 * t), math.cos(0.1 * t)]
        assert see(frames, t) is None
        assert frames.observe("cart", cart, ns(100 + t), ns(100 + t), ns(t)) is None
    seen, held, later = (state(frames, t) for t in (1.99, 5.98, 600.0))
    assert seen["cart"].covariance is None and seen["cart"].status is FrameStatus.VISIBLE
    for now in (held, later):
        assert all(now[name].status is FrameStatus.HELD and now[name].confidence == 1.0 for name in now)
        assert now["object"].covariance is None, "at rest it is where it was"
    np.testing.assert_allclose(np.diag(held["cart"].covariance), [0.4**2] * 3 + [0.8**2] * 3, rtol=1e-6)
    assert np.all(np.diag(later["cart"].covariance) > np.diag(held["cart"].covariance))
    see(frames, 600.1)
    assert state(frames, 600.1)["object"].status is FrameStatus.VISIBLE


@pytest.mark.parametrize(("rests", "deviation"), [(2.0, 0.0), (0.2, 0.05)])
def test_a_push_counts_while_it_may_go_on_and_not_once_the_object_has_come_to_rest(rests, deviation):
    frames = FrameTracker(["object"], config=CONFIG, unknown_after={"object": math.inf})
    for t in np.arange(0.0, 2.0 + rests, 0.02):  # 5 cm within the second second
        see(frames, t, [0.05 * minimum_jerk(t - 1.0), *POSE[1:]])
    covariance = state(frames, 3.0 + rests)["object"].covariance
    spread = 0.0 if covariance is None else math.sqrt(covariance[0, 0])
    assert spread == 0.0 if deviation == 0.0 else spread > deviation


def test_noise_of_a_frame_at_rest_is_no_motion():
    rng = np.random.default_rng(0)
    frames = FrameTracker(["object"], config=CONFIG, unknown_after={"object": math.inf})
    for step in range(150):
        turn = quaternion.exp(rng.normal(scale=0.01, size=3))
        see(frames, step / 30.0, [*rng.normal(scale=0.002, size=3), *turn])
    deviations = np.sqrt(np.diag(state(frames, 65.0)["object"].covariance or np.zeros((6, 6))))
    assert deviations[0] < 0.06 and deviations[5] < 0.3, "in a minute"


def test_a_frame_is_unknown_after_its_own_time():
    frames = FrameTracker(["object", "cup"], config=CONFIG, unknown_after={"cup": 5.0})
    for name in ("object", "cup"):
        frames.observe(name, POSE, ns(100), ns(100), ns(0))
    by_time = {t: state(frames, t) for t in (0.1, 3.0, 4.0, 5.15, 6.0)}
    assert by_time[4.0]["object"].status is FrameStatus.MISSING
    assert by_time[5.15]["cup"].status is FrameStatus.HELD and by_time[5.15]["cup"].confidence == 1.0
    assert by_time[6.0]["cup"].status is FrameStatus.MISSING
    with pytest.raises(ValueError, match="unknown_after"):
        FrameTracker(["object"], unknown_after={"lamp": 1.0})


def test_confidence_never_jumps_however_observations_come():
    frames = tracker()
    rng = np.random.default_rng(0)
    last = None
    for step in range(3000):
        t = step * 0.01
        if rng.random() < (0.002 if (step // 500) % 2 else 0.3):
            see(frames, t)
        confidence = state(frames, t)["object"].confidence
        if last is not None:
            assert abs(confidence - last) <= 0.01 / CONFIG.fade_time + 1e-12
        last = confidence


def test_a_frame_seen_before_the_first_update_is_trusted_at_once():
    frames = tracker()
    see(frames, 0.0)
    assert state(frames, 0.01)["object"].confidence == 1.0


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ([np.nan, 0, 0, 0, 0, 0, 1], "not finite"),
        ([np.inf, 0, 0, 0, 0, 0, 1], "not finite"),
        ([0, 0, 0, 0, 0, 0, 0], "zero quaternion"),
        ([0, 0, 0, 1], "wrong size"),
    ],
)
def test_what_is_no_pose_is_refused_and_the_last_good_one_stays(pose, words):
    frames = tracker()
    see(frames, 0.0)
    assert words in see(frames, 0.1, pose)
    np.testing.assert_array_equal(state(frames, 0.1)["object"].pose, POSE)
    assert sum(frames.refusals("object").values()) == 1


@pytest.mark.parametrize(
    ("stamp", "words"),
    [(0.5, "future"), (-1.5, "too old"), (-100.0, "it is 0"), (-0.01, "repeated"), (-0.05, "out of order")],
)
def test_a_stamp_that_lies_is_refused(stamp, words):
    frames = tracker()
    assert frames.observe("object", POSE, ns(99.99), ns(100.0), ns(0.0)) is None
    assert words in frames.observe("object", POSE, ns(100.0 + stamp), ns(100.0), ns(0.01))


def test_a_frozen_stamp_does_not_keep_a_frame_visible():
    frames = tracker()
    see(frames, 0.0)
    for step in range(1, 50):
        frames.observe("object", POSE, ns(100.0), ns(100.0 + step * 0.01), ns(step * 0.01))
    assert state(frames, 0.5)["object"].status is FrameStatus.HELD


def test_time_that_jumps_back_is_forgotten_and_tracking_goes_on():
    frames = tracker()
    see(frames, 50.0)
    state(frames, 50.0)
    frames.forget()
    assert state(frames, 50.1)["object"].status is FrameStatus.MISSING
    assert frames.observe("object", POSE, ns(1.0), ns(1.0), ns(50.2)) is None
    now = state(frames, 50.2)["object"]
    assert now.status is FrameStatus.VISIBLE
    # it was published as missing 0.1 s before, and fades in from there
    assert now.confidence == pytest.approx(0.1 / CONFIG.fade_time)


def test_after_time_has_jumped_back_a_frame_that_is_seen_is_trusted_at_once():
    frames = tracker()
    see(frames, 50.0)
    state(frames, 50.0)
    frames.forget()
    assert frames.observe("object", POSE, ns(1.0), ns(1.0), ns(50.01)) is None
    now = state(frames, 50.02)["object"]
    assert now.status is FrameStatus.VISIBLE and now.confidence == 1.0


def test_a_fixed_frame_takes_no_observations_and_must_be_a_pose():
    assert "fixed" in tracker().observe("robot", POSE, ns(100), ns(100), 0)
    with pytest.raises(ValueError, match="zero quaternion"):
        FrameTracker([], fixed={"robot": [0] * 7})
    with pytest.raises(ValueError, match="no frames"):
        FrameTracker([])


@given(st.lists(st.floats(width=32), min_size=7, max_size=7))
def test_whatever_comes_poses_stay_finite_with_unit_quaternions(pose):
    frames = tracker()
    see(frames, 0.0, pose)
    known = state(frames, 0.0)["object"].pose
    assert known is None or (np.isfinite(known).all() and abs(np.linalg.norm(known[3:]) - 1) < 1e-9)


@pytest.mark.parametrize("value", [-1.0, 1e9, float("nan"), "soon", True])
def test_a_bad_timeout_is_refused_by_name(value):
    with pytest.raises(ValueError, match="hold_time"):
        TrackingConfig(hold_time=value)


@pytest.mark.parametrize("number", [1e200, -1e155, 1.7e308, 1e9])
@pytest.mark.parametrize("at", range(7))
def test_a_pose_out_of_all_proportion_is_refused_whatever_its_squares_are(number: float, at: int) -> None:
    pose = np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0])
    pose[at] = number
    with np.errstate(all="raise"):
        checked, reason = check_pose(pose)
    assert checked is None and "implausibly large" in reason


@pytest.mark.parametrize("at", range(7))
def test_integers_that_a_message_has_taken_for_floats_are_named(at: int) -> None:
    """The bits of an int of rclpy, read as a double: position and quaternion would be silently wrong."""
    pose = np.array([0.5, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0])
    pose[at] = 5e-324
    accepted, reason = check_pose(pose)
    assert accepted is None
    assert "write 1.0, not 1" in reason


def say(frames: FrameTracker, seconds: float, pose=POSE, stamp=0.0) -> str | None:
    """Once, by a publisher that keeps it."""
    return frames.observe("object", pose, ns(stamp), ns(100 + seconds), ns(seconds), lasts=True)


def kept(frames: FrameTracker, seconds: float, by=("object",)):
    return {item.name: item for item in frames.update(ns(seconds), by)}["object"]


@pytest.mark.parametrize("stamp", [0.0, 1.0, 100.0, 3600.0])
def test_what_is_said_once_holds_whatever_its_stamp_until_something_else_is_said_or_nobody_keeps_it(stamp):
    frames = tracker()
    assert say(frames, 0.0, stamp=stamp) is None
    for t in np.arange(0.0, 60.0, 0.1):
        now = kept(frames, t)
        assert now.status is FrameStatus.VISIBLE and now.confidence == 1.0
    there = [2.0, *POSE[1:]]
    for t, pose in ((60.0, there), (60.01, POSE), (60.02, there)):  # no leap, no average, no repeated stamp
        assert say(frames, t, pose, stamp) is None
        np.testing.assert_array_equal(kept(frames, t).pose, pose)
    assert "keeps it" in " ".join(frames.health(ns(60.0))["object"].notes)
    assert kept(frames, 60.5, ()).status is FrameStatus.HELD
    assert kept(frames, 61.1, ()).status is FrameStatus.HELD
    assert kept(frames, 62.2, ()).status is FrameStatus.MISSING


def test_a_stream_is_one_though_its_publisher_keeps_the_last_pose():
    frames = tracker()
    for step in range(30):
        t = step / 30
        assert say(frames, t, stamp=100.0 + t) is None
        kept(frames, t)
    assert kept(frames, 1.5).status is FrameStatus.HELD
    assert "leap" in (say(frames, 1.5, [50.0, *POSE[1:]], stamp=101.5) or "")
    assert "too old" in (say(frames, 1.6) or "")


def test_an_old_stream_does_not_stand_though_its_publisher_keeps_the_last_pose():
    frames = tracker()
    for step in range(60):
        t = step / 30
        refused = say(frames, t, stamp=1.0 + t)
        now = kept(frames, t)
    assert "too old" in (refused or "") and now.status is FrameStatus.HELD


def test_seen_by_others_it_is_judged_as_they_see_it():
    frames = tracker()
    assert say(frames, 0.0) is None
    assert see(frames, 1.0) is None
    assert kept(frames, 1.3).status is FrameStatus.HELD


def test_what_was_said_once_and_is_in_the_hand_moves_with_it():
    frames = FrameTracker(["object"], config=CONFIG, unknown_after={"object": math.inf}, with_hand=["object"])
    frames.observe_hand(POSE, ns(100), ns(0.0))
    frames.observe_gripper("object", False, ns(100), ns(0.0))
    assert say(frames, 0.0, stamp=100.0) is None
    frames.observe_gripper("object", True, ns(100), ns(0.0))
    way = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    for t in np.arange(0.01, 1.0, 0.01):
        frames.observe_hand(POSE + t * way, ns(100 + t), ns(t))
        now = kept(frames, t)
    np.testing.assert_allclose(now.pose, POSE + 0.99 * way, atol=1e-9)
    frames.observe_gripper("object", False, ns(100.99), ns(0.99))
    frames.observe_hand(POSE + 2 * way, ns(102), ns(2.0))
    np.testing.assert_allclose(kept(frames, 2.0).pose, POSE + 0.99 * way, atol=1e-9)
