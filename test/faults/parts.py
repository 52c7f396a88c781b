# SPDX-License-Identifier: Apache-2.0
"""Joint states of one driver among several."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import JointState

from tpgmm_ros.messages import conversions


def part(state: JointState, names: Sequence[str], stamp_ns: int) -> JointState:
    """Of a state what one of several drivers publishes."""
    chosen = [state.name.index(name) for name in names]
    message = conversions.joint_state_message(list(names), stamp_ns)
    for field in ("position", "velocity", "effort"):
        setattr(message, field, array("d", [getattr(state, field)[i] for i in chosen]))
    return message


def gripper(stamp_ns: int) -> JointState:
    """What a gripper's driver publishes on the same topic."""
    two = np.array([0.02, 0.02])
    return conversions.joint_state_message(["finger_joint1", "finger_joint2"], stamp_ns, two, 0.0 * two, two + np.nan)
