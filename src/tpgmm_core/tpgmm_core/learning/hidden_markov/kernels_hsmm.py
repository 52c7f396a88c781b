# SPDX-License-Identifier: Apache-2.0
"""Forward-backward and Viterbi of a hidden semi-Markov model, compiled, in logarithms (Yu, 2010, Section 2).

A sequence is cut into segments; each has a state k, and a duration d = 1 .. L with log_durations[k, d - 1].
Segments begin and end with the sequence. Arrays have states first, so that innermost loops run over durations
that lie side by side; position t of (K, T + 1) arrays stands between the samples t - 1 and t.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, exp_in_place, inlined
from tpgmm_core.learning.hidden_markov.kernels_hmm import log_sum


@compiled
def cumulate(log_densities: Array, total: Array) -> float:
    """Cumulative log-densities: total[k, t] is the sum over the samples before t, less the best of each sample.

    Sums of what is near zero keep their digits.

    Parameters
    ----------
    log_densities
        (T, K)
    total
        (K, T + 1), written

    Returns
    -------
    float
        the sum of the best ones
    """
    T, K = log_densities.shape
    taken = 0.0
    for k in range(K):
        total[k, 0] = 0.0
    for t in range(T):
        best = log_densities[t].max()
        taken += best
        for k in range(K):
            total[k, t + 1] = total[k, t] + log_densities[t, k] - best
    return taken


@compiled
def log_sum_fast(values: Array, n: int, polynomial: Array, bits: Array, scale: Array) -> float:
    """`log_sum` for many values.

    Parameters
    ----------
    values
        (n or more,), overwritten
    n
        how many
    polynomial, bits, scale
        (n or more,), scratch of `exp_in_place`

    Returns
    -------
    float
        log of the sum of the exponentials
    """
    top = -np.inf
    for i in range(n):
        top = max(top, values[i])
    if top == -np.inf:
        return top
    for i in range(n):
        values[i] -= top
    exp_in_place(values, n, polynomial, bits, scale)
    total = 0.0
    for i in range(n):
        total += values[i]
    return top + math.log(total)


@compiled
def forward(
    log_start: Array, log_transitions: Array, log_durations: Array, total: Array, begins: Array, ends: Array
) -> float:
    """The forward recursion over segments.

    Parameters
    ----------
    log_start, log_transitions, log_durations
        (K,), (K, K) and (K, L)
    total
        see `cumulate`
    begins
        (K, T + 1), written: log p(samples before t, a segment of k begins at t)
    ends
        (K, T + 1), written: log p(samples before t, a segment of k ends there)

    Returns
    -------
    float
        the log-likelihood, less what `cumulate` took off
    """
    K, L = log_durations.shape
    T = total.shape[1] - 1
    backwards = np.empty((K, L))  # durations, the longest first: they then lie as the positions of the beginnings
    for k in range(K):
        for d in range(L):
            backwards[k, d] = log_durations[k, L - 1 - d]
    values, polynomial, bits = np.empty(L), np.empty(L), np.empty(L, dtype=np.int64)
    scale = bits.view(np.float64)
    origin = np.empty((K, T + 1))  # begins - total
    scratch = np.empty(K)
    for t in range(T + 1):
        if t > 0:
            first = max(0, t - L)
            n = t - first
            for k in range(K):
                offset = L - n
                for i in range(n):
                    values[i] = origin[k, first + i] + backwards[k, offset + i]
                ends[k, t] = total[k, t] + log_sum_fast(values, n, polynomial, bits, scale)
        else:
            ends[:, 0] = -np.inf
        for k in range(K):
            if t == 0:
                begins[k, 0] = log_start[k]
            else:
                for i in range(K):
                    scratch[i] = ends[i, t] + log_transitions[i, k]
                begins[k, t] = log_sum(scratch, K)
            origin[k, t] = begins[k, t] - total[k, t]
    for k in range(K):
        scratch[k] = ends[k, T]
    return log_sum(scratch, K)


@inlined
def backward(log_transitions: Array, log_durations: Array, total: Array, begun: Array, ended: Array) -> None:
    """The backward recursion over segments.

    Parameters
    ----------
    log_transitions, log_durations
        (K, K) and (K, L)
    total
        see `cumulate`
    begun
        (K, T + 1), written: log p(samples from t | a segment of k begins at t)
    ended
        (K, T + 1), written: log p(samples from t | a segment of k ends there)
    """
    K, L = log_durations.shape
    T = total.shape[1] - 1
    values, polynomial, bits = np.empty(L), np.empty(L), np.empty(L, dtype=np.int64)
    scale = bits.view(np.float64)
    aim = np.empty((K, T + 1))  # ended + total
    scratch = np.empty(K)
    for t in range(T, -1, -1):
        n = min(L, T - t)
        for k in range(K):
            for i in range(n):
                values[i] = aim[k, t + 1 + i] + log_durations[k, i]
            begun[k, t] = log_sum_fast(values, n, polynomial, bits, scale) - total[k, t]
        for k in range(K):
            if t == T:
                ended[k, T] = 0.0
            else:
                for i in range(K):
                    scratch[i] = log_transitions[k, i] + begun[i, t]
                ended[k, t] = log_sum(scratch, K)
            aim[k, t] = ended[k, t] + total[k, t]


@compiled
def posteriors(
    log_start: Array, log_transitions: Array, log_durations: Array, log_densities: Array,
    occupancy: Array, starts: Array, transitions: Array, durations: Array,
) -> float:  # fmt: skip
    """Expected states of one sequence.

    Parameters
    ----------
    log_start, log_transitions, log_durations
        (K,), (K, K) and (K, L)
    log_densities
        (T, K)
    occupancy
        (T, K), written
    starts, transitions, durations
        expected numbers, (K,), (K, K) and (K, L), added to

    Returns
    -------
    float
        the log-likelihood; when it is -inf nothing else is written
    """
    T, K = log_densities.shape
    L = log_durations.shape[1]
    total = np.empty((K, T + 1))
    begins, ends = np.empty((K, T + 1)), np.empty((K, T + 1))
    begun, ended = np.empty((K, T + 1)), np.empty((K, T + 1))
    taken = cumulate(log_densities, total)
    log_likelihood = forward(log_start, log_transitions, log_durations, total, begins, ends)
    if log_likelihood == -np.inf:
        return log_likelihood
    backward(log_transitions, log_durations, total, begun, ended)
    values, polynomial, bits = np.empty(L), np.empty(L), np.empty(L, dtype=np.int64)
    scale = bits.view(np.float64)
    for k in range(K):
        starts[k] += math.exp(begins[k, 0] + begun[k, 0] - log_likelihood)
        # a state is occupied from where its segments begin to where they end
        occupied = 0.0
        for t in range(T):
            occupied += math.exp(begins[k, t] + begun[k, t] - log_likelihood)
            occupied -= math.exp(ends[k, t] + ended[k, t] - log_likelihood)
            occupancy[t, k] = occupied if occupied > 1e-12 else 0.0  # what is less is rounding
        for t in range(T):
            origin = begins[k, t] - total[k, t] - log_likelihood
            if begins[k, t] + begun[k, t] - log_likelihood < -50.0:
                continue
            n = min(L, T - t)
            for i in range(n):
                # at most 0, but for rounding
                values[i] = min(0.0, origin + log_durations[k, i] + total[k, t + 1 + i] + ended[k, t + 1 + i])
            exp_in_place(values, n, polynomial, bits, scale)
            for i in range(n):
                durations[k, i] += values[i]
    for t in range(1, T):
        for i in range(K):
            if ends[i, t] == -np.inf:
                continue
            for j in range(K):
                term = ends[i, t] + log_transitions[i, j] + begun[j, t]
                if term > -np.inf:
                    transitions[i, j] += math.exp(term - log_likelihood)
    return log_likelihood + taken


@compiled
def viterbi(
    log_start: Array, log_transitions: Array, log_durations: Array, log_densities: Array, path: Array
) -> float:  # fmt: skip
    """The likeliest states of one sequence.

    Parameters
    ----------
    log_start, log_transitions, log_durations
        (K,), (K, K) and (K, L)
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
    L = log_durations.shape[1]
    total = np.empty((K, T + 1))
    taken = cumulate(log_densities, total)
    begins, ends = np.full((K, T + 1), -np.inf), np.full((K, T + 1), -np.inf)
    came_from = np.zeros((K, T + 1), dtype=np.int64)
    length = np.zeros((K, T + 1), dtype=np.int64)
    for k in range(K):
        begins[k, 0] = log_start[k]
    for t in range(1, T + 1):
        for k in range(K):
            for d in range(1, min(L, t) + 1):
                value = begins[k, t - d] - total[k, t - d] + log_durations[k, d - 1]
                if value > ends[k, t]:
                    ends[k, t] = value
                    length[k, t] = d
            ends[k, t] += total[k, t]
        for k in range(K):
            for i in range(K):
                value = ends[i, t] + log_transitions[i, k]
                if value > begins[k, t]:
                    begins[k, t] = value
                    came_from[k, t] = i
    k = int(np.argmax(ends[:, T]))
    best = ends[k, T]
    if best == -np.inf:
        return best
    t = T
    while t > 0:
        d = length[k, t]
        for s in range(t - d, t):
            path[s] = k
        t -= d
        k = came_from[k, t]
    return best + taken
