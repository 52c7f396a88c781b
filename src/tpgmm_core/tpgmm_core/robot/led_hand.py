# SPDX-License-Identifier: Apache-2.0
"""`LedHand`: a person's hand that leads that of a robot to a place, softly and no faster than a person leads it.

Where the place leaps, what the spring pulls towards follows smoothly. Near the place the spring works off what friction
leaves. The spring is at the robot itself: over a network its force would come late, and late springs swing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE


@dataclass(frozen=True, slots=True, kw_only=True)
class LeadingConfig(Settings):
    """How a person leads a hand; the defaults are those of someone who does it with care."""

    stiffness: float = setting(600.0, 1.0, 1e4, "Stiffness of the person's arm, N/m")
    damping: float = setting(60.0, 0.0, 1e3, "Damping of it, N s/m")
    turn_stiffness: float = setting(20.0, 0.1, 1e3, "Stiffness against turning, N m/rad")
    turn_damping: float = setting(1.5, 0.0, 1e2, "Damping of turning, N m s/rad")
    correction: float = setting(2.0, 0.0, 100.0, "How fast a remaining error is worked off, 1/s")
    max_force: float = setting(40.0, 0.1, 1e3, "Largest force in each direction, N")
    max_torque: float = setting(8.0, 0.1, 1e3, "Largest torque about each axis, N m")
    max_speed: float = setting(0.25, 0.01, 5.0, "Largest speed at which the hand is led, m/s")
    max_turn: float = setting(1.2, 0.01, 20.0, "Largest angular speed, rad/s")
    follow_rate: float = setting(6.0, 0.1, 100.0, "How fast the spring's end follows a place that leaps, 1/s")


class LedHand:
    """Leads a hand; it begins where the hand is.

    Parameters
    ----------
    pose
        (7,) of the hand, m and unit quaternion
    config
        how firmly and how fast
    """

    def __init__(self, pose: Array, config: LeadingConfig | None = None) -> None:
        self._config = config or LeadingConfig()
        self._pose = np.array(pose)
        self._velocity = np.zeros(6)
        self._offset = np.zeros(6)

    def wrench(self, seconds: float, aim: Array, pose: Array, twist: Array) -> Array:
        """Give the force of the person's hand after a time.

        Parameters
        ----------
        seconds
            since it was asked last
        aim
            (7,) where the hand is to be
        pose, twist
            (7,) where it is, and (6,) its velocity in base axes, m/s and rad/s

        Returns
        -------
        Array
            force and torque (6,) in base axes, N and N m
        """
        config = self._config
        self._follow(seconds, aim)
        error = POSE.log(pose, self._pose)
        left = POSE.log(self._pose, aim)
        is_there = float(np.linalg.norm(left[:3])) < 0.004 and float(np.linalg.norm(left[3:])) < 0.03
        # while it moves, the correction of the last place is let go of
        self._offset += seconds * (config.correction * error if is_there else -self._offset)
        stiffness = np.repeat([config.stiffness, config.turn_stiffness], 3)
        damping = np.repeat([config.damping, config.turn_damping], 3)
        most = np.repeat([config.max_force, config.max_torque], 3)
        self._offset = np.clip(self._offset, -most / stiffness, most / stiffness)
        wanted = stiffness * (error + self._offset) + damping * (self._velocity - twist)
        return np.clip(wanted, -most, most)

    def _follow(self, seconds: float, aim: Array) -> None:
        rate = self._config.follow_rate
        # semi-implicit, so that it is stable for every step that can come
        pull = rate * rate * POSE.log(self._pose, aim) - 2.0 * rate * self._velocity
        change = seconds / (1.0 + 2.0 * rate * seconds) * pull
        for part, fastest in ((slice(0, 3), self._config.max_speed), (slice(3, 6), self._config.max_turn)):
            _shorten(change[part], 2.0 * rate * fastest * seconds)  # what it needs to stop in time
            self._velocity[part] += change[part]
            _shorten(self._velocity[part], fastest)
        self._pose = POSE.exp(self._pose, seconds * self._velocity)


def _shorten(vector: Array, most: float) -> None:
    """Make a vector as short as this, in place."""
    length = float(np.linalg.norm(vector))
    if length > most:
        vector *= most / length
