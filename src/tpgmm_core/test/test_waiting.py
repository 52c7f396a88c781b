# SPDX-License-Identifier: Apache-2.0
"""A movement that waits while too little is known: when, how it is said, and how it goes on or ends.

That every method does so is tested beside what else all methods do, in test_retrieval_methods.py.
"""

from __future__ import annotations

import numpy as np
import pytest

from hidden_world import GOAL, HIDDEN_AT, SITUATION, START, TICK_NS, World, between, run, speeds, waiting, without
from reaching import DURATION, frames_at, place, reaching_model
from tpgmm_core import Frame
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.execution import Execution, Stage
from tpgmm_core.retrieval.methods import make_retrieval
from tpgmm_core.retrieval.outcome import ExecutionConfig


def test_where_the_rule_is_off_the_movement_goes_on_without_the_frame() -> None:
    plain = make_retrieval(reaching_model(20))
    never = waiting(reaching_model(20), unknown_position=100.0, unknown_orientation=100.0)
    for movement in (plain, never):
        movement.start(0, START)
    for i in range(1, 260):
        frames = without("object").frames(1e-9 * i * TICK_NS)
        one, other = (movement.step(i * TICK_NS, frames, START) for movement in (plain, never))
        np.testing.assert_array_equal(one.gaussian.mean, other.gaussian.mean)
        np.testing.assert_array_equal(one.gaussian.covariance, other.gaussian.covariance)


def test_a_frame_that_fades_is_waited_for_once_it_says_too_little_and_goes_on_when_it_has_come_back() -> None:
    hidden, fade, seen = 0.5 * DURATION, 0.5, 0.5 * DURATION + 1.5
    times = [hidden, hidden + fade, seen, seen + fade]

    def weights(time: float) -> dict[str, float]:
        return {"object": float(np.interp(time, times, [1.0, 0.0, 0.0, 1.0]))}

    def frames(time: float) -> dict[str, Frame]:
        return SITUATION if weights(time)["object"] > 0.0 else {"start": SITUATION["start"]}

    references = run(waiting(reaching_model(20)), World(frames, weights), 2.0 * DURATION + 2.0)
    changes = np.flatnonzero(np.diff([bool(r.waits) for r in references]))
    assert len(changes) == 2  # it waits once
    begins, ends = (1e-9 * TICK_NS * (i + 2) for i in changes)
    assert hidden < begins <= hidden + fade + 0.02 and seen < ends < seen + fade
    assert references[-1].phase == pytest.approx(1.0)
    assert np.linalg.norm(references[-1].gaussian.mean[:3] - GOAL[:3]) < 0.02


def test_with_no_frame_at_all_it_waits_and_a_speed_that_is_set_meanwhile_holds_afterwards() -> None:
    movement = waiting(reaching_model(20))
    movement.start(0, START)
    movement.step(TICK_NS, SITUATION, START)
    first = movement.step(2 * TICK_NS, {}, START)
    assert first.waits.startswith("without start, object the reference is known ")
    movement.speed = 0.5
    stood = [movement.step(i * TICK_NS, {}, START) for i in range(3, 100)]
    assert stood[60].phase == pytest.approx(stood[-1].phase, abs=1e-4) and movement.speed == 0.5
    went = [movement.step(i * TICK_NS, SITUATION, START) for i in range(100, 200)]
    rate = (went[-1].phase - went[80].phase) / (19 * 1e-9 * TICK_NS)
    assert rate == pytest.approx(0.5 / DURATION, rel=1e-3)


def test_a_frame_whose_pose_is_known_too_roughly_is_said() -> None:
    def seen_to(deviation: float) -> Frame:
        covariance = np.diag(np.square([deviation] * 3 + [1e-3] * 3))
        return Frame.from_pose(GOAL[:3], GOAL[3:], covariance).with_time()

    for deviation, is_enough in ((0.01, True), (0.2, False)):
        frames = {**SITUATION, "object": seen_to(deviation)}
        references = run(waiting(reaching_model(20)), World(lambda time, frames=frames: frames), 1.2 * DURATION)
        assert (references[-1].waits == "") is is_enough
    assert references[-1].waits.startswith("with object known as roughly as now, the reference is known to ")


def test_it_stays_where_it_waits_whatever_the_other_frames_do() -> None:
    def frames(time: float) -> dict[str, Frame]:
        if time < HIDDEN_AT:
            return SITUATION
        return frames_at(start=place(0.02 + 0.1 * (time - HIDDEN_AT), -0.03, 0.2))

    references = run(waiting(reaching_model(20)), World(frames), HIDDEN_AT + 3.0)
    assert speeds(between(references, HIDDEN_AT + 1.0, HIDDEN_AT + 3.0)).max() < 1e-3


def executed(config: ExecutionConfig, world: World, seconds: float) -> tuple[Execution, list[Reference | None]]:
    execution, pose, references = Execution(waiting(reaching_model(20)), config), START, []
    for i in range(1, round(1e9 * seconds) // TICK_NS):
        time = 1e-9 * i * TICK_NS
        reference = execution.step(i * TICK_NS, world.frames(time), pose, world.weights(time))
        pose = pose if reference is None else reference.gaussian.mean
        references.append(reference)
    return execution, references


def test_a_movement_that_has_waited_for_too_long_is_aborted_with_the_reason_and_stays_there() -> None:
    config = ExecutionConfig(unknown_timeout=2.0, stall_timeout=0.5)
    gone = World(lambda time: {} if time > HIDDEN_AT else SITUATION)
    execution, references = executed(config, gone, HIDDEN_AT + 4.0)
    assert execution.stage is Stage.ENDED and execution.outcome is not None and not execution.outcome.success
    assert execution.outcome.reason.startswith("waited for 2 s at phase 0.8")
    assert "without start, object the reference is known not at all" in execution.outcome.reason
    stays = [reference.gaussian.mean for reference in references[-150:] if reference is not None]
    assert len(stays) == 150 and np.abs(np.diff(stays, axis=0)).max() < 1e-9


def test_a_movement_that_has_waited_ends_well_and_the_wait_counts_as_no_stall() -> None:
    config = ExecutionConfig(unknown_timeout=5.0, stall_timeout=0.5, position_tolerance=0.02)
    execution, _ = executed(config, without("object"), 2.0 * DURATION + 3.0)
    assert execution.outcome is not None and execution.outcome.success, execution.outcome
