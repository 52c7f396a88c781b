# SPDX-License-Identifier: Apache-2.0
"""A hand that is led by the mouse: a soft spring pulls it to where the gizmo is, as a person's hand would.

The gizmo may leap; what the spring pulls towards follows it smoothly and no faster than a person leads an arm. At rest
the spring works off what friction leaves, so that the hand gets to where it is shown.
"""

from __future__ import annotations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_demos.teaching.teacher import Teacher, TeacherConfig

#: How fast what the spring pulls towards follows the gizmo, 1/s, and its largest speeds, m/s and rad/s.
FOLLOW_RATE, MAX_SPEED, MAX_TURN = 6.0, 0.25, 1.2
#: So near to the gizmo it rests, m and rad.
NEAR = (0.004, 0.03)
#: A longer time without a pose of the hand is a pause, s.
PAUSE = 0.25
#: Of a person's arm: less than where a program leads, since poses of the hand come late over the network.
SPRING = TeacherConfig(stiffness=(400.0, 12.0), damping=(50.0, 1.2), correction=1.5, max_force=35.0, max_torque=7.0)


class _Follower:
    """What the spring pulls towards."""

    def __init__(self, pose: Array) -> None:
        self.pose, self.aim = pose, pose
        self._velocity = np.zeros(6)

    def step(self, seconds: float) -> None:
        error = POSE.log(self.pose, self.aim)
        # semi-implicit, so that it is stable for every step that can come
        slope = FOLLOW_RATE * FOLLOW_RATE * error - 2.0 * FOLLOW_RATE * self._velocity
        self._velocity += seconds / (1.0 + 2.0 * FOLLOW_RATE * seconds) * slope
        for part, most in ((slice(0, 3), MAX_SPEED), (slice(3, 6), MAX_TURN)):
            speed = float(np.linalg.norm(self._velocity[part]))
            if speed > most:
                self._velocity[part] *= most / speed
        self.pose = POSE.exp(self.pose, seconds * self._velocity)

    def at(self, time: float) -> tuple[Array, bool]:
        error = POSE.log(self.pose, self.aim)
        return self.pose, float(np.linalg.norm(error[:3])) < NEAR[0] and float(np.linalg.norm(error[3:])) < NEAR[1]


class Leading:
    """Leads one hand; while nobody leads it, it gives no force."""

    def __init__(self) -> None:
        self._teacher: Teacher[_Follower] | None = None
        self._aim: Array | None = None
        self._last = 0.0

    @property
    def aim(self) -> Array | None:
        """The pose (7,) to which the hand is led; None while nobody leads it."""
        return self._aim

    def lead(self, aim: Array) -> None:
        """Lead the hand to a pose (7,) from now on."""
        self._aim = np.array(aim)

    def let_go(self) -> None:
        """Give no more force."""
        self._aim = self._teacher = None

    def wrench(self, time: float, hand: Array) -> Array | None:
        """Give the force that leads the hand.

        Parameters
        ----------
        time
            of the hand's pose, s
        hand
            (7,) where it is

        Returns
        -------
        Array | None
            force and torque (6,) in base axes, N and N m; None while nobody leads it
        """
        if self._aim is None:
            return None
        step = time - self._last
        self._last = time
        if self._teacher is None or not 0.0 <= step <= PAUSE:
            self._teacher, step = Teacher(_Follower(np.array(hand)), SPRING), 0.0
        follower = self._teacher.intention
        follower.aim = self._aim
        follower.step(step)
        return self._teacher.wrench(time, hand)

    def is_there(self, hand: Array) -> bool:
        """Whether the hand is where it is led to, to 1 cm and 5 degrees."""
        if self._aim is None:
            return False
        error = POSE.log(hand, self._aim)
        return float(np.linalg.norm(error[:3])) < 0.01 and float(np.linalg.norm(error[3:])) < 0.09
