# SPDX-License-Identifier: Apache-2.0
"""`RobotData`: the scratch memory of one loop, and what Pinocchio computes in it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from tpgmm_core.common.types import Array

AXES = pin.LOCAL_WORLD_ALIGNED


class RobotData:
    """Kinematics and dynamics at one state; call `update` first. Not for two threads at once.

    Parameters
    ----------
    model
        of Pinocchio
    frame_ids
        end point -> Pinocchio's index of its frame
    world_to_base
        from Pinocchio's world to the base frame, in whose axes everything is expressed
    """

    def __init__(self, model: pin.Model, frame_ids: Mapping[str, int], world_to_base: pin.SE3) -> None:
        self._model, self._frame_ids, self._world_to_base = model, frame_ids, world_to_base
        # Apart, since the dynamics algorithms overwrite velocities and accelerations of the kinematics
        self._data = self._model.createData()
        self._dynamics = self._model.createData()
        self._zero = np.zeros(model.nv)
        rotation = world_to_base.rotation
        # blkdiag(R, R) turns motions and forces from world to base axes; most robots have the same axes for
        # both
        aligned = np.allclose(rotation, np.eye(3), rtol=0.0, atol=1e-12)
        self._turn = None if aligned else np.kron(np.eye(2), rotation)

    def update(self, q: Array, v: Array | None = None) -> None:
        """Kinematics at joint positions q and velocities v (nv,), zero if not given."""
        pin.forwardKinematics(self._model, self._data, q, self._zero if v is None else v, self._zero)
        pin.computeJointJacobians(self._model, self._data)
        pin.updateFramePlacements(self._model, self._data)

    def pose(self, endpoint: str) -> Array:
        """Pose [x, y, z, qx, qy, qz, qw] of an end point in the base frame, m."""
        return self.frame_pose(self._frame_ids[endpoint])

    def frame_pose(self, frame_id: int) -> Array:
        """Pose [x, y, z, qx, qy, qz, qw] of any frame of the URDF in the base frame, m."""
        return pin.SE3ToXYZQUAT(self._world_to_base.act(self._data.oMf[frame_id]))

    def relative_pose(self, parent_id: int, frame_id: int) -> Array:
        """Pose [x, y, z, qx, qy, qz, qw] of a frame of the URDF in another one, m."""
        return pin.SE3ToXYZQUAT(self._data.oMf[parent_id].actInv(self._data.oMf[frame_id]))

    def twist(self, endpoint: str) -> Array:
        """Velocity (6,) of an end point in base axes: linear m/s, then angular rad/s."""
        motion = pin.getFrameVelocity(self._model, self._data, self._frame_ids[endpoint], AXES)
        return self._in_base(motion.vector)

    def jacobian(self, endpoint: str) -> Array:
        """Jacobian (6, nv) with `twist = J v`."""
        return self.frame_jacobian(self._frame_ids[endpoint])

    def frame_jacobian(self, frame_id: int) -> Array:
        """Jacobian (6, nv) of any frame of the URDF: motion of its origin, in base axes."""
        return self._in_base(pin.getFrameJacobian(self._model, self._data, frame_id, AXES))

    def bias_acceleration(self, endpoint: str) -> Array:
        """Acceleration `Jdot v` (6,) of an end point when no joint accelerates, in base axes."""
        motion = pin.getFrameClassicalAcceleration(self._model, self._data, self._frame_ids[endpoint], AXES)
        return self._in_base(motion.vector)

    def mass_matrix(self, q: Array) -> Array:
        """Joint-space inertia M(q), (nv, nv). The array is overwritten by the next call."""
        return pin.crba(self._model, self._dynamics, q)

    def nonlinear_effects(self, q: Array, v: Array) -> Array:
        """Gravity, Coriolis and centrifugal torques (nv,). The array is overwritten by the next call."""
        return pin.nonLinearEffects(self._model, self._dynamics, q, v)

    def gravity(self, q: Array) -> Array:
        """Torques (nv,) that hold the robot at q. The array is overwritten by the next call."""
        return pin.computeGeneralizedGravity(self._model, self._dynamics, q)

    def _in_base(self, motion: Array) -> Array:
        return motion if self._turn is None else self._turn @ motion
