# SPDX-License-Identifier: Apache-2.0
"""What joints are to do: `Aim`, where a hand or joints are to be, how accurately, and how that moves on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import Lag
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.data import RobotData
from tpgmm_core.robot.model import RobotModel


@dataclass(frozen=True, slots=True)
class Aim:
    """Something that joints are to bring about, in m coordinates; checked.

    Parameters
    ----------
    endpoint
        whose pose it is; empty for positions of joints
    joints
        (m,), places of these joints in joint vectors; empty for a pose
    mean
        (7,), the pose in base axes, or (m,), positions
    velocity
        (m,), of the mean: linear then angular for a pose
    spread
        (m, m), Cholesky factor of the covariance: S S^T
    """

    endpoint: str
    joints: NDArray[np.intp]
    mean: Array
    velocity: Array
    spread: Array

    @classmethod
    def of_pose(cls, endpoint: str, reference: PoseReference) -> Aim:
        """An aim of the hand.

        Parameters
        ----------
        endpoint
            of the robot file
        reference
            pose, twist and covariance, in base axes

        Returns
        -------
        Aim
            for `JointMotion.step`

        Raises
        ------
        ValueError
            it is not finite, its quaternion is not of length 1, or the covariance is not positive definite
        """
        length = float(np.linalg.norm(reference.pose[3:]))
        if not abs(length - 1.0) < 1e-3:
            raise ValueError(f"the reference's quaternion has the length {length:.3g}; expected 1")
        none = np.zeros(0, dtype=np.intp)
        return cls(endpoint, none, reference.pose, reference.twist, _spread(reference.covariance))

    @classmethod
    def of_reference(cls, robot: RobotModel, endpoint: str, reference: Reference) -> Aim:
        """An aim of what a reproduction sends.

        Parameters
        ----------
        robot
            the robot
        endpoint
            whose pose a reference of a pose means
        reference
            over a pose, or over positions of joints, which its dimensions name

        Returns
        -------
        Aim
            moving on as the reference does

        Raises
        ------
        ValueError
            neither of a pose nor of joints of the robot, or as `of_pose`
        """
        gaussian, names = reference.gaussian, reference.dimensions
        velocity = reference.velocity()
        if gaussian.manifold == POSE:
            return cls.of_pose(endpoint, PoseReference(gaussian.mean, gaussian.covariance, velocity))
        known = all(name in robot.joint_names for name in names)
        if not gaussian.manifold.is_euclidean or not known or len(names) != gaussian.manifold.dim:
            raise ValueError(
                f"the reference is on '{gaussian.manifold}' with the dimensions {listed(names)}; expected a pose on "
                f"'{POSE}', or a Gaussian over joints, which its dimensions name, of {listed(robot.joint_names, 40)}"
            )
        spread = _spread(gaussian.covariance)
        return cls("", robot.indices(names), np.array(gaussian.mean), velocity, spread)

    def __post_init__(self) -> None:
        """Raise ValueError where a number is not finite."""
        if not (np.isfinite(self.mean).all() and np.isfinite(self.velocity).all()):
            raise ValueError("the reference's mean or velocity is not finite")

    @property
    def covariance(self) -> Array:
        """(m, m), of the mean."""
        return self.spread @ self.spread.T

    def jacobian(self, data: RobotData, nv: int) -> Array:
        """(m, nv), with `velocity = J v`."""
        return data.jacobian(self.endpoint) if self.endpoint else np.eye(nv)[self.joints]

    def missing(self, data: RobotData, q: Array) -> Array:
        """(m,), what is left to the mean, in m and rad."""
        return POSE.log(data.pose(self.endpoint), self.mean) if self.endpoint else self.mean - q[self.joints]

    def lag(self, missing: Array, names: tuple[str, ...]) -> Lag:
        """What is missing, in words; `names` are those of all joints."""
        return Lag.of_pose(missing) if self.endpoint else Lag.of_joints(missing, [names[i] for i in self.joints])


def _spread(covariance: Array) -> Array:
    try:
        spread = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        spread = np.full_like(covariance, np.nan)
    if not (np.isfinite(spread).all() and np.isfinite(covariance).all()):
        raise ValueError("the reference's covariance is not finite, or not positive definite")
    return spread
