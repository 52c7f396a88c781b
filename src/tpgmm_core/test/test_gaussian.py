# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

from random_problems import POSE, random_gaussian, random_quaternion
from tpgmm_core import Frame, Gaussian, Manifold
from tpgmm_core.common.types import Array

rng = np.random.default_rng(2)
seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=50)
@given(seed=seeds, n=st.integers(1, 6), count=st.integers(1, 5))
def test_a_product_solves_the_normal_equations_of_eq_3(seed: int, n: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    gaussians = [random_gaussian(rng, Manifold.euclidean(n), 1.0) for _ in range(count)]
    product = Gaussian.product(gaussians)
    precisions = [np.linalg.inv(g.covariance) for g in gaussians]
    H = sum(precisions)
    np.testing.assert_allclose(
        product.mean,
        np.linalg.solve(H, sum(P @ g.mean for P, g in zip(precisions, gaussians, strict=True))),
        rtol=1e-7,
        atol=1e-7,
    )
    np.testing.assert_allclose(product.covariance @ H, np.eye(n), atol=1e-7)


@settings(max_examples=20)
@given(seed=seeds)
def test_a_product_on_the_sphere_minimises_eq_3(seed: int) -> None:
    rng = np.random.default_rng(seed)
    base = rng.normal(size=7)
    base[3:] /= np.linalg.norm(base[3:])
    gaussians = [
        Gaussian(POSE.exp(base, 0.5 * rng.normal(size=6)), random_gaussian(rng, POSE).covariance, POSE)
        for _ in range(3)
    ]
    product = Gaussian.product(gaussians)

    def eq3(v: np.ndarray) -> float:
        x = POSE.exp(product.mean, v)
        errors = [POSE.log(g.mean, x) for g in gaussians]
        return 0.5 * sum(e @ g.precision @ e for e, g in zip(errors, gaussians, strict=True))

    h = 1e-5
    gradient = [(eq3(h * e) - eq3(-h * e)) / (2 * h) for e in np.eye(6)]
    scale = max(np.trace(g.precision) for g in gaussians)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-7 * scale)
    found = minimize(eq3, 0.02 * rng.normal(size=6), method="Nelder-Mead", options={"maxiter": 200})
    assert eq3(np.zeros(6)) <= found.fun + 1e-9


@pytest.mark.parametrize(
    ("space", "spread"), [("S3", np.inf), ("R3 x S3", np.inf), ("S3 x S3", 0.6), ("R3 x S3 x R3 x S3", 0.6)]
)
@pytest.mark.parametrize("count", [2, 3, 6])
def test_a_product_of_gaussians_far_apart_is_stationary_or_refused(space: str, spread: float, count: int) -> None:
    """Orientations are anywhere, or deviate by a spread (rad); each term counts by the better way round."""
    manifold = Manifold.parse(space)
    rng = np.random.default_rng(count)
    refused = 0
    for _ in range(40):
        gaussians = [random_gaussian(rng, manifold) for _ in range(count)]
        if np.isfinite(spread):
            base = gaussians[0].mean
            means = [manifold.exp(base, spread * rng.normal(size=manifold.tangent_dim)) for _ in range(count)]
            gaussians = [Gaussian(x, g.covariance, manifold) for x, g in zip(means, gaussians, strict=True)]
        try:
            product = Gaussian.product(gaussians)
        except ValueError as error:
            assert "contradict each other" in str(error)
            refused += 1
            continue
        assert_stationary(product, gaussians)
    assert refused <= 2


@pytest.mark.parametrize("seed", [455, 1038, 1418])
def test_a_product_is_found_where_steps_have_to_be_halved_several_times(seed: int) -> None:
    manifold, rng = Manifold.parse("S3 x S3"), np.random.default_rng(seed)
    gaussians = [random_gaussian(rng, manifold) for _ in range(4)]
    assert_stationary(Gaussian.product(gaussians), gaussians)


def assert_stationary(product: Gaussian, gaussians: Sequence[Gaussian]) -> None:
    """Eq. (3) pulls nowhere at the product's mean, and its Hessian there is the product's precision."""
    manifold = product.manifold
    n = manifold.tangent_dim
    H, pull = np.zeros((n, n)), np.zeros(n)
    for g in gaussians:
        e = nearest_error(manifold, product.mean, g)
        J = np.stack([numerical_rate(manifold, product.mean, g, e, axis) for axis in np.eye(n)], axis=1)
        H += J.T @ g.precision @ J
        pull += J.T @ g.precision @ e
    np.testing.assert_allclose(product.covariance @ pull, 0.0, atol=1e-7)
    np.testing.assert_allclose(product.covariance @ H, np.eye(n), atol=1e-4)


def nearest_error(manifold: Manifold, x: Array, g: Gaussian) -> Array:
    """Of the turns that lead from the mean of g to x, shorter or longer than pi, those that cost less."""
    errors = [manifold.log(g.mean, x)]
    for s in manifold.spheres:
        for e in list(errors):
            angle = np.linalg.norm(e[s.tangent])
            longer = e.copy()
            longer[s.tangent] *= 1.0 - 2.0 * np.pi / angle
            if angle > np.pi / 4.0:
                errors.append(longer)
    return min(errors, key=lambda e: float(e @ g.precision @ e))


def numerical_rate(manifold: Manifold, x: Array, g: Gaussian, e: Array, axis: Array) -> Array:
    """How the error e, continued, changes when x moves along an axis of the tangent space."""
    h = 1e-6

    def near(step: Array) -> Array:
        moved = manifold.log(g.mean, manifold.exp(x, step))
        for s in manifold.spheres:
            turn = moved[s.tangent]
            if np.linalg.norm(turn - e[s.tangent]) > 1e-3:
                moved[s.tangent] = turn * (1.0 - 2.0 * np.pi / np.linalg.norm(turn))
        return moved

    return (near(h * axis) - near(-h * axis)) / (2.0 * h)


def test_the_product_of_one_gaussian_is_itself() -> None:
    g = random_gaussian(rng, POSE)
    product = Gaussian.product([g])
    np.testing.assert_allclose(product.mean, g.mean, atol=1e-12)
    np.testing.assert_allclose(product.covariance, g.covariance, rtol=1e-7, atol=1e-10)


def test_moving_the_world_moves_the_product() -> None:
    world = Frame.from_pose(rng.normal(size=3), random_quaternion(rng))
    base = random_gaussian(rng, POSE).mean
    gaussians = [
        Gaussian(POSE.exp(base, 0.4 * rng.normal(size=6)), random_gaussian(rng, POSE).covariance, POSE)
        for _ in range(3)
    ]
    moved = Gaussian.product([g.transform(world) for g in gaussians])
    expected = Gaussian.product(gaussians).transform(world)
    assert POSE.distance(moved.mean, expected.mean) < 1e-9
    np.testing.assert_allclose(moved.covariance, expected.covariance, atol=1e-9)
    flipped = [Gaussian(g.mean * np.r_[1, 1, 1, -np.ones(4)], g.covariance, POSE) for g in gaussians]
    assert POSE.distance(Gaussian.product(flipped).mean, Gaussian.product(gaussians).mean) < 1e-12


def test_transform_is_eqs_1_and_2_for_rectangular_matrices_too() -> None:
    g = random_gaussian(rng, Manifold.euclidean(2))
    A, b = rng.normal(size=(3, 2)), rng.normal(size=3)
    image = g.transform(Frame(A, b))
    np.testing.assert_allclose(image.mean, A @ g.mean + b)
    np.testing.assert_allclose(image.covariance, A @ g.covariance @ A.T)


def test_conditioning_matches_the_closed_form() -> None:
    g = random_gaussian(rng, Manifold.euclidean(5), 1.0)
    i, o = [3, 0], [1, 2, 4]
    values = rng.normal(size=2)
    S = g.covariance
    gain = S[np.ix_(o, i)] @ np.linalg.inv(S[np.ix_(i, i)])
    c = g.condition(i, values)
    np.testing.assert_allclose(c.mean, g.mean[o] + gain @ (values - g.mean[i]))
    np.testing.assert_allclose(c.covariance, S[np.ix_(o, o)] - gain @ S[np.ix_(i, o)])
    np.testing.assert_allclose(c.precision, g.precision[np.ix_(o, o)], rtol=1e-7)
    np.testing.assert_allclose(
        g.log_density(g.mean),
        multivariate_normal(g.mean, S).logpdf(g.mean),
    )


def test_density_factorises_into_marginal_and_conditional() -> None:
    g = random_gaussian(rng, Manifold.euclidean(4), 1.0)
    x = rng.normal(size=4)
    joint = g.marginal([0, 2]).log_density(x[[0, 2]]) + g.condition([0, 2], x[[0, 2]]).log_density(x[[1, 3]])
    np.testing.assert_allclose(joint, g.log_density(x))
    points = rng.normal(size=(7, 4))
    np.testing.assert_allclose(g.log_density(points), multivariate_normal(g.mean, g.covariance).logpdf(points))


def test_conditioning_a_pose_on_time_keeps_unit_quaternions() -> None:
    manifold = Manifold.parse("R1 x R3 x S3")
    g = random_gaussian(rng, manifold)
    c = g.condition([0], [g.mean[0] + 0.2])
    assert str(c.manifold) == "R3 x S3"
    np.testing.assert_allclose(np.linalg.norm(c.mean[3:]), 1.0)
    at_mean = g.condition([0], g.mean[:1])
    np.testing.assert_allclose(at_mean.mean, g.mean[1:], atol=1e-12)


def test_bad_gaussians_are_refused_with_what_was_expected() -> None:
    with pytest.raises(ValueError, match="shape"):
        Gaussian([0.0, 0.0], np.eye(3))
    with pytest.raises(ValueError, match="finite"):
        Gaussian([0.0, np.nan], np.eye(2))
    with pytest.raises(ValueError, match="symmetric"):
        Gaussian([0.0, 0.0], [[1.0, 0.5], [0.0, 1.0]])
    with pytest.raises(ValueError, match="positive definite"):
        _ = Gaussian([0.0, 0.0], np.diag([1.0, 0.0])).precision
    with pytest.raises(ValueError, match="same manifold"):
        Gaussian.product([Gaussian([0.0], [[1.0]]), Gaussian([0.0, 0.0], np.eye(2))])
    with pytest.raises(ValueError, match=r"given dimensions \[0, 2\] is singular, .*larger reg_covar"):
        Gaussian(np.zeros(3), [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 1.0]]).condition([0, 2], [0.0, 0.0])
    with pytest.raises(ValueError, match=r"points of R2 have shape \(\.\.\., 2\)"):
        Gaussian(np.zeros(3), np.eye(3)).condition([0, 2], [0.0])
