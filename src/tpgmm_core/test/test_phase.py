# SPDX-License-Identifier: Apache-2.0
"""Phases: how the model's time advances, and that the reference never jumps meanwhile."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from random_problems import random_quaternion
from reaching import DURATION, frames_at, place, reaching_model
from tpgmm_core import Frame, Gaussian
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.phase import PHASES, ArcLengthConfig, ArcLengthPhase, ClockPhase, StatePhase, StatePhaseConfig
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct
from tpgmm_core.retrieval.reproduction import Reproduction
from worlds import assert_moved, moved

MS = 1_000_000
START, OBJECT = place(0.0, 0.0, 0.0), place(0.5, 0.1, 0.4)
HERE = frames_at(start=START, object=OBJECT)
THERE = frames_at(start=START, object=place(0.5, -0.1, -0.4))
ALL_PHASES = pytest.mark.parametrize("name", PHASES)
METRES_PER_RADIAN = 0.25


def started(phase: ClockPhase, order: type = RegressThenProduct) -> Reproduction:
    reproduction = Reproduction(order(reaching_model()), phase=phase)
    reproduction.start(0)
    return reproduction


def run(
    reproduction: Reproduction,
    begin: int,
    end: int,
    frames: Callable[[int], dict[str, Frame]] = lambda _: HERE,
    robot: Callable[[int, Array], Array] | None = None,
    state: Array | None = None,
) -> list[Reference]:
    """One reference per ms; robot(ms, reference) says where the robot is by the next step."""
    references = []
    for ms in range(begin, end):
        references.append(reproduction.step(ms * MS, frames(ms), state))
        state = None if robot is None else robot(ms, references[-1].gaussian.mean)
    return references


def velocities(references: list[Reference]) -> Array:
    """Per ms, (T - 1, 6)."""
    means = [r.gaussian.mean for r in references]
    return np.array([POSE.log(a, b) for a, b in zip(means, means[1:], strict=False)])


def largest_jump(references: list[Reference]) -> float:
    """Of the velocity, m and rad per ms."""
    return float(np.abs(np.diff(velocities(references), axis=0)).max())


def wandering(ms: int) -> dict[str, Frame]:
    """The object moves all the time, and leaps once."""
    t = ms // 10 * 0.01
    leap = 0.15 if ms >= 700 else 0.0
    return SITUATIONS.setdefault((ms // 10, leap), frames_at(start=START, object=place(0.5 + leap, 0.1 * t, 0.3 * t)))


SITUATIONS: dict[tuple[int, float], dict[str, Frame]] = {}


@ALL_PHASES
@pytest.mark.parametrize("order", [AdaptThenRegress, RegressThenProduct])
def test_the_reference_does_not_jump_whatever_the_frames_and_the_speed_do(name: str, order: type) -> None:
    still = largest_jump(run(started(PHASES[name](), order), 0, 2_000))
    reproduction = started(PHASES[name](), order)
    references = run(reproduction, 0, 400, wandering, lambda _, mean: mean)
    for i, speed in enumerate((2.0, 0.0, -1.0, 1.0, 0.3)):
        reproduction.speed = speed
        begin = 400 + 250 * i
        references += run(
            reproduction, begin, begin + 250, wandering, lambda _, mean: mean, references[-1].gaussian.mean
        )
    assert np.abs(np.array([r.gaussian.mean for r in references])).max() < 2.0
    # A tenth of a mm per ms² is 100 m/s²; without the blending the leap alone would give 50 times as much
    assert largest_jump(references) < 4.0 * still + 2e-4


@ALL_PHASES
def test_a_pause_holds_the_reference_and_it_goes_on_from_there(name: str) -> None:
    reproduction = started(PHASES[name]())
    before = run(reproduction, 0, 800)
    reproduction.speed = 0.0
    held = run(reproduction, 800, 3_800)
    assert reproduction.speed == 0.0
    lag = held[-1].phase - before[-1].phase  # of the filter of the speed, which is 0.1 s late
    assert lag == pytest.approx(0.1 / DURATION, abs=1e-6)
    np.testing.assert_allclose(held[-1].velocity(), 0.0, atol=1e-9)
    assert held[-1].phase == pytest.approx(held[1_500].phase, abs=1e-6)
    reproduction.speed = 1.0
    after = run(reproduction, 3_800, 5_200)
    assert after[999].phase - held[-1].phase == pytest.approx(1.0 / DURATION - lag, abs=1e-5)
    assert after[-1].phase == 1.0
    expected = RegressThenProduct(reaching_model()).retrieve(HERE, [DURATION])[0]
    np.testing.assert_allclose(POSE.log(expected.mean, after[-1].gaussian.mean), 0.0, atol=1e-9)


@ALL_PHASES
def test_reversing_returns_along_the_same_path_to_the_start_and_stays_there(name: str) -> None:
    phase = PHASES[name]()
    reproduction = started(phase)
    run(reproduction, 0, 1_200)
    reproduction.speed = -1.0
    course = RegressThenProduct(reaching_model())
    course.situate(HERE)
    values = []
    for ms in range(1_200, 2_800):
        reference = reproduction.step(ms * MS, HERE)
        values.append(reference.phase)
        if ms % 100 == 0:
            there = course.at(phase.times(np.zeros(1)))[0][0]
            np.testing.assert_allclose(POSE.log(there, reference.gaussian.mean), 0.0, atol=1e-12)
    assert values[0] > 0.59 and max(np.diff(values[150:])) <= 0.0 and values[-1] == 0.0
    np.testing.assert_allclose(reference.velocity(), 0.0, atol=1e-9)


@ALL_PHASES
def test_the_horizon_is_what_later_steps_give_when_nothing_changes(name: str) -> None:
    reproduction = started(PHASES[name]())
    run(reproduction, 0, 500)
    run(reproduction, 500, 530, lambda _: THERE)  # the change is still being taken over
    ahead = reproduction.horizon(4, 0.02)
    later = run(reproduction, 530, 620, lambda _: THERE)
    for i, gaussian in enumerate(ahead):
        reached = later[20 * (i + 1) - 1].gaussian
        np.testing.assert_allclose(POSE.log(reached.mean, gaussian.mean), 0.0, atol=1e-9)
        np.testing.assert_allclose(reached.covariance, gaussian.covariance, rtol=1e-9, atol=1e-12)


@ALL_PHASES
def test_moving_the_world_moves_the_references(name: str) -> None:
    rng = np.random.default_rng(4)
    for order in (AdaptThenRegress, RegressThenProduct):
        world = Frame.from_pose(rng.normal(size=3), random_quaternion(rng))
        here, there = moved(world, HERE), moved(world, THERE)
        one, other = started(PHASES[name](), order), started(PHASES[name](), order)
        robot = OBJECT * 0.5 + START * 0.5
        robot[3:] /= np.linalg.norm(robot[3:])
        for ms in range(0, 1_500, 5):
            a = one.step(ms * MS, HERE if ms < 600 else THERE, robot)
            b = other.step(ms * MS, here if ms < 600 else there, world.A @ robot + world.b)
            if ms % 100 == 0:
                assert_moved(world, [a.gaussian, *a.horizon], [b.gaussian, *b.horizon], 1e-9)
                assert a.phase == pytest.approx(b.phase, abs=1e-9)


@ALL_PHASES
def test_signs_of_quaternions_do_not_matter(name: str) -> None:
    flip = np.array([1, 1, 1, -1, -1, -1, -1])
    turned = frames_at(start=START * flip, object=OBJECT)
    one, other = started(PHASES[name]()), started(PHASES[name]())
    robot = place(0.2, 0.05, 0.1)
    for ms in range(0, 1_500, 5):
        a, b = one.step(ms * MS, HERE, robot), other.step(ms * MS, turned, robot * flip)
    np.testing.assert_allclose(POSE.log(a.gaussian.mean, b.gaussian.mean), 0.0, atol=1e-12)
    np.testing.assert_allclose(a.gaussian.covariance, b.gaussian.covariance, atol=1e-12)


def arc_speeds(references: list[Reference]) -> Array:
    """m/s, turns included."""
    rates = velocities(references) * np.array([1, 1, 1, *3 * [METRES_PER_RADIAN]])
    return 1e3 * np.linalg.norm(rates, axis=1)


def test_by_arc_length_the_path_is_gone_along_at_constant_speed() -> None:
    by_clock = arc_speeds(run(started(ClockPhase()), 300, 1_700))
    by_length = arc_speeds(run(started(ArcLengthPhase()), 0, 2_000))
    middle = by_length[300:1_700]
    assert by_clock.max() > 2.0 * by_clock.min()
    assert middle.max() < 1.1 * middle.min()
    assert max(by_length[0], by_length[-1]) < 0.05 * middle.mean()


def test_a_given_speed_of_the_path_makes_the_duration() -> None:
    reproduction = started(ArcLengthPhase(ArcLengthConfig(path_speed=0.1)))
    references = run(reproduction, 0, 2_000)
    np.testing.assert_allclose(arc_speeds(references)[1_000:1_900], 0.1, rtol=0.05)
    assert reproduction.duration > 5.0 and references[-1].phase == pytest.approx(2.0 / reproduction.duration, rel=1e-3)


def test_another_path_is_gone_along_from_the_same_time_of_the_model() -> None:
    phase = ArcLengthPhase(ArcLengthConfig(path_speed=0.3))
    reproduction = started(phase)
    run(reproduction, 0, 700)
    before = float(phase.times(np.zeros(1))[0])
    reproduction.course.situate(THERE)
    phase.situated()
    assert 0.2 < before < 1.8
    assert float(phase.times(np.zeros(1))[0]) == pytest.approx(before, abs=1e-9)


def following(begin: int = 10_000, end: int = 10_000) -> Callable[[int, Array], Array]:
    """A robot that follows within 20 ms, except while it is held."""
    where: list[Array] = []

    def robot(ms: int, mean: Array) -> Array:
        if not where:
            where.append(mean)
        if not begin <= ms < end:
            where[0] = POSE.exp(where[0], 0.05 * POSE.log(where[0], mean))
        return where[0]

    return robot


def test_a_robot_that_is_held_lets_the_movement_wait_and_is_led_on_when_it_is_free() -> None:
    reproduction = started(StatePhase())
    references = run(reproduction, 0, 5_000, robot=following(900, 2_900))
    phases = np.array([r.phase for r in references])
    assert phases[2_899] - phases[900] < 0.15  # two seconds by the clock would be all of the movement
    assert phases[2_899] - phases[1_900] < 1e-3
    assert phases[-1] == 1.0
    held = references[2_899].gaussian.mean
    assert np.linalg.norm(held[:3] - references[900].gaussian.mean[:3]) < 0.15


def test_a_robot_that_follows_takes_little_longer_than_demonstrated() -> None:
    phases = np.array([r.phase for r in run(started(StatePhase()), 0, 3_000, robot=following())])
    assert 2_000 <= np.argmax(phases >= 1.0) < 2_400


def test_a_robot_that_is_carried_ahead_is_caught_up_with() -> None:
    course = RegressThenProduct(reaching_model())
    ahead = course.retrieve(HERE, [1.3])[0].mean
    reproduction = started(StatePhase())
    run(reproduction, 0, 600, robot=lambda _, mean: mean)
    references = run(reproduction, 600, 1_000, robot=lambda *_: ahead)
    assert 0.58 < references[-1].phase < 0.78  # 0.5 by the clock
    assert largest_jump(references) < 2e-4


def test_a_push_across_the_path_changes_nothing() -> None:
    def across(_: int, mean: Array) -> Array:
        """10 cm, orthogonal to the path in the metric of the Gaussian."""
        before, now = course.at(phase.times(np.array([-0.01, 0.01])))[:2]
        slope = np.linalg.solve(now[0], POSE.log(before[0], before[1]))
        push = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
        return POSE.exp(mean, push - slope * (slope @ push) / (slope @ slope))

    phase = StatePhase()
    reproduction = started(phase)
    course = RegressThenProduct(reaching_model())
    course.situate(HERE)
    references = run(reproduction, 0, 600, robot=lambda _, mean: mean)
    references += run(reproduction, 600, 1_400, robot=across, state=references[-1].gaussian.mean)
    np.testing.assert_allclose([r.phase for r in references], np.arange(1_400) / 2_000, atol=0.02)


def test_a_robot_that_is_not_seen_leaves_the_clock() -> None:
    unseen, clock = (run(started(phase), 0, 500)[-1] for phase in (StatePhase(), ClockPhase()))
    assert unseen.phase == pytest.approx(clock.phase, abs=1e-12)


def test_a_robot_that_is_seen_no_longer_leaves_the_clock_as_well() -> None:
    def held(_: int, mean: Array) -> Array:
        return POSE.exp(mean, np.array([-0.03, 0.0, 0.0, 0.0, 0.0, 0.0]))

    reproduction = started(StatePhase())
    behind = run(reproduction, 0, 700, robot=held)
    assert behind[-1].phase < 0.34  # 0.35 by the clock
    run(reproduction, 700, 1_200)  # ten times the response
    alone = run(reproduction, 1_200, 1_401)
    assert alone[-1].phase - alone[0].phase == pytest.approx(0.1, abs=1e-6)


def test_at_its_end_a_movement_has_no_speed_left_that_a_way_back_would_have_to_brake() -> None:
    reproduction = started(ClockPhase())
    assert run(reproduction, 0, 3_000)[-1].phase == 1.0
    reproduction.speed = -1.0
    # s after the last step, with a low-pass of 0.1 s from rest
    back = run(reproduction, 3_000, 3_500)
    seconds = 1e-3 * np.arange(1, 501)
    expected = 1.0 - (seconds + 0.1 * np.expm1(-seconds / 0.1)) / DURATION
    np.testing.assert_allclose([r.phase for r in back], expected, atol=1e-9)


def test_a_movement_by_arc_length_that_starts_again_takes_nothing_over() -> None:
    reproduction = started(ArcLengthPhase())
    run(reproduction, 0, 500)
    reproduction.start(1_000 * MS, phase=0.4)
    elsewhere = frames_at(start=place(-0.6, 0.3, 0.2), object=place(0.2, 0.2, -0.6))
    assert reproduction.step(1_000 * MS, elsewhere).phase == 0.4


def test_the_filter_does_not_depend_on_the_rate_of_the_loop() -> None:
    robot = RegressThenProduct(reaching_model()).retrieve(HERE, [0.9])[0].mean
    phases = []
    for step in (1, 5):
        reproduction = started(StatePhase())
        for ms in range(0, 1_501, step):
            reference = reproduction.step(ms * MS, HERE, robot)
        phases.append(reference.phase)
    assert phases[0] == pytest.approx(phases[1], abs=1e-6)


@ALL_PHASES
def test_a_movement_can_begin_in_its_middle(name: str) -> None:
    reproduction = Reproduction(reaching_model(), phase=PHASES[name]())
    reproduction.start(5_000 * MS, phase=0.5)
    assert reproduction.step(5_000 * MS, HERE).phase == 0.5
    assert reproduction.step(6_000 * MS, HERE).phase == pytest.approx(1.0)


@ALL_PHASES
@pytest.mark.parametrize("speed", [math.nan, math.inf, -11.0])
def test_a_speed_that_is_none_is_refused(name: str, speed: float) -> None:
    reproduction = started(PHASES[name]())
    with pytest.raises(ValueError, match="speed"):
        reproduction.speed = speed
    assert reproduction.speed == 1.0


def test_settings_that_make_no_sense_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match="easing"):
        ArcLengthConfig(easing=0.0)
    with pytest.raises(ValueError, match="memory"):
        StatePhaseConfig(memory=math.nan)


def test_a_course_that_stays_where_it_is_has_an_end_too() -> None:
    class Standing:
        """A course of one point."""

        manifold, frame_names, duration = POSE, ("start",), 1.0

        def situate(self, *_: object) -> None: ...

        def at(self, times: Array) -> tuple[Array, Array, Array]:
            H = len(times)
            return np.tile(START, (H, 1)), np.tile(np.eye(6), (H, 1, 1)), np.ones(1)

        def mixture(self) -> None: ...

    for phase in (ArcLengthPhase(ArcLengthConfig(path_speed=0.1)), StatePhase()):
        reproduction = Reproduction(Standing(), phase=phase)  # type: ignore[arg-type]
        reproduction.start(0)
        references = [reproduction.step(ms * MS, HERE, START) for ms in range(0, 1_100, 10)]
        assert references[-1].phase == 1.0
        assert isinstance(references[-1].gaussian, Gaussian)
