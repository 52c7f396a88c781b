# SPDX-License-Identifier: Apache-2.0
"""A frame whose pose is known badly in a direction counts less in that direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from random_problems import random_covariance, random_quaternion
from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.model.derived_frames import unturned
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct
from tpgmm_core.retrieval.time_steps import TimeSteps

MANIFOLD = Manifold.parse("R1 x R3 x S3")


def random_pose(rng: np.random.Generator) -> Array:
    return np.concatenate([rng.normal(size=3), random_quaternion(rng)])


def model_of(frame: str, mean: Array, covariance: Array, manifold: Manifold) -> TPGMM:
    model = TPGMM(1, manifold=manifold)
    model.frame_names_, model.manifold_ = (frame,), manifold
    model.priors_, model.means_, model.covariances_ = np.ones(1), {frame: mean[None]}, {frame: covariance[None]}
    return model


def test_the_pose_error_reaches_a_component_as_numerical_derivatives_say() -> None:
    rng = np.random.default_rng(1)
    pose, mean = random_pose(rng), random_pose(rng)
    P, covariance = random_covariance(rng, 6), random_covariance(rng, 6)
    frame = Frame.from_pose(pose[:3], pose[3:], P)

    def seen(error: Array) -> Array:
        turned = quaternion.multiply(quaternion.exp(error[3:]), pose[3:])
        other = Frame.from_pose(pose[:3] + error[:3], turned)
        return POSE.log(frame.A @ mean + frame.b, other.A @ mean + other.b)

    step = 1e-6
    J = np.column_stack([(seen(step * e) - seen(-step * e)) / (2.0 * step) for e in np.eye(6)])
    tangent = POSE.tangent_map(frame.A)
    expected = tangent @ covariance @ tangent.T + J @ P @ J.T
    model = model_of("object", mean, covariance, POSE)
    for weight in (1.0, 0.25):  # what is trusted less has a precision that is lower by that factor
        adapted = model.adapt({"object": frame}, weights={"object": weight}).covariances[0]
        np.testing.assert_allclose(weight * adapted, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("variance", [1e4, 1e8, 1e12, 1e30])
def test_what_is_not_known_at_all_in_one_direction_hides_nothing_in_the_others(variance: float) -> None:
    """Along a diagonal, so that rounding of the large numbers meets all of the entries."""
    P = np.zeros((6, 6))
    P[:2, :2] = 0.5 * variance
    model = model_of("object", np.array([0.1, 0.2, 0.3]), 1e-6 * np.eye(3), Manifold.euclidean(3))
    frame = Frame(np.eye(3), np.array([1.0, 2.0, 3.0]), pose_covariance=P)
    found = np.linalg.inv(model.adapt({"object": frame}).covariances[0])
    axes = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]]) / np.sqrt(2.0)
    seen = np.diag(axes @ found @ axes.T)
    np.testing.assert_allclose(seen[1:], 1e6, rtol=1e-5)
    assert seen[0] == pytest.approx(1.0 / (1e-6 + min(variance, 1e4)), rel=1e-2)


@pytest.fixture(scope="module")
def model() -> TPGMM:
    return TPGMM(3, manifold=MANIFOLD).fit(reaching_demonstrations())


def frames_of(model: TPGMM, uncertainty: Array | None = None) -> dict[str, Frame]:
    """Two frames, of which the end is known that well."""
    start, end = model.frame_names_
    frames = frames_at(**{start: place(0.0, 0.0, 0.0), end: place(0.3, 0.1, 0.4)})
    return frames | {end: replace(frames[end], pose_covariance=uncertainty)}


def test_a_frame_that_is_known_badly_counts_less_and_one_that_is_not_known_leaves_all_to_the_other(
    model: TPGMM,
) -> None:
    exact = model.adapt(frames_of(model))
    start, _ = frames_of(model)
    alone = model.adapt({start: frames_of(model)[start]})
    vague = model.adapt(frames_of(model, np.diag([1e8, 0.0, 0.0, 0.0, 0.0, 0.0])))
    for k in range(3):
        assert vague.covariances[k, 1, 1] > exact.covariances[k, 1, 1]
    none = model.adapt(frames_of(model, np.zeros((6, 6))))
    np.testing.assert_allclose(none.means, exact.means, atol=1e-9)
    np.testing.assert_allclose(none.covariances, exact.covariances, rtol=1e-6, atol=1e-12)
    everything = model.adapt(frames_of(model, 1e12 * np.eye(6)))
    np.testing.assert_allclose(everything.means[:, 1:4], alone.means[:, 1:4], atol=0.02)


def test_an_exact_frame_after_an_uncertain_one_is_bit_by_bit_as_before(model: TPGMM) -> None:
    before = model.adapt(frames_of(model))
    model.adapt(frames_of(model, np.eye(6)))
    after = model.adapt(frames_of(model))
    assert (before.means == after.means).all() and (before.covariances == after.covariances).all()


@pytest.mark.parametrize("method", ["adapt_regress", "regress_product", "time_steps"])
def test_every_retrieval_in_time_weighs_a_frame_by_its_uncertainty(method: str) -> None:
    demonstrations = reaching_demonstrations()
    model = TimeStepTPGMM(manifold=MANIFOLD).fit(demonstrations) if method == "time_steps" else None
    model = model or TPGMM(3, manifold=MANIFOLD).fit(demonstrations)
    make = {"adapt_regress": AdaptThenRegress, "regress_product": RegressThenProduct, "time_steps": TimeSteps}
    retrieval = make[method](model)
    end = [float(demonstrations[0].times[-1])]
    start, _ = frames_of(model)
    exact, vague, unknown, alone = (
        retrieval.retrieve(frames, end)[0]
        for frames in (
            frames_of(model),
            frames_of(model, np.diag([0.01, 1e-12, 1e-12, 1e-12, 1e-12, 1e-12])),
            frames_of(model, 1e12 * np.eye(6)),
            {start: frames_of(model)[start]},
        )
    )
    assert vague.covariance[0, 0] > 1.5 * exact.covariance[0, 0]
    np.testing.assert_allclose(vague.covariance[1, 1], exact.covariance[1, 1], rtol=0.2)
    np.testing.assert_allclose(unknown.mean[:3], alone.mean[:3], atol=0.02)


@pytest.mark.parametrize("wrong", [np.eye(3), -np.eye(6), np.full((6, 6), np.nan), np.triu(np.ones((6, 6)))])
def test_what_is_no_covariance_is_refused(wrong: Array) -> None:
    with pytest.raises(ValueError, match="covariance \\(6, 6\\) of its pose"):
        Frame.from_pose(np.zeros(3), [0.0, 0.0, 0.0, 1.0], wrong)


def test_a_covariance_of_a_pose_is_refused_where_the_data_are_none() -> None:
    model = model_of("a", np.zeros(2), np.eye(2), Manifold.euclidean(2))
    with pytest.raises(ValueError, match="needs data"):
        model.adapt({"a": Frame(np.eye(2), np.zeros(2), pose_covariance=np.eye(6))})


def test_frames_that_differ_in_their_covariance_alone_are_not_equal() -> None:
    exact, vague = (Frame.from_pose(np.zeros(3), [0.0, 0.0, 0.0, 1.0], P) for P in (None, np.eye(6)))
    assert exact != vague and vague == replace(exact, pose_covariance=np.eye(6))
    assert vague.with_time().pose_covariance is not None
    np.testing.assert_array_equal(np.diag(unturned(vague.with_time()).pose_covariance), [1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
