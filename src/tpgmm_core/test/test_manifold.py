# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from random_problems import random_quaternion
from tpgmm_core import Frame, Manifold
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE

rng = np.random.default_rng(1)
M = Manifold.parse("R1 x R3 x S3")


def random_points(n: int) -> np.ndarray:
    return np.concatenate([rng.normal(size=(n, 4)), random_quaternion(rng, n)], axis=1)


def test_parse_and_str_invert_each_other() -> None:
    assert str(M) == "R1 x R3 x S3" and (M.dim, M.tangent_dim) == (8, 7)
    assert Manifold.parse(str(M)) == M and hash(Manifold.parse(str(M))) == hash(M)
    assert Manifold.parse("euclidean", 3) == Manifold.euclidean(3)
    assert Manifold.parse("S3 x S3").tangent_dim == 6


@pytest.mark.parametrize("text", ["R0", "S2", "R3 S3", "", "R3 x", "cone", "euclidean"])
def test_parse_refuses_what_it_does_not_know(text: str) -> None:
    with pytest.raises(ValueError):
        Manifold.parse(text)


def test_exp_inverts_log_and_the_sign_of_quaternions_does_not_matter() -> None:
    base, x = random_points(50), random_points(50)
    v = M.log(base, x)
    assert M.distance(M.exp(base, v), x).max() < 1e-12
    flipped = x * np.r_[np.ones(4), -np.ones(4)]
    np.testing.assert_allclose(M.log(base, flipped), v, atol=1e-15)


def test_transport_keeps_lengths_and_the_direction_of_travel() -> None:
    base, to = random_points(50), random_points(50)
    T = M.transport(base, to)
    np.testing.assert_allclose(T @ np.swapaxes(T, 1, 2), np.broadcast_to(np.eye(7), T.shape), atol=1e-12)
    arrived = np.einsum("nij,nj->ni", T, M.log(base, to))
    np.testing.assert_allclose(arrived, -M.log(to, base), atol=1e-12)


def test_transport_matches_parallel_transport_on_the_sphere_in_four_dimensions() -> None:
    S3 = Manifold.parse("S3")
    base = random_quaternion(rng)
    w = rng.normal(size=3)
    u = np.cross(w, rng.normal(size=3))  # across the way: constant in R^4 along a great circle
    to = S3.exp(base, w)
    in_r4 = quaternion.multiply(np.append(0.5 * u, 0.0), base)
    back = 2.0 * quaternion.multiply(in_r4, quaternion.conjugate(to))
    np.testing.assert_allclose(S3.transport(base, to) @ u, back[:3], atol=1e-12)


def test_a_pose_frame_moves_tangent_vectors_as_its_tangent_map_says() -> None:
    frame = Frame.from_pose(rng.normal(size=3), random_quaternion(rng)).with_time()
    base, x = random_points(20), random_points(20)
    A, b = frame.A, frame.b
    moved = M.log(base @ A.T + b, x @ A.T + b)
    np.testing.assert_allclose(moved, M.log(base, x) @ M.tangent_map(A).T, atol=1e-12)


def test_tangent_map_refuses_blocks_that_are_no_left_multiplication() -> None:
    good = Frame.from_pose(np.zeros(3), random_quaternion(rng)).with_time().A
    scaled = good.copy()
    scaled[4:, 4:] *= 2.0
    right = good.copy()
    right[4:, 4:] = right[4:, 4:].T * np.array([[1, 1, 1, -1]] * 3 + [[1, 1, -1, 1]])
    mixed = good.copy()
    mixed[0, 5] = 0.1
    for A in (scaled, right, mixed):
        with pytest.raises(ValueError, match="S3"):
            M.tangent_map(A)
    with pytest.raises(ValueError, match="shape"):
        M.tangent_map(np.eye(4))
    reflected = good.copy()
    reflected[1:4, 1:4] *= -2.0  # Euclidean blocks may be anything
    np.testing.assert_allclose(M.tangent_map(reflected)[1:4, 1:4], reflected[1:4, 1:4])


def test_subset_keeps_quaternions_whole() -> None:
    assert str(M.subset([0])) == "R1"
    assert str(M.subset([4, 5, 6, 7, 2])) == "S3 x R1"
    np.testing.assert_array_equal(M.tangent_indices([4, 5, 6, 7, 2]), [4, 5, 6, 2])
    assert str(M.subset([1, 2, 3])) == "R3" and M.rest([0]) == [1, 2, 3, 4, 5, 6, 7]
    for dims in ([4, 5, 6], [5, 4, 6, 7], [0, 0], [8], [-1], []):
        with pytest.raises(ValueError):
            M.subset(dims)


def test_single_poses_and_stacks_of_them_go_through_the_same_maps() -> None:
    rng = np.random.default_rng(2)
    start, goal = rng.normal(size=(2, 5, 7))
    start[:, 3:], goal[:, 3:] = quaternion.normalize(start[:, 3:]), quaternion.normalize(goal[:, 3:])
    v = POSE.log(start, goal)
    for one_start, one_goal, one_v in zip(start, goal, v, strict=True):
        np.testing.assert_allclose(POSE.log(one_start, one_goal), one_v, atol=1e-12)
        np.testing.assert_allclose(POSE.log(one_start, np.r_[one_goal[:3], -one_goal[3:]]), one_v, atol=1e-12)
        np.testing.assert_allclose(POSE.distance(POSE.exp(one_start, one_v), one_goal), 0.0, atol=1e-7)


@pytest.mark.parametrize("text", ["S3", "R3 x S3", "R3"])
def test_points_and_vectors_of_other_dimensions_are_refused_with_the_shapes(text: str) -> None:
    manifold = Manifold.parse(text)
    point, vector = np.r_[np.zeros(manifold.dim - 1), 1.0], np.zeros(manifold.tangent_dim)
    for wrong in (point[:-1], np.r_[point, 0.0], np.zeros((5, manifold.dim - 1)), 1.0):
        with pytest.raises(ValueError, match=rf"points of {text} have shape \(\.\.\., {manifold.dim}\)"):
            manifold.log(point, wrong)
        with pytest.raises(ValueError, match=rf"points of {text} have shape \(\.\.\., {manifold.dim}\)"):
            manifold.exp(wrong, vector)
    with pytest.raises(ValueError, match=rf"tangent vectors \(\.\.\., {manifold.tangent_dim}\)"):
        manifold.exp(point, np.r_[vector, 0.0])


def test_a_mean_without_weight_or_without_points_is_refused() -> None:
    points = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    S3 = Manifold.parse("S3")
    for weights in (np.zeros(3), [1.0, -1.0, 0.0], [np.nan, 1.0, 1.0], np.ones(2)):
        with pytest.raises(ValueError, match="3 points have shape .* a positive sum"):
            S3.mean(points, weights)
    for wrong in (np.zeros((0, 4)), np.zeros((3, 3)), np.zeros(4)):
        with pytest.raises(ValueError, match=r"needs points \(N, 4\) with N > 0"):
            S3.mean(wrong)
    np.testing.assert_array_equal(S3.mean(points, [0.0, 0.0, 2.0]), points[0])
