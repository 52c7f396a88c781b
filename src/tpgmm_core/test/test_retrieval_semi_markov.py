# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache

import numpy as np
import pytest

from reaching import frames_at, place
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.learning.hidden_markov.durations import Durations
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.hidden_markov.markov import SemiMarkovChain
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval import kernels_semi_markov
from tpgmm_core.retrieval.dynamic_features import with_derivatives
from tpgmm_core.retrieval.semi_markov import SemiMarkovMovement
from tpgmm_core.retrieval.state_filter import NominalSchedule, StateFilter
from worlds import DURATION, moved, planar_demonstrations, planar_frame, planar_situation, random_world

TICK = 5_000_000
Disturbance = Callable[[float, Array, Array], Array]


@cache
def planar_model(K: int = 5) -> TPHSMM:
    model = TPHSMM(K, reg_covar=1e-5).fit(planar_demonstrations())
    model.metadata_ = {"duration_s": DURATION}
    return model


@cache
def pose_demonstrations() -> tuple[Demonstration, ...]:
    random = np.random.default_rng(0)
    times = np.linspace(0.0, DURATION, 60)
    s = times / DURATION
    blend = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]
    demonstrations = []
    for _ in range(6):
        start = place(*random.uniform(-0.1, 0.1, 2), random.uniform(-0.5, 0.5))
        goal = place(0.5 + random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), random.uniform(-0.5, 0.5))
        positions = start[:3] + blend * (goal - start)[:3] + 2e-3 * random.standard_normal((60, 3))
        turns = quaternion.slerp(np.tile(start[3:], (60, 1)), goal[3:], blend[:, 0])
        data = np.column_stack([times, positions, turns])
        demonstrations.append(Demonstration(times, data, frames_at(start=start, object=goal)))
    return tuple(demonstrations)


@cache
def pose_model() -> TPHSMM:
    model = TPHSMM(4, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(pose_demonstrations())
    model.metadata_ = {"duration_s": DURATION}
    return model


def pose_situation() -> dict[str, Frame]:
    return frames_at(start=place(0.02, -0.05, 0.3), object=place(0.55, 0.08, -0.4))


def free(time: float, robot: Array, reference: Array) -> Array:
    """A robot in the plane that follows within a twentieth of a second."""
    return robot + 0.1 * (reference - robot)


def run(
    movement: SemiMarkovMovement,
    situation: Mapping[str, Frame],
    start: Array,
    seconds: float,
    robot: Disturbance = free,
) -> tuple[list[Reference], Array]:
    """References, and where the robot was at them."""
    movement.start(0, start)
    references, path, x = [], [], start
    for i in range(round(seconds * 1e9 / TICK) + 1):
        references.append(movement.step(i * TICK, situation, x))
        path.append(x)
        x = robot(i * TICK * 1e-9, x, references[-1].gaussian.mean)
    return references, np.array(path)


def small_chain(rng: np.random.Generator, K: int = 3, L: int = 3) -> SemiMarkovChain:
    transitions = rng.random((K, K)) * (1.0 - np.eye(K))
    durations = Durations.around(rng.uniform(1.0, L, K), L)
    return SemiMarkovChain(rng.dirichlet(np.ones(K)), transitions / transitions.sum(axis=1, keepdims=True), durations)


def segments(K: int, L: int, T: int) -> Iterator[list[tuple[int, int]]]:
    """All sequences of states and durations that cover T samples; the last one may be unfinished."""
    if T <= 0:
        yield []
        return
    for k in range(K):
        for d in range(1, min(L, T) + 1):
            for rest in segments(K, L, T - d):
                yield [(k, d), *rest]


def test_the_forward_variable_is_that_of_all_that_could_have_happened() -> None:
    rng = np.random.default_rng(0)
    K, L, T = 3, 3, 6
    chain = small_chain(rng, K, L)
    fits = rng.random((T, K))
    p, lasts = np.exp(chain.durations.log_probabilities), np.exp(chain.durations.log_survival)
    expected = np.zeros((K, L))
    for course in segments(K, L, T):
        value, t = chain.start[course[0][0]], 0
        for i, (k, d) in enumerate(course):
            value *= chain.transitions[course[i - 1][0], k] if i else 1.0
            value *= p[k, d - 1] if i < len(course) - 1 else lasts[k, d - 1]
            value *= np.prod(fits[t : t + d, k])
            t += d
        expected[course[-1][0], course[-1][1] - 1] += value
    forward, ahead = np.zeros((K, L)), np.empty((K, L))
    forward[:, 0] = chain.start * fits[0]
    likelihood = forward.sum()
    forward /= likelihood
    nowhere, middle = np.zeros((K, K)), np.zeros(K, dtype=np.int64)
    for fit in fits[1:]:
        args = forward, chain.durations.hazards, chain.transitions, nowhere, middle, fit, 0.0, ahead
        likelihood *= kernels_semi_markov.advance(*args)
        forward, ahead = ahead, forward
    assert likelihood == pytest.approx(expected.sum(), rel=1e-12)
    np.testing.assert_allclose(forward, expected / expected.sum(), atol=1e-14)


def test_a_sample_that_is_a_disturbance_leaves_state_and_age_as_they_were() -> None:
    """Against a matrix of transitions over all pairs of state and age."""
    rng = np.random.default_rng(1)
    K, L = 3, 4
    chain = small_chain(rng, K, L)
    hazards, carried = np.minimum(chain.durations.hazards, 0.5), 0.1 * rng.random((K, K))
    middle = np.array([1, 0, 2])
    step = np.zeros((K, L, K, L))
    for k in range(K):
        stays = 1.0 - carried[k].sum()
        for d in range(L):
            step[k, d, k, min(d + 1, L - 1)] += stays * (1.0 - hazards[k, d])
            for i in range(K):
                step[k, d, i, 0] += stays * hazards[k, d] * chain.transitions[k, i]
                step[k, d, i, middle[i]] += carried[k, i]
    np.testing.assert_allclose(step.sum(axis=(2, 3)), 1.0)
    before, fit, ahead = rng.dirichlet(np.ones(K * L)).reshape(K, L), rng.random(K), np.empty((K, L))
    expected = fit[:, None] * np.einsum("kd,kdie->ie", before, step) + 0.2 * before
    total = kernels_semi_markov.advance(before, hazards, chain.transitions, carried, middle, fit, 0.2, ahead)
    assert total == pytest.approx(expected.sum())
    np.testing.assert_allclose(ahead, expected / expected.sum(), atol=1e-14)
    kernels_semi_markov.advance(before, hazards, chain.transitions, carried, middle, np.zeros(K), 0.2, ahead)
    np.testing.assert_allclose(ahead, before, atol=1e-14)  # nothing fits: nothing has happened


def test_the_likeliest_course_is_the_best_of_all() -> None:
    model = planar_model(3)
    log_p = model.chain_.durations.log_probabilities
    for T in (40, 70, 95):
        courses = [(i, j, T - i - j) for i in range(1, T) for j in range(1, T - i) if max(i, j, T - i - j) <= 80]
        best = max(courses, key=lambda d: sum(log_p[k, d[k] - 1] for k in range(3)))
        states, durations = model.likeliest_course(T)
        np.testing.assert_array_equal(states, [0, 1, 2])
        np.testing.assert_array_equal(durations, best)
    with pytest.raises(ValueError, match="no sequence of the 3 states lasts 2 samples"):
        model.likeliest_course(2)


def test_a_course_goes_through_all_states_in_their_durations() -> None:
    course = NominalSchedule(planar_model().chain_)
    places = [course.onwards(0, 0.0, float(i)) for i in range(round(course.total) + 1)]
    left = [course.remaining(*p) for p in places]
    np.testing.assert_allclose(left, course.total - np.arange(len(left)), atol=1e-9)
    np.testing.assert_allclose(course.nominal, planar_model().mean_durations_, rtol=0.01)
    # a state that has lasted for ever is left, half a state ahead
    state, age = course.onwards(1, 1000.0, 0.0)
    assert state == 2 and age == pytest.approx(0.5 * course.nominal[2])


def test_without_observation_the_movement_follows_the_clock() -> None:
    movement = SemiMarkovMovement(planar_model(), duration=3.0)
    for demonstration in planar_demonstrations():
        movement.start(0, demonstration.data[0, 1:])
        references = [movement.step(i * TICK, demonstration.frames) for i in range(601)]
        phases = np.array([r.phase for r in references])
        np.testing.assert_allclose(phases, np.linspace(0.0, 1.0, 601), atol=0.015)
        assert phases[-1] == 1.0 and np.all(np.diff(phases) >= 0.0)
        path = np.array([r.gaussian.mean for r in references])
        nearest = np.linalg.norm(demonstration.data[:, None, 1:] - path, axis=2).min(axis=1)
        assert nearest.max() < 0.06 and np.linalg.norm(path[-1] - demonstration.data[-1, 1:]) < 0.01


def test_a_robot_that_follows_is_at_its_end_in_time() -> None:
    for demonstration in planar_demonstrations():
        references, path = run(
            SemiMarkovMovement(planar_model()), demonstration.frames, demonstration.data[0, 1:], 1.3 * DURATION
        )
        phases = np.array([r.phase for r in references])
        assert np.searchsorted(phases, 0.9) * TICK * 1e-9 == pytest.approx(0.9 * DURATION, rel=0.15)
        assert phases[-1] == 1.0
        assert np.linalg.norm(path[-1] - demonstration.data[-1, 1:]) < 0.01


def test_a_held_robot_is_waited_for_and_goes_on_when_released() -> None:
    demonstration = planar_demonstrations()[0]

    def held(time: float, robot: Array, reference: Array) -> Array:
        return robot if 0.8 < time < 20.0 else free(time, robot, reference)

    movement = SemiMarkovMovement(planar_model())
    references, path = run(movement, demonstration.frames, demonstration.data[0, 1:], 22.0, held)
    phases = np.array([r.phase for r in references])
    before, waiting, released = (round(t * 1e9 / TICK) for t in (0.8, 5.0, 20.0))
    share_of_a_state = movement.model.mean_durations_.max() / movement.model.mean_durations_.sum()
    assert phases[released] - phases[before] < share_of_a_state
    assert phases[released] == pytest.approx(phases[waiting], abs=0.02)
    # the reference waits too, a little ahead
    waits = references[released].gaussian.mean
    np.testing.assert_allclose(waits, references[waiting].gaussian.mean, atol=0.01)
    nearest = [np.argmin(np.linalg.norm(demonstration.data[:, 1:] - x, axis=1)) for x in (path[released], waits)]
    assert 0 < nearest[1] - nearest[0] < 1.6 * movement.model.mean_durations_.max()
    assert phases[-1] == 1.0 and np.linalg.norm(path[-1] - demonstration.data[-1, 1:]) < 0.01


def test_a_robot_that_is_carried_ahead_is_caught_up_with() -> None:
    demonstration = planar_demonstrations()[0]
    later = demonstration.data[60, 1:]

    def carried(time: float, robot: Array, reference: Array) -> Array:
        return later if 0.5 < time < 0.7 else free(time, robot, reference)

    movement = SemiMarkovMovement(planar_model())
    references, path = run(movement, demonstration.frames, demonstration.data[0, 1:], 1.7, carried)
    phases = np.array([r.phase for r in references])
    assert phases[100] < 0.3 and phases[round(0.7e9 / TICK)] > 0.6
    assert phases[-1] == 1.0 and np.linalg.norm(path[-1] - demonstration.data[-1, 1:]) < 0.02


@pytest.mark.parametrize("far", [4.0, 8.0])
@pytest.mark.parametrize("angle", [0.0, 1.6, 3.1])
def test_a_robot_that_is_where_its_reference_was_is_never_taken_for_a_held_one(far: float, angle: float) -> None:
    """Even where no state expects it: frames lie four and eight times as far apart as in any demonstration."""
    movement = SemiMarkovMovement(planar_model(3))
    situation = {"start": planar_frame(0.0, 0.0, 0.0).with_time(), "goal": planar_frame(far, 0.0, angle).with_time()}

    def exact(time: float, robot: Array, reference: Array) -> Array:
        return reference

    references, _ = run(movement, situation, np.zeros(2), 1.5 * DURATION, exact)
    phases = np.array([r.phase for r in references])
    assert phases[-1] == 1.0
    assert np.searchsorted(phases, 0.9) * TICK * 1e-9 == pytest.approx(0.9 * DURATION, rel=0.15)

    def held(time: float, robot: Array, reference: Array) -> Array:  # not by the reference itself: it is waited for
        return robot if time > 0.8 else reference

    references, _ = run(movement, situation, np.zeros(2), 4.0 * DURATION, held)
    assert references[-1].phase < 0.7


@pytest.mark.parametrize("push", [(0.0, 0.6), (0.0, -0.6), (-0.5, 0.0), (10.0, 30.0)])
def test_a_robot_that_is_pushed_aside_loses_no_order(push: tuple[float, float]) -> None:
    demonstration = planar_demonstrations()[0]

    def pushed(time: float, robot: Array, reference: Array) -> Array:
        return reference + push if 0.8 <= time < 4.0 else free(time, robot, reference)

    movement = SemiMarkovMovement(planar_model())
    references, path = run(movement, demonstration.frames, demonstration.data[0, 1:], 6.5, pushed)
    phases = np.array([r.phase for r in references])
    before, after = round(0.8e9 / TICK), round(4e9 / TICK)
    assert abs(phases[after] - phases[before]) < 0.25
    visited = [int(np.argmax(r.activations)) for r in references]
    assert np.abs(np.diff(visited)).max() == 1  # which of two neighbours it is may be considered again
    assert phases[-1] == 1.0 and np.linalg.norm(path[-1] - demonstration.data[-1, 1:]) < 0.01


def test_a_place_that_the_movement_comes_back_to_is_not_taken_for_the_later_one() -> None:
    times = np.linspace(0.0, 2.0, 80)
    angle = 2.0 * np.pi * times / 2.0
    demonstrations = [
        Demonstration(
            times,
            np.column_stack([times, r * np.cos(angle), r * np.sin(angle)]),
            {"centre": Frame(np.eye(2), np.zeros(2)).with_time()},
        )
        for r in (0.95, 1.0, 1.05)
    ]
    model = TPHSMM(6, reg_covar=1e-4).fit(demonstrations)
    model.metadata_ = {"duration_s": 2.0}
    references, path = run(SemiMarkovMovement(model), demonstrations[0].frames, demonstrations[1].data[0, 1:], 2.6)
    phases = np.array([r.phase for r in references])
    assert phases[200] == pytest.approx(0.5, abs=0.05) and phases[-1] == 1.0
    assert np.ptp(path, axis=0).min() > 1.6


def test_nothing_jumps_when_frames_move_and_states_change() -> None:
    movement = SemiMarkovMovement(planar_model())
    situation = planar_situation()
    movement.start(0, situation["start"].b[1:])
    x, means, velocities = situation["start"].b[1:], [], []
    for i in range(3000):
        if i in (600, 1100, 1600):
            situation = moved(random_world(2, np.random.default_rng(i)), planar_situation())
        movement.speed = {0: 1.0, 900: 2.0, 1300: 0.0, 1800: 0.5}.get(i, movement.speed)
        reference = movement.step(i * 1_000_000, situation, x)
        means.append(reference.gaussian.mean)
        velocities.append(reference.velocity())
        x = x + 0.02 * (means[-1] - x)
    # a change of velocity is a change of at most so much acceleration for a millisecond
    velocity = np.diff(means, axis=0) / 1e-3
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.02 * np.abs(velocity).max()
    # of an acceleration that may turn round at once, the velocity over the 5 ms ahead has half
    acceleration = np.abs(np.diff(velocity, axis=0)).max() / 1e-3
    assert np.abs(np.diff(velocities, axis=0)).max() < 0.0025 * 2.0 * acceleration


def test_the_path_does_not_depend_on_the_speed_and_a_pause_is_a_pause() -> None:
    fast, slow = SemiMarkovMovement(planar_model()), SemiMarkovMovement(planar_model())
    fast.speed, slow.speed = 2.0, 0.5
    fast.start(0)
    slow.start(0)
    situation = planar_situation()
    for i in range(400):
        a, b = fast.step(i * TICK, situation), slow.step(4 * i * TICK, situation)
        np.testing.assert_allclose(a.gaussian.mean, b.gaussian.mean, atol=1e-9)
        assert a.phase == pytest.approx(b.phase, abs=0.02)
    slow.start(0)
    slow.step(0, situation)
    slow.step(10**9, situation)
    slow.speed = 0.0
    paused = [slow.step(round(t * 1e9), situation) for t in (4.0, 5.0, 100.0)]
    np.testing.assert_allclose(paused[0].gaussian.mean, paused[-1].gaussian.mean, atol=1e-9)
    np.testing.assert_allclose(paused[-1].velocity(), 0.0, atol=1e-9)
    for speed in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="cannot move backwards"):
            slow.speed = speed
    assert slow.speed == 0.0


def test_the_horizon_is_what_happens() -> None:
    movement, situation = SemiMarkovMovement(planar_model()), planar_situation()
    movement.start(0)
    for i in range(0, 100):
        movement.step(i * TICK, situation)
    ahead = movement.horizon(60, 0.02)
    for i, g in enumerate(ahead):
        later = movement.step(99 * TICK + (i + 1) * 20_000_000, situation).gaussian
        np.testing.assert_allclose(g.mean, later.mean, atol=1e-9)
        np.testing.assert_allclose(g.covariance, later.covariance, atol=1e-9)


def test_a_movement_may_begin_in_its_middle() -> None:
    movement, situation = SemiMarkovMovement(planar_model()), planar_situation()
    for phase in (0.0, 0.4, 1.0):
        movement.start(7, phase=phase)
        assert movement.step(7, situation).phase == pytest.approx(phase, abs=0.01)


def test_poses_arrive_where_the_object_is() -> None:
    movement = SemiMarkovMovement(pose_model())
    for demonstration in pose_demonstrations():
        movement.start(0, demonstration.data[0, 1:])
        for i in range(round(1.3e9 * DURATION / TICK)):
            reference = movement.step(i * TICK, demonstration.frames)
        error = movement.manifold.log(demonstration.data[-1, 1:], reference.gaussian.mean)
        assert reference.phase == 1.0
        assert np.linalg.norm(error[:3]) < 0.01 and np.linalg.norm(error[3:]) < 0.05


@pytest.mark.parametrize("manifold", ["euclidean", "R1 x R3 x S3"])
def test_a_model_of_derivatives_serves_as_well(manifold: str) -> None:
    demonstrations = planar_demonstrations() if manifold == "euclidean" else pose_demonstrations()
    space = manifold if manifold == "euclidean" else f"{manifold} x R12"
    model = TPHSMM(4, reg_covar=1e-4, manifold=space).fit([with_derivatives(d, manifold) for d in demonstrations])
    model.metadata_ = {"duration_s": DURATION}
    movement = SemiMarkovMovement(model, derivatives=True)
    last = demonstrations[0]
    movement.start(0, last.data[0, 1:])
    reference = [movement.step(i * TICK, last.frames) for i in range(450)][-1]
    assert reference.phase == 1.0 and movement.mixture().manifold == model.manifold_
    assert np.linalg.norm(movement.manifold.log(last.data[-1, 1:], reference.gaussian.mean)[:2]) < 0.05


def test_what_nobody_sees_stays_and_a_frame_that_is_lost_is_no_jump() -> None:
    movement, situation = SemiMarkovMovement(planar_model()), planar_situation()
    movement.start(0)
    for i in range(200):
        reference = movement.step(i * TICK, situation)
    without = {"start": situation["start"]}
    lost = movement.step(200 * TICK, without)
    assert lost.frames == ("start",)
    assert np.linalg.norm(lost.gaussian.mean - reference.gaussian.mean) < 0.02
    unsure = movement.step(201 * TICK, situation, weights={"start": 0.0, "goal": 0.0})
    for i in range(202, 800):
        unsure = movement.step(i * TICK, situation, weights=None)
    assert unsure.phase == 1.0


def test_bad_input_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match="TPHSMM, got TPGMM"):
        SemiMarkovMovement(TPGMM(2).fit(planar_demonstrations()))  # type: ignore[arg-type]
    nameless = TPHSMM(2).fit(planar_demonstrations())
    with pytest.raises(ValueError, match="duration_s"):
        SemiMarkovMovement(nameless)
    circular = TPHSMM(2, transitions="ergodic").fit(planar_demonstrations())
    circular.metadata_ = {"duration_s": 2.0}
    with pytest.raises(ValueError, match="left-right"):
        SemiMarkovMovement(circular)
    with pytest.raises(ValueError, match="dynamic features|derivatives"):
        SemiMarkovMovement(planar_model(), derivatives=True)
    for name in ("duration", "smoothing", "position_tolerance", "blend_time", "horizon_time_step"):
        with pytest.raises(ValueError, match=name):
            SemiMarkovMovement(planar_model(), **{name: 0.0})  # type: ignore[arg-type]
    movement, situation = SemiMarkovMovement(planar_model()), planar_situation()
    with pytest.raises(ValueError, match="start"):
        movement.step(0, situation)
    movement.start(0)
    with pytest.raises(ValueError, match="no step"):
        movement.mixture()
    with pytest.raises(ValueError, match="no step"):
        movement.horizon(2, 0.1)
    with pytest.raises(ValueError, match="at least one"):
        movement.step(0, {})
    with pytest.raises(ValueError, match="unknown frame"):
        movement.step(0, {"table": situation["start"]})
    for state in (np.zeros(3), np.array([np.nan, 0.0])):
        with pytest.raises(ValueError, match="state is a point of R2"):
            movement.step(0, situation, state)
    with pytest.raises(ValueError, match="phase"):
        movement.start(0, phase=1.5)


def test_a_step_after_a_long_gap_is_the_end() -> None:
    movement, situation = SemiMarkovMovement(planar_model()), planar_situation()
    movement.start(0)
    movement.step(0, situation)
    late = movement.step(10**15, situation)
    assert late.phase == 1.0
    for i in range(200):
        settled = movement.step(10**15 + i * TICK, situation)
    assert np.linalg.norm(late.gaussian.mean - settled.gaussian.mean) < 0.05
    assert movement.step(0, situation).phase == 1.0  # a clock that jumps back is no time


def test_a_filter_is_sure_of_what_it_was_told() -> None:
    chain = planar_model().chain_
    course = NominalSchedule(chain)
    estimate = StateFilter(chain, course)
    estimate.reset(2, 5.0)
    assert estimate.place == (2, 5.0)
    assert estimate.remaining == pytest.approx(course.remaining(2, 5.0))
    for _ in range(1000):
        estimate.update(np.zeros(len(chain.start)))  # nowhere: it waits
    assert estimate.place == (2, 5.0)
    for _ in range(1000):
        estimate.update(None)
    assert estimate.place[0] == len(chain.start) - 1 and estimate.remaining == pytest.approx(0.0, abs=1e-6)
