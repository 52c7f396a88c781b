# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back: the only place, under one name.

What comes from outside is checked here: a message that is not what it should be raises ``MessageError`` with the
reason, and nothing behind these modules has to trust a message's sizes.
Poses are ``[x, y, z, qx, qy, qz, qw]``, m; times are integers in ns.
"""

from __future__ import annotations

from tpgmm_ros.messages.basic_messages import (
    MAX_WRENCH,
    MessageError,
    floats,
    header_at,
    pose_from_array,
    pose_stamped,
    pose_to_array,
    pose_with_covariance,
    time_from_ns,
    time_to_ns,
    wrench_from_array,
    wrench_to_array,
)
from tpgmm_ros.messages.frame_messages import (
    MAX_DIMENSION,
    MAX_ITEMS,
    TaskFrameState,
    task_parameters,
    task_parameters_message,
)
from tpgmm_ros.messages.joint_messages import JointReader, JointStates, joint_state_message
from tpgmm_ros.messages.reference_messages import (
    gaussian,
    gaussian_message,
    reference,
    reference_message,
    terms_of,
    torque_terms,
)

__all__ = [
    "JointReader",
    "JointStates",
    "MAX_DIMENSION",
    "MAX_ITEMS",
    "MAX_WRENCH",
    "MessageError",
    "TaskFrameState",
    "floats",
    "gaussian",
    "gaussian_message",
    "header_at",
    "joint_state_message",
    "pose_from_array",
    "pose_stamped",
    "pose_to_array",
    "pose_with_covariance",
    "reference",
    "reference_message",
    "task_parameters",
    "task_parameters_message",
    "terms_of",
    "time_from_ns",
    "time_to_ns",
    "torque_terms",
    "wrench_from_array",
    "wrench_to_array",
]
