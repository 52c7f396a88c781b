# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from random_problems import random_covariance, random_quaternion
from reaching import frames_at, place, reaching_model
from tpgmm_core import Demonstration, Frame, Manifold
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.learning.endpoints import END, EndpointTPGMM
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.dynamical_system import Convergence, StableDynamics, with_velocity
from tpgmm_core.retrieval.recipe import Recipe
from worlds import DURATION, moved, planar_demonstrations, planar_frame, planar_situation, random_world

SPACES = {"plane": "R2", "poses": "R3 x S3"}


@cache
def planar_model() -> EndpointTPGMM:
    model = EndpointTPGMM(5, init="bins", reg_covar=1e-5).fit([with_velocity(d) for d in planar_demonstrations()])
    model.metadata_ = {"duration_s": DURATION}
    return model


@cache
def pose_demonstrations() -> tuple[Demonstration, ...]:
    """[time, pose] in an arc from a start to an object, both turned at random; signs of quaternions as they come."""
    rng = np.random.default_rng(7)
    u = np.linspace(0.0, 1.0, 80)
    blend = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    demonstrations = []
    for _ in range(6):
        start, goal = place(*(0.1 * rng.normal(size=2)), rng.uniform(-0.5, 0.5)), place(0.5, 0.1, rng.uniform(-1, 1))
        goal[:3] += 0.1 * rng.normal(size=3)
        positions = start[:3] + blend[:, None] * (goal - start)[:3]
        positions[:, 2] += 0.6 * blend * (1.0 - blend)
        turns = quaternion.slerp(start[3:], goal[3:], blend) * rng.choice([-1.0, 1.0], (80, 1))
        data = np.column_stack([DURATION * u, positions, turns])
        demonstrations.append(Demonstration(DURATION * u, data, frames_at(start=start, object=goal)))
    return tuple(demonstrations)


@cache
def pose_model() -> EndpointTPGMM:
    demonstrations = [with_velocity(d, "R1 x R3 x S3") for d in pose_demonstrations()]
    model = EndpointTPGMM(5, init="bins", reg_covar=1e-5, manifold="R3 x S3 x R6").fit(demonstrations)
    model.metadata_ = {"duration_s": DURATION}
    return model


def run(
    system: StableDynamics,
    frames: dict[str, Frame],
    seconds: float,
    dt: float = 0.01,
    begin: int = 0,
    robot: Array | None = None,
) -> list[Reference]:
    """References every dt, s; the first one dt after step `begin`."""
    return [system.step(round(1e9 * dt * (begin + i + 1)), frames, robot) for i in range(round(seconds / dt))]


def begun(
    model: EndpointTPGMM, start: Array | list[float] | None, frames: dict[str, Frame], **convergence: float
) -> StableDynamics:
    """With a step at time 0."""
    system = StableDynamics(model, convergence=Convergence(**convergence))
    system.start(0, start)
    system.step(0, frames)
    return system


def means(references: list[Reference]) -> Array:
    return np.stack([reference.gaussian.mean for reference in references])


def speeds(references: list[Reference], dt: float) -> Array:
    path = means(references)
    return np.linalg.norm(references[0].gaussian.manifold.log(path[:-1], path[1:]), axis=1) / dt


def random_model(rng: np.random.Generator, space: str, speed: float = 1.0) -> EndpointTPGMM:
    """Of two frames that agree roughly, and four components that have nothing to do with each other or with a goal."""
    points = Manifold.parse(SPACES[space])
    n = points.tangent_dim
    model = EndpointTPGMM(4)
    model.manifold_ = Manifold((*points.factors, ("R", n)))
    model.frame_names_ = ("a", "b")
    model.priors_ = rng.dirichlet(np.ones(4))

    def parts(K: int) -> tuple[dict[str, Array], dict[str, Array]]:
        centres, spreads = {}, {}
        common = points.exp(np.r_[np.zeros(points.dim)[:-1], 1.0], 0.5 * rng.normal(size=(K, n)))
        velocities = speed * rng.normal(size=(K, n))
        for name in model.frame_names_:
            x = points.exp(common, 0.1 * rng.normal(size=(K, n)))
            centres[name] = np.column_stack([x, velocities + 0.1 * rng.normal(size=(K, n))])
            spreads[name] = np.stack([random_covariance(rng, 2 * n, 0.4) for _ in range(K)])
        return centres, spreads

    model.means_, model.covariances_ = parts(4)
    model._learned_endpoints(*parts(2))
    model.metadata_ = {"duration_s": 2.0}
    return model


def random_frames(rng: np.random.Generator, space: str) -> dict[str, Frame]:
    """Anywhere in the plane; poses lie apart by less than what orientations have no mean for."""
    if space == "plane":
        return {name: random_world(2, rng).with_time() for name in "ab"}
    p, q = 0.1 * rng.normal(size=(2, 3)), quaternion.exp(0.3 * rng.uniform(-1.0, 1.0, size=(2, 3)))
    world = random_world(7, rng)
    return moved(world, {name: Frame.from_pose(p[i], q[i]).with_time() for i, name in enumerate("ab")})


def random_point(rng: np.random.Generator, space: str, scale: float) -> Array:
    return scale * rng.normal(size=2) if space == "plane" else np.r_[scale * rng.normal(size=3), random_quaternion(rng)]


def test_velocities_are_seen_from_frames_as_vectors() -> None:
    rng = np.random.default_rng(0)
    u = np.linspace(0.0, 2.0, 50)
    velocity, turn = rng.normal(size=3), rng.normal(size=3)
    world = Frame.from_pose(rng.normal(size=3), q := random_quaternion(rng))
    poses = np.column_stack([u[:, None] * velocity, quaternion.multiply(quaternion.exp(u[:, None] * turn), q)])
    encoded = with_velocity(Demonstration(u, np.column_stack([u, poses]), {"f": world.with_time()}), "R1 x R3 x S3")
    np.testing.assert_allclose(encoded.data[:, :7], poses)
    np.testing.assert_allclose(encoded.data[:, 7:], np.tile(np.r_[velocity, turn], (50, 1)), atol=1e-9)
    R = quaternion.rotation_matrix(q)
    seen = encoded.projected()["f"]
    np.testing.assert_allclose(seen[:, 7:], np.tile(np.r_[R.T @ velocity, R.T @ turn], (50, 1)), atol=1e-9)
    np.testing.assert_allclose(seen[:, :7], world.project(poses), atol=1e-9)


def law(radius: float, reach: float, time: float, system: StableDynamics, top_speed: float) -> float:
    """The largest radius after a time that the theorem of the module admits, by integrating r' = -rho(r)."""
    c, T = system.convergence, 2.0
    steps = 2000
    for _ in range(steps):
        rho = min(c.rate / T * reach ** (1 / 3) * radius ** (2 / 3), c.goal_rate / T * radius, top_speed)
        radius *= np.exp(-time / steps * rho / max(radius, 1e-300))
    return radius


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(list(SPACES)),
    st.sampled_from([0.0, 0.5, 3.0]),
    st.floats(-3.0, 3.0),
    st.floats(-2.0, 1.0),
)
@settings(max_examples=40)
def test_the_goal_is_reached_as_the_theorem_says(
    seed: int, space: str, detour: float, log_time_step: float, log_scale: float
) -> None:
    rng = np.random.default_rng(seed)
    frames = random_frames(rng, space)
    model, start = random_model(rng, space, 5.0), random_point(rng, space, 10.0**log_scale)
    try:
        system = begun(model, start, frames, detour=detour)
    except ValueError as error:  # random frames may contradict each other, and are refused then
        assume("contradict each other" not in str(error))
        raise
    first, dt = system.distance, 10.0**log_time_step
    top_speed = float(system._here.law[3])
    assert system.radius == pytest.approx((1.0 + detour) * first)
    longest = first
    time_ns = 0
    for i in range(60):
        radius, distance = system.radius, system.distance
        time_ns += round(1e9 * dt)
        reference = system.step(time_ns, frames)
        assert system.distance <= system.radius * (1.0 + 1e-9) + 1e-12
        assert system.distance <= (1.0 + detour) * first * (1.0 + 1e-9)
        assert system.radius <= radius * (1.0 + 1e-12)
        if detour == 0.0:
            assert system.distance <= distance * (1.0 + 1e-9) + 1e-12
        if i < 3:
            assert system.radius <= law(radius, longest, dt, system, top_speed) * 1.01 + 1e-9
        longest = max(longest, system.distance)
    latest = 3.0 * (1.0 + detour) / system.convergence.rate * 2.0 + (1.0 + detour) * first / top_speed + 20.0
    for _ in range(30):
        time_ns += round(1e9 * latest / 30)
        reference = system.step(time_ns, frames)
    assert system.distance < system.convergence.arrival
    assert reference.phase == 1.0


def test_without_the_correction_it_would_not_get_there() -> None:
    """A field that goes round and outwards for ever: what the guarantee is for."""
    model = random_model(np.random.default_rng(0), "plane")
    spread, outwards = 0.2 * np.eye(4), np.array([[0.1, -1.0], [1.0, 0.1]])
    spread[2:, :2] = 0.2 * outwards
    spread[:2, 2:] = spread[2:, :2].T
    spread[2:, 2:] = 0.2 * outwards @ outwards.T + 0.01 * np.eye(2)
    for name in model.frame_names_:
        model.means_[name], model.covariances_[name] = np.zeros((4, 4)), np.stack([spread] * 4)
        model.endpoints_.means_[name][END] = 0.0
    frames = {name: Frame(np.eye(2), np.zeros(2)).with_time() for name in ("a", "b")}
    system = begun(model, [0.5, 0.0], frames)
    np.testing.assert_allclose(system.regressed, [0.05, 0.5], atol=1e-9)
    assert run(system, frames, 6.0)[-1].phase == 1.0


def test_a_demonstration_is_followed_again() -> None:
    for demonstration in planar_demonstrations():
        frames = dict(demonstration.frames)
        references = run(begun(planar_model(), demonstration.data[0, 1:], frames), frames, 3.0 * DURATION)
        path, shown = means(references), demonstration.data[:, 1:]
        away = np.linalg.norm(shown[:, None] - path, axis=2).min(axis=1)
        assert np.sqrt(np.mean(away**2)) < 0.05
        assert np.linalg.norm(path[-1] - shown[-1]) < 0.002
        arrived = next(i for i, reference in enumerate(references) if reference.phase == 1.0)
        assert 0.5 * DURATION < 0.01 * arrived < 1.7 * DURATION


@pytest.mark.parametrize("space", list(SPACES))
def test_the_correction_touches_little_of_what_was_demonstrated(space: str) -> None:
    """Share of the velocity that is not as regressed, along the way, until the last tenth of the distance."""
    model, demonstrations = (
        (planar_model(), planar_demonstrations()) if space == "plane" else (pose_model(), pose_demonstrations())
    )
    touched = gone = 0.0
    for demonstration in demonstrations:
        frames = dict(demonstration.frames)
        system = begun(model, demonstration.data[0, 1:], frames)
        first, i = system.distance, 0
        while system.distance > 0.1 * first:
            i += 1
            system.step(10_000_000 * i, frames)
            touched += np.linalg.norm(system.velocity - system.regressed)
            gone += np.linalg.norm(system.velocity)
    assert touched < 0.1 * gone


def test_a_pose_is_reached_from_where_demonstrations_began_and_from_elsewhere() -> None:
    goal = place(0.6, -0.1, 0.3)
    frames = frames_at(start=place(0.05, 0.0, 0.2), object=goal)
    for start in (None, np.r_[0.3, 0.4, 0.5, random_quaternion(np.random.default_rng(2))]):
        end = run(begun(pose_model(), start, frames), frames, 4.0 * DURATION)[-1]
        assert end.phase == 1.0
        np.testing.assert_allclose(end.gaussian.manifold.log(goal, end.gaussian.mean), 0.0, atol=5e-3)
    first = begun(pose_model(), None, frames).horizon(1, 1e-6)[0]
    np.testing.assert_allclose(first.manifold.log(place(0.05, 0.0, 0.2), first.mean), 0.0, atol=5e-3)


def test_it_starts_at_rest_and_frames_that_leap_change_neither_place_nor_velocity_at_once() -> None:
    dt = 0.002
    before = planar_situation()
    after = before | {"goal": planar_frame(0.6, 0.9, 1.0).with_time()}
    system = begun(planar_model(), [0.1, 0.6], before)
    radius = 0.0
    references = run(system, before, 0.8, dt)
    assert speeds(references, dt)[0] < 0.05
    radius, goal = system.radius, system.goal(before).mean
    references += run(system, after, dt, dt, begin=400)
    assert system.radius <= radius + np.linalg.norm(system.goal(after).mean - goal) + 1e-9
    references += run(system, after, 4.0, dt, begin=401)
    assert references[-1].phase == 1.0
    velocities = np.diff(means(references), axis=0) / dt
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() < 0.08  # m/s in 2 ms, of 1 m/s
    assert np.linalg.norm(means(references)[-1] - [0.6, 0.9]) < 0.01


def test_a_robot_that_is_held_is_waited_for() -> None:
    frames = planar_situation()
    robot = np.array([0.1, 0.6])
    system = begun(planar_model(), robot, frames)
    path = means(run(system, frames, 6.0, robot=robot))
    leash = system.convergence.leash
    assert np.linalg.norm(path - robot, axis=1).max() < 2.0 * leash + 1.5 * system.blend_time  # it runs at 1.5 m/s
    assert np.linalg.norm(path[-1] - robot) < 2.0 * leash
    assert np.linalg.norm(path[-1] - path[-100]) < 0.02  # m within 1 s
    assert run(system, frames, 6.0, begin=600)[-1].phase == 1.0


def test_a_robot_that_is_pulled_away_takes_the_reference_along_within_the_stated_speed() -> None:
    frames, dt = planar_situation(), 0.002
    system = begun(planar_model(), [-0.1, 0.3], frames)
    before = run(system, frames, 3.0 * DURATION, dt)
    assert before[-1].phase == 1.0
    away = before[-1].gaussian.mean + [1.0, 0.5]
    pulled = run(system, frames, 8.0, dt, begin=3000, robot=away)
    assert speeds(pulled, dt).max() < system.convergence.leash_speed
    assert pulled[-1].phase < 1.0
    assert np.linalg.norm(pulled[-1].gaussian.mean - away) < 2.1 * system.convergence.leash
    assert run(system, frames, 3.0 * DURATION, dt, begin=7000)[-1].phase == 1.0


def test_at_speed_zero_it_waits_and_goes_on_where_it_was() -> None:
    frames = planar_situation()
    system = begun(planar_model(), [-0.1, 0.3], frames)
    moving = run(system, frames, 0.8)
    system.speed = 0.0
    waiting = run(system, frames, 5.0, begin=80)
    assert np.abs(np.diff(speeds(moving + waiting, 0.01))).max() < 0.15 * speeds(moving, 0.01).max()
    np.testing.assert_allclose(means(waiting)[-1], means(waiting)[-100], atol=1e-6)
    assert waiting[-1].phase < 0.8
    system.speed = 2.0
    assert run(system, frames, 3.0, begin=580)[-1].phase == 1.0


def test_the_path_does_not_depend_on_the_duration() -> None:
    frames = planar_situation()
    paths = []
    for duration in (1.0, 7.0):
        system = StableDynamics(planar_model(), duration=duration, blend_time=1e-3)
        system.start(0, [-0.1, 0.3])
        system.step(0, frames)
        paths.append(means(run(system, frames, 2.0 * duration, duration / 200)))
    np.testing.assert_allclose(paths[0], paths[1], atol=2e-3)


def test_the_horizon_is_what_comes_and_disturbs_nothing() -> None:
    frames = planar_situation()
    plain = means(run(begun(planar_model(), [-0.1, 0.3], frames), frames, 1.3, 0.02))
    system = begun(planar_model(), [-0.1, 0.3], frames)
    run(system, frames, 0.5, 0.02)
    ahead = system.horizon(40, 0.02)
    later = run(system, frames, 0.8, 0.02, begin=25)
    np.testing.assert_array_equal(means(later), plain[25:])
    np.testing.assert_allclose([g.mean for g in ahead], means(later), atol=5e-3)
    np.testing.assert_allclose([g.mean for g in ahead[:10]], means(later)[:10], atol=1e-3)
    assert system.horizon(0, 0.02) == []


def test_position_matters_across_the_movement_and_at_its_end() -> None:
    frames = planar_situation()
    system = begun(planar_model(), [-0.1, 0.3], frames)
    references = run(system, frames, 3.0 * DURATION)
    middle = references[100]
    along = middle.velocity() / np.linalg.norm(middle.velocity())
    across = np.array([-along[1], along[0]])
    covariance = middle.gaussian.covariance
    assert along @ covariance @ along > 3.0 * (across @ covariance @ across)
    np.testing.assert_allclose(references[-1].gaussian.covariance, system.goal(frames).covariance, rtol=0.1)


def test_phases_begin_at_zero_or_where_asked_and_end_at_one() -> None:
    frames = planar_situation()
    phases = [reference.phase for reference in run(begun(planar_model(), [-0.1, 0.3], frames), frames, 5.0)]
    assert phases[0] < 0.01
    assert phases[-1] == 1.0
    system = StableDynamics(planar_model())
    system.start(0, [-0.1, 0.3], phase=0.6)
    assert system.step(0, frames).phase == pytest.approx(0.6)


def test_what_no_frame_sees_ends_is_learned_from_all_that_it_saw() -> None:
    """A frame that is hidden at the end, as an object in the hand, knows little of the end; the others know it."""
    hidden = []
    for d in planar_demonstrations():
        seen = np.arange(len(d.times)) < 40
        hidden.append(with_velocity(Demonstration(d.times, d.data, d.frames, {"start": seen})))
    model = EndpointTPGMM(5, init="bins", reg_covar=1e-5).fit(hidden)
    assert np.trace(model.endpoints_.covariances_["start"][END]) > 10.0 * np.trace(
        model.endpoints_.covariances_["goal"][END]
    )
    model.metadata_ = {"duration_s": DURATION}
    frames = planar_situation()
    goal = StableDynamics(model).goal(frames)
    assert np.linalg.norm(goal.mean - frames["goal"].b[1:]) < 0.01


def test_model_files_know_the_goal(tmp_path: Path) -> None:
    pose_model().save(tmp_path / "dynamical_system.tpgmm")
    frames = dict(pose_demonstrations()[0].frames)
    one, other = (
        StableDynamics(model).goal(frames)
        for model in (pose_model(), EndpointTPGMM.load(tmp_path / "dynamical_system.tpgmm"))
    )
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_bad_input_is_refused_with_the_reason() -> None:
    for name, value in (("rate", 0.0), ("detour", -0.1), ("leash", np.nan)):
        with pytest.raises(ValueError, match=name):
            Convergence(**{name: value})
    with pytest.raises(ValueError, match="with_velocity"):
        StableDynamics(EndpointTPGMM(3).fit(list(planar_demonstrations())))
    with pytest.raises(ValueError, match="with_velocity|EndpointTPGMM"):
        StableDynamics(reaching_model())  # type: ignore[arg-type]
    model = EndpointTPGMM(5, init="bins").fit([with_velocity(d) for d in planar_demonstrations()])
    with pytest.raises(ValueError, match="duration_s"):
        StableDynamics(model)
    with pytest.raises(ValueError, match="duration"):
        StableDynamics(model, duration=0.0)
    system = StableDynamics(planar_model())
    with pytest.raises(ValueError, match="start"):
        system.step(0, planar_situation())
    system.start(0, [0.0, 0.0])
    for wrong in (system.mixture, lambda: system.horizon(2, 0.1)):
        with pytest.raises(ValueError, match="no step"):
            wrong()
    for speed in (-1.0, np.inf):
        with pytest.raises(ValueError, match="speed"):
            system.speed = speed
    with pytest.raises(ValueError, match="with_time"):
        system.step(0, {"goal": Frame(2.0 * np.eye(3), np.zeros(3))})
    with pytest.raises(ValueError, match="at least one"):
        system.step(0, {})
    with pytest.raises(ValueError, match="unknown frame"):
        system.step(0, {"table": planar_frame(0.0, 0.0, 0.0).with_time()})
    with pytest.raises(ValueError, match="shape \\(2,\\) and is finite"):
        system.step(0, planar_situation(), [0.0, np.inf])


def test_a_closed_path_is_refused_with_the_reason() -> None:
    """A system without time would have arrived before it starts: it never goes round."""
    times = np.linspace(0.0, 5.0, 100)
    angle = 2.0 * np.pi * (1.0 - np.cos(np.pi * times / 5.0)) / 2.0
    circle = np.column_stack([times, np.cos(angle), np.sin(angle)])
    frames = {"base": Frame(np.eye(3), np.zeros(3))}
    recipe = Recipe.of({"n_components": 4}, "dynamical_system")
    with pytest.raises(ValueError, match="demonstration 1: ends .* from where it began.*such as dmp"):
        recipe.learn([Demonstration(times[:60], circle[:60], frames), Demonstration(times, circle, frames)], "R1 x R2")
