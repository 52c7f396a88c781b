# SPDX-License-Identifier: Apache-2.0
"""`UrdfKinematics`: frames for any robot with a URDF, by Pinocchio (through `robot.py`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel


class UrdfKinematics:
    """Some joints of a robot; the others stand still.

    Poses and Jacobians are in the robot's base frame.

    Parameters
    ----------
    robot
        the robot; may be shared
    joints
        a group of the robot file, or several groups and joints by name; their order is the order in q
    points
        end points of the robot file, or frames of the URDF; or name → one of these; the end points where None
    posture
        (nv,), where the other joints are, rad and m; the robot's home where None

    Attributes
    ----------
    joint_names
        in the order of q

    Raises
    ------
    ValueError
        for unknown names, and no joints
    """

    def __init__(
        self,
        robot: RobotModel,
        joints: str | Sequence[str],
        points: Sequence[str] | Mapping[str, str] | None = None,
        posture: ArrayLike | None = None,
    ) -> None:
        self._data = robot.create_data()
        groups = (joints,) if isinstance(joints, str) else joints
        self._joints = np.concatenate([robot.indices(group) for group in groups])
        self.joint_names = tuple(robot.joint_names[i] for i in self._joints)
        chosen = tuple(robot.endpoints) if points is None else points
        named = chosen if isinstance(chosen, Mapping) else {name: name for name in chosen}
        ends = robot.endpoint_frame_ids
        self._frame_ids = {name: ends[of] if of in ends else robot.frame_id(of) for name, of in named.items()}
        self._posture = np.array(robot.home if posture is None else posture, dtype=float)
        self.update(self._posture[self._joints])

    @property
    def n_joints(self) -> int:
        """Number of the joints that move."""
        return len(self._joints)

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the points, as given."""
        return tuple(self._frame_ids)

    def update(self, q: Array) -> None:
        """Move these joints.

        Parameters
        ----------
        q
            shape (n,), rad or m

        Raises
        ------
        ValueError
            for another shape
        """
        if np.shape(q) != self._joints.shape:
            raise ValueError(f"there are {self.n_joints} joints, got q of shape {np.shape(q)}")
        self._posture[self._joints] = q
        self._data.update(self._posture)

    def place(self, point: str) -> Array:
        """Pose (7,) of a point in the base frame, m."""
        return self._data.frame_pose(self._frame_id(point))

    def jacobian(self, point: str) -> Array:
        """Jacobian (6, n) of a point, about the axes of the base frame."""
        return self._data.frame_jacobian(self._frame_id(point))[:, self._joints]

    def _frame_id(self, point: str) -> int:
        if point not in self._frame_ids:
            raise ValueError(f"unknown point {point!r}; there are {list(self._frame_ids)}")
        return self._frame_ids[point]
