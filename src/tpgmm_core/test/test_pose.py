# SPDX-License-Identifier: Apache-2.0
"""Poses compose and have inverses, one by one and in batches; what is left between two is a distance and an angle."""

from __future__ import annotations

import numpy as np
import pytest

from random_problems import random_quaternion
from tpgmm_core import Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.geometry.pose import compose, inverse, pose_error

IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def random_poses(rng: np.random.Generator, *shape: int) -> Array:
    return np.concatenate([rng.normal(size=(*shape, 3)), random_quaternion(rng, *shape)], axis=-1)


def test_a_pose_composed_with_its_inverse_is_the_identity() -> None:
    poses = random_poses(np.random.default_rng(0), 20)
    for composed in (compose(poses, inverse(poses)), compose(inverse(poses), poses)):
        for pose in composed:
            assert pose_error(pose, IDENTITY) == pytest.approx((0.0, 0.0), abs=1e-7)


def test_composing_is_what_the_frame_of_the_pose_does() -> None:
    pose, relative, third = random_poses(np.random.default_rng(1), 3)
    frame = Frame.from_pose(pose[:3], pose[3:])
    np.testing.assert_allclose(compose(pose, relative), frame.A @ relative + frame.b, atol=1e-12)
    np.testing.assert_allclose(compose(compose(pose, relative), third), compose(pose, compose(relative, third)))


def test_batches_broadcast() -> None:
    rng = np.random.default_rng(2)
    one, many = random_poses(rng), random_poses(rng, 4, 5)
    for found, expected in (
        (compose(one, many), [compose(one, p) for p in many.reshape(-1, 7)]),
        (compose(many, one), [compose(p, one) for p in many.reshape(-1, 7)]),
        (inverse(many), [inverse(p) for p in many.reshape(-1, 7)]),
    ):
        np.testing.assert_allclose(found.reshape(-1, 7), expected, atol=1e-14)


def test_the_error_is_a_distance_and_an_angle_whatever_the_sign() -> None:
    pose = random_poses(np.random.default_rng(3))
    other = POSE.exp(pose, [0.3, 0.0, -0.4, 0.0, 0.6, 0.0])
    for sign in (1.0, -1.0):
        assert pose_error(np.r_[other[:3], sign * other[3:]], pose) == pytest.approx((0.5, 0.6))
