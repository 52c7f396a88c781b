# SPDX-License-Identifier: Apache-2.0
"""A Gaussian per time step and frame: what a step knows, and what it does with few demonstrations."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from reaching import DURATION, frames_at, place, reaching_demonstrations
from tpgmm_core import Demonstration, Frame, Gaussian
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.learning.shown_to_frame import isotropic_blocks
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.retrieval.time_steps import TimeSteps, views_at
from worlds import planar_demonstrations

OVER_POSES = "R1 x R3 x S3"


@cache
def learned(count: int = 6) -> TimeStepTPGMM:
    model = TimeStepTPGMM(manifold=OVER_POSES, n_steps=40).fit(reaching_demonstrations(count))
    model.metadata_ = {"duration_s": DURATION}
    return model


def test_a_step_knows_the_mean_of_the_demonstrations_and_a_covariance_by_the_formula_of_the_module() -> None:
    times = np.linspace(0.0, 1.0, 11)
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(4, 11, 2))
    still = {"still": Frame(np.eye(2), np.zeros(2)).with_time()}
    model = TimeStepTPGMM(reg_covar=0.0, prior_strength=2.0, n_steps=11, manifold="R1 x R2").fit(
        [Demonstration(times, np.column_stack([times, points]), still) for points in rows]
    )
    np.testing.assert_allclose(model.means_["still"][:, 1:], rows.mean(axis=0), atol=1e-12)
    S = model.covariances_["still"]
    within = S[:, 1:, 1:] - S[:, 1:, 0, None] * S[:, None, 0, 1:] / S[:, 0, 0, None, None]
    for step in range(11):
        sample = np.cov(rows[:, step], rowvar=False)
        shrunk = (3.0 * sample + 2.0 * np.eye(2) * np.trace(sample) / 2.0) / 5.0
        np.testing.assert_allclose(within[step], (1.0 + 1.0 / 4.0) * 6.0 / 4.0 * shrunk, rtol=1e-9)


def test_the_movement_is_the_product_of_what_the_frames_expect_at_that_time() -> None:
    situation = frames_at(start=place(0.1, 0.2, 0.3), object=place(0.6, -0.2, -0.8))
    movement, model = TimeSteps(learned()), learned()
    movement.situate(situation)
    grid = model.means_["start"][:, 0]
    means, covariances, activations = movement.at(grid[[7, 20]])
    for i, step in enumerate((7, 20)):
        seen = []
        for name, frame in situation.items():
            S = model.covariances_[name][step]
            within = S[1:, 1:] - np.outer(S[1:, 0], S[0, 1:]) / S[0, 0]
            data = Frame(frame.A[1:, 1:], frame.b[1:])
            seen.append(Gaussian(model.means_[name][step, 1:], within, POSE).transform(data))
        expected = Gaussian.product(seen)
        np.testing.assert_allclose(POSE.log(expected.mean, means[i]), 0.0, atol=1e-9)
        np.testing.assert_allclose(covariances[i], expected.covariance, rtol=1e-6, atol=1e-12)
    assert activations[7] == pytest.approx(1.0) and activations.shape == (40,)


def test_between_steps_the_path_has_no_corners() -> None:
    movement = TimeSteps(learned())
    movement.situate(reaching_demonstrations()[0].frames)
    h, grid = 1e-5, learned().means_["start"][1:-1, 0]
    before, at, after = (movement.at(grid + offset)[0] for offset in (-h, 0.0, h))
    bends = POSE.log(at, after) / h + POSE.log(at, before) / h
    speeds = np.abs(POSE.log(at, after) / h).max()
    assert np.abs(bends).max() < 0.1 * speeds  # what the weights of the frames change within a step


def test_two_demonstrations_tell_what_the_frames_have_in_common_and_that_they_are_two() -> None:
    """A hand from one frame to another: the end is found, and the model is about as unsure as it is."""
    errors, inside = [], []
    movement = TimeSteps(learned(2))
    for shown in reaching_demonstrations(20)[2:]:
        movement.situate(shown.frames)
        means, covariances, _ = movement.at(shown.times)
        steps = POSE.log(means, shown.data[:, 1:])[:, :3]
        errors.append(np.linalg.norm(steps[-1]))
        inside.append(np.mean(np.einsum("ti,tij,tj->t", steps, np.linalg.inv(covariances[:, :3, :3]), steps) < 6.25))
    assert np.median(errors) < 0.01 and np.mean(inside) > 0.5


def test_fewer_demonstrations_say_less() -> None:
    """The same spread, of 3 and of 12 demonstrations: the covariance is wider by what the Student distribution says."""
    times = np.linspace(0.0, 1.0, 5)
    corners = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])
    still = {"still": Frame(np.eye(2), np.zeros(2)).with_time()}

    def width(copies: int) -> float:
        shown = [
            Demonstration(times, np.column_stack([times, np.tile(x, (5, 1))]), still)
            for x in np.tile(corners, (copies, 1))
        ]
        model = TimeStepTPGMM(reg_covar=0.0, n_steps=5, manifold="R1 x R2").fit(shown)
        return float(model.covariances_["still"][2, 1, 1])

    few, many = 0.75 * (4.0 / 3.0) * 4.0 / 2.0, 6.0 / 11.0 * (13.0 / 12.0) * 22.0 / 20.0
    assert width(1) / width(4) == pytest.approx(few / many, rel=1e-6)


def test_one_demonstration_is_reproduced_although_nothing_is_known_of_what_matters() -> None:
    shown = reaching_demonstrations()[0]
    movement = TimeSteps(TimeStepTPGMM(manifold=OVER_POSES, n_steps=40).fit([shown]))
    movement.situate(shown.frames)
    means, covariances, _ = movement.at(shown.times)
    assert np.abs(POSE.log(means, shown.data[:, 1:])).max() < 0.05
    assert np.sqrt(covariances[:, 0, 0].min()) > 0.05


def test_a_frame_that_saw_nothing_at_a_time_has_no_say_there() -> None:
    shown = []
    for d in planar_demonstrations():
        seen = np.arange(len(d.times)) >= 40
        shown.append(Demonstration(d.times, d.data, d.frames, {"goal": seen}))
    model = TimeStepTPGMM(n_steps=20, manifold="R1 x R2").fit(shown)
    widths = np.trace(model.covariances_["goal"][:, 1:, 1:], axis1=1, axis2=2)
    assert widths[:8].min() > 3.0 * widths[12:].max()


def test_no_step_waits_for_the_compiler() -> None:
    movement = TimeSteps(learned())
    compiled = list(views_at.signatures)
    movement.situate(frames_at(start=place(0.1, 0.2, 0.3), object=place(0.6, -0.2, -0.8)), weights={"start": 0.5})
    movement.at(0.005 * np.arange(3))
    movement.at(np.zeros(1))
    assert compiled and list(views_at.signatures) == compiled


def test_blocks_are_the_factors_of_the_space() -> None:
    assert isotropic_blocks(Manifold.parse("R3 x S3 x R2")) == [slice(0, 3), slice(3, 6), slice(6, 8)]


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="n_steps is an integer from 2, got 1"):
        TimeStepTPGMM(n_steps=1).fit(planar_demonstrations())
    with pytest.raises(ValueError, match="time first"):
        TimeStepTPGMM().fit_projected({"frame": np.zeros((9, 1))})
