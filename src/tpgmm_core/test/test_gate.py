# SPDX-License-Identifier: Apache-2.0
"""Leaps, flips and swaps are refused until they persist; whatever moves as things move is followed, bit by bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.gate import LeapGate, MotionLimits
from tpgmm_core.observation.plausible_poses import plausible_poses
from tpgmm_core.observation.tracked import TrackingConfig
from tpgmm_core.observation.tracking import FrameTracker

HOME = np.array([0.5, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0])
LIMITS = MotionLimits()
PERIODS = [0.005, 0.02, 1 / 30, 0.1]


def ns(seconds: float) -> int:
    return round(1e9 * (100.0 + seconds))


def turned(pose: NDArray[np.float64], vector: list[float]) -> NDArray[np.float64]:
    return np.concatenate([pose[:3], quaternion.multiply(pose[3:], quaternion.exp(vector))])


FLIPS = {"tilted": turned(HOME, [np.pi / 3, 0.0, 0.0]), "turned": turned(HOME, [0.0, 0.0, np.pi])}


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("flip", FLIPS)
@pytest.mark.parametrize("share", [0.03, 0.2, 0.4])
def test_flips_that_come_and_go_are_never_followed(period: float, flip: str, share: float) -> None:
    gate, random = LeapGate(LIMITS), np.random.default_rng(3)
    gate.judge(HOME, ns(0.0))
    for k in range(1, 2000):
        is_flipped = random.random() < share
        leap = gate.judge(FLIPS[flip] if is_flipped else HOME, ns(k * period))
        assert (leap is not None) == is_flipped
        assert leap is None or leap.is_flip


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("to", [*FLIPS.values(), HOME + [0.4, 0, 0, 0, 0, 0, 0]], ids=[*FLIPS, "moved"])
def test_what_persists_is_followed_after_the_stated_time(period: float, to: NDArray[np.float64]) -> None:
    gate = LeapGate(LIMITS)
    for k in range(20):
        assert gate.judge(HOME, ns((k - 20) * period)) is None
    times = period * np.arange(300)
    followed = [gate.judge(to, ns(t)) is None for t in times]
    first, is_flip = times[int(np.argmax(followed))], to[0] == HOME[0]
    due = max(3 * LIMITS.leap_time, 9 * period) if is_flip else LIMITS.leap_time
    assert due - 1e-9 <= first <= due + 2 * period
    assert all(followed[int(np.argmax(followed)) :])


@given(st.integers(0, 1000), st.sampled_from(PERIODS), st.floats(0.0, 3.0), st.floats(0.0, 6.0))
def test_what_moves_as_fast_as_it_can_is_always_followed(seed: int, period: float, speed: float, rate: float) -> None:
    random = np.random.default_rng(seed)
    gate, pose, poses, stamps, at = LeapGate(LIMITS), HOME, [], [], 0.0
    for _ in range(60):
        step = period * random.uniform(0.5, 1.5)
        at += step
        way, turn = random.normal(size=3), random.normal(size=3)
        pose = turned(pose, (step * rate * turn / np.linalg.norm(turn)).tolist())
        pose[:3] += step * speed * way / np.linalg.norm(way)
        assert gate.judge(pose, ns(at)) is None
        poses.append(pose)
        stamps.append(ns(at))
    assert plausible_poses(np.array(poses), np.array(stamps), LIMITS).kept.all()


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("flip", FLIPS)
def test_the_solution_of_a_tag_that_is_seen_more_often_wins_whichever_came_first(period: float, flip: str) -> None:
    gate = LeapGate(LIMITS)
    refused = [gate.judge(FLIPS[flip] if k % 4 == 0 else HOME, ns(k * period)) is not None for k in range(2000)]
    switched = 6.0 * 3 * LIMITS.leap_time + 1.0  # of four poses three are for it and one against
    late = np.arange(2000) >= round(switched / period)
    assert late.sum() > 500
    np.testing.assert_array_equal(np.array(refused)[late], (np.arange(2000) % 4 == 0)[late])


def test_what_was_not_seen_for_a_while_may_be_anywhere() -> None:
    gate = LeapGate(LIMITS)
    gate.judge(HOME, ns(0.0))
    assert gate.judge(HOME + [2.0, 0, 0, 0, 0, 0, 0], ns(1.0)) is None


def test_messages_that_come_in_bursts_are_no_leaps() -> None:
    gate = LeapGate(LIMITS)
    for k in range(60):
        moved = HOME + [0.06 * k, 0, 0, 0, 0, 0, 0]
        assert gate.judge(moved, ns(0.05 * (k - k % 4) + 0.0001 * (k % 4) if k >= 20 else 0.05 * k)) is None


@pytest.mark.parametrize("limits", [MotionLimits(0.0, 0.0), MotionLimits(leap_time=0.0)])
def test_a_gate_can_be_off(limits: MotionLimits) -> None:
    gate = LeapGate(limits)
    for k in range(20):
        assert gate.judge(FLIPS["turned"] if k % 2 else HOME + [k, 0, 0, 0, 0, 0, 0], ns(0.01 * k)) is None


# recordings


@pytest.mark.parametrize("flip", FLIPS)
@pytest.mark.parametrize("share", [0.03, 0.2, 0.4])
def test_flips_in_a_recording_are_left_out(flip: str, share: float) -> None:
    bad = np.random.default_rng(5).random(400) < share
    poses = np.where(bad[:, None], FLIPS[flip], HOME)
    stamps = np.array([ns(0.05 * k) for k in range(400)])
    found = plausible_poses(poses, stamps, LIMITS)
    np.testing.assert_array_equal(found.kept, ~bad)
    assert found.way == 0.0 and found.turn == pytest.approx(quaternion.angle_between(HOME[3:], poses[bad][0, 3:]))


@pytest.mark.parametrize("flip", FLIPS)
def test_a_tag_that_stays_flipped_for_the_shorter_part_of_a_recording_is_left_out(flip: str) -> None:
    """The hand is near, and the camera sees the tag from another side until the end."""
    poses = np.tile(HOME, (80, 1))
    poses[64:] = FLIPS[flip]
    found = plausible_poses(poses, np.array([ns(0.05 * k) for k in range(80)]), LIMITS)
    np.testing.assert_array_equal(found.kept, np.arange(80) < 64)


def test_what_is_put_elsewhere_and_stays_is_followed_in_a_recording_from_its_first_pose() -> None:
    poses = np.tile(HOME, (80, 1))
    poses[50:, 0] += 0.5
    found = plausible_poses(poses, np.array([ns(0.05 * k) for k in range(80)]), LIMITS)
    assert found.kept.all() and found.followed == (2.5,)


def test_a_phantom_that_does_not_stay_is_left_out_of_a_recording() -> None:
    poses = np.tile(HOME, (80, 1))
    poses[[3, 30, 31, 79], 1] += [0.5, 0.5, 0.5, 2.0]
    found = plausible_poses(poses, np.array([ns(0.05 * k) for k in range(80)]), LIMITS)
    np.testing.assert_array_equal(np.flatnonzero(~found.kept), [3, 30, 31, 79])
    assert found.way == pytest.approx(2.0) and not found.followed


# in the tracker


def tracker(**config: float) -> FrameTracker:
    return FrameTracker(["cup", "plate"], config=TrackingConfig(**config))


def see(frames: FrameTracker, name: str, pose: NDArray[np.float64], seconds: float) -> str | None:
    return frames.observe(name, pose, ns(seconds), ns(seconds), ns(seconds))


PLATE = HOME + [0.0, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_the_kind_of_a_leap_is_said() -> None:
    frames = tracker()
    see(frames, "cup", HOME, 0.0), see(frames, "plate", PLATE, 0.0)
    assert "frame 'cup': flip: turned on the spot: by 0.000 m and 180 deg" in str(
        see(frames, "cup", FLIPS["turned"], 0.03)
    )
    assert "frame 'cup': leap: by 0.300 m and 0 deg in 0.060 s" in str(see(frames, "cup", HOME - [0.3, *[0] * 6], 0.06))
    assert "frame 'plate': swapped identity: leapt by 0.400 m" in str(see(frames, "plate", HOME, 0.06))
    assert "where 'cup' is" in str(see(frames, "plate", HOME, 0.07))
    assert frames.refusals("cup") == {"flip": 1, "leap": 1} and frames.refusals("plate") == {"swapped identity": 2}


def test_while_a_leap_is_refused_the_frame_stays_and_gets_old() -> None:
    frames = tracker(leap_time=1.0)
    see(frames, "cup", HOME, 0.0)
    for k in range(1, 20):
        see(frames, "cup", FLIPS["turned"], 0.03 * k)
        known = frames.update(ns(0.03 * k))[0]
        np.testing.assert_array_equal(known.pose, HOME)
    assert known.status.name == "HELD"
    assert frames.health(ns(0.6))["cup"].age == pytest.approx(0.6)


def test_rate_noise_and_frozen_numbers_are_told() -> None:
    frames, random = tracker(), np.random.default_rng(0)
    for k in range(90):
        see(frames, "cup", HOME + [*(1e-3 * random.normal(size=3)), 0, 0, 0, 0], k / 30)
    health = frames.health(ns(3.0))["cup"]
    assert health.rate == pytest.approx(30.0, rel=1e-3) and health.refused == {} and not health.doubts
    assert 0.5e-3 < health.noise[0] < 2e-3
    for k in range(90, 130):
        see(frames, "cup", HOME, k / 30)
        see(frames, "plate", HOME + [0, 0, k / 300, 0, 0, 0, 0] if k < 60 else HOME, k / 30)
    told = frames.health(ns(130 / 30))
    assert "possibly frozen: the same numbers for 1.3 s with new stamps" in told["cup"].doubts[0]
    assert not told["plate"].doubts, "what never trembled may rest"


def test_lengths_of_quaternions_and_magnitudes_are_told() -> None:
    frames = tracker()
    see(frames, "cup", HOME * [1000, 1000, 1000, 1.3, 1.3, 1.3, 1.3], 0.0)
    notes = frames.health(ns(0.0))["cup"].notes
    assert "1 quaternions were not of length 1" in notes[0] and "lies 547.7 m from the origin" in notes[1]
