# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from random_problems import random_covariance, random_quaternion
from tpgmm_core import Gaussian, Manifold
from tpgmm_core.common.types import Array
from tpgmm_core.retrieval.covariance_mean import CovarianceMean
from tpgmm_core.retrieval.spring import Smoothed

K = 4


def problem(rng: np.random.Generator, n: int) -> tuple[Array, Gaussian, Array]:
    """Covariances of very different size, one at a goal, and weights that leave something to it."""
    sizes = 10.0 ** rng.uniform(-3.0, 1.0, K)
    covariances = np.stack([size * random_covariance(rng, n, 0.4) for size in sizes])
    return covariances, Gaussian(np.zeros(n), 1e-3 * random_covariance(rng, n, 0.4)), rng.dirichlet(np.ones(K + 1))[:K]


def mean(covariances: Array, goal: Gaussian, weights: Array) -> Array:
    n = len(goal.mean)
    means = CovarianceMean(Manifold.euclidean(n), K)
    assert means.take(np.zeros((K, n)), covariances, goal)
    return means.at(np.ones(n), weights)


@pytest.mark.parametrize("n", [1, 2, 6])
def test_the_mean_is_that_of_the_equation_and_of_precisions_too(n: int) -> None:
    rng = np.random.default_rng(n)
    covariances, goal, weights = problem(rng, n)
    L = np.linalg.cholesky(goal.covariance)
    seen = np.linalg.inv(L) @ covariances @ np.linalg.inv(L).T
    values, V = np.linalg.eigh(seen)
    logarithms = V * np.log(values)[:, None, :] @ np.swapaxes(V, 1, 2)
    expected = L @ expm(np.einsum("k,kij->ij", weights, logarithms)) @ L.T
    found = mean(covariances, goal, weights)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_array_equal(found, found.T)
    # The mean of precisions, as the goal's precision sees them, is the precision of the mean.
    of_precisions = mean(np.linalg.inv(covariances), Gaussian(goal.mean, np.linalg.inv(goal.covariance)), weights)
    np.testing.assert_allclose(of_precisions @ found, np.eye(n), atol=1e-8)
    for k in range(K):
        np.testing.assert_allclose(mean(covariances, goal, np.eye(K)[k]), covariances[k], rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(mean(covariances, goal, np.zeros(K)), goal.covariance, rtol=1e-12, atol=1e-18)


def test_little_of_a_wide_one_adds_little() -> None:
    narrow, wide = np.eye(2), 64.0 * np.eye(2)
    found = mean(np.stack([narrow, wide, wide, wide]), Gaussian(np.zeros(2), narrow), np.array([0.99, 0.01, 0.0, 0.0]))
    np.testing.assert_allclose(found, 64.0**0.01 * np.eye(2), rtol=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_any_other_frame_of_reference_sees_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covariances, goal, weights = problem(rng, 6)
    A = rng.normal(size=(6, 6))
    there = mean(A @ covariances @ A.T, Gaussian(np.zeros(6), A @ goal.covariance @ A.T), weights)
    expected = A @ mean(covariances, goal, weights) @ A.T
    np.testing.assert_allclose(there, expected, rtol=1e-4, atol=1e-8 * np.abs(expected).max())


def test_on_poses_covariances_go_to_the_goal_and_from_there_to_the_point_by_parallel_transport() -> None:
    rng, manifold = np.random.default_rng(0), Manifold.parse("R3 x S3")
    poses = np.column_stack([rng.normal(size=(K + 2, 3)), [random_quaternion(rng) for _ in range(K + 2)]])
    covariances = np.stack([random_covariance(rng, 6, 0.4) for _ in range(K)])
    goal, x = Gaussian(poses[K], 1e-3 * random_covariance(rng, 6, 0.4), manifold), poses[K + 1]
    means = CovarianceMean(manifold, K)
    assert means.take(poses[:K], covariances, goal)
    for k in range(K):
        there = manifold.transport(poses[k], poses[K])
        on = manifold.transport(poses[K], x) @ there
        np.testing.assert_allclose(means.at(x, np.eye(K)[k]), on @ covariances[k] @ on.T, rtol=1e-8, atol=1e-12)


def test_what_is_not_definite_is_refused() -> None:
    means, goal = CovarianceMean(Manifold.euclidean(2), 1), Gaussian(np.zeros(2), np.eye(2))
    assert means.take(np.zeros((1, 2)), np.eye(2)[None], goal)
    assert not means.take(np.zeros((1, 2)), -np.eye(2)[None], goal)
    assert not means.take(np.zeros((1, 2)), np.eye(2)[None], Gaussian(np.zeros(2), np.zeros((2, 2))))


def test_what_is_smoothed_begins_at_rest_and_stays_a_mean_whatever_the_time_steps() -> None:
    rng = np.random.default_rng(0)
    one, other = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    several, once = Smoothed(one), Smoothed(one)
    for seconds in rng.dirichlet(np.ones(20)):
        several.follow(other, 3.0, seconds)
    once.follow(other, 3.0, 1.0)
    np.testing.assert_allclose(several.value, once.value, rtol=1e-12)
    np.testing.assert_allclose(once.value[0], np.exp(-3.0) * (1.0 + 3.0), rtol=1e-12)
    weights = Smoothed(rng.dirichlet(np.ones(5)))
    for _ in range(300):
        weights.follow(rng.dirichlet(0.1 * np.ones(5)), 10.0, rng.exponential(0.1))
        assert weights.value.min() >= -1e-15 and weights.value.sum() == pytest.approx(1.0, abs=1e-12)
    early = Smoothed(one)
    early.follow(other, 3.0, 1e-3)
    assert early.value[1] < 1e-5
