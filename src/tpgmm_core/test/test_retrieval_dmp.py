# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reaching import reaching_model
from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.learning.endpoints import EndpointTPGMM
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.dmp import DmpParameters, DynamicMovementPrimitive
from worlds import DURATION, planar_demonstrations, planar_frame, planar_situation

LAW = DmpParameters()
POSES = "R1 x R3 x S3"


@cache
def planar_model(n_components: int = 5) -> EndpointTPGMM:
    model = EndpointTPGMM(n_components, init="bins", reg_covar=1e-6).fit(
        [LAW.encode(d) for d in planar_demonstrations()]
    )
    model.metadata_ = {"duration_s": DURATION}
    return model


@cache
def pose_model() -> EndpointTPGMM:
    demonstrations = [LAW.encode(d, POSES) for d in pose_demonstrations()]
    return EndpointTPGMM(3, init="bins", reg_covar=1e-5, manifold=POSES).fit(demonstrations)


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


def run(
    system: DynamicMovementPrimitive,
    frames: dict[str, Frame],
    seconds: float,
    dt: float = 0.01,
    begin: int = 0,
    robot: Array | None = None,
) -> list[Reference]:
    """References every dt, s; the first one dt after step `begin`."""
    return [system.step(round(1e9 * dt * (begin + i + 1)), frames, robot) for i in range(round(seconds / dt))]


def started(
    model: EndpointTPGMM, duration: float, start: Array | list[float] | None, **settings: float
) -> DynamicMovementPrimitive:
    system = DynamicMovementPrimitive(model, LAW, duration=duration, **settings)
    system.start(0, start)
    return system


def begun(
    model: EndpointTPGMM, duration: float, start: Array | list[float] | None, frames: dict[str, Frame]
) -> DynamicMovementPrimitive:
    """With a step at time 0."""
    system = started(model, duration, start)
    system.step(0, frames)
    return system


def positions(references: list[Reference]) -> Array:
    return np.stack([reference.gaussian.mean for reference in references])


def test_a_demonstration_is_followed_again() -> None:
    dt = DURATION / 200
    for demonstration in planar_demonstrations():
        frames = dict(demonstration.frames)
        path = positions(run(begun(planar_model(), DURATION, demonstration.data[0, 1:], frames), frames, DURATION, dt))
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
    for _ in range(5):
        system = begun(planar_model(), duration, rng.normal(size=2), frames)
        references = run(system, frames, 3.0 * duration, duration / 100)
        goal = system.goal(frames)
        np.testing.assert_allclose(references[-1].gaussian.mean, goal.mean, atol=1e-9)
        np.testing.assert_allclose(references[-1].velocity(), 0.0, atol=1e-9)
        assert references[-1].phase == 1.0
    assert np.linalg.norm(goal.mean - frames["goal"].b[1:]) < 0.01


@pytest.mark.parametrize("n_components", [3, 8, 15])
def test_many_components_do_not_pull_the_end_aside(n_components: int) -> None:
    frames = planar_situation()
    end = run(begun(planar_model(n_components), 2.0, [-0.1, 0.3], frames), frames, 5.0)[-1]
    assert np.linalg.norm(end.gaussian.mean - frames["goal"].b[1:]) < 1e-3


def test_a_pose_is_reached_too() -> None:
    demonstration = pose_demonstrations()[0]
    frames = dict(demonstration.frames)
    end = run(begun(pose_model(), 1.0, demonstration.data[0, 1:], frames), frames, 3.0)[-1].gaussian.mean
    shown = demonstration.data[-1, 1:]
    assert np.linalg.norm(end[:3] - shown[:3]) < 0.03
    assert quaternion.angle_between(end[3:], shown[3:]) < 0.05


def test_without_a_robot_it_begins_where_demonstrations_began() -> None:
    frames = planar_situation()
    first = begun(planar_model(), 2.0, None, frames).horizon(1, 1e-6)[0]
    assert np.linalg.norm(first.mean - frames["start"].b[1:]) < 0.01


def test_the_path_does_not_depend_on_the_duration() -> None:
    frames = planar_situation()
    fast, slow = (run(begun(planar_model(), d, [-0.1, 0.3], frames), frames, d, d / 200) for d in (1.0, 7.0))
    np.testing.assert_allclose(positions(fast), positions(slow), atol=1e-9)


def test_changing_duration_or_speed_keeps_the_path_and_does_not_jump() -> None:
    frames = planar_situation()
    plain = positions(run(begun(planar_model(), 2.0, [-0.1, 0.3], frames), frames, 2.5, 0.005))
    system = begun(planar_model(), 2.0, [-0.1, 0.3], frames)
    references = run(system, frames, 0.8, 0.005)
    system.duration = 5.0
    references += run(system, frames, 1.0, 0.005, begin=160)
    system.speed = 3.0
    references += run(system, frames, 3.0, 0.005, begin=360)
    assert references[-1].phase == 1.0
    path = positions(references)
    for x in path:
        assert np.linalg.norm(plain - x, axis=1).min() < 0.01  # half of the longest step between two of its points
    np.testing.assert_allclose(path[-1], system.goal(frames).mean, atol=1e-3)
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.005
    assert np.abs(np.diff(speeds)).max() < 0.05 * speeds.max()


def test_at_speed_zero_it_waits_and_goes_on_where_it_was() -> None:
    frames = planar_situation()
    system = begun(planar_model(), 2.0, [-0.1, 0.3], frames)
    run(system, frames, 0.8)
    system.speed = 0.0
    waiting = positions(run(system, frames, 10.0, begin=80))
    np.testing.assert_allclose(waiting[300:], waiting[-1:].repeat(700, axis=0), atol=1e-6)
    assert np.linalg.norm(waiting[-1] - system.goal(frames).mean) > 0.3
    system.speed = 1.0
    assert run(system, frames, 3.0, begin=1080)[-1].phase == 1.0


def test_a_goal_that_moves_is_followed_without_a_jump() -> None:
    before = planar_situation()
    after = before | {"goal": planar_frame(1.5, 0.5, -0.6).with_time()}
    system = begun(planar_model(), 2.0, [-0.1, 0.3], before)
    path = positions(run(system, before, 1.2, 0.001) + run(system, after, 4.0, 0.001, begin=1200))
    assert np.linalg.norm(path[-1] - [1.5, 0.5]) < 0.01
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.001
    assert np.abs(np.diff(speeds)).max() < 0.1  # m/s in 1 ms


def test_a_robot_that_is_held_makes_it_wait() -> None:
    frames = planar_situation()
    free = run(begun(planar_model(), 2.0, [-0.1, 0.3], frames), frames, 2.0)[-1]
    system = begun(planar_model(), 2.0, [-0.1, 0.3], frames)
    held = run(system, frames, 2.0, robot=np.array([-0.1, 0.3]))[-1]
    assert free.phase == pytest.approx(1.0)
    assert held.phase < 0.6
    assert run(system, frames, 3.0, begin=200)[-1].phase == 1.0


def test_the_horizon_is_what_comes() -> None:
    frames = planar_situation()
    system = begun(planar_model(), 2.0, [-0.1, 0.3], frames)
    run(system, frames, 0.5)
    ahead = system.horizon(40, 0.02)
    later = run(system, frames, 0.8, 0.02, begin=25)
    np.testing.assert_allclose([g.mean for g in ahead], positions(later), atol=1e-3)


def test_references_without_a_horizon() -> None:
    system = DynamicMovementPrimitive(planar_model(), LAW, horizon_steps=0)
    system.start(0)
    reference = system.step(0, planar_situation())
    assert reference.horizon == () and reference.horizon_time_step == 0.0
    assert system.horizon(0, 0.1) == []


def test_it_may_begin_within_the_movement() -> None:
    frames = planar_situation()
    system = begun(planar_model(), 2.0, [-0.1, 0.3], frames)
    where = run(system, frames, 1.0)[-1].gaussian.mean
    system.start(0, where, phase=0.5)
    assert system.step(0, frames).phase == 0.5
    assert run(system, frames, 1.0)[-1].phase == pytest.approx(1.0)


def test_any_time_step_is_stable() -> None:
    frames = planar_situation()
    for dt in (1e-4, 0.1, 10.0, 1e6):
        path = positions(run(begun(planar_model(), 2.0, [10.0, -10.0], frames), frames, 20 * dt, dt))
        assert np.abs(path).max() < 20.0


def test_model_files_know_the_goal(tmp_path: Path) -> None:
    planar_model().save(tmp_path / "dmp.tpgmm")
    loaded = EndpointTPGMM.load(tmp_path / "dmp.tpgmm")
    frames = planar_situation()
    one, other = (begun(model, 2.0, None, frames).goal(frames) for model in (planar_model(), loaded))
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.covariance, other.covariance)
    with pytest.raises(ValueError, match="holds a model of the kind EndpointTPGMM"):
        TPHMM.load(tmp_path / "dmp.tpgmm")


def test_bad_input_is_refused_with_the_reason() -> None:
    for name in ("decay_rate", "stiffness"):
        for value in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(ValueError, match=name):
                DmpParameters(**{name: value})
    for duration in (0.0, np.nan):
        with pytest.raises(ValueError, match="duration"):
            DynamicMovementPrimitive(planar_model(), LAW, duration=duration)
    for name, wrong in (("wait_distance", 0.0), ("goal_from", 1.0), ("horizon_time_step", -1.0), ("blend_time", 0.0)):
        with pytest.raises(ValueError, match=name):
            DynamicMovementPrimitive(planar_model(), LAW, **{name: wrong})
    with pytest.raises(ValueError, match="duration_s"):
        DynamicMovementPrimitive(pose_model(), LAW)
    with pytest.raises(ValueError, match="EndpointTPGMM"):
        DynamicMovementPrimitive(reaching_model(), LAW)  # type: ignore[arg-type]
    system = DynamicMovementPrimitive(planar_model(), LAW)
    with pytest.raises(ValueError, match="start"):
        system.step(0, planar_situation())
    with pytest.raises(ValueError, match="no step"):
        system.horizon(1, 0.1)
    for state in ([0.0, 0.0, 0.0], [np.nan, 0.0]):
        with pytest.raises(ValueError, match="shape \\(2,\\) and is finite"):
            system.start(0, state)
    with pytest.raises(ValueError, match="phase"):
        system.start(0, [0.0, 0.0], phase=1.5)
    system.start(0, [0.0, 0.0])
    with pytest.raises(ValueError, match="no step"):
        system.mixture()
    with pytest.raises(ValueError, match="cannot move backwards"):
        system.speed = -1.0
    with pytest.raises(ValueError, match="with_time"):
        system.step(0, {"goal": Frame(2.0 * np.eye(3), np.zeros(3))})
    with pytest.raises(ValueError, match="at least one"):
        system.step(0, {})
