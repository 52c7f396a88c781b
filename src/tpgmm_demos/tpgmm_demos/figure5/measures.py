# SPDX-License-Identifier: Apache-2.0
"""What recorded joint states mean: how level the cup is, where the sugar is, how much energy there is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import DynamicState
from tpgmm_core.control.joint_impedance import JointImpedanceConfig, JointImpedanceLaw
from tpgmm_core.geometry import quaternion
from tpgmm_core.kinematics.hand_tasks import HandTask, HandTasks
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.figure5.lessons import CUP_AXIS, HANDS, SUGAR_PLACE
from tpgmm_demos.figure5.session import Trace

ARMS = ("left_arm", "right_arm")
#: The law that holds the tasks. Softer than by default, in all directions alike: who moves the hand by 20 cm would load
#: its wrist beyond what the motors have.
LAW = JointImpedanceConfig(joint_control_cost=1.0)
#: A time step so long that a law follows its reference at once, s.
AT_ONCE = 1e3


@dataclass(frozen=True, slots=True)
class Measures:
    """What is measured over the samples of a segment.

    Attributes
    ----------
    tilt
        (T,), deg
    offset
        (T,), of the sugar from its place, m
    where
        (T, 3), of the link, m
    left, right
        (T, 3), of the hands, m
    turned
        (T, 3), rotation vector of the left hand since the beginning, rad
    """

    tilt: Array
    offset: Array
    where: Array
    left: Array
    right: Array
    turned: Array

    @property
    def moved(self) -> Array:
        """(T,), m: how far the link is from where it was."""
        return np.asarray(np.linalg.norm(self.where - self.where[0], axis=1))


def measure(robot: RobotModel, segment: Trace, link: str) -> Measures:
    """Kinematics of all samples.

    Parameters
    ----------
    robot
        that was simulated
    segment
        T samples
    link
        whose pose is wanted

    Returns
    -------
    Measures
        at all samples
    """
    data, frame = robot.create_data(), robot.frame_id(link)
    rows = []
    for q in segment.q:
        data.update(q)
        rows.append(np.concatenate([*(data.pose(hand) for hand in HANDS), data.frame_pose(frame)[:3]]))
    left, right, where = np.split(np.array(rows), [7, 14], axis=1)
    R = quaternion.rotation_matrix(left[:, 3:])
    upright = np.einsum("ti,i->t", R[:, 2], CUP_AXIS)
    seen = np.einsum("tji,tj->ti", R, right[:, :3] - left[:, :3])
    turned = quaternion.log(quaternion.multiply(left[:, 3:], quaternion.conjugate(left[0, 3:])))
    return Measures(
        tilt=np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))),
        offset=np.linalg.norm(seen - SUGAR_PLACE, axis=1),
        where=where,
        left=left[:, :3],
        right=right[:, :3],
        turned=turned,
    )


def energy(robot: RobotModel, tasks: Mapping[str, HandTask], segment: Trace, rest: Array) -> Array:
    """Kinetic energy of the arms, and what the law's springs hold, e^T K e / 2, while some tasks hold.

    Parameters
    ----------
    robot
        that was simulated
    tasks
        that hold, by name
    segment
        T samples
    rest
        shape (nv,), posture of the joints

    Returns
    -------
    Array
        shape (T, 2), kinetic energy and that of the springs, J
    """
    product, law = HandTasks(robot, tasks, ARMS), JointImpedanceLaw(robot, ARMS, LAW)
    data, joints = robot.create_data(), product.joints
    result = []
    for q, v in zip(segment.q, segment.v, strict=True):
        reference = Reference(0.0, product.at(q, rest), 0.0, (), np.ones(1), ())
        moment = DynamicState.at(data, q, v)
        law.reset()
        answer = law.step(moment, law.target(reference, False), AT_ONCE)
        kinetic = v[joints] @ moment.inertia[np.ix_(joints, joints)] @ v[joints]
        result.append([0.5 * kinetic, 0.5 * answer.error @ answer.stiffness @ answer.error])
    return np.array(result)
