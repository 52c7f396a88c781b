# SPDX-License-Identifier: Apache-2.0
"""Densities of a point in all states of a skill, and the chain of its states, compiled."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.kernels_manifold import difference


@compiled
def log_densities(
    means: Array, whitening: Array, log_norms: Array, point: Array, weight: float, flat: Array, spheres: Array,
    out: Array,
) -> None:  # fmt: skip
    """Log-densities of a point under N Gaussians, times a weight.

    Parameters
    ----------
    means
        (N, D)
    whitening
        (N, n, n), L^-1 of the covariances L L^T, lower triangles
    log_norms
        (N,), logarithms of the densities at the means
    point
        (D,)
    weight
        factor
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    out
        (N,), written
    """
    N, n = whitening.shape[:2]
    e = np.empty(n)
    for k in range(N):
        difference(point, means[k], flat, spheres, e)
        squared = 0.0
        for i in range(n):
            total = 0.0
            for j in range(i + 1):
                total += whitening[k, i, j] * e[j]
            squared += total * total
        out[k] = weight * (log_norms[k] - 0.5 * squared)


@compiled
def advance(alpha: Array, share: float, largest: float) -> None:
    """Let states be left for the next one, the last one excepted.

    Parameters
    ----------
    alpha
        (N,), probabilities, changed
    share
        time that passes, in times that a state lasts
    largest
        share that is left within one step; longer times are taken in several
    """
    n = math.ceil(share / largest)
    for _ in range(n):
        for i in range(len(alpha) - 1, 0, -1):
            kept = 1.0 if i == len(alpha) - 1 else 1.0 - share / n
            alpha[i] = kept * alpha[i] + share / n * alpha[i - 1]
        if len(alpha) > 1:
            alpha[0] *= 1.0 - share / n
