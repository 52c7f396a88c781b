# SPDX-License-Identifier: Apache-2.0
"""Velocity from position by regression, and steps of the system that converges, compiled.

Points x (D,) lie on a manifold given by `flat` and `spheres` (see `kernels_product`), of n tangent dimensions. A model
over [x, v] is prepared (`prepare`) once for a situation. `metric` (n,) holds the squared weights of the dimensions.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import cholesky, compiled, copy, gram, inlined, invert_lower
from tpgmm_core.geometry.kernels_manifold import difference, move


@compiled
def prepare(
    log_priors: Array, means: Array, covariances: Array, D: int, whitening: Array, offsets: Array, gains: Array
) -> bool:
    """What regression on the first D ambient (n tangent) dimensions needs of K components over [x, v].

    Parameters
    ----------
    log_priors, means, covariances
        of the components, (K,), (K, D + n) and (K, 2 n, 2 n)
    D
        ambient dimensions of x
    whitening
        (K, n, n), written: inverse Cholesky factors of the covariances of x
    offsets
        (K,), written: logarithms of what stands before the exponential
    gains
        (K, n, n), written: how v changes with x

    Returns
    -------
    bool
        False when a covariance is not positive definite
    """
    K, n = whitening.shape[0], whitening.shape[1]
    L, precision = np.empty((n, n)), np.empty((n, n))
    for k in range(K):
        if not cholesky(covariances[k], n, L):
            return False
        invert_lower(L, n, whitening[k])
        gram(whitening[k], n, precision)
        offsets[k] = log_priors[k]
        for i in range(n):
            offsets[k] += math.log(L[i, i])
            for m in range(n):
                total = 0.0
                for c in range(n):
                    total += covariances[k, n + i, c] * precision[c, m]
                gains[k, i, m] = total
    return True


@inlined
def regress_velocity(
    x: Array, means: Array, whitening: Array, offsets: Array, gains: Array, flat: Array, spheres: Array,
    activations: Array, v: Array,
) -> None:  # fmt: skip
    """Regression v = E[v | x], and the components' activations.

    Parameters
    ----------
    x
        (D,)
    means, whitening, offsets, gains
        of the components, see `prepare`
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    activations
        (K,), written: they sum to 1, also far from all components
    v
        (n,), written
    """
    K, n, D = whitening.shape[0], whitening.shape[1], len(x)
    e = np.empty((K, n))
    top = -np.inf
    for k in range(K):
        difference(x, means[k, :D], flat, spheres, e[k])
        total = 0.0
        for i in range(n):
            white = 0.0
            for m in range(i + 1):
                white += whitening[k, i, m] * e[k, m]
            total += white * white
        activations[k] = offsets[k] - 0.5 * total
        top = max(top, activations[k])
    total = 0.0
    for k in range(K):
        activations[k] = math.exp(activations[k] - top)
        total += activations[k]
    v[:] = 0.0
    for k in range(K):
        activations[k] /= total
        for i in range(n):
            component = means[k, D + i]
            for m in range(n):
                component += gains[k, i, m] * e[k, m]
            v[i] += activations[k] * component


@compiled
def distance(e: Array, metric: Array) -> float:
    """Length of a tangent vector (n,) in the metric."""
    total = 0.0
    for i in range(len(e)):
        total += metric[i] * e[i] * e[i]
    return math.sqrt(total)


@inlined
def shrink_rate(d: float, law: Array) -> float:
    """rho(d) / d, the least rate at which distances fall: see `dynamical_system`."""
    rate, goal_rate, reach, top_speed = law[0], law[1], law[2], law[3]
    return min(min(rate * (reach / d) ** (1.0 / 3.0), goal_rate), top_speed / d)


@inlined
def shrunk(radius: float, law: Array, h: float) -> float:
    """The radius after a time, of r' = -rho(r) or faster: the slowest of its three laws, each solved exactly.

    Parameters
    ----------
    radius
        now
    law
        see `stable_velocity`
    h
        the time

    Returns
    -------
    float
        the radius then
    """
    rate, goal_rate, reach, top_speed = law[0], law[1], law[2], law[3]
    root = max(radius ** (1.0 / 3.0) - h * rate * reach ** (1.0 / 3.0) / 3.0, 0.0)
    return max(max(root**3, radius * math.exp(-goal_rate * h)), radius - top_speed * h)


@compiled
def stable_velocity(
    x: Array, radius: float, goal: Array, law: Array, metric: Array, means: Array, whitening: Array, offsets: Array,
    gains: Array, flat: Array, spheres: Array, activations: Array, regressed: Array, v: Array, e: Array,
) -> None:  # fmt: skip
    """The regressed velocity and the corrected one at x, in a ball of this radius about the goal.

    Parameters
    ----------
    x
        (D,)
    radius
        of the ball
    goal
        (D,)
    law
        rate, goal_rate, reach, top_speed, detour, goal_radius: see `dynamical_system`
    metric
        (n,), weights of squared tangent coordinates in lengths, m²/rad² on S³
    means, whitening, offsets, gains
        of the components, see `prepare`
    flat, spheres
        arrangement of the manifold, see `kernels_manifold`
    activations
        (K,), written
    regressed, v
        (n,), written: the velocity of the model, and the corrected one
    e
        (n,), written: log_goal(x)
    """
    goal_rate, top_speed, detour, goal_radius = law[1], law[3], law[4], law[5]
    n = len(v)
    regress_velocity(x, means, whitening, offsets, gains, flat, spheres, activations, regressed)
    difference(x, goal, flat, spheres, e)
    d = distance(e, metric)
    speed = distance(regressed, metric)
    if speed > top_speed:
        for i in range(n):
            regressed[i] *= top_speed / speed
    near = math.exp(-0.5 * (d / goal_radius) ** 2)
    radial = 0.0  # the rate of e along itself; on S³ too, since e about the fixed axes is the same at both of its ends
    for i in range(n):
        v[i] = (1.0 - near) * regressed[i] - near * goal_rate * e[i]
        radial += metric[i] * e[i] * v[i]
    if not d > 0.0:
        return
    excess = radial / (d * d) + shrink_rate(d, law)
    if excess > 0.0:
        free = 1.0 / (1.0 + detour)  # share of the radius from where on the correction fades in
        used = (d / radius - free) / (1.0 - free) if detour > 0.0 else 1.0
        for i in range(n):
            v[i] -= min(max(used, 0.0), 1.0) * excess * e[i]


@compiled
def go(
    x: Array, radius: float, time: float, n_steps: int, goal: Array, law: Array, metric: Array, means: Array,
    whitening: Array, offsets: Array, gains: Array, flat: Array, spheres: Array, activations: Array,
    regressed: Array, v: Array,
) -> float:  # fmt: skip
    """Advance x by a time, in the unit of the model's velocities.

    Midpoint steps along geodesics. Where one of them would leave the ball, since it has shrunk meanwhile, it ends at
    the nearest point of the ball, on the geodesic to the goal: the bound holds for steps of any length.

    Parameters
    ----------
    x
        (D,), changed
    radius
        of the ball now
    time
        how long
    n_steps
        how many steps
    goal, law, metric, means, whitening, offsets, gains, flat, spheres
        as for `stable_velocity`
    activations
        (K,), written
    regressed, v
        (n,), written

    Returns
    -------
    float
        the radius of the ball that x is in then
    """
    n = len(v)
    h, detour = time / n_steps, law[4]
    e, step, middle = np.empty(n), np.empty(n), np.empty(len(x))
    field = goal, law, metric, means, whitening, offsets, gains, flat, spheres, activations, regressed
    for _ in range(n_steps):
        difference(x, goal, flat, spheres, e)
        radius = min(radius, (1.0 + detour) * distance(e, metric))
        stable_velocity(x, radius, *field, v, e)
        radius = shrunk(radius, law, h)
        copy(x, middle)
        for i in range(n):
            step[i] = 0.5 * h * v[i]
        move(middle, step, flat, spheres)
        stable_velocity(middle, radius, *field, v, e)
        for i in range(n):
            step[i] = h * v[i]
        move(x, step, flat, spheres)
        difference(x, goal, flat, spheres, e)
        d = distance(e, metric)
        if d > radius:
            copy(goal, x)
            for i in range(n):
                e[i] *= radius / d
            move(x, e, flat, spheres)
    return radius
