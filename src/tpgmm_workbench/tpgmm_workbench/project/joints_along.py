# SPDX-License-Identifier: Apache-2.0
"""Joints along a path of poses: inverse kinematics that stays within the limits of positions.

Gauss-Newton steps with the damped pseudo-inverse of the project's kinematics, from each pose to the next. A joint that
a step would drive over its limit is put at the limit and left out of the step, which is then made anew with the others
(as in Baerlocher and Boulic 2004). What the hand leaves free is drawn towards the posture at the start, weakly.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.inverse import damped_pseudo_inverse
from tpgmm_core.robot.model import RobotModel

STEPS, FIRST_STEPS = 8, 100
CLOSE = 1e-4
"""Errors that are less are none: m, and rad times LENGTH."""
LENGTH = 0.3
"""A turn by 1 rad counts as this many metres."""
LARGEST_STEP = 0.2
"""Of a joint in one step, rad or m: Newton's steps far from the goal are no better."""
POSTURE = 0.05
"""Share of the way to the posture at the start that one step goes, where the hand leaves that free."""
DAMPED = 0.01
"""Singular values that are less are damped."""


def joints_along(robot: RobotModel, endpoint: str, path: Array, q: Array) -> tuple[Array, Array]:
    """Joints that put an end point on a path.

    Parameters
    ----------
    robot
        the robot
    endpoint
        a name of the robot file; the joints of its group move, the others stay
    path
        (T, 7) poses in the base frame
    q
        (nv,), where the robot is

    Returns
    -------
    tuple[Array, Array]
        positions (T, nv) within their limits, and what is missing to each pose, (T, 2): m, rad
    """
    data, joints = robot.create_data(), robot.indices(robot.endpoints[endpoint].joints)
    lower, upper = robot.lower_limits[joints], robot.upper_limits[joints]
    scale = np.repeat([1.0, LENGTH], 3)
    found, missing = np.empty((len(path), robot.nv)), np.empty((len(path), 2))
    now, rest = np.array(q, float), np.array(q, float)[joints]
    now[joints] = np.clip(now[joints], lower, upper)
    for i, pose in enumerate(path):
        for _ in range(FIRST_STEPS if i == 0 else STEPS):
            data.update(now)
            error = POSE.log(data.pose(endpoint), pose) * scale
            if np.linalg.norm(error) < CLOSE:
                break
            J = np.ascontiguousarray(data.jacobian(endpoint)[:, joints] * scale[:, None])
            now[joints] = _step(J, error, now[joints], rest, lower, upper)
        data.update(now)
        error = POSE.log(data.pose(endpoint), pose)
        found[i], missing[i] = now, (np.linalg.norm(error[:3]), np.linalg.norm(error[3:]))
    return found, missing


def _step(J: Array, error: Array, q: Array, rest: Array, lower: Array, upper: Array) -> Array:
    """One step (n,) towards the pose, and where that is free towards the rest posture, within the limits."""
    free, new = np.ones(len(q), bool), q.copy()
    for _ in range(len(q)):
        moved = np.where(free, q, new) - q  # joints at their limits go there, the others make up for it
        used = np.ascontiguousarray(J[:, free])
        inverse = damped_pseudo_inverse(used, DAMPED)
        drawn = POSTURE * (rest - q)[free]
        step = inverse @ (error - J @ moved - used @ drawn) + drawn
        largest = float(np.abs(step).max(initial=0.0))
        new[free] = q[free] + step * min(1.0, LARGEST_STEP / max(largest, 1e-12))
        over = free & ((new < lower) | (new > upper))
        if not over.any():
            break
        new[over] = np.clip(new[over], lower[over], upper[over])
        free &= ~over
        if not free.any():
            break
    return new
