# SPDX-License-Identifier: Apache-2.0
"""`Execution`: when a movement begins, when it is done, and what is said of its end."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest

from reaching import frames_at, place, reaching_model
from tpgmm_core import TPGMM
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.execution import Execution, Stage
from tpgmm_core.retrieval.outcome import ExecutionConfig, Outcome
from tpgmm_core.retrieval.phase import StatePhase
from tpgmm_core.retrieval.regression import RegressThenProduct
from tpgmm_core.retrieval.reproduction import Reproduction
from worlds import planar_demonstrations

FRAMES = frames_at(start=place(0.0, 0.0, 0.0), object=place(0.5, 0.1, 0.4))
WEIGHTS = {"start": 1.0, "object": 1.0}
SECOND = 1_000_000_000
CONFIG = ExecutionConfig(start_timeout=1.0, settle_time=0.5, stall_timeout=2.0)


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


def test_a_movement_that_goes_back_waits_at_its_start_and_may_go_forward_again() -> None:
    run = execution()
    pose = reaching_model().adapt(FRAMES).condition([0], [2.0]).mean
    seen = []
    for tenth in range(90):
        if tenth == 22:
            assert run.stage is Stage.SETTLING
            run.retrieval.speed = -1.0
        if tenth == 60:
            run.retrieval.speed = 1.0
        reference = run.step(tenth * SECOND // 10, FRAMES, pose, WEIGHTS)
        assert reference is not None
        seen.append((run.stage, reference.phase))
    assert seen[50] == (Stage.MOVING, 0.0) and run.stage is Stage.ENDED
    assert run.outcome is not None and run.outcome.success


def held(seconds: float, speeds: dict[int, float]) -> list[tuple[Stage, float]]:
    """Stages and phases, a tenth of a second apart, while a robot is held at the start; speeds by tenths."""
    run, found = Execution(Reproduction(reaching_model(), phase=StatePhase()), CONFIG), []
    for tenth in range(round(10 * seconds)):
        if tenth in speeds:
            run.retrieval.speed = speeds[tenth]
        reference = run.step(tenth * SECOND // 10, FRAMES, place(0.0, 0.0, 0.0), WEIGHTS)
        assert reference is not None
        found.append((run.stage, reference.phase))
    if run.outcome is not None:
        assert not run.outcome.success and "stalled for 2 s" in run.outcome.reason
        assert f"phase {reference.phase:.2f}" in run.outcome.reason and "held" in run.outcome.reason
    return found


def test_a_movement_that_waits_for_a_held_robot_is_given_up_in_the_end() -> None:
    found = held(8.0, {})
    ended = [stage for stage, _ in found].index(Stage.ENDED)
    assert 20 <= ended < 40
    assert {phase for _, phase in found[ended:]} == {found[ended][1]}  # the reference stays where it is


def test_neither_a_pause_nor_the_wait_at_the_start_is_a_stall() -> None:
    assert {stage for stage, _ in held(8.0, {10: 0.0})} == {Stage.MOVING}
    assert {stage for stage, _ in held(8.0, {10: -1.0})} == {Stage.MOVING}
    # what has stood still before a pause counts, and the pause does not
    usual = [stage for stage, _ in held(8.0, {})].index(Stage.ENDED)
    paused = [stage for stage, _ in held(12.0, {usual - 5: 0.0, usual + 35: 1.0})].index(Stage.ENDED)
    assert usual + 38 <= paused <= usual + 42


def test_what_is_slow_does_not_stand_still() -> None:
    run = Execution(Reproduction(reaching_model(), duration=200.0), CONFIG)
    run.retrieval.speed = 0.1
    for tenth in range(100):
        run.step(tenth * SECOND // 10, FRAMES, None, WEIGHTS)
    assert run.stage is Stage.MOVING


def jumps(references: list[Reference]) -> tuple[float, float]:
    """Largest step, and largest change of steps, of the mean."""
    means = [r.gaussian.mean for r in references]
    steps = np.array([POSE.log(a, b) for a, b in zip(means, means[1:], strict=False)])
    return float(np.abs(steps).max()), float(np.abs(np.diff(steps, axis=0)).max())


def test_another_retrieval_takes_over_in_the_middle_without_a_jump() -> None:
    """Another order of regression on another model, and back, while the former change is still being taken over."""
    others = {
        500: Reproduction(RegressThenProduct(shifted_model()), horizon_steps=1),
        560: Reproduction(reaching_model()),
    }
    usual, swapped = execution(), execution()
    references: dict[Execution, list[Reference]] = {usual: [], swapped: []}
    for run, found in references.items():
        for ms in range(1_500):
            if run is swapped and ms in others:
                run.take_over(others[ms])
            reference = run.step(ms * SECOND // 1000, FRAMES, None, WEIGHTS)
            assert reference is not None
            found.append(reference)
    largest_step, largest_change = jumps(references[usual])
    step, change = jumps(references[swapped])
    assert step < largest_step + 1e-3 and change < 3.0 * largest_change  # the models are 5 cm apart
    np.testing.assert_allclose([r.phase for r in references[swapped]], [r.phase for r in references[usual]], atol=1e-9)
    apart = POSE.log(references[usual][540].gaussian.mean, references[swapped][540].gaussian.mean)
    assert np.abs(apart).max() > 2e-3
    np.testing.assert_allclose(
        POSE.log(references[usual][-1].gaussian.mean, references[swapped][-1].gaussian.mean), 0.0, atol=1e-3
    )
    covariances = np.array([r.gaussian.covariance for r in references[swapped][490:520]])
    assert np.abs(np.diff(covariances, axis=0)).max() < 0.05 * np.abs(covariances).max()


def shifted_model() -> TPGMM:
    """The same movement 5 cm higher, as seen from both frames."""
    model = copy.copy(reaching_model())
    model.means_ = {name: means + 0.05 * np.eye(8)[3] for name, means in model.means_.items()}
    return model


def test_a_retrieval_that_takes_over_keeps_speed_and_horizon() -> None:
    run = execution()
    run.retrieval.speed = 0.5
    for ms in range(100):
        run.step(ms * SECOND // 1000, FRAMES, None, WEIGHTS)
    run.take_over(Reproduction(shifted_model()))
    run.step(100 * SECOND // 1000, FRAMES, None, WEIGHTS)
    assert run.retrieval.speed == 0.5 and run.retrieval.frame_names == ("start", "object")
    ahead = run.retrieval.horizon(5, 0.01)
    for ms in range(101, 151):
        reference = run.step(ms * SECOND // 1000, FRAMES, None, WEIGHTS)
    assert reference is not None
    np.testing.assert_allclose(POSE.log(reference.gaussian.mean, ahead[-1].mean), 0.0, atol=1e-9)
    np.testing.assert_allclose(reference.gaussian.covariance, ahead[-1].covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(run.retrieval.mixture().means, shifted_model().adapt(FRAMES).means)


def test_a_retrieval_in_another_space_is_refused_and_the_movement_goes_on() -> None:
    run = execution()
    run.step(0, FRAMES, None, WEIGHTS)
    flat = TPGMM(2, reg_covar=1e-5).fit(planar_demonstrations())
    flat.metadata_ = {"duration_s": 2.0}
    with pytest.raises(ValueError, match="same dimensions"):
        run.take_over(Reproduction(flat))
    reference = run.step(SECOND, FRAMES, None, WEIGHTS)
    assert reference is not None and reference.phase == 0.5


def test_before_the_movement_begins_another_retrieval_just_takes_its_place() -> None:
    run = execution()
    assert run.step(0, {}, None, {}) is None
    other = Reproduction(shifted_model())
    run.take_over(other)
    assert run.retrieval is other
    reference = run.step(SECOND // 2, FRAMES, None, WEIGHTS)
    assert reference is not None and reference.phase == 0.0


@pytest.mark.parametrize("name", [item.name for item in fields(ExecutionConfig)])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_settings_that_make_no_sense_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        ExecutionConfig(**{name: value})


@pytest.mark.parametrize(
    ("follows", "cause"),
    [
        (lambda t: 0.0, "hardly moved"),
        (lambda t: min(0.6, t), "has stopped there"),
        (lambda t: min(1.0, 0.3 * t), "late and still approaching"),
    ],
    ids=["held", "blocked", "late"],
)
def test_a_missed_end_names_what_the_way_of_the_robot_tells_of_the_cause(
    follows: Callable[[float], float], cause: str
) -> None:
    run = execution()
    end = reaching_model().adapt(FRAMES).condition([0], [2.0]).mean
    start = POSE.exp(end, np.array([0.3, -0.4, 0.2, 0.0, 0.0, 0.0]))
    way = POSE.log(start, end)
    for tenth in range(40):
        run.step(tenth * SECOND // 10, FRAMES, POSE.exp(start, follows(tenth / 10) * way), WEIGHTS)
    assert run.outcome is not None and run.outcome.is_missed and not run.outcome.success
    assert "from the model's end of the movement; " in run.outcome.reason and cause in run.outcome.reason
