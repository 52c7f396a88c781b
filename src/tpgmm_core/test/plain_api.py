# SPDX-License-Identifier: Apache-2.0
"""Eqs. (5), (6) and regression as they are written in the papers, component by component: the oracle of the plain API.

Orientations by scipy; nothing of the core but the layout of its manifolds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from tpgmm_core import TPGMM, Frame, GaussianMixture, Manifold
from tpgmm_core.common.types import Array


def factors(manifold: Manifold, dims: Sequence[int]) -> list[tuple[str, list[int], list[int]]]:
    """Kind, ambient and tangent indices of each factor of which `dims` are chosen, in the order of dims."""
    parts, ambient, tangent = [], 0, 0
    of: dict[int, tuple[str, list[int], list[int]]] = {}
    for kind, n in manifold.factors:
        size = 4 if kind == "S" else n
        if kind == "S":
            of[ambient] = ("S", list(range(ambient, ambient + 4)), list(range(tangent, tangent + 3)))
        else:
            of |= {ambient + i: ("R", [ambient + i], [tangent + i]) for i in range(n)}
        ambient, tangent = ambient + size, tangent + n
    i = 0
    while i < len(dims):
        parts.append(of[dims[i]])
        i += len(parts[-1][1])
    return parts


def log(parts: list[tuple[str, list[int], list[int]]], base: Array, x: Array) -> Array:
    """Tangent vector from base to x, whose numbers are those of the parts one after the other."""
    result: list[float] = []
    a = 0
    for kind, ambient, _ in parts:
        p, q = base[a : a + len(ambient)], x[a : a + len(ambient)]
        result += list((Rotation.from_quat(q) * Rotation.from_quat(p).inv()).as_rotvec() if kind == "S" else q - p)
        a += len(ambient)
    return np.array(result)


def exp(parts: list[tuple[str, list[int], list[int]]], base: Array, v: Array) -> Array:
    result: list[float] = []
    a = t = 0
    for kind, ambient, tangent in parts:
        p, w = base[a : a + len(ambient)], v[t : t + len(tangent)]
        result += list((Rotation.from_rotvec(w) * Rotation.from_quat(p)).as_quat() if kind == "S" else p + w)
        a, t = a + len(ambient), t + len(tangent)
    return np.array(result)


def transport(parts: list[tuple[str, list[int], list[int]]], base: Array, to: Array) -> Array:
    """Parallel transport along the shortest way, in fixed axes: half of the turn."""
    v, t, blocks = log(parts, base, to), 0, []
    for kind, _, tangent in parts:
        blocks.append(Rotation.from_rotvec(0.5 * v[t : t + 3]).as_matrix() if kind == "S" else np.eye(1))
        t += len(tangent)
    return np.asarray(block_diag(*blocks))


def condition(mixture: GaussianMixture, dims: Sequence[int], values: Sequence[float]) -> tuple[Array, Array]:
    """Mean and covariance of the other dimensions."""
    rest = [i for i in range(mixture.manifold.dim) if i not in dims]
    given, free = factors(mixture.manifold, list(dims)), factors(mixture.manifold, rest)
    i, o = [t for part in given for t in part[2]], [t for part in free for t in part[2]]
    log_h, means, covariances = [], [], []
    for prior, mean, S in zip(mixture.priors, mixture.means, mixture.covariances, strict=True):
        d = log(given, mean[list(dims)], np.asarray(values, dtype=float))
        S_ii, S_oi = S[np.ix_(i, i)], S[np.ix_(o, i)]
        log_h.append(np.log(max(prior, 1e-300)) + multivariate_normal(np.zeros(len(i)), S_ii).logpdf(d))
        moved = exp(free, mean[rest], S_oi @ np.linalg.solve(S_ii, d))
        T = transport(free, mean[rest], moved)
        means.append(moved)
        covariances.append(T @ (S[np.ix_(o, o)] - S_oi @ np.linalg.solve(S_ii, S_oi.T)) @ T.T)
    h = np.exp(np.array(log_h) - logsumexp(log_h))
    x = means[int(np.argmax(h))]
    for _ in range(200):
        x = exp(free, x, sum(w * log(free, x, m) for w, m in zip(h, means, strict=True)))
    covariance = np.zeros((len(o), len(o)))
    for w, m, C in zip(h, means, covariances, strict=True):
        T, d = transport(free, m, x), log(free, x, m)
        covariance += w * (T @ C @ T.T + np.outer(d, d))
    return x, covariance


def adapt(
    model: TPGMM, frames: Mapping[str, Frame], weights: Mapping[str, float], state: Array, floor: float
) -> tuple[Array, Array]:
    """Means and covariances on R^D for any A; what is left below the precision `floor` is filled up at the state."""
    means, covariances = [], []
    for k in range(len(model.priors_)):
        H, pull = np.zeros((len(state), len(state))), np.zeros(len(state))
        for name, frame in frames.items():
            M = np.linalg.pinv(frame.A) if frame.inverse is None else frame.inverse
            precision = weights.get(name, 1.0) * M.T @ np.linalg.inv(model.covariances_[name][k]) @ M
            H += precision
            pull += precision @ (frame.A @ model.means_[name][k] + frame.b)
        eigenvalues, vectors = np.linalg.eigh(H)
        lowest = max(floor, 1e-13 * eigenvalues[-1])
        missing = (vectors * np.maximum(lowest - eigenvalues, 0.0)) @ vectors.T
        covariance = np.linalg.inv(H + missing)
        covariances.append(covariance)
        means.append(covariance @ (pull + missing @ state))
    return np.array(means), np.array(covariances)
