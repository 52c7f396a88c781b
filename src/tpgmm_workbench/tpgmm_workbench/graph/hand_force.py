# SPDX-License-Identifier: Apache-2.0
"""How hard somebody pushes the hand, where the robot measures it: joint torques, or a wrench -> `ForceView`."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import WrenchStamped

from tpgmm_core.common.text import one_line, shown
from tpgmm_core.common.types import Array
from tpgmm_core.observation.external_torques import ExternalTorques, size_of
from tpgmm_core.observation.joint_states import MAX_SPREAD
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointStates, MessageError
from tpgmm_ros.messages.joint_state_bytes import JointStateValues
from tpgmm_ros.messages.qos import STREAM
from tpgmm_workbench.graph.latest import Looker
from tpgmm_workbench.session.view import ForceView

#: What came longer ago is not of now, s.
LASTS = 0.5
TOPIC = "external_wrench"


class HandForce:
    """Looks at what a robot measures of pushes.

    Parameters
    ----------
    looker
        at the topic of wrenches
    robot
        whose dynamics measured torques are held against
    endpoint
        the hand
    """

    def __init__(self, looker: Looker, robot: RobotModel, endpoint: str) -> None:
        self._robot = robot
        arm = robot.endpoints[endpoint].joints
        names = [robot.joint_names[i] for i in robot.indices(arm)]
        self._arm = robot.indices(names)
        # other joints may have drivers that measure nothing: they stand still, as far as this arm feels
        self._states = JointStates(names, ("position", "velocity", "effort"), MAX_SPREAD)
        self._external = ExternalTorques(robot, endpoint)
        self._moving = frozenset(names)
        self._wrenches = looker.topic(WrenchStamped, TOPIC, STREAM)
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

    def look(self, is_heard: bool) -> ForceView:
        """What is known now; `is_heard`: whether joint states come."""
        self._external.step()
        wrench = self._wrenches.newest()
        found: list[tuple[float, str]] = []
        refused = ""
        if wrench is not None and self._wrenches.silence <= LASTS:
            values, refused = conversions.wrench_to_array(wrench), self._not_of_arm(wrench.header.frame_id)
            if not refused and np.isfinite(values).all():
                found.append((size_of(values), TOPIC))
        trouble = self._trouble if is_heard else "no joint states arrive"
        if not trouble and self._external.is_known:
            found.append((self._external.hand_force(), "joint torques"))
        if not found:
            return ForceView(why="; ".join(part for part in (trouble or "too few joint states yet", refused) if part))
        return ForceView(*max(found))

    def _not_of_arm(self, link: str) -> str:
        """Why a wrench at a link tells nothing of this arm; empty where it does."""
        try:
            joints = self._robot.joints_above(link)
        except ValueError:
            return f"{TOPIC} is at {shown(link)}, which the robot file does not know"
        return "" if self._moving.intersection(joints) else f"{TOPIC} is at {shown(link)}, which this arm does not move"
