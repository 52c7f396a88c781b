# SPDX-License-Identifier: Apache-2.0
"""The world of the pick-and-place task: where things lie, how they are held, and what counts as done.

Shared by ``teach``, which demonstrates the task, and ``demo``, which asks for it in situations of its own.
Poses are ``[x, y, z, qx, qy, qz, qw]`` in the robot's base frame, m; the z axis of an object points up, that of the
hand out of the hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse, pose_error

#: The hand at an object: upside down above its middle, the hand's x axis against the object's, so that an object that
#: is not turned is grasped in the middle of the wrist's range.
GRASP = np.array([0.0, 0.0, 0.02, 0.0, 1.0, 0.0, 0.0])
#: The height above a place from which the hand comes down and to which it goes up, m.
CLEARANCE = 0.10


@dataclass(frozen=True, slots=True)
class PlacementRegion:
    """Where something may lie: a box (m) and how far it may be turned (rad): about the vertical, and tilted."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    yaw: float
    tilt: float

    def sample(self, random: np.random.Generator) -> Array:
        """A random pose in the region."""
        tilt_axis = random.uniform(0.0, 2.0 * np.pi)
        tilt = random.uniform(0.0, self.tilt) * np.array([np.cos(tilt_axis), np.sin(tilt_axis), 0.0])
        yaw = np.array([0.0, 0.0, random.uniform(-self.yaw, self.yaw)])
        turn = quaternion.multiply(quaternion.exp(tilt), quaternion.exp(yaw))
        return np.concatenate([random.uniform(self.lower, self.upper), turn])


#: On a table in front of the left arm; the target's place may be inclined.
OBJECT_REGION = PlacementRegion((0.55, 0.30, -0.05), (0.75, 0.50, 0.02), yaw=0.7, tilt=0.0)
TARGET_REGION = PlacementRegion((0.55, 0.00, -0.02), (0.75, 0.18, 0.08), yaw=0.7, tilt=0.17)


@dataclass(frozen=True, slots=True)
class Placement:
    """One placing of the task's objects."""

    object: Array
    target: Array


def random_placement(random: np.random.Generator) -> Placement:
    """Object and target somewhere in their regions."""
    return Placement(object=OBJECT_REGION.sample(random), target=TARGET_REGION.sample(random))


def hand_at(place: Array, height: float = 0.0) -> Array:
    """The hand's pose when it holds an object that lies at ``place``, or ``height`` above it along its z axis."""
    raised = np.array([0.0, 0.0, height, 0.0, 0.0, 0.0, 1.0])
    return compose(compose(place, raised), GRASP)


class Grasp:
    """A gripper that closes when the hand rests where the object can be grasped, and then holds it as it is.

    The object then moves with the hand, and cannot be seen any more: the hand covers it.
    """

    #: How near (m, rad) and for how long (s) the hand must be there before the gripper closes, and how far (m, rad) it
    #: may move meanwhile: a hand that passes by, or swings, does not rest.
    TOLERANCE = (0.015, 0.14)
    DWELL = 0.3
    REST = (0.003, 0.03)

    def __init__(self, lies: Array) -> None:
        self.object = lies
        self._in_hand: Array | None = None
        self._rests: tuple[float, Array] | None = None  # since when, and where

    @property
    def holds(self) -> bool:
        """Whether the object is in the hand."""
        return self._in_hand is not None

    def move_object(self, lies: Array) -> None:
        """Someone pushes the object; one that is held cannot be pushed."""
        if not self.holds:
            self.object = lies

    def update(self, hand: Array, time: float) -> None:
        """Take in the hand's pose at a time in s."""
        if self._in_hand is not None:
            self.object = compose(hand, self._in_hand)
            return
        if not _is_within(pose_error(hand, hand_at(self.object)), self.TOLERANCE):
            self._rests = None
        elif self._rests is None or not _is_within(pose_error(hand, self._rests[1]), self.REST):
            self._rests = time, hand.copy()
        elif time - self._rests[0] >= self.DWELL:
            self._in_hand = compose(inverse(hand), self.object)


def _is_within(error: tuple[float, float], bound: tuple[float, float]) -> bool:
    return error[0] <= bound[0] and error[1] <= bound[1]
