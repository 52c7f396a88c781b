# SPDX-License-Identifier: Apache-2.0
"""Forward-backward and Viterbi of a hidden Markov model, compiled, in logarithms (Rabiner, 1989).

Arrays: log_start (K,), log_transitions (K, K) from row to column, log_densities (T, K) of one sequence. Zero
probabilities are -inf, and stay so. Densities of neighbouring states easily differ by a factor e^1000, which
is why not even scaled probabilities would do.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled


@compiled
def log_sum(values: Array, n: int) -> float:
    """Logarithm of the sum of exp(values[:n]); -inf for a sum of nothing."""
    top = -np.inf
    for i in range(n):
        top = max(top, values[i])
    if top == -np.inf:
        return top
    total = 0.0
    for i in range(n):
        if values[i] > -np.inf:
            total += math.exp(values[i] - top)
    return top + math.log(total)


@compiled
def step(log_from: Array, log_transitions: Array, scratch: Array, out: Array) -> None:
    """out[j] = log sum_i exp(log_from[i] + log_transitions[i, j]).

    Parameters
    ----------
    log_from
        (K,)
    log_transitions
        (K, K)
    scratch
        (K,)
    out
        (K,), written
    """
    K = len(log_from)
    for j in range(K):
        for i in range(K):
            scratch[i] = log_from[i] + log_transitions[i, j]
        out[j] = log_sum(scratch, K)


@compiled
def forward(log_start: Array, log_transitions: Array, log_densities: Array, alpha: Array) -> float:
    """The forward recursion, alpha[t, k] = log p(samples 0..t, state k at t).

    Parameters
    ----------
    log_start, log_transitions
        (K,) and (K, K)
    log_densities
        (T, K)
    alpha
        (T, K), written

    Returns
    -------
    float
        the log-likelihood
    """
    T, K = log_densities.shape
    scratch = np.empty(K)
    for k in range(K):
        alpha[0, k] = log_start[k] + log_densities[0, k]
    for t in range(1, T):
        step(alpha[t - 1], log_transitions, scratch, alpha[t])
        for k in range(K):
            alpha[t, k] += log_densities[t, k]
    return log_sum(alpha[T - 1], K)


@compiled
def posteriors(
    log_start: Array, log_transitions: Array, log_densities: Array,
    occupancy: Array, starts: Array, transitions: Array,
) -> float:  # fmt: skip
    """Expected states of one sequence.

    Parameters
    ----------
    log_start, log_transitions
        (K,) and (K, K)
    log_densities
        (T, K)
    occupancy
        (T, K), written
    starts, transitions
        (K,) and (K, K), added to

    Returns
    -------
    float
        the log-likelihood; when it is -inf nothing else is written
    """
    T, K = log_densities.shape
    alpha = np.empty((T, K))
    log_likelihood = forward(log_start, log_transitions, log_densities, alpha)
    if log_likelihood == -np.inf:
        return log_likelihood
    scratch = np.empty(K)
    ahead = np.empty(K)  # log p(samples t..T-1 | state k at t)
    beta = np.zeros(K)  # log p(samples t+1..T-1 | state k at t)
    for t in range(T - 1, -1, -1):
        for k in range(K):
            occupancy[t, k] = math.exp(alpha[t, k] + beta[k] - log_likelihood)
            ahead[k] = beta[k] + log_densities[t, k]
        if t == 0:
            break
        for i in range(K):
            if alpha[t - 1, i] == -np.inf:
                continue
            for j in range(K):
                term = alpha[t - 1, i] + log_transitions[i, j] + ahead[j]
                if term > -np.inf:
                    transitions[i, j] += math.exp(term - log_likelihood)
        step(ahead, log_transitions.T, scratch, beta)
    for k in range(K):
        starts[k] += occupancy[0, k]
    return log_likelihood


@compiled
def viterbi(log_start: Array, log_transitions: Array, log_densities: Array, path: Array) -> float:
    """The likeliest states of one sequence.

    Parameters
    ----------
    log_start, log_transitions
        (K,) and (K, K)
    log_densities
        (T, K)
    path
        (T,), written

    Returns
    -------
    float
        the logarithm of the joint density of states and samples
    """
    T, K = log_densities.shape
    came_from = np.zeros((T, K), dtype=np.int64)
    best = log_start + log_densities[0]
    new = np.empty(K)
    for t in range(1, T):
        for j in range(K):
            new[j] = -np.inf
            for i in range(K):
                value = best[i] + log_transitions[i, j]
                if value > new[j]:
                    new[j] = value
                    came_from[t, j] = i
        for j in range(K):
            best[j] = new[j] + log_densities[t, j]
    path[T - 1] = np.argmax(best)
    for t in range(T - 1, 0, -1):
        path[t - 1] = came_from[t, path[t]]
    return best[path[T - 1]]
