# SPDX-License-Identifier: Apache-2.0
"""Demonstrations that pass an obstacle on the left or on the right: found, kept apart, chosen, never averaged."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reaching import reaching_demonstrations
from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.modes import find_modes
from tpgmm_core.learning.promp import ProMPTPGMM
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.retrieval.methods import load_model, make_retrieval
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.time_steps import TimeSteps
from worlds import moved, random_world

RADIUS = 0.1
LEFT, RIGHT = 1.0, -1.0
TICK_NS = 10_000_000


def past(seed: int, side: float, shift: float = 0.0) -> Demonstration:
    """A hand in the plane goes from a start to a goal, past an obstacle between them on one side, 0.2 m off.

    The obstacle is `shift` (m) to the left of the straight way.
    """
    rng = np.random.default_rng(seed)
    start = np.array([0.0, 0.0]) + rng.uniform(-0.1, 0.1, 2)
    goal = np.array([1.0, 0.2]) + rng.uniform(-0.1, 0.1, 2)
    along = (goal - start) / np.linalg.norm(goal - start)
    across = np.array([-along[1], along[0]])
    obstacle = 0.5 * (start + goal) + (rng.uniform(-0.02, 0.02) + shift) * across
    u = np.linspace(0.0, 1.0, 80)
    way = (u**3 * (10.0 - 15.0 * u + 6.0 * u**2))[:, None]
    aside = (obstacle - 0.5 * (start + goal)) @ across + side * 0.2
    path = (1.0 - way) * start + way * goal + aside * np.sin(np.pi * way) ** 2 * across
    path += 0.003 * np.sin(2.0 * np.pi * rng.uniform(1.0, 2.0) * u)[:, None] * rng.normal(size=2)
    angle = np.arctan2(along[1], along[0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    places = {"start": start, "obstacle": obstacle, "goal": goal}
    frames = {name: Frame(turn, place).with_time() for name, place in places.items()}
    return Demonstration(2.0 * u, np.column_stack([2.0 * u, path]), frames)


@cache
def half_on_each_side(per_side: int = 4) -> tuple[Demonstration, ...]:
    return tuple(past(seed, side) for seed in range(per_side) for side in (LEFT, RIGHT))


@cache
def learned(kind: type[TimeStepTPGMM] = TimeStepTPGMM) -> TimeStepTPGMM:
    model = kind(manifold="R1 x R2").fit(half_on_each_side())
    model.metadata_ = {"duration_s": 2.0, "retrieval": "time_steps"}
    return model


def side_of(path: Array, situation: Demonstration) -> float:
    """1 left, -1 right of the obstacle, 0 where the path comes within its radius."""
    obstacle, turn = situation.frames["obstacle"].b[1:], situation.frames["obstacle"].A[1:, 1:]
    off = (path - obstacle) @ turn
    nearest = off[np.argmin(np.linalg.norm(off, axis=1))]
    return float(np.sign(nearest[1])) if np.linalg.norm(nearest) > RADIUS else 0.0


@pytest.mark.parametrize("kind", [TimeStepTPGMM, ProMPTPGMM])
def test_both_ways_are_found_and_each_is_gone_as_a_whole(kind: type[TimeStepTPGMM]) -> None:
    model = learned(kind)
    assert model.modes_[0] != model.modes_[1]
    np.testing.assert_array_equal(model.modes_, np.tile(model.modes_[:2], 4))
    movement, sides = TimeSteps(model), set()
    for mode in (1, 2):
        movement.choose(mode)
        for seed in range(50, 56):
            new = past(seed, LEFT)
            movement.situate(new.frames)
            path, covariances, _ = movement.at(new.times)
            side = side_of(path, new)
            assert side == (LEFT if model.modes_[0] == mode - 1 else RIGHT) and movement.mode == mode
            sides.add(side)
            shown = past(seed, side)
            assert np.linalg.norm(path - shown.data[:, 1:], axis=1).max() < 0.05
            assert np.sqrt(covariances[40].max()) < 0.1  # sure of its way
    assert sides == {LEFT, RIGHT}


def test_without_telling_them_apart_the_way_goes_through_the_obstacle() -> None:
    """What the others are tested against: one mean of both ways."""
    movement = TimeSteps(TimeStepTPGMM(manifold="R1 x R2", modes=1).fit(half_on_each_side()))
    new = past(50, LEFT)
    movement.situate(new.frames)
    assert side_of(movement.at(new.times)[0], new) == 0.0 and movement.mode == 1


def test_the_situation_chooses_where_it_tells() -> None:
    """An obstacle that stands left of the way was passed on the right, and the other way round."""
    shown = [past(seed, side, -side * 0.08) for seed in range(5) for side in (LEFT, RIGHT)]
    movement = TimeSteps(TimeStepTPGMM(manifold="R1 x R2").fit(shown))
    for seed in range(50, 58):
        for side in (LEFT, RIGHT):
            new = past(seed, side, -side * 0.08)
            movement.situate(new.frames)
            assert side_of(movement.at(new.times)[0], new) == side


def test_a_movement_keeps_its_way_whatever_moves_meanwhile() -> None:
    shown = [past(seed, side, -side * 0.08) for seed in range(5) for side in (LEFT, RIGHT)]
    recipe = Recipe.of({"retrieval": "time_steps"})
    retrieval = make_retrieval(recipe.learn(shown, "R1 x R2"))
    before, after = past(60, LEFT, -0.08), past(60, RIGHT, 0.08)
    retrieval.start(0)
    path = []
    for i in range(1, 230):
        frames = before.frames if i < 60 else after.frames
        path.append(retrieval.step(i * TICK_NS, frames).gaussian.mean)
    assert side_of(np.array(path), after) == LEFT
    assert np.linalg.norm(path[-1] - after.frames["goal"].b[1:]) < 0.02
    retrieval.start(0)  # the next movement chooses anew
    path = [retrieval.step(i * TICK_NS, after.frames).gaussian.mean for i in range(1, 230)]
    assert side_of(np.array(path), after) == RIGHT


def test_one_way_alone_is_learned_where_it_is_asked_for() -> None:
    left = 1 + int(learned().modes_[0])
    model = TimeStepTPGMM(manifold="R1 x R2", mode=left).fit(half_on_each_side())
    new = past(70, RIGHT)
    movement = TimeSteps(model)
    movement.situate(new.frames)
    assert model.shown_ is None and side_of(movement.at(new.times)[0], new) == LEFT
    with pytest.raises(ValueError, match="mode is 3; expected 1 to 2"):
        TimeStepTPGMM(manifold="R1 x R2", mode=3).fit(half_on_each_side())
    with pytest.raises(ValueError, match="mode is 3; expected 1 to 2"):
        TimeSteps(learned()).choose(3)


def test_ways_are_saved_with_the_model(tmp_path: Path) -> None:
    learned().save(tmp_path / "model.tpgmm")
    loaded = load_model(tmp_path / "model.tpgmm")
    assert isinstance(loaded, TimeStepTPGMM)
    np.testing.assert_array_equal(loaded.modes_, learned().modes_)
    movement, new = TimeSteps(loaded), past(50, LEFT)
    for mode in (1, 2):
        movement.choose(mode)
        movement.situate(new.frames)
        assert side_of(movement.at(new.times)[0], new) != 0.0


def test_a_world_that_is_elsewhere_is_divided_alike() -> None:
    worlds = [random_world(2, np.random.default_rng(i)) for i in range(8)]
    shown = []
    for world, d in zip(worlds, half_on_each_side(), strict=True):
        data = np.column_stack([d.times, d.data[:, 1:] @ world.A.T + world.b])
        shown.append(Demonstration(d.times, data, moved(world, dict(d.frames))))
    np.testing.assert_array_equal(TimeStepTPGMM(manifold="R1 x R2").fit(shown).modes_, learned().modes_)


@pytest.mark.parametrize("seed", range(6))
def test_demonstrations_of_one_way_are_one_way(seed: int) -> None:
    rng = np.random.default_rng(seed)
    several = [past(int(s), LEFT) for s in rng.integers(0, 10_000, 10)]
    assert TimeStepTPGMM(manifold="R1 x R2").fit(several).modes_.max() == 0
    reaching = TimeStepTPGMM(manifold="R1 x R3 x S3").fit(reaching_demonstrations(20)[seed : seed + 10])
    assert reaching.modes_.max() == 0


def test_two_that_went_another_way_are_too_few_for_a_way() -> None:
    shown = [past(seed, LEFT) for seed in range(6)] + [past(seed, RIGHT) for seed in range(2)]
    assert TimeStepTPGMM(manifold="R1 x R2").fit(shown).modes_.max() == 0


def test_demonstrations_that_are_all_the_same_or_partly_hidden_from_all_frames_are_one_way() -> None:
    same = [past(3, LEFT)] * 7
    centres = [frame.project(same[0].data)[:, 1:] for frame in same[0].frames.values()]
    nothing = [np.zeros((80, 2, 2))] * 3
    assert find_modes(centres, nothing, same, Manifold.parse("R2")).max() == 0
    seen = np.arange(80) > 15
    hidden = [Demonstration(d.times, d.data, d.frames, dict.fromkeys(d.frames, seen)) for d in half_on_each_side()]
    np.testing.assert_array_equal(TimeStepTPGMM(manifold="R1 x R2").fit(hidden).modes_, learned().modes_)


@pytest.mark.parametrize(("name", "value"), [("modes", 2), ("modes", -1), ("mode", -1), ("mode", 1.5)])
def test_numbers_that_cannot_be_are_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"{name} is "):
        TimeStepTPGMM(**{name: value}).fit(half_on_each_side())  # type: ignore[arg-type]
