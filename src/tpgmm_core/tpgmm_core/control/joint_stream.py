# SPDX-License-Identifier: Apache-2.0
"""`JointStream`: joint positions that follow pose references, for robots that take positions instead of torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from tpgmm_core.common.types import Array
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.geometry.gaussian import is_positive_definite
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.robot.model import RobotModel


@dataclass(frozen=True, slots=True)
class JointStep:
    """Positions and velocities (n,) of the end point's joints, and in words what was done."""

    q: Array
    v: Array
    state: str


class JointStream:
    """Inverse kinematics with limits, weighted by the precision of the references.

    Each step solves min |L^T (x - J v)|² + |v|² / d² within the bounds of v, where L L^T is the precision of the
    reference, x its twist plus `rate` times what is missing, and d the `rest_deviation`.

    Parameters
    ----------
    robot
        with its limits
    endpoint
        that follows, by the joints of the robot file
    q
        (nv,), measured positions: where the stream starts
    rate
        1/s, how fast what is missing is made up for
    acceleration
        rad/s² (m/s²), largest change of the joints' velocities
    rest_deviation
        rad/s (m/s), speed of a joint that counts as much as one standard deviation of the reference per second
    max_age
        s, a reference older than this is not followed

    Raises
    ------
    ValueError
        q is not finite, has a wrong shape, or is outside the joint limits
    """

    def __init__(
        self,
        robot: RobotModel,
        endpoint: str,
        q: Array,
        *,
        rate: float = 4.0,
        acceleration: float = 10.0,
        rest_deviation: float = 1.0,
        max_age: float = 0.2,
    ) -> None:
        self._data, self._endpoint = robot.create_data(), endpoint
        self.joints = robot.indices(robot.endpoints[endpoint].joints)
        self._lower, self._upper = robot.lower_limits[self.joints], robot.upper_limits[self.joints]
        self._fastest = robot.velocity_limits[self.joints]
        self._rate, self._acceleration, self._max_age = rate, acceleration, max_age
        self._rest = np.eye(len(self.joints)) / rest_deviation
        self._q = np.array(q, dtype=np.float64)
        if self._q.shape != (robot.nv,) or not np.isfinite(self._q).all():
            raise ValueError(f"measured positions are {self._q}; expected {robot.nv} finite numbers")
        here = self._q[self.joints]
        outside = (here < self._lower) | (here > self._upper)
        if outside.any():
            names = ", ".join(robot.joint_names[i] for i in self.joints[outside])
            raise ValueError(f"measured positions are outside the joint limits: {names}; move the robot inside first")
        self._v = np.zeros(len(self.joints))

    def step(self, reference: PoseReference | None, age: float, dt: float) -> JointStep:
        """Positions after a time step.

        Parameters
        ----------
        reference
            the latest one, in base axes; None before the first
        age
            s, since it was made
        dt
            s, positive

        Returns
        -------
        JointStep
            within the limits of position and speed; without a fresh reference the joints slow down and stay
        """
        here, change = self._q[self.joints], self._acceleration * dt
        # The speed from which a joint can still stop before its limit
        up = np.minimum(self._fastest, np.sqrt(2.0 * self._acceleration * (self._upper - here)))
        down = -np.minimum(self._fastest, np.sqrt(2.0 * self._acceleration * (here - self._lower)))
        low = np.minimum(np.maximum(down, self._v - change), up)
        high = np.maximum(np.minimum(up, self._v + change), low)
        if reference is None:
            v, state = np.clip(np.zeros_like(here), low, high), "holds: no reference yet"
        elif age > self._max_age:
            v = np.clip(np.zeros_like(here), low, high)
            state = f"holds: the reference is {age:.2f} s old, more than {self._max_age:.2f} s"
        elif not _usable(reference):
            v = np.clip(np.zeros_like(here), low, high)
            state = "holds: the reference is not finite, or its covariance is not positive definite"
        else:
            v, state = self._follow(reference, low, high)
        moved = np.clip(here + dt * v, self._lower, self._upper)
        self._v = (moved - here) / dt
        self._q[self.joints] = moved
        return JointStep(moved.copy(), self._v.copy(), state)

    def _follow(self, reference: PoseReference, low: Array, high: Array) -> tuple[Array, str]:
        self._data.update(self._q)
        J = self._data.jacobian(self._endpoint)[:, self.joints]
        missing = POSE.log(self._data.pose(self._endpoint), reference.pose)
        twist = reference.twist + self._rate * missing
        weight = np.linalg.cholesky(np.linalg.inv(reference.covariance)).T
        A, b = np.vstack([weight @ J, self._rest]), np.concatenate([weight @ twist, np.zeros(len(low))])
        free = np.linalg.lstsq(A, b, rcond=None)[0]
        if ((free >= low) & (free <= high)).all():
            return free, "follows"
        wide = high + 1e-9  # the solver wants room between the bounds
        v = np.clip(lsq_linear(A, b, (low, wide), method="bvls").x, low, high)
        return v, "follows as far as the joints' limits allow"


def _usable(reference: PoseReference) -> bool:
    finite = all(np.isfinite(x).all() for x in (reference.pose, reference.twist, reference.covariance))
    return finite and is_positive_definite(reference.covariance)
