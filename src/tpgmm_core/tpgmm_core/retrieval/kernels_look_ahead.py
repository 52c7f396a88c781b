# SPDX-License-Identifier: Apache-2.0
"""Where a system that converges will be, and how firm, compiled: see `dynamical_system`."""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, copy
from tpgmm_core.geometry.kernels_manifold import difference, move
from tpgmm_core.retrieval.covariance_mean import exponential
from tpgmm_core.retrieval.kernels_dynamical_system import distance, go
from tpgmm_core.retrieval.spring import damp


@compiled
def look_ahead(
    start: Array, radius: float, seconds: Array, scaled: Array, longest_step: float, max_steps: int, goal: Array,
    law: Array, metric: Array, means: Array, whitening: Array, offsets: Array, gains: Array, flat: Array,
    spheres: Array, late: Array, late_velocity: Array, memory_rate: float, offset: Array, offset_rate: Array,
    blend_rate: float, logs: Array, factor: Array, out_means: Array, out_covariances: Array,
) -> None:  # fmt: skip
    """References at some times from now, if nothing changes.

    Parameters
    ----------
    start
        (D,), where the system is
    radius
        of the ball that it is in
    seconds, scaled
        (H,), increasing times from now, s, and how far the model's time goes until then
    longest_step, max_steps
        of the integration, in the model's time
    goal, law, metric, means, whitening, offsets, gains, flat, spheres
        as for `kernels_dynamical_system.go`
    late, late_velocity, memory_rate
        (K + n,): activations and the way from the goal, of late, and how they change; 1/s
    offset, offset_rate, blend_rate
        (n,), of the reference from the system; 1/s
    logs, factor
        (K, n, n) and (n, n), see `CovarianceMean`
    out_means, out_covariances
        (H, D) and (H, n, n), written
    """
    K, n = len(offsets), len(flat)
    x, value, velocity = start.copy(), late.copy(), late_velocity.copy()
    activations, regressed, v, target = np.empty(K), np.empty(n), np.empty(n), np.empty(K + n)
    away, away_rate, weights = np.empty(n), np.empty(n), np.empty(K)
    time, gone = 0.0, 0.0
    for h in range(len(seconds)):
        part = scaled[h] - gone
        n_steps = int(min(max(math.ceil(part / longest_step), 1.0), float(max_steps)))
        radius = go(
            x, radius, part, n_steps, goal, law, metric, means, whitening, offsets, gains, flat, spheres, activations,
            regressed, v,
        )  # fmt: skip
        copy(activations, target)
        difference(x, goal, flat, spheres, target[K:])
        for i in range(K + n):
            value[i] -= target[i]
        damp(value, velocity, memory_rate, seconds[h] - time)
        for i in range(K + n):
            value[i] += target[i]
        time, gone = seconds[h], scaled[h]
        near = math.exp(-0.5 * (distance(value[K:], metric) / law[5]) ** 2)
        for k in range(K):
            weights[k] = (1.0 - near) * value[k]
        exponential(x, weights, goal, flat, spheres, logs, factor, out_covariances[h])
        copy(offset, away)
        copy(offset_rate, away_rate)
        damp(away, away_rate, blend_rate, time)
        copy(x, out_means[h])
        move(out_means[h], away, flat, spheres)
