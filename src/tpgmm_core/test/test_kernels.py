# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from random_problems import random_covariance, random_rotation
from tpgmm_core.geometry import kernels, kernels_rotation
from tpgmm_core.geometry.kernels_product import FOUND, UNSURE, fuse, search
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.kernels_expectation import factorise

rng = np.random.default_rng(0)
SOURCES = [
    Path(__file__).parents[2] / name / name for name in ("tpgmm_core", "tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")
]


@kernels.compiled
def _sum_is_finite(values: np.ndarray, more: float) -> bool:
    total = more
    for i in range(len(values)):
        total += values[i]
    return bool(kernels.is_finite(total))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_compiled_code_notices_sums_that_are_no_numbers(bad: float) -> None:
    assert _sum_is_finite(np.ones(3), 1.0) and _sum_is_finite(np.zeros(0), -1e308)
    assert not _sum_is_finite(np.ones(3), bad)
    assert not _sum_is_finite(np.array([1.0, bad, 2.0]), 1.0)
    assert not _sum_is_finite(np.array([1e308]), 1e308)


def test_compiled_code_does_not_ask_by_subtraction() -> None:
    sources = [path for package in SOURCES for path in package.rglob("*.py")]
    compiled = [
        (path, function)
        for path in sources
        for function in ast.parse(path.read_text()).body
        if isinstance(function, ast.FunctionDef)
        and any(re.search("compiled|inlined|njit", ast.unparse(decorator)) for decorator in function.decorator_list)
    ]
    assert len(compiled) > 150
    for path, function in compiled:
        names = {node.attr for node in ast.walk(function) if isinstance(node, ast.Attribute)}
        names |= {node.id for node in ast.walk(function) if isinstance(node, ast.Name)}
        assert not names & {"isfinite", "isinf"}, f"{path.name}, {function.name}: use kernels.is_finite"


@pytest.mark.parametrize(("n", "width"), [(1, 1), (3, 3), (7, 2), (14, 28)])
def test_systems_are_solved_as_by_numpy(n: int, width: int) -> None:
    for W in (rng.normal(size=(n, n)), np.eye(n)[::-1] + 0.0, random_covariance(rng, n)):
        X = rng.normal(size=(n, width))
        found = X.copy()
        assert kernels.solve_in_place(W.copy(), found, 0.0)
        np.testing.assert_allclose(found, np.linalg.solve(W, X), rtol=1e-7, atol=1e-9)


def test_singular_systems_are_told() -> None:
    for W in (np.zeros((2, 2)), np.ones((2, 2)), np.full((2, 2), np.nan)):
        assert not kernels.solve_in_place(W.copy(), np.eye(2), 0.0)
    nearly = np.diag([1.0, 1e-9])
    assert kernels.solve_in_place(nearly.copy(), np.eye(2), 1e-12)
    assert not kernels.solve_in_place(nearly.copy(), np.eye(2), 1e-6)


def test_exp_is_exact_to_rounding_where_it_matters() -> None:
    x = -np.r_[0.0, np.logspace(-18, np.log10(700.0), 5000), 0.5 * np.log(2.0) * np.arange(200)]
    bits = np.empty(len(x), dtype=np.int64)
    values = x.copy()
    kernels.exp_in_place(values, len(x), np.empty(len(x)), bits, bits.view(np.float64))
    np.testing.assert_allclose(values, np.exp(x), rtol=1e-13)
    far = np.array([-1e3, -1e300, -np.inf])
    kernels.exp_in_place(far, 3, np.empty(3), bits, bits.view(np.float64))
    assert np.all((far >= 0.0) & (far < 1e-300))


@pytest.mark.parametrize("shape", [(1, 1), (4, 4), (7, 7), (5, 2), (2, 5)])
def test_pseudo_inverse_is_that_of_numpy(shape: tuple[int, int]) -> None:
    for _ in range(20):
        A = rng.normal(size=shape)
        np.testing.assert_allclose(kernels.pseudo_inverse(A, 1e-10), np.linalg.pinv(A), rtol=1e-7, atol=1e-8)


def test_pseudo_inverse_knows_rotations_permutations_and_projections() -> None:
    R = random_rotation(rng, 5)
    np.testing.assert_allclose(kernels.pseudo_inverse(R, 1e-10), R.T, atol=1e-14)
    permuted = np.diag([1.0, 2.0, 3.0, 4.0])[[2, 3, 0, 1]]
    np.testing.assert_allclose(kernels.pseudo_inverse(permuted, 1e-10), np.linalg.inv(permuted), atol=1e-14)
    Q = np.linalg.qr(rng.normal(size=(6, 2)))[0]
    N = np.eye(6) - Q @ Q.T  # a null-space projection is its own pseudo-inverse
    np.testing.assert_allclose(kernels.pseudo_inverse(N, 1e-10), N, atol=1e-12)
    assert not kernels.pseudo_inverse(np.zeros((3, 3)), 1e-10).any()


def test_cholesky_factors_invert_and_refuse_what_is_not_definite() -> None:
    S = random_covariance(rng, 6)
    L, F, P = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    assert kernels.cholesky(S, 6, L)
    kernels.invert_lower(L, 6, F)
    kernels.gram(F, 6, P)
    np.testing.assert_allclose(P @ S, np.eye(6), atol=1e-9)
    for bad in (np.diag([1.0, 0.0]), np.diag([1.0, -1.0]), np.full((2, 2), np.nan)):
        assert not kernels.cholesky(bad, 2, np.zeros((2, 2)))


def test_the_inverse_left_jacobian_is_the_derivative_of_the_logarithm() -> None:
    J = np.empty((3, 3))
    for scale in (1e-6, 1e-3, 0.5, 3.0):
        e = rng.normal(size=3)
        e *= scale / np.linalg.norm(e)
        kernels_rotation.inverse_left_jacobian(*e, J)
        h = 1e-6
        numeric = [
            (
                (Rotation.from_rotvec(h * u) * Rotation.from_rotvec(e)).as_rotvec()
                - (Rotation.from_rotvec(-h * u) * Rotation.from_rotvec(e)).as_rotvec()
            )
            / (2.0 * h)
            for u in np.eye(3)
        ]
        np.testing.assert_allclose(J, np.transpose(numeric), atol=1e-8)


@pytest.mark.parametrize(("left", "definite"), [(4e-13, True), (2e-15, False)])
def test_a_covariance_that_is_definite_by_rounding_alone_is_refused(left: float, definite: bool) -> None:
    """`left`: the variance of the second dimension, given the first, of a variance of 1."""
    singular = np.array([[1.0, 1.0], [1.0, 1.0 + left]])
    assert kernels.cholesky(singular, 2, np.zeros((2, 2)))
    covariances = np.stack([np.stack([np.eye(2), np.eye(2)]), np.stack([np.eye(2), singular])])
    layout = np.array([[0, 2], [2, 2]])
    found = factorise(layout, covariances, np.zeros((2, 2, 2, 2)), np.zeros((2, 2)))
    assert found == (-1 if definite else 3)  # of frame 1 and component 1


def test_rounding_of_a_large_precision_is_no_information_about_the_free_directions() -> None:
    """One direction is known to 1e-10; in the others the mean stays at the state."""
    u = np.array([0.6, 0.0, 0.8])
    precision = 1e20 * np.outer(u, u)
    target, state = np.array([1.0, 2.0, 3.0]), np.array([-4.0, 5.0, -6.0])
    flat, spheres = np.arange(3), np.empty((0, 2), np.int64)
    mean, covariance = np.empty(3), np.empty((3, 3))
    fuse(target[None], precision[None], np.ones(1), state, 1e-8, flat, spheres, mean, covariance)
    np.testing.assert_allclose(u @ mean, u @ target, rtol=1e-9)
    across = np.array([[0.0, 1.0, 0.0], [0.8, 0.0, -0.6]])
    np.testing.assert_allclose(across @ mean, across @ state, atol=0.02)


@pytest.mark.parametrize("space", ["R3 x S3", "S3", "R1 x S3 x R2 x S3"])
def test_steps_by_parts_are_those_of_the_whole_hessian(space: str) -> None:
    manifold = Manifold.parse(space)
    n, layout = manifold.tangent_dim, (manifold.ambient_of_tangent, manifold.sphere_starts)
    base = np.full(manifold.dim, 0.5)  # of unit length on S³
    weights = np.array([1.0, 0.0, 0.4, 1.0])
    for _ in range(10):
        targets = np.stack([manifold.exp(base, 0.3 * rng.normal(size=n)) for _ in weights])
        precisions = np.stack([w * np.linalg.inv(random_covariance(rng, n)) for w in weights])
        found = []
        for by_parts in (True, False):
            mean, covariance = np.empty(manifold.dim), np.empty((n, n))
            inputs = targets, precisions, weights, targets[0], 1e-6, *layout
            assert search(*inputs, by_parts, mean, covariance) == FOUND
            found.append((mean, covariance))
        np.testing.assert_allclose(manifold.log(found[1][0], found[0][0]), 0.0, atol=1e-9)
        np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-7, atol=1e-9)
    # a direction that no term knows may have to stay where the state is: only the whole Hessian can tell
    precisions[:, 0, :] = precisions[:, :, 0] = 0.0
    alone = np.array([1.0, 0.0, 0.0, 0.0])
    assert search(targets, precisions, alone, targets[0], 1e-6, *layout, True, mean, covariance) == UNSURE
