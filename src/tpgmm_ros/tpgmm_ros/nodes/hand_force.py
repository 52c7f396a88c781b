# SPDX-License-Identifier: Apache-2.0
"""How hard somebody pushes a hand, where the robot measures it: joint torques, or a wrench -> `MeasuredForce`."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import WrenchStamped

from tpgmm_core.common.text import one_line, shown
from tpgmm_core.common.types import Array
from tpgmm_core.observation.external_torques import ExternalTorques, MeasuredForce, size_of
from tpgmm_core.observation.joint_states import MAX_SPREAD
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointStates, MessageError
from tpgmm_ros.messages.joint_state_bytes import JointStateValues

#: A wrench that came longer ago is not of now, s.
LASTS = 0.5
WRENCH = "external_wrench"


class HandForce:
    """Judges what a robot measures of pushes.

    Parameters
    ----------
    robot
        whose dynamics measured torques are held against
    endpoint
        the hand
    """

    def __init__(self, robot: RobotModel, endpoint: str) -> None:
        self._robot = robot
        arm = robot.endpoints[endpoint].joints
        names = [robot.joint_names[i] for i in robot.indices(arm)]
        self._arm = robot.indices(names)
        # other joints may have drivers that measure nothing: they stand still, as far as this arm feels
        self._states = JointStates(names, ("position", "velocity", "effort"), MAX_SPREAD)
        self._external = ExternalTorques(robot, endpoint)
        self._moving = frozenset(names)
        self._trouble = "no joint states arrive"

    def take(self, message: JointStateValues, q: Array | None) -> None:
        """Take in a message of joint states; `q`: where all joints are (nv,), rad and m, as far as that is known."""
        try:
            sample = self._states.take(message)
        except MessageError as error:
            self._trouble = one_line(error, 200)
            self._external.forget()
            return
        if sample is None or q is None:
            return
        position, velocity, effort = (np.zeros(self._robot.nv) for _ in range(3))
        position[:] = q
        position[self._arm], velocity[self._arm], effort[self._arm] = sample.values
        if not effort.any():  # what drivers say that measure none
            self._trouble = "all joint torques (effort of joint_states) are 0"
            self._external.forget()
            return
        self._trouble = ""
        self._external.take(sample.stamp_ns, position, velocity, effort)

    def measured(self, wrench: WrenchStamped | None, is_heard: bool = True) -> MeasuredForce:
        """What is known now.

        Parameters
        ----------
        wrench
            the newest of `WRENCH`; None where none came within `LASTS`
        is_heard
            whether joint states come

        Returns
        -------
        MeasuredForce
            the largest that is measured
        """
        self._external.step()
        found: list[tuple[float, str]] = []
        refused = ""
        if wrench is not None:
            values, refused = conversions.wrench_to_array(wrench), self._not_of_arm(wrench.header.frame_id)
            if not refused and np.isfinite(values).all():
                found.append((size_of(values), WRENCH))
        trouble = self._trouble if is_heard else "no joint states arrive"
        if not trouble and self._external.is_known:
            found.append((self._external.hand_force(), "joint torques"))
        if not found:
            why = "; ".join(part for part in (trouble or "too few joint states yet", refused) if part)
            return MeasuredForce(why=why)
        return MeasuredForce(*max(found))

    def _not_of_arm(self, link: str) -> str:
        """Why a wrench at a link tells nothing of this arm; empty where it does."""
        try:
            joints = self._robot.joints_above(link)
        except ValueError:
            return f"{WRENCH} is at {shown(link)}, which the robot file does not know"
        is_moved = self._moving.intersection(joints)
        return "" if is_moved else f"{WRENCH} is at {shown(link)}, which this arm does not move"
