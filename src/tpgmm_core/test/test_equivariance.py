# SPDX-License-Identifier: Apache-2.0
"""No retrieval method knows where the origin of the world is, or which sign a quaternion has.

All of `ALL_METHODS` are held to this, for a point in the plane, for a hand, and for two hands.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from random_problems import random_gaussian, random_quaternion
from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM, Demonstration, Frame, Gaussian, Manifold
from tpgmm_core.common.types import Array
from tpgmm_core.lqr.double_integrator import double_integrator_gains
from tpgmm_core.retrieval.methods import ALL_METHODS, METHODS, make_retrieval
from tpgmm_core.retrieval.recipe import Recipe
from wiping import shown_for
from worlds import assert_moved, moved, planar_demonstrations, planar_frame, planar_situation, random_world

TOLERANCE = 1e-9
TICK_NS = 20_000_000
PLANE = 0
MANIFOLDS = {
    PLANE: Manifold.parse("R1 x R2"),
    1: Manifold.parse("R1 x R3 x S3"),
    2: Manifold.parse("R1 x R3 x S3 x R3 x S3"),
}
"""By the number of hands, of which a point in the plane has none."""
HELD = np.array([0.0, 0.3, 0.1, 0.0, 0.0, np.sin(0.4), np.cos(0.4)])
"""The second hand's pose, as the first one sees it."""


def signs(hands: int, first: float, second: float = 1.0) -> Array:
    """Of [time, pose] or [time, pose, pose], by quaternion."""
    return np.concatenate([[1.0], np.ones(3), np.full(4, first), np.ones(3), np.full(4, second)])[: 1 + 7 * hands]


def over_hands(frames: Mapping[str, Frame], hands: int) -> dict[str, Frame]:
    """Frames over [time, pose], which all hands are seen from."""
    return {
        name: Frame.stacked([Frame(frame.A[1:, 1:], frame.b[1:])] * hands).with_time() for name, frame in frames.items()
    }


def beside(pose: Array, hands: int) -> Array:
    """Poses (..., 7) of the first hand, with the second one that goes along with it."""
    hand = Frame.from_pose(pose[..., :3], pose[..., 3:])
    return np.concatenate([pose, hand.A @ HELD + hand.b], axis=-1)[..., : 7 * hands]


@cache
def demonstrations(method: str, hands: int) -> tuple[Demonstration, ...]:
    if hands == PLANE:
        return shown_for(method, planar_demonstrations())
    return tuple(
        Demonstration(d.times, np.column_stack([d.times, beside(d.data[:, 1:], hands)]), over_hands(d.frames, hands))
        for d in shown_for(method, reaching_demonstrations(8))
    )


def learned_from(method: str, hands: int, shown: tuple[Demonstration, ...]) -> TPGMM:
    recipe = Recipe.of({"n_components": 3, "reg_covar": 1e-5, "retrieval": method})
    return recipe.learn(shown, MANIFOLDS[hands])


@cache
def learned(method: str, hands: int) -> TPGMM:
    return learned_from(method, hands, demonstrations(method, hands))


def situations(hands: int) -> tuple[dict[str, Frame], dict[str, Frame], Array]:
    """Before and after the object was moved; and a robot that is not where it ought to be."""
    if hands == PLANE:
        before, start = planar_situation(), np.array([-0.2, 0.4])
        return before, before | {"goal": planar_frame(1.0, -0.2, -0.4).with_time()}, start
    start = place(0.1, 0.2, 0.3)
    before, after = (
        over_hands(frames_at(start=start, object=place(*there)), hands)
        for there in ((0.6, -0.2, -0.4), (0.5, 0.1, 0.2))
    )
    return before, after, beside(place(0.12, 0.17, 0.4), hands)


def run(model: TPGMM, before: dict[str, Frame], after: dict[str, Frame], state: Array) -> list[Gaussian]:
    """References and their horizons; the object moves on the way, and the robot stays behind at first."""
    retrieval = make_retrieval(model)
    retrieval.start(0, state)
    found: list[Gaussian] = []
    here = state
    for i in range(1, 90):
        reference = retrieval.step(i * TICK_NS, before if i < 40 else after, here)
        here = state if i < 10 else reference.gaussian.mean
        if i % 4 == 0:
            found += [reference.gaussian, *reference.horizon]
    return found + retrieval.horizon(3, 0.1)


@pytest.mark.parametrize("hands", MANIFOLDS)
@pytest.mark.parametrize("method", ALL_METHODS)
def test_moving_the_world_moves_what_is_retrieved(method: str, hands: int) -> None:
    rng = np.random.default_rng(5)
    model = learned(method, hands)
    before, after, state = situations(hands)
    expected = run(model, before, after, state)
    for _ in range(2):
        world = random_world(2, rng) if hands == PLANE else Frame.stacked([random_world(7, rng)] * hands)
        found = run(model, moved(world, before), moved(world, after), world.A @ state + world.b)
        assert_moved(world, expected, found, TOLERANCE)


@pytest.mark.parametrize("hands", [1, 2])
@pytest.mark.parametrize("method", ALL_METHODS)
def test_signs_of_quaternions_change_nothing(method: str, hands: int) -> None:
    """Neither those of demonstrations, one by one, nor those of the frames, nor those of the robot's state."""
    rng = np.random.default_rng(6)
    before, after, state = situations(hands)
    expected = run(learned(method, hands), before, after, state)
    flipped = []
    for d in demonstrations(method, hands):
        data = d.data * np.stack([signs(hands, *rng.choice([-1.0, 1.0], 2)) for _ in d.times])
        flipped.append(
            Demonstration(d.times, data, {name: turned(frame, rng, hands) for name, frame in d.frames.items()})
        )
    before, after = ({name: turned(f, rng, hands) for name, f in frames.items()} for frames in (before, after))
    found = run(learned_from(method, hands, tuple(flipped)), before, after, state * signs(hands, -1.0, -1.0)[1:])
    same = Frame(np.eye(7 * hands), np.zeros(7 * hands))
    assert_moved(same, expected, found, TOLERANCE)


@pytest.mark.parametrize("method", METHODS)
def test_the_second_hand_goes_where_it_belongs(method: str) -> None:
    """End to end on R1 x R3 x S3 x R3 x S3: both hands end as the object says, the second where the first holds it."""
    before, after, state = situations(2)
    end = run(learned(method, 2), before, after, state)[-1]
    goal = beside(place(0.5, 0.1, 0.2), 2)
    manifold = MANIFOLDS[2].subset(range(1, 15))
    assert end.manifold == manifold
    difference = manifold.log(goal, end.mean)
    assert np.abs(difference[[0, 1, 2, 6, 7, 8]]).max() < 0.05 and np.abs(difference[[3, 4, 5, 9, 10, 11]]).max() < 0.1


@pytest.mark.parametrize("space", ["R3 x S3", "S3 x S3", "R3 x S3 x R3 x S3"])
def test_a_linear_quadratic_regulator_in_the_tangent_space_moves_with_the_world(space: str) -> None:
    """Two hands too: u = K_P log_x(x_ref) - K_V xdot, from far away, ends at the reference, wherever the world is."""
    manifold = Manifold.parse(space)
    rng = np.random.default_rng(7)
    reference = random_gaussian(rng, manifold)
    start = manifold.exp(reference.mean, rng.uniform(-1.0, 1.0, manifold.tangent_dim))
    turn = Frame.from_pose(rng.normal(size=3), random_quaternion(rng))
    of_factor = {"R": Frame(turn.A[:3, :3], turn.b[:3]), "S": Frame(turn.A[3:, 3:], np.zeros(4))}
    world = Frame.stacked([of_factor[kind] for kind, _ in manifold.factors])

    def regulated(reference: Gaussian, x: Array) -> list[Gaussian]:
        gains = double_integrator_gains(reference.precision, min_stiffness=4.0)
        rate, path, dt = np.zeros(manifold.tangent_dim), [], 0.01
        for _ in range(600):
            rate = rate + dt * (gains.stiffness @ manifold.log(x, reference.mean) - gains.damping @ rate)
            x = manifold.exp(x, dt * rate)
            path.append(Gaussian(x, reference.covariance, manifold))
        return path

    before = regulated(reference, start)
    np.testing.assert_allclose(manifold.log(before[-1].mean, reference.mean), 0.0, atol=1e-3)
    assert_moved(world, before, regulated(reference.transform(world), world.A @ start + world.b), TOLERANCE)
    opposite = Gaussian(-reference.mean, reference.covariance, manifold) if space == "S3 x S3" else reference
    assert_moved(Frame(np.eye(manifold.dim), np.zeros(manifold.dim)), before, regulated(opposite, start), TOLERANCE)


def turned(frame: Frame, rng: np.random.Generator, hands: int) -> Frame:
    """The same frame, of quaternions of the opposite sign."""
    return Frame(frame.A * signs(hands, *rng.choice([-1.0, 1.0], 2)), frame.b)
