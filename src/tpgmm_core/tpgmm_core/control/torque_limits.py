# SPDX-License-Identifier: Apache-2.0
"""What stands between a law of control and the motors: each stage one short function, compiled.

All vectors (n,) are in model order, N m, rad and s (N and m for prismatic joints); stages change `tau` in
place. `torque_pipeline` says in which order they are applied, and which one wins where two contradict each other.
"""

from __future__ import annotations

import math

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, inlined, is_finite


@compiled
def finite(values: Array) -> bool:
    """Whether no value is NaN or infinite."""
    for i in range(len(values)):
        if not is_finite(values[i]):
            return False
    return True


@compiled
def blend(tau: Array, safe: Array, share: float) -> None:
    """Blend in place: tau ← safe + share (tau - safe).

    Parameters
    ----------
    tau, safe
        (n,), N m; tau is changed
    share
        0 to 1
    """
    for i in range(len(tau)):
        tau[i] = safe[i] + share * (tau[i] - safe[i])


@compiled
def clamp(value: float, lower: float, upper: float) -> float:
    """A number limited to two bounds.

    Parameters
    ----------
    value
        the number
    lower, upper
        the bounds

    Returns
    -------
    float
        the number within the bounds; the upper one where they contradict each other
    """
    return min(max(value, lower), upper)


@compiled
def approach_speed(distance: float, max_speed: float, approach_rate: float) -> float:
    """How fast a joint may move towards a limit: it slows down exponentially.

    Parameters
    ----------
    distance
        to the limit, rad or m; negative beyond it
    max_speed
        of the joint, rad/s or m/s
    approach_rate
        speed per distance that is left, 1/s

    Returns
    -------
    float
        rad/s or m/s; negative beyond the limit: away from it
    """
    return clamp(approach_rate * distance, -max_speed, max_speed)


@inlined
def clamp_at_limits(
    tau: Array,
    q: Array,
    v: Array,
    nonlinear: Array,
    mass: Array,
    lower: Array,
    upper: Array,
    max_speed: Array,
    effort: Array,
    approach_rate: float,
    bandwidth: float,
) -> bool:
    """Keep torques from driving a joint beyond its position or speed limit; brake one that is too fast.

    Towards each limit a joint may have the speed s of `approach_speed`. The torque beyond what carries the robot
    (`nonlinear`) is at most `mass bandwidth (s - v)`: none at that speed, less than none above it. A joint with
    most of its speed in reserve gets all its effort, so that a hand can push against a table. As the soft limits
    of ros2_control's joint_limits, with the inertia that makes one gain right for shoulders and fingers.

    Parameters
    ----------
    tau, q, v
        (n,), torques, which are changed, positions and velocities
    nonlinear
        (n,), torques that carry the robot
    mass
        (n,), inertia that each joint feels, 1 / (M^-1)_ii
    lower, upper, max_speed, effort
        (n,), limits of positions, speeds and torques
    approach_rate, bandwidth
        1/s

    Returns
    -------
    bool
        whether a torque was changed
    """
    changed = False
    for i in range(len(tau)):
        to_upper = approach_speed(upper[i] - q[i], max_speed[i], approach_rate) - v[i]
        to_lower = approach_speed(q[i] - lower[i], max_speed[i], approach_rate) + v[i]
        # twice the effort: at rest, far from the limits, any torque is allowed, whatever the robot's weight needs
        reserve_up = 2.0 * effort[i] * max(0.0, 2.0 * to_upper / max_speed[i] - 1.0)
        reserve_down = 2.0 * effort[i] * max(0.0, 2.0 * to_lower / max_speed[i] - 1.0)
        largest = nonlinear[i] + mass[i] * bandwidth * to_upper + reserve_up
        smallest = nonlinear[i] - mass[i] * bandwidth * to_lower - reserve_down
        allowed = clamp(tau[i], smallest, largest)
        if allowed != tau[i]:
            tau[i] = allowed
            changed = True
    return changed


@inlined
def repel(
    tau: Array, q: Array, v: Array, mass: Array, lower: Array, upper: Array, margin: float, frequency: float
) -> bool:
    """Push joints softly out of the margin before their position limits.

    Parameters
    ----------
    tau
        (n,), N m, changed
    q, v
        state (n,)
    mass
        (n,), inertia of each joint by itself
    lower, upper
        position limits (n,), rad or m
    margin
        rad or m; a tenth of the joint's range at most
    frequency
        of the spring, rad/s

    Attributes
    ----------
    critically damped spring that only pushes, never pulls
        it gives back little of the energy that it took.

    Returns
    -------
    bool
        whether a joint was pushed
    """
    pushed = False
    for i in range(len(tau)):
        width = min(margin, 0.1 * (upper[i] - lower[i]))
        for sign in (1.0, -1.0):
            distance = q[i] - lower[i] if sign > 0.0 else upper[i] - q[i]
            # no deeper than the margin: a joint far beyond a limit is not shot back
            depth = min(width - distance, width)
            if depth > 0.0:
                push = mass[i] * frequency * (frequency * depth - 2.0 * sign * v[i])
                if push > 0.0:
                    tau[i] += sign * push
                    pushed = True
    return pushed


@inlined
def torque_bounds(effort: Array, previous: Array, max_change: Array, lowest: Array, highest: Array) -> None:
    """Torques that keep the effort limit and the rate limit: one interval per joint, never empty.

    Parameters
    ----------
    effort
        (n,), effort limits
    previous
        (n,), the last torques that were sent; NaN where there were none
    max_change
        (n,), by which they may change, >= 0
    lowest, highest
        (n,), the interval, which is written
    """
    for i in range(len(effort)):
        lowest[i], highest[i] = -effort[i], effort[i]
        if not math.isnan(previous[i]):
            before = clamp(previous[i], -effort[i], effort[i])
            lowest[i] = max(lowest[i], before - max_change[i])
            highest[i] = min(highest[i], before + max_change[i])


@inlined
def keep_within(tau: Array, lowest: Array, highest: Array) -> bool:
    """Limit torques to bounds.

    Parameters
    ----------
    tau
        (n,), N m, changed
    lowest, highest
        bounds (n,), N m

    Returns
    -------
    bool
        whether a torque was changed
    """
    changed = False
    for i in range(len(tau)):
        allowed = clamp(tau[i], lowest[i], highest[i])
        if allowed != tau[i]:
            tau[i] = allowed
            changed = True
    return changed


@inlined
def injected_power(tau: Array, v: Array, nonlinear: Array) -> float:
    """Power that torques put into the motion, (tau - nonlinear)^T v: beyond lifting the robot's own weight.

    Parameters
    ----------
    tau
        (n,), N m
    v
        (n,), rad/s or m/s
    nonlinear
        (n,), N m, what carries the robot

    Returns
    -------
    float
        W
    """
    power = 0.0
    for i in range(len(tau)):
        power += (tau[i] - nonlinear[i]) * v[i]
    return power


@inlined
def limit_power(tau: Array, v: Array, nonlinear: Array, max_power: float, lowest: Array, highest: Array) -> bool:
    """Scale down the torques that drive joints until the injected power is within a bound.

    Joints that brake are left alone, and no torque leaves its bounds: where these do not permit so little power, it is
    as little as they permit.

    Parameters
    ----------
    tau
        (n,), N m, changed
    v
        (n,), rad/s or m/s
    nonlinear
        (n,), N m, what carries the robot
    max_power
        W, > 0
    lowest, highest
        bounds (n,) of the torques, N m

    Returns
    -------
    bool
        whether a torque was changed
    """
    power = injected_power(tau, v, nonlinear)
    if not power > max_power:
        return False
    least = 0.0
    for i in range(len(tau)):
        excess = tau[i] - nonlinear[i]
        if excess * v[i] > 0.0:
            excess = clamp(nonlinear[i], lowest[i], highest[i]) - nonlinear[i]
        least += excess * v[i]
    share = clamp((max_power - least) / (power - least), 0.0, 1.0) if power > least else 1.0
    for i in range(len(tau)):
        if (tau[i] - nonlinear[i]) * v[i] > 0.0:
            floor = clamp(nonlinear[i], lowest[i], highest[i])
            tau[i] = clamp(floor + share * (tau[i] - floor), lowest[i], highest[i])
    return True


@compiled
def fit(wanted: Array, given: Array, limits: Array) -> float:
    """Largest share of some torques that fits into the limits beside others, |given + s wanted| <= limits.

    Scaling a vector of torques keeps the direction in which the hand accelerates; clamping single joints turns it, and
    a hand that is pushed aside by its own controller may swing for ever.

    Parameters
    ----------
    wanted, given
        (n,), N m
    limits
        (n,), N m. Joints for which `given` alone is too much are left out

    Returns
    -------
    float
        s, 0 to 1
    """
    share = 1.0
    for i in range(len(wanted)):
        room = limits[i] - given[i] if wanted[i] > 0.0 else limits[i] + given[i]
        if abs(wanted[i]) > room and room > 0.0:
            share = min(share, room / abs(wanted[i]))
    return share
