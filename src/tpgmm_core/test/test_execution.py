# SPDX-License-Identifier: Apache-2.0
"""`Execution`: when a movement begins, when it is done, and what is said of its end."""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
import pytest

from reaching import frames_at, place, reaching_model
from tpgmm_core.execution import Execution, ExecutionConfig, Outcome, Stage
from tpgmm_core.reproduction import Reproduction

FRAMES = frames_at(start=place(0.0, 0.0, 0.0), object=place(0.5, 0.1, 0.4))
WEIGHTS = {"start": 1.0, "object": 1.0}
SECOND = 1_000_000_000
CONFIG = ExecutionConfig(start_timeout=1.0, settle_time=0.5)


def execution() -> Execution:
    return Execution(Reproduction(reaching_model()), CONFIG)


def outcome_with(error: np.ndarray) -> Outcome:
    """The outcome for a robot that is off the reference by a tangent vector (6,)."""
    run = execution()
    pose = None
    for tenth in range(40):
        reference = run.step(tenth * SECOND // 10, FRAMES, pose, WEIGHTS)
        assert reference is not None
        pose = reference.gaussian.manifold.exp(reference.gaussian.mean, error)
    assert run.outcome is not None
    return run.outcome


def test_it_waits_for_all_frames_and_then_moves_from_the_beginning() -> None:
    run = execution()
    assert run.step(0, {"start": FRAMES["start"]}, None, {"start": 1.0}) is None
    assert run.stage is Stage.STARTING
    reference = run.step(SECOND // 2, FRAMES, None, WEIGHTS)
    assert reference is not None and reference.phase == 0.0
    assert run.stage is Stage.MOVING


def test_frames_that_are_not_seen_in_time_end_it_by_name_and_nothing_moves() -> None:
    run = execution()
    for tenth in range(20):
        assert run.step(tenth * SECOND // 10, {"start": FRAMES["start"]}, None, {"start": 1.0}) is None
    assert run.stage is Stage.ENDED
    assert run.outcome is not None and not run.outcome.success
    assert "object" in run.outcome.reason and "start," not in run.outcome.reason
    # Not even when they come after all
    assert run.step(3 * SECOND, FRAMES, None, WEIGHTS) is None


def test_an_end_near_enough_is_a_success_and_the_errors_are_told() -> None:
    outcome = outcome_with(np.array([0.003, 0.0, 0.0, 0.0, 0.0, 0.02]))
    assert outcome.success
    assert outcome.position_error == pytest.approx(0.003) and outcome.orientation_error == pytest.approx(0.02)


@pytest.mark.parametrize("error", [[0.02, 0, 0, 0, 0, 0], [0, 0, 0, 0.2, 0, 0]], ids=["position", "orientation"])
def test_an_end_too_far_off_is_none_and_the_errors_are_told(error: list[float]) -> None:
    outcome = outcome_with(np.array(error))
    assert not outcome.success and "mm" in outcome.reason and "deg" in outcome.reason
    assert math.hypot(outcome.position_error, outcome.orientation_error) == pytest.approx(max(error))


def test_it_is_judged_only_after_the_settle_time_and_the_reference_goes_on_after_the_end() -> None:
    run = execution()
    pose = reaching_model().adapt(FRAMES).condition([0], [2.0]).mean
    stages = []
    for tenth in range(40):
        assert run.step(tenth * SECOND // 10, FRAMES, pose, WEIGHTS) is not None
        stages.append(run.stage)
    assert stages.index(Stage.SETTLING) == 20 and stages.index(Stage.ENDED) == 25
    assert run.outcome is not None and run.outcome.success


def test_a_robot_that_is_not_seen_is_no_success() -> None:
    run = execution()
    for tenth in range(40):
        run.step(tenth * SECOND // 10, FRAMES, None, WEIGHTS)
    assert run.outcome is not None and not run.outcome.success
    assert "pose is not known" in run.outcome.reason and math.isnan(run.outcome.position_error)


def test_a_stop_leaves_the_reference_where_it_is_and_keeps_the_first_reason() -> None:
    run = execution()
    for ms in range(0, 1000, 10):
        last = run.step(ms * SECOND // 1000, FRAMES, None, WEIGHTS)
    run.stop(990 * SECOND // 1000, "canceled")
    run.stop(SECOND, "too late")
    later = run.step(5 * SECOND, FRAMES, None, WEIGHTS)
    assert last is not None and later is not None
    np.testing.assert_allclose(later.gaussian.mean, last.gaussian.mean, atol=1e-12)
    assert run.outcome == Outcome(False, "canceled", run.outcome.position_error, run.outcome.orientation_error)  # type: ignore[union-attr]
    assert run.stage is Stage.ENDED


def test_without_any_frame_there_is_no_reference_and_it_goes_on_when_one_is_back() -> None:
    run = execution()
    assert run.step(0, FRAMES, None, WEIGHTS) is not None
    assert run.step(SECOND, {}, None, {}) is None
    reference = run.step(3 * SECOND // 2, FRAMES, None, WEIGHTS)
    assert reference is not None and reference.phase == pytest.approx(0.75)


@pytest.mark.parametrize("name", [item.name for item in fields(ExecutionConfig)])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_settings_that_make_no_sense_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        ExecutionConfig(**{name: value})
