# SPDX-License-Identifier: Apache-2.0
"""Quaternions with w first are suspected where something tells so, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tpgmm_core.doubt.doubts import RawDemonstration
from tpgmm_core.doubt.judging import judged
from tpgmm_core.doubt.quaternion_order import doubts_of_quaternion_order, w_first
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose

DOWN = quaternion.exp([np.pi, 0.0, 0.0])
"""A hand that points downwards; in the wrong order, no rotation."""


def reaching(seed: int, grasp: list[float], tilt: float = 0.0, turn: float = 0.8) -> RawDemonstration:
    """A hand goes to a place in an object's frame, turned as that is, from somewhere."""
    rng = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, 60)[:, None] ** 2
    rotation = quaternion.multiply(
        quaternion.exp([0.0, 0.0, rng.uniform(-turn, turn)]), quaternion.exp(rng.normal(0.0, tilt, 3))
    )
    place = np.array([*rng.uniform(-0.2, 0.2, 2), 0.1, *rotation])
    goal = compose(place[None], np.array([[*grasp, *DOWN]]))[0]
    movement = np.tile(goal, (60, 1))
    movement[:, :3] += (1.0 - share) * rng.uniform(0.1, 0.3, 3) + rng.normal(0.0, 5e-4, (60, 3))
    movement[:, 3:] = quaternion.multiply(movement[:, 3:], quaternion.exp((1.0 - share) * [0.0, 0.0, 0.4]))
    poses = np.tile(place, (60, 1))
    return RawDemonstration(f"demo_{seed}", np.linspace(0.0, 3.0, 60), movement, {"object": poses})


def miswritten(one: RawDemonstration, hand: bool = True, frames: bool = True) -> RawDemonstration:
    """The same from a program that writes w first."""

    def turned(poses: np.ndarray) -> np.ndarray:
        return np.hstack([poses[:, :3], np.roll(poses[:, 3:], 1, axis=1)])

    return replace(
        one,
        movement=turned(one.movement) if hand else one.movement,
        frames={name: turned(poses) if frames else poses for name, poses in one.frames.items()},
    )


GROUPS = {
    "turned about the vertical": {"grasp": [0.0, 0.05, 0.1]},
    "turned anyhow": {"grasp": [0.02, 0.05, 0.1], "tilt": 0.4},
    "grasped from above": {"grasp": [0.0, 0.0, 0.1], "tilt": 0.2},
}


@pytest.mark.parametrize("settings", GROUPS.values(), ids=GROUPS)
def test_w_first_is_suspected_and_x_first_is_not(settings: dict[str, object]) -> None:
    right = [reaching(seed, **settings) for seed in range(6)]  # type: ignore[arg-type]
    assert not doubts_of_quaternion_order(right)
    (doubt,) = doubts_of_quaternion_order([miswritten(one) for one in right])
    assert doubt.kind == "order" and not doubt.refuses and not doubt.about
    assert "--orientation wxyz" in doubt.text and "object: " in doubt.text and "the movement: " in doubt.text
    (only_hand,) = doubts_of_quaternion_order([miswritten(one, frames=False) for one in right])
    assert "the movement: " in only_hand.text and "object: " not in only_hand.text
    assert doubt in judged([miswritten(one) for one in right])


def test_what_was_not_measured_is_suspected_by_its_numbers() -> None:
    right = [reaching(seed, [0.0, 0.0, 0.1], turn=0.0) for seed in range(2)]
    points = [
        replace(one, movement=np.hstack([one.movement[:, :3], np.tile([1.0, 0, 0, 0], (60, 1))])) for one in right
    ]
    (doubt,) = doubts_of_quaternion_order(points)
    assert "the movement: is 1 0 0 0 in every sample" in doubt.text
    near = [reaching(seed, [0.0, 0.0, 0.1], turn=0.02, tilt=0.02) for seed in range(2)]
    level = [
        replace(one, movement=np.hstack([one.movement[:, :3], quaternion.multiply(one.movement[:, 3:], DOWN)]))
        for one in near
    ]
    assert not doubts_of_quaternion_order(level)
    (doubt,) = doubts_of_quaternion_order([miswritten(one) for one in level])
    assert "all begin near 1 0 0 0" in doubt.text


def test_a_hand_that_points_downwards_and_objects_that_do_not_matter_are_not_suspected() -> None:
    alone = [replace(reaching(seed, [0.0, 0.0, 0.1]), frames={}) for seed in range(6)]
    assert not doubts_of_quaternion_order(alone)
    rng = np.random.default_rng(0)
    for _ in range(20):
        any_way = [reaching(int(rng.integers(1 << 30)), list(rng.uniform(-0.2, 0.2, 3)), 2.0, 3.0) for _ in range(5)]
        others = any_way[1:] + any_way[:1]
        assert not doubts_of_quaternion_order(any_way)
        strangers = [replace(one, frames=other.frames) for one, other in zip(any_way, others, strict=True)]
        assert not doubts_of_quaternion_order(strangers)


def test_the_other_order_is_that_of_w_first() -> None:
    np.testing.assert_array_equal(w_first(np.array([1.0, 2.0, 3.0, 4.0])), [2.0, 3.0, 4.0, 1.0])


def test_one_recording_in_another_order_than_the_others_is_named() -> None:
    several = [reaching(seed, [0.0, 0.05, 0.1]) for seed in range(6)]
    assert not doubts_of_quaternion_order([*several[:3], miswritten(several[3], frames=False), *several[4:]])
    (doubt,) = doubts_of_quaternion_order([*several[:3], miswritten(several[3]), *several[4:]])
    assert doubt.about == ("demo_3",) and "object: " in doubt.text


def test_many_recordings_are_gone_through_in_time_that_grows_with_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each is held against all others in one call; not once more for each that may be left out."""
    calls = 0

    def counted(*poses: np.ndarray, measure: Callable[..., np.ndarray] = quaternion.angle_between) -> np.ndarray:
        nonlocal calls
        calls += 1
        return measure(*poses)

    monkeypatch.setattr(quaternion, "angle_between", counted)
    needed = []
    for count in (20, 40):
        several, calls = [reaching(seed, [0.0, 0.05, 0.1]) for seed in range(count)], 0
        (doubt,) = doubts_of_quaternion_order([*several[:3], miswritten(several[3]), *several[4:]])
        assert doubt.about == ("demo_3",)
        needed.append(calls)
    assert needed[1] < 2.5 * needed[0]
