# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from random_problems import random_quaternion
from reaching import reaching_model
from tpgmm_core import TPGMM, Demonstration, Frame, Manifold, quaternion
from tpgmm_core.quaternion import Array
from tpgmm_core.retrieval.decay import DecayLaw, DecayStep, DecaySystem
from worlds import DURATION, assert_moved, moved, planar_demonstrations, planar_frame, planar_situation, random_world

LAW = DecayLaw()
POSES = "R1 x R3 x S3"


@cache
def planar_model() -> TPGMM:
    return TPGMM(5, init="bins", reg_covar=1e-6).fit([LAW.encode(d) for d in planar_demonstrations()])


@cache
def pose_model() -> TPGMM:
    demonstrations = [LAW.encode(d, POSES) for d in pose_demonstrations()]
    return TPGMM(3, init="bins", reg_covar=1e-5, manifold=POSES).fit(demonstrations)


@cache
def pose_demonstrations() -> tuple[Demonstration, ...]:
    """[time, pose] from a start to an object, both turned at random, at rest at both; signs as they come."""
    rng = np.random.default_rng(7)
    u = np.linspace(0.0, 1.0, 80)
    blend = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    demonstrations = []
    for _ in range(6):
        start, goal = (0.2 * rng.normal(size=3), np.array([0.6, 0.0, 0.2]) + 0.2 * rng.normal(size=3))
        p, q = quaternion.exp(0.5 * rng.normal(size=(2, 3)))
        positions = start + blend[:, None] * (goal - start)
        turns = quaternion.slerp(p, q, blend) * rng.choice([-1.0, 1.0], (80, 1))
        frames = {"start": Frame.from_pose(start, p).with_time(), "object": Frame.from_pose(goal, q).with_time()}
        demonstrations.append(Demonstration(2.0 * u, np.column_stack([2.0 * u, positions, turns]), frames))
    return tuple(demonstrations)


def run(system: DecaySystem, frames: dict[str, Frame], duration: float, dt: float = 0.01) -> list[DecayStep]:
    return [system.step(dt, frames) for _ in range(round(duration / dt))]


def positions(steps: list[DecayStep]) -> Array:
    return np.stack([step.position for step in steps])


def test_a_demonstration_is_followed_again() -> None:
    for demonstration in planar_demonstrations():
        start = demonstration.data[0, 1:]
        dt = DURATION / 200
        path = positions(
            run(DecaySystem(planar_model(), LAW, DURATION, start), dict(demonstration.frames), DURATION, dt)
        )
        shown = np.stack(
            [np.interp(dt * np.arange(1, 201), demonstration.times, x) for x in demonstration.data[:, 1:].T], axis=1
        )
        assert np.sqrt(np.mean(np.sum((path - shown) ** 2, axis=1))) < 0.04


def test_the_attractor_of_a_spring_solution_is_where_it_was() -> None:
    """A movement that the spring itself makes towards a fixed point: encoding finds the point."""
    u = np.linspace(0.0, 1.0, 400)
    rate = np.sqrt(LAW.stiffness)
    goal = np.array([0.3, -0.2])
    x = goal * (1.0 - (1.0 + rate * u) * np.exp(-rate * u))[:, None]
    times = 5.0 * u
    frames = {"goal": planar_frame(0.0, 0.0, 0.0).with_time()}
    encoded = LAW.encode(Demonstration(times, np.column_stack([times, x]), frames), window=3)
    np.testing.assert_allclose(encoded.data[5:-5, 1:], np.tile(goal, (390, 1)), atol=1e-3)
    np.testing.assert_allclose(encoded.data[:, 0], np.exp(-LAW.decay_rate * u))


@pytest.mark.parametrize("duration", [0.5, 2.0, 30.0])
def test_the_goal_is_reached_from_anywhere_and_held(duration: float) -> None:
    rng = np.random.default_rng(0)
    frames = planar_situation()
    goal = planar_model().adapt(frames).condition([0], [np.exp(-LAW.decay_rate)])
    for _ in range(5):
        system = DecaySystem(planar_model(), LAW, duration, rng.normal(size=2), rng.normal(size=2))
        steps = run(system, frames, 3.0 * duration, duration / 100)
        np.testing.assert_allclose(steps[-1].position, goal.mean, atol=1e-9)
        np.testing.assert_allclose(steps[-1].velocity, 0.0, atol=1e-9)
        np.testing.assert_allclose(system.goal(frames).mean, goal.mean, atol=1e-12)
    assert np.linalg.norm(goal.mean - frames["goal"].b[1:]) < 0.01


def test_a_pose_is_reached_too() -> None:
    demonstration = pose_demonstrations()[0]
    system = DecaySystem(pose_model(), LAW, 1.0, demonstration.data[0, 1:])
    end = run(system, dict(demonstration.frames), 3.0, 0.005)[-1]
    shown = demonstration.data[-1, 1:]
    assert np.linalg.norm(end.position[:3] - shown[:3]) < 0.03
    assert quaternion.angle_between(end.position[3:], shown[3:]) < 0.05
    np.testing.assert_allclose(np.linalg.norm(end.position[3:]), 1.0, atol=1e-12)


@pytest.mark.parametrize("space", ["plane", "poses"])
def test_moving_the_world_moves_the_movement(space: str) -> None:
    rng = np.random.default_rng(1)
    if space == "plane":
        model, frames, dimensions, start = planar_model(), planar_situation(), 2, np.array([-0.2, 0.4])
        turn = np.eye(2)
    else:
        model, frames, dimensions = pose_model(), dict(pose_demonstrations()[0].frames), 7
        start = np.r_[0.1, 0.2, 0.3, random_quaternion(rng)]
    for _ in range(3):
        world = random_world(dimensions, rng)
        velocity = 0.3 * rng.normal(size=model.manifold_.tangent_dim - 1)
        manifold = model.manifold_.subset(range(1, model.manifold_.dim))
        turn = manifold.tangent_map(world.A)
        before = run(DecaySystem(model, LAW, 1.0, start, velocity), frames, 1.5)
        elsewhere = DecaySystem(model, LAW, 1.0, world.A @ start + world.b, turn @ velocity)
        after = run(elsewhere, moved(world, frames), 1.5)
        assert_moved(world, [s.attractor for s in before], [s.attractor for s in after])
        for a, b in zip(before, after, strict=True):
            np.testing.assert_allclose(manifold.log(world.A @ a.position + world.b, b.position), 0.0, atol=1e-9)
            np.testing.assert_allclose(turn @ a.velocity, b.velocity, atol=1e-9)


def test_signs_of_quaternions_do_not_matter() -> None:
    frames = dict(pose_demonstrations()[0].frames)
    start = pose_demonstrations()[0].data[0, 1:]
    flip = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0])
    one, other = (run(DecaySystem(pose_model(), LAW, 1.0, s), frames, 1.0) for s in (start, flip * start))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(Manifold.parse("R3 x S3").log(a.position, b.position), 0.0, atol=1e-9)


def test_the_path_does_not_depend_on_the_duration() -> None:
    start = np.array([-0.1, 0.3])
    fast, slow = (run(DecaySystem(planar_model(), LAW, d, start), planar_situation(), d, d / 200) for d in (1.0, 7.0))
    np.testing.assert_allclose(positions(fast), positions(slow), atol=1e-12)
    for a, b in zip(fast, slow, strict=True):
        np.testing.assert_allclose(a.velocity, 7.0 * b.velocity, atol=1e-9)


def test_changing_the_duration_while_moving_keeps_the_path() -> None:
    start = np.array([-0.1, 0.3])
    plain = positions(run(DecaySystem(planar_model(), LAW, 2.0, start), planar_situation(), 2.0, 0.005))
    system = DecaySystem(planar_model(), LAW, 2.0, start)
    changed = run(system, planar_situation(), 0.8, 0.005)
    system.duration = 5.0
    changed += run(system, planar_situation(), 3.0, 0.005)
    assert system.phase == pytest.approx(1.0)
    for x in positions(changed):
        assert np.linalg.norm(plain - x, axis=1).min() < 0.01  # half of the longest step between two of its points
    np.testing.assert_allclose(changed[-1].position, plain[-1], atol=1e-3)


def test_a_goal_that_moves_is_followed_without_a_jump() -> None:
    before = planar_situation()
    after = before | {"goal": planar_frame(1.5, 0.5, -0.6).with_time()}
    system = DecaySystem(planar_model(), LAW, 2.0, [-0.1, 0.3])
    steps = run(system, before, 1.2, 0.001) + run(system, after, 4.0, 0.001)
    path = positions(steps)
    assert np.linalg.norm(path[-1] - [1.5, 0.5]) < 0.01
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.001
    assert np.abs(np.diff(speeds)).max() < 0.1  # m/s in 1 ms


def test_the_state_of_the_robot_counts_where_it_is_given() -> None:
    system = DecaySystem(planar_model(), LAW, 2.0, [-0.1, 0.3])
    run(system, planar_situation(), 0.5)
    held = system.step(1e-6, planar_situation(), state=([5.0, 5.0], [0.1, -0.2]))
    np.testing.assert_allclose(held.position, [5.0, 5.0], atol=1e-5)
    np.testing.assert_allclose(held.velocity, [0.1, -0.2], atol=1e-2)


def test_any_time_step_is_stable() -> None:
    for dt in (1e-4, 0.1, 10.0, 1e6):
        system = DecaySystem(planar_model(), LAW, 2.0, [10.0, -10.0], [1.0, 1.0])
        for _ in range(20):
            assert np.abs(system.step(dt, planar_situation()).position).max() < 20.0


def test_bad_input_is_refused_with_the_reason() -> None:
    for name in ("decay_rate", "stiffness"):
        for value in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(ValueError, match=name):
                DecayLaw(**{name: value})
    for duration in (0.0, np.nan):
        with pytest.raises(ValueError, match="duration"):
            DecaySystem(planar_model(), LAW, duration, [0.0, 0.0])
    with pytest.raises(ValueError, match="position \\(2,\\)"):
        DecaySystem(planar_model(), LAW, 1.0, [0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="norm"):
        DecaySystem(reaching_model(), LAW, 1.0, np.zeros(7))
    system = DecaySystem(planar_model(), LAW, 1.0, [0.0, 0.0])
    with pytest.raises(ValueError, match="dt"):
        system.step(0.0, planar_situation())
    with pytest.raises(ValueError, match="finite"):
        system.step(0.1, planar_situation(), state=([np.nan, 0.0], [0.0, 0.0]))
    with pytest.raises(ValueError, match="with_time"):
        system.step(0.1, {"goal": Frame(2.0 * np.eye(3), np.zeros(3))})
