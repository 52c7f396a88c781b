# SPDX-License-Identifier: Apache-2.0
"""`Reproduction`: what the model says while the frames stay, and no jump when they do not."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

from reaching import DURATION, frames_at, place, reaching_model
from tpgmm_core import TPGMM, Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.reproduction import Reproduction
from worlds import planar_demonstrations

POSE = Manifold.parse("R3 x S3")
MS = 1_000_000
HERE = frames_at(start=place(0.0, 0.0, 0.0), object=place(0.5, 0.1, 0.4))
THERE = frames_at(start=place(0.0, 0.0, 0.0), object=place(0.5, -0.1, -0.4))
WITHOUT = {"start": HERE["start"]}


def started(**settings: float) -> Reproduction:
    reproduction = Reproduction(reaching_model(), **settings)  # type: ignore[arg-type]
    reproduction.start(0)
    return reproduction


def run(reproduction: Reproduction, begin: int, end: int, frames: dict[str, Frame]) -> list[Reference]:
    """One reference per ms."""
    return [reproduction.step(ms * MS, frames) for ms in range(begin, end)]


def means(references: list[Reference]) -> np.ndarray:
    return np.array([reference.gaussian.mean for reference in references])


@pytest.mark.parametrize("seconds", [0.0, 0.5, 1.3, 2.0])
def test_while_the_frames_stay_the_reference_is_exactly_what_the_model_says(seconds: float) -> None:
    reference = started().step(round(1e9 * seconds), HERE)
    expected = reaching_model().adapt(HERE).condition([0], [seconds])
    np.testing.assert_allclose(POSE.log(expected.mean, reference.gaussian.mean), 0.0, atol=1e-9)
    np.testing.assert_allclose(reference.gaussian.covariance, expected.covariance, atol=1e-9)
    assert reference.phase == pytest.approx(seconds / DURATION)
    assert reference.frames == ("start", "object")
    assert reference.activations.sum() == pytest.approx(1.0)


def test_another_duration_scales_time() -> None:
    slow = started(duration=10.0).step(5_000 * MS, HERE)
    usual = started().step(1_000 * MS, HERE)
    np.testing.assert_allclose(slow.gaussian.mean, usual.gaussian.mean, atol=1e-12)
    assert slow.phase == usual.phase == 0.5


def test_after_its_end_the_reference_stays() -> None:
    reproduction = started()
    at_end, later = reproduction.step(2_000 * MS, HERE), reproduction.step(9_000 * MS, HERE)
    assert at_end.phase == later.phase == 1.0
    np.testing.assert_allclose(later.gaussian.mean, at_end.gaussian.mean, atol=1e-12)
    np.testing.assert_allclose(later.velocity(), 0.0, atol=1e-9)


def test_the_horizon_holds_what_comes_next() -> None:
    references = run(started(horizon_steps=3, horizon_time_step=0.01), 500, 531, HERE)
    ahead = references[0].horizon
    assert len(ahead) == 3 and references[0].horizon_time_step == 0.01
    for i, gaussian in enumerate(ahead):
        np.testing.assert_allclose(gaussian.mean, references[10 * (i + 1)].gaussian.mean, atol=1e-9)
    none = started(horizon_steps=0).step(0, HERE)
    assert none.horizon == () and none.horizon_time_step == 0.0
    np.testing.assert_array_equal(none.velocity(), np.zeros(6))


@pytest.mark.parametrize("changed", [THERE, WITHOUT], ids=["moved", "lost"])
def test_when_frames_move_or_disappear_neither_position_nor_velocity_jumps(changed: dict[str, Frame]) -> None:
    reproduction = started(horizon_time_step=0.005)  # velocities are continuous as far as the horizon tells them
    before = run(reproduction, 0, 1_000, HERE)
    after = run(reproduction, 1_000, 2_000, changed)
    would_jump = POSE.log(
        reaching_model().adapt(HERE).condition([0], [1.0]).mean,
        reaching_model().adapt(changed).condition([0], [1.0]).mean,
    )
    assert np.abs(would_jump).max() > 0.02
    path = means(before[-200:] + after)
    rates = np.array([POSE.log(a, b) for a, b in zip(path, path[1:], strict=False)])
    assert np.abs(rates).max() < 0.01  # m and rad per ms
    assert np.abs(np.diff(rates, axis=0)).max() < 2e-4
    assert after[0].frames == tuple(changed)


def test_a_change_is_taken_over_within_some_time_constants() -> None:
    reproduction = started(blend_time=0.1)
    run(reproduction, 0, 1_000, HERE)
    last = run(reproduction, 1_000, 3_000, THERE)[-1]  # the movement ends after 2 s
    expected = reaching_model().adapt(THERE).condition([0], [2.0])
    np.testing.assert_allclose(POSE.log(expected.mean, last.gaussian.mean), 0.0, atol=1e-3)
    np.testing.assert_allclose(last.gaussian.covariance, expected.covariance, rtol=0.02, atol=1e-7)


def test_covariances_stay_symmetric_and_positive_while_frames_come_and_go() -> None:
    reproduction = started()
    for ms in range(0, 1_000, 5):
        frames = (HERE, THERE, WITHOUT)[ms // 50 % 3]
        covariance = reproduction.step(ms * MS, frames).gaussian.covariance
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-12)
        assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_a_covariance_goes_from_the_former_one_to_what_the_model_says_without_a_jump() -> None:
    reproduction = started()
    before = run(reproduction, 0, 1_000, HERE)[-1].gaussian.covariance
    covariances = np.array([r.gaussian.covariance for r in run(reproduction, 1_000, 6_500, WITHOUT)])
    end = reaching_model().adapt(WITHOUT).condition([0], [2.0]).covariance
    assert np.linalg.norm(end) > 2.0 * np.linalg.norm(before)
    steps = np.abs(np.diff([before, *covariances], axis=0)).max(axis=(1, 2))
    assert steps.max() < 0.02 * np.abs(covariances).max()
    np.testing.assert_allclose(covariances[-1], end, rtol=0.0, atol=1e-12)


def test_what_no_frame_constrains_goes_with_the_robot() -> None:
    model = TPGMM(3, reg_covar=1e-5).fit(planar_demonstrations())
    model.metadata_ = {"duration_s": DURATION}
    reproduction = Reproduction(model)
    reproduction.start(0)
    frames = {"goal": Frame([[1.0, 0.0], [0.0, 0.0]], [0.4, 0.0]).with_time()}
    for ms in range(3_000):
        robot = np.array([0.0, -3.0 if ms < 500 else -2.5])
        reference = reproduction.step(ms * MS, frames, robot)
        if ms == 100:
            assert reference.gaussian.mean[1] == pytest.approx(-3.0, abs=1e-5)
    assert reference.gaussian.mean[1] == pytest.approx(-2.5, abs=1e-3)
    seen = run(reproduction, 3_000, 3_001, frames)[0]  # a robot that is not seen stays where it was
    assert seen.gaussian.mean[1] == pytest.approx(-2.5, abs=1e-3)


def test_frames_that_are_refused_leave_no_trace() -> None:
    reproduction, undisturbed = started(), started()
    before = run(reproduction, 0, 500, HERE)
    with pytest.raises(ValueError, match="unknown"):
        reproduction.step(500 * MS, frames_at(object=place(9.0, 9.0, 0.0), nowhere=place(0.0, 0.0, 0.0)))
    path = means(before + run(reproduction, 501, 520, HERE))
    np.testing.assert_allclose(
        path, means(run(undisturbed, 0, 500, HERE) + run(undisturbed, 501, 520, HERE)), atol=1e-4
    )


def test_a_frame_that_is_trusted_less_pulls_less() -> None:
    def end(weight: float) -> np.ndarray:
        weights = {"start": 1.0, "object": weight}
        return started().step(2_000 * MS, HERE, weights=weights).gaussian.covariance

    assert np.trace(end(0.1)) > np.trace(end(1.0))


def test_a_new_start_forgets_what_was_before() -> None:
    reproduction = started()
    run(reproduction, 0, 500, HERE)
    reproduction.start(5_000 * MS)
    fresh = started()
    for ms in range(10):
        again, first = reproduction.step((5_000 + ms) * MS, THERE), fresh.step(ms * MS, THERE)
        np.testing.assert_allclose(again.gaussian.mean, first.gaussian.mean, atol=1e-12)
        np.testing.assert_allclose(again.gaussian.covariance, first.gaussian.covariance, atol=1e-12)


def test_a_clock_that_steps_back_is_no_step_at_all() -> None:
    reproduction = started()
    reproduction.step(1_000 * MS, HERE)
    reference = reproduction.step(-1_000 * MS, HERE)
    assert reference.phase == 0.0 and np.isfinite(reference.gaussian.mean).all()


@pytest.mark.parametrize("name", ["duration", "horizon_time_step", "blend_time"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_times_that_are_none_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Reproduction(reaching_model(), **{name: value})  # type: ignore[arg-type]


def test_a_model_without_duration_and_a_step_before_the_start_are_refused_with_what_to_do() -> None:
    nameless = copy.copy(reaching_model())
    nameless.metadata_ = {}
    with pytest.raises(ValueError, match="duration_s"):
        demonstrated_duration(nameless)
    with pytest.raises(ValueError, match="start"):
        Reproduction(reaching_model()).step(0, HERE)
    with pytest.raises(ValueError):
        started().step(0, {})
    with pytest.raises(ValueError):
        started().step(0, frames_at(nowhere=place(0.0, 0.0, 0.0)))


def test_the_mixture_is_the_model_adapted_to_the_frames_of_the_last_step() -> None:
    reproduction = started()
    with pytest.raises(ValueError, match="no step yet"):
        reproduction.mixture()
    reproduction.step(0, HERE)
    reproduction.step(MS, THERE)
    mixture, expected = reproduction.mixture(), reaching_model().adapt(THERE)
    np.testing.assert_allclose(mixture.means, expected.means)
    np.testing.assert_allclose(mixture.covariances, expected.covariances)
