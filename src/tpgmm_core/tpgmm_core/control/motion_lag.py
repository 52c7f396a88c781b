# SPDX-License-Identifier: Apache-2.0
"""How far a robot is from what it was told: its joints, or its hand where only poses are told.

A controller of poses chooses the joints of a redundant arm by itself. They say nothing of whether it follows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.control.joint_motion import JointMotion
from tpgmm_core.geometry.pose import pose_error


@dataclass(frozen=True, slots=True, kw_only=True)
class LagLimits(Settings):
    """When a robot does not follow. A controller that cuts the error of the pose pulls no harder beyond that."""

    max_lag: float = setting(
        0.2, 0.001, 3.2, "Largest distance of a measured joint from its command, rad (m); beyond it, the joints stop"
    )
    max_hand_lag: float = setting(
        0.2, 0.001, 2.0, "Where poses alone are sent: the same for the hand, m, instead of for the joints"
    )
    max_hand_turn: float = setting(1.0, 0.01, 3.2, "The same for the rotation of the hand, rad")


class MotionLag(ABC):
    """Measured against a motion. `forget` at its begin: what has come to a joint before shows nothing."""

    @abstractmethod
    def forget(self) -> None:
        """Nothing has been measured yet."""

    @abstractmethod
    def take(self, q: Array) -> None:
        """Measured positions (nv,), at the time of what was told last."""

    @abstractmethod
    def why_lost(self, limits: LagLimits) -> str:
        """In words, why the robot does not follow; empty where it does."""

    @property
    @abstractmethod
    def largest(self) -> float:
        """Rad or m."""

    @property
    @abstractmethod
    def values(self) -> dict[str, str]:
        """For the diagnostics."""


class JointLag(MotionLag):
    """Of the joints that move."""

    def __init__(self, motion: JointMotion) -> None:
        self._motion = motion
        self.forget()

    def forget(self) -> None:
        """See the base class."""
        self._lags = np.zeros(len(self._motion.joints))

    def take(self, q: Array) -> None:
        """See the base class."""
        self._lags = np.abs(q - self._motion.q)[self._motion.joints]

    @property
    def largest(self) -> float:
        """See the base class."""
        return float(self._lags.max())

    def why_lost(self, limits: LagLimits) -> str:
        """See the base class."""
        if self.largest <= limits.max_lag:
            return ""
        return f"the robot does not follow: {self._worst} is {self.largest:.2f} rad (m) from its command"

    @property
    def values(self) -> dict[str, str]:
        """See the base class."""
        return {"robot_lag_rad": f"{self.largest:.4f}", "robot_lag_joint": self._worst}

    @property
    def _worst(self) -> str:
        return self._motion.names[int(np.argmax(self._lags))]


class HandLag(MotionLag):
    """Of an end point."""

    def __init__(self, motion: JointMotion, endpoint: str) -> None:
        self._motion, self._endpoint = motion, endpoint
        self._data = motion.robot.create_data()
        self.forget()

    def forget(self) -> None:
        """See the base class."""
        self._way = self._turn = 0.0

    def take(self, q: Array) -> None:
        """See the base class."""
        self._data.update(q)
        self._way, self._turn = pose_error(self._data.pose(self._endpoint), self._motion.pose(self._endpoint))

    @property
    def largest(self) -> float:
        """See the base class."""
        return max(self._way, self._turn)

    def why_lost(self, limits: LagLimits) -> str:
        """See the base class."""
        if self._way <= limits.max_hand_lag and self._turn <= limits.max_hand_turn:
            return ""
        how = f"{1e3 * self._way:.0f} mm and {np.degrees(self._turn):.0f} deg"
        return f"the robot does not follow: {self._endpoint} is {how} from its command"

    @property
    def values(self) -> dict[str, str]:
        """See the base class."""
        return {"hand_lag_mm": f"{1e3 * self._way:.1f}", "hand_lag_deg": f"{np.degrees(self._turn):.1f}"}
