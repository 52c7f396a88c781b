# SPDX-License-Identifier: Apache-2.0
"""A frame whose pose is known badly in a direction counts less in that direction."""

from __future__ import annotations

import numpy as np
import pytest

from random_problems import random_covariance, random_quaternion
from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.model.frame_uncertainty import uncertain_precisions

MANIFOLD = Manifold.parse("R1 x R3 x S3")


def random_pose(rng: np.random.Generator) -> Array:
    return np.concatenate([rng.normal(size=3), random_quaternion(rng)])


def test_the_pose_error_reaches_a_component_as_numerical_derivatives_say() -> None:
    rng = np.random.default_rng(1)
    pose, mean = random_pose(rng), random_pose(rng)
    P, covariance = random_covariance(rng, 6), random_covariance(rng, 6)
    frame = Frame.from_pose(pose[:3], pose[3:])

    def seen(error: Array) -> Array:
        turned = quaternion.multiply(quaternion.exp(error[3:]), pose[3:])
        other = Frame.from_pose(pose[:3] + error[:3], turned)
        return POSE.log(frame.A @ mean + frame.b, other.A @ mean + other.b)

    step = 1e-6
    J = np.column_stack([(seen(step * e) - seen(-step * e)) / (2.0 * step) for e in np.eye(6)])
    tangent = POSE.tangent_map(frame.A)
    expected = tangent @ covariance @ tangent.T + J @ P @ J.T
    precision = uncertain_precisions("object", mean[None], np.linalg.inv(covariance)[None], frame, POSE, P)[0]
    np.testing.assert_allclose(tangent @ np.linalg.inv(precision) @ tangent.T, expected, rtol=1e-5, atol=1e-7)


@pytest.fixture(scope="module")
def model() -> TPGMM:
    return TPGMM(3, manifold=MANIFOLD).fit(reaching_demonstrations())


def frames_of(model: TPGMM) -> dict[str, Frame]:
    start, end = model.frame_names_
    return frames_at(**{start: place(0.0, 0.0, 0.0), end: place(0.3, 0.1, 0.4)})


def test_a_frame_that_is_known_badly_counts_less_and_one_that_is_not_known_leaves_all_to_the_other(
    model: TPGMM,
) -> None:
    frames = frames_of(model)
    exact = model.adapt(frames)
    other, end = frames
    alone = model.adapt({other: frames[other]})
    vague = model.adapt(frames, uncertainties={end: np.diag([1e8, 0.0, 0.0, 0.0, 0.0, 0.0])})
    for k in range(3):
        assert vague.covariances[k, 1, 1] > exact.covariances[k, 1, 1]
    none = model.adapt(frames, uncertainties={end: np.zeros((6, 6))})
    np.testing.assert_allclose(none.means, exact.means, atol=1e-9)
    np.testing.assert_allclose(none.covariances, exact.covariances, rtol=1e-6, atol=1e-12)
    everything = model.adapt(frames, uncertainties={end: 1e12 * np.eye(6)})
    np.testing.assert_allclose(everything.means[:, 1:4], alone.means[:, 1:4], atol=0.02)


def test_a_later_call_without_uncertainty_is_bit_by_bit_as_before(model: TPGMM) -> None:
    frames = frames_of(model)
    before = model.adapt(frames)
    model.adapt(frames, uncertainties={model.frame_names_[1]: np.eye(6)})
    after = model.adapt(frames)
    assert (before.means == after.means).all() and (before.covariances == after.covariances).all()


@pytest.mark.parametrize("wrong", [np.eye(3), -np.eye(6), np.full((6, 6), np.nan), np.triu(np.ones((6, 6)))])
def test_what_is_no_covariance_is_refused(model: TPGMM, wrong: Array) -> None:
    with pytest.raises(ValueError, match="covariance \\(6, 6\\) of its pose"):
        model.adapt(frames_of(model), uncertainties={model.frame_names_[1]: wrong})


def test_the_uncertainty_of_an_unknown_frame_is_refused(model: TPGMM) -> None:
    with pytest.raises(ValueError, match="the known frames are"):
        model.adapt(frames_of(model), uncertainties={"lamp": np.eye(6)})
