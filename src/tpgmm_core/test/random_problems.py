# SPDX-License-Identifier: Apache-2.0
"""Random problems that several tests share."""

from __future__ import annotations

import numpy as np

from tpgmm_core import Gaussian, Manifold
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion

POSE = Manifold.parse("R3 x S3")


def random_quaternion(rng: np.random.Generator, *shape: int) -> Array:
    return quaternion.normalize(rng.normal(size=(*shape, 4)))


def random_covariance(rng: np.random.Generator, n: int, scale: float = 1.0) -> Array:
    root = rng.normal(size=(n, n + 2)) * scale
    return root @ root.T / (n + 2) + 1e-3 * scale**2 * np.eye(n)


def random_gaussian(rng: np.random.Generator, manifold: Manifold, scale: float = 0.3) -> Gaussian:
    mean = rng.normal(size=manifold.dim)
    return Gaussian(mean, random_covariance(rng, manifold.tangent_dim, scale), manifold)


def random_rotation(rng: np.random.Generator, n: int) -> Array:
    Q, R = np.linalg.qr(rng.normal(size=(n, n)))
    Q = Q * np.sign(np.diagonal(R))
    return Q * np.append(np.ones(n - 1), np.sign(np.linalg.det(Q)))
