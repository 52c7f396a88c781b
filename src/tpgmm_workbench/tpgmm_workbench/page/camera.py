# SPDX-License-Identifier: Apache-2.0
"""From where a page looks at the robot at first: over the hand, from in front and beside, the panels at the right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array

#: From the hand to the camera, m: forward, to the side, up; and where the middle of the picture is beside the hand.
FORWARD, SIDE, UP, BESIDE = 1.05, 0.75, 0.75, 0.3


@dataclass(frozen=True, slots=True)
class Camera:
    """Where it is and where it looks, (3,) in the base frame, m; its vertical field of view, rad."""

    position: Array
    look_at: Array
    fov: float = 0.9


def camera_for(hand: Array) -> Camera:
    """Place the camera for a hand that is at home at a pose (7,)."""
    forward = np.array([float(hand[0]), float(hand[1]), 0.0])
    length = float(np.linalg.norm(forward))
    forward = forward / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    side = np.array([-forward[1], forward[0], 0.0])
    # the panels cover the right of the picture: what is looked at lies to the left of its middle
    position = hand[:3] + FORWARD * forward + SIDE * side + np.array([0.0, 0.0, UP])
    ahead = hand[:3] - position
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Camera(position + BESIDE * right, hand[:3] + BESIDE * right - np.array([0.0, 0.0, 0.05]))
