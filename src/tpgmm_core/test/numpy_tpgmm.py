# SPDX-License-Identifier: Apache-2.0
"""TP-GMM in careful vectorised numpy: the yardstick of the benchmarks and the oracle of the tests.

Written from the equations of the paper for Euclidean data and frames with invertible A, with log-sum-exp and
Cholesky factors, and nothing else: it shares no code with tpgmm_core.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass
class NumpyTPGMM:
    """Parameters: priors (K,), and per frame means (K, D_j) and covariances (K, D_j, D_j)."""

    priors: Array
    means: list[Array]
    covariances: list[Array]
    log_likelihoods: list[float] = field(default_factory=list)


def start_from_time(X: list[Array], times: Array, n_components: int, reg_covar: float) -> NumpyTPGMM:
    """Bins of equal width between the first and the last time, half-open; unbiased covariances + reg_covar I."""
    edges = np.linspace(times.min(), times.max(), n_components + 1)
    bins = [(times >= a) & (times < b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    counts = np.array([chosen.sum() for chosen in bins], dtype=float)
    means = [np.stack([x[chosen].mean(axis=0) for chosen in bins]) for x in X]
    covariances = [
        np.stack([np.atleast_2d(np.cov(x[chosen].T)) + reg_covar * np.eye(x.shape[1]) for chosen in bins]) for x in X
    ]
    return NumpyTPGMM(counts / counts.sum(), means, covariances)


def fit(
    X: list[Array],
    times: Array,
    n_components: int,
    reg_covar: float = 1e-4,
    tol: float = 1e-5,
    max_iter: int = 100,
) -> NumpyTPGMM:
    """EM on data (N, D_j) per frame; every M-step adds reg_covar I."""
    model = start_from_time(X, times, n_components, reg_covar)
    N = len(times)
    for iteration in range(max_iter):
        log_joint = np.log(model.priors)[:, None] + np.zeros(N)
        for x, mean, covariance in zip(X, model.means, model.covariances, strict=True):
            log_joint += log_density(x, mean, covariance)
        top = log_joint.max(axis=0)
        joint = np.exp(log_joint - top)
        total = joint.sum(axis=0)
        model.log_likelihoods.append(float(np.mean(top + np.log(total))))
        r = joint / total
        counts = r.sum(axis=1)
        model.priors = counts / N
        for j, x in enumerate(X):
            model.means[j] = r @ x / counts[:, None]
            for k, (weights, mean) in enumerate(zip(r, model.means[j], strict=True)):
                d = x - mean
                model.covariances[j][k] = (weights[:, None] * d).T @ d / counts[k] + reg_covar * np.eye(x.shape[1])
        if iteration >= 4 and model.log_likelihoods[-1] - model.log_likelihoods[-2] < tol:
            break
    return model


def log_density(x: Array, mean: Array, covariance: Array) -> Array:
    """Logarithms of the densities of K Gaussians at N points, (K, N): one product for all of them."""
    K, D = mean.shape
    inverse_factor = np.linalg.inv(np.linalg.cholesky(covariance))
    whitened = (inverse_factor.reshape(K * D, D) @ x.T).reshape(K, D, len(x))
    whitened -= np.einsum("kij,kj->ki", inverse_factor, mean)[:, :, None]
    log_root_precision = np.log(np.diagonal(inverse_factor, axis1=1, axis2=2)).sum(axis=1)[:, None]
    whitened *= whitened
    quadratic = whitened.sum(axis=1)
    return -0.5 * (x.shape[1] * np.log(2.0 * np.pi) + quadratic) + log_root_precision


def adapt(model: NumpyTPGMM, frames: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Eqs. (5) and (6): means (K, D) and covariances (K, D, D) for frames (A, b) with invertible A."""
    precision_sum: Array | float = 0.0
    weighted_sum: Array | float = 0.0
    for (A, b), mean, covariance in zip(frames, model.means, model.covariances, strict=True):
        precision = np.linalg.inv(A @ covariance @ A.T)
        precision_sum = precision_sum + precision
        weighted_sum = weighted_sum + np.einsum("kij,kj->ki", precision, mean @ A.T + b)
    covariances = np.linalg.inv(precision_sum)
    return np.einsum("kij,kj->ki", covariances, weighted_sum), covariances


def condition_on_first(priors: Array, means: Array, covariances: Array, t: float) -> tuple[Array, Array, Array]:
    """Gaussian mixture regression on the first dimension: mean, moment-matched covariance, activations (K,)."""
    variances = covariances[:, 0, 0]
    log_h = np.log(priors) - 0.5 * (np.log(2.0 * np.pi * variances) + (t - means[:, 0]) ** 2 / variances)
    h = np.exp(log_h - log_h.max())
    h /= h.sum()
    gains = covariances[:, 1:, 0] / variances[:, None]
    mus = means[:, 1:] + gains * (t - means[:, :1])
    within = covariances[:, 1:, 1:] - gains[:, :, None] * covariances[:, None, 0, 1:]
    mean = h @ mus
    d = mus - mean
    return mean, np.einsum("k,kij->ij", h, within) + (h[:, None] * d).T @ d, h
