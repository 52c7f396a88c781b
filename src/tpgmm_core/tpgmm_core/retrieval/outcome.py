# SPDX-License-Identifier: Apache-2.0
"""How a movement ended: what counts as its end, and what is known of the cause where the robot is elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold

_HARDLY = 0.1
"""A share of the way below this counts as none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutionConfig(Settings):
    """When an execution counts as begun and as done."""

    start_timeout: float = setting(
        5.0, 0.1, 600.0, "Time after a request within which all frames must have been seen, s"
    )
    settle_time: float = setting(
        1.0, 0.01, 60.0, "Time that the robot has to settle before its error at the end is judged, s"
    )
    stall_timeout: float = setting(
        10.0, 0.1, 600.0, "A movement that stalls for this long, although its speed is not 0, is aborted, s"
    )
    unknown_timeout: float = setting(
        30.0, 0.1, 3600.0, "Time after which a movement that waits, because too little is known, is aborted, s"
    )
    position_tolerance: float = setting(0.01, 1e-4, 1.0, "Largest position error at the end that counts as success, m")
    orientation_tolerance: float = setting(
        0.0873, 1e-3, 3.2, "Largest orientation error at the end that counts as success, rad"
    )
    joint_tolerance: float = setting(
        0.05, 1e-3, 3.2, "Largest error of a joint at the end that counts as success, for movements of joints, rad or m"
    )
    transition_speed: float = setting(
        0.15,
        0.001,
        10.0,
        "Largest speed of the transition to a skill that begins away from the end of the previous one, m/s",
    )
    transition_rate: float = setting(
        0.6, 0.001, 30.0, "The same for orientations and joints, rad/s (prismatic joints: m/s)"
    )


@dataclass(frozen=True, slots=True)
class Outcome:
    """How an execution ended.

    Parameters
    ----------
    success
        whether the robot came to the end of the movement
    reason
        a sentence for users
    position_error, orientation_error
        of the robot's pose from the end of the reference, m and rad; NaN where not known, as for movements of joints
    is_missed
        whether the robot did not follow the references to their end; a caller who knows more may add why
    """

    success: bool
    reason: str
    position_error: float = math.nan
    orientation_error: float = math.nan
    is_missed: bool = False


def distance(config: ExecutionConfig, manifold: Manifold, end: Array, pose: Array) -> float:
    """Distance of a pose, or of a configuration, from another.

    Parameters
    ----------
    config
        the tolerances
    manifold
        of both
    end, pose
        points (D,)

    Returns
    -------
    float
        in tolerances: 1 is at the border of what counts as there
    """
    error = manifold.log(end, pose)
    if manifold.is_euclidean:
        return float(np.abs(error).max()) / config.joint_tolerance
    position, orientation = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    return max(position / config.position_tolerance, orientation / config.orientation_tolerance)


def judged(config: ExecutionConfig, end: Gaussian, way: tuple[Array | None, Array | None, Array | None]) -> Outcome:
    """What is said of a robot at the end of a movement.

    Parameters
    ----------
    config
        the tolerances
    end
        the last reference
    way
        where the robot was when the movement began, when the reference came to its end, and where it is now; None where
        that is not known

    Returns
    -------
    Outcome
        with the cause, as far as the way shows it
    """
    pose = way[2]
    if pose is None:
        return Outcome(False, "the robot's pose is not known: no message arrived on the movement's topic")
    near = distance(config, end.manifold, end.mean, pose) <= 1.0
    error = end.manifold.log(end.mean, pose)
    if end.manifold.is_euclidean:
        position = orientation = math.nan
        words = f"joints are {np.abs(error).max():.3f} rad or m"
    else:
        position, orientation = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        words = f"{1e3 * position:.1f} mm and {math.degrees(orientation):.1f} deg"
    words += " from the model's end of the movement"
    if not near:
        words += f"; {_cause(config, end, way[0], way[1], pose)}"
    return Outcome(near, words, position, orientation, is_missed=not near)


def _cause(config: ExecutionConfig, end: Gaussian, first: Array | None, settling: Array | None, pose: Array) -> str:
    """Why the robot is not at the end, as far as its way shows, in words."""
    if first is None or settling is None:
        return "its pose arrived only at the end"
    manifold = end.manifold
    left, asked = (distance(config, manifold, end.mean, one) for one in (pose, first))
    gone, late = distance(config, manifold, first, pose), distance(config, manifold, end.mean, settling)
    if asked > 1.0 and gone < _HARDLY * asked:
        return "the robot has hardly moved: check that a controller is active and that nothing holds the robot"
    if left < (1.0 - _HARDLY) * late:
        return "the robot is late and still approaching: request a longer duration, or increase settle_time"
    return "the robot has stopped there: blocked, at its limits, too weak, or out of its reach"
