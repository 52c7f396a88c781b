# SPDX-License-Identifier: Apache-2.0
"""One step of the forward variable of a hidden semi-Markov model, compiled (Yu, 2010, Section 2)."""

from __future__ import annotations

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled


@compiled
def advance(
    forward: Array, hazards: Array, onwards: Array, carried: Array, middle: Array, fit: Array, standing: float,
    ahead: Array,
) -> float:  # fmt: skip
    """The forward variable one sample later, in time O(K L + K²).

    Parameters
    ----------
    forward
        (K, L), probability of each state and of the samples that it has lasted before this one
    hazards
        (K, L), probability that a state which has lasted so long ends; a state that lasted L - 1 stays there
    onwards
        (K, K), from a state that ends to the next; what has no next goes on
    carried
        (K, K), probability per sample of being carried from a state to the middle of another one
    middle
        (K,), how many samples a state has lasted in its middle
    fit
        (K,), how well the observation fits each state
    standing
        what it counts that nothing went on meanwhile
    ahead
        (K, L), written: sums to 1, or zero where the likelihood is 0

    Returns
    -------
    float
        the likelihood
    """
    K, L = forward.shape
    ahead[:] = 0.0
    for k in range(K):
        leaving, mass, last = 0.0, 0.0, 0.0
        for i in range(K):
            last += onwards[k, i]
        lost = 0.0
        for i in range(K):
            lost += carried[k, i]
        for d in range(L):
            here = (1.0 - lost) * forward[k, d]
            mass += forward[k, d]
            ends = here * hazards[k, d] * last
            leaving += here * hazards[k, d]
            ahead[k, min(d + 1, L - 1)] += here - ends
        for i in range(K):
            ahead[i, 0] += leaving * onwards[k, i]
            ahead[i, middle[i]] += mass * carried[k, i]
    total = 0.0
    for k in range(K):
        for d in range(L):
            ahead[k, d] = fit[k] * ahead[k, d] + standing * forward[k, d]
            total += ahead[k, d]
    if total > 0.0:
        scale = 1.0 / total
        for k in range(K):
            for d in range(L):
                ahead[k, d] *= scale
    return total
