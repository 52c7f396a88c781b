# SPDX-License-Identifier: Apache-2.0
"""Cameras whose transform is inverted: found where it shows, and in no good recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from long_tests import mostly_long
from tpgmm_core.doubt.cameras import doubts_of_cameras
from tpgmm_core.doubt.doubts import RawDemonstration
from tpgmm_core.doubt.judging import judged
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse

IN_BASE = np.array([0.9, -0.5, 1.1, *quaternion.normalize([0.7, -0.6, 0.2, 0.3])])
ON_HAND = np.array([0.03, -0.06, 0.08, *quaternion.exp([0.2, 0.1, 1.4])])
"""Where a camera is."""
TABLE = np.array([0.0, 0.0, 1.0])


def reaching(seed: int, turn: float = 0.8, matters: bool = True) -> RawDemonstration:
    """A hand goes to an object on a table, with the turns that arms make."""
    rng = np.random.default_rng(seed)
    share = np.linspace(0.0, 1.0, 60)[:, None]
    place, elsewhere = (np.array([0.5, 0.0, 0.1, *quaternion.exp(rng.uniform(-turn, turn) * TABLE)]) for _ in range(2))
    place[:2] += rng.uniform(-0.2, 0.2, 2)
    elsewhere[:2] += rng.uniform(-0.2, 0.2, 2)
    goal = compose(place if matters else elsewhere, np.array([0.02, 0.05, 0.1, *quaternion.exp([np.pi, 0.0, 0.0])]))
    hand = np.tile(goal, (60, 1))
    hand[:, :3] += (1.0 - share) ** 2 * rng.uniform(0.1, 0.3, 3)
    hand[:, 3:] = quaternion.multiply(hand[:, 3:], quaternion.exp(np.sin(3.0 * share) * [0.4, -0.3, 0.2]))
    hand[:, :3] += rng.normal(0.0, 5e-4, (60, 3))
    return RawDemonstration(f"demo_{seed}", 0.1 * np.arange(60), hand, {"object": np.tile(place, (60, 1))})


def seen_by(one: RawDemonstration, camera: np.ndarray, given: np.ndarray, noise: float = 1e-3) -> RawDemonstration:
    """As a camera (7,) or (T, 7) sees the object, which a program takes for one that is elsewhere."""
    rng = np.random.default_rng(len(one.name))
    seen = compose(inverse(camera), one.frames["object"])
    seen[:, :3] += rng.normal(0.0, noise, (len(seen), 3))
    return replace(one, frames={"object": compose(given, seen)})


def fixed(one: RawDemonstration, inverted: bool) -> RawDemonstration:
    return seen_by(one, IN_BASE, inverse(IN_BASE) if inverted else IN_BASE)


def on_hand(one: RawDemonstration, inverted: bool) -> RawDemonstration:
    camera = compose(one.movement, ON_HAND)
    return seen_by(one, camera, compose(one.movement, inverse(ON_HAND)) if inverted else camera)


@pytest.mark.parametrize("count", [5, 8, 40])
@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_a_fixed_camera_that_is_given_inverted_is_doubted(count: int, turn: float) -> None:
    several = [reaching(seed, turn) for seed in range(count)]
    assert not doubts_of_cameras([fixed(one, inverted=False) for one in several])
    found = judged([fixed(one, inverted=True) for one in several])
    (doubt,) = [doubt for doubt in found if doubt.kind == "origin"]
    assert not doubt.refuses and "the frame object and the movement seem to be in different base" in doubt.text


@pytest.mark.parametrize("count", [5, 8, 40])
def test_a_camera_on_the_hand_that_is_given_inverted_is_doubted(count: int) -> None:
    several = [reaching(seed) for seed in range(count)]
    assert not doubts_of_cameras([on_hand(one, inverted=False) for one in several])
    (doubt,) = doubts_of_cameras([on_hand(one, inverted=True) for one in several])
    assert "while the hand does, and would rest within 0.00" in doubt.text


@pytest.mark.parametrize("first", mostly_long(range(0, 200, 10), 0, 10, 20, 30))
def test_objects_that_do_not_matter_are_not_doubted(first: int) -> None:
    """They stand anywhere beside what the hand goes to."""
    for count in (5, 6, 10):
        assert not doubts_of_cameras([reaching(first + seed, matters=False) for seed in range(count)])


def test_an_object_that_is_carried_or_moved_by_another_is_not_doubted() -> None:
    several = []
    for seed in range(6):
        one = reaching(seed)
        moved = one.frames["object"].copy()
        if seed % 2:
            moved[:, :3] += np.linspace(0.0, 0.3, 60)[:, None] * [1.0, 0.2, 0.0]
        else:
            moved[30:] = compose(one.movement[30:], compose(inverse(one.movement[30]), moved[30]))
        several.append(replace(one, frames={"object": moved}))
    assert not doubts_of_cameras(several)
