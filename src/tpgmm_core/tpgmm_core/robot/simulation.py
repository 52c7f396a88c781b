# SPDX-License-Identifier: Apache-2.0
"""`RobotSimulator`: forward dynamics with friction, limits and external wrenches.

One step solves `(M + dt D + dt^2 K) a = tau - nle - D v - K (p + dt v)` with Pinocchio's articulated-body
algorithm, where the diagonals D and K of dampers and springs enter as armature. That is implicit Euler in
friction, joint stops and speed limits, hence stable for the lightest finger and the hardest stop, and
Euler-Cromer in the rest. The same input gives the same result to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel

# Coulomb friction f_c sgn(v) is taken as f_c v / (|v| + v_s): below this speed (rad/s or m/s) a joint creeps
# where a real one would stick.
STICTION_SPEED = 5e-3
# A joint that presses on its stop with its full effort goes this far beyond it (rad or m) ...
STOP_DEPTH = 1e-3
# ... and comes to rest there about as fast as this time constant (s).
STOP_TIME = 0.01
# Full effort overcomes the speed limit of the drive by this share.
SPEED_OVERSHOOT = 0.02
# Contacts change which limits are touched; the set of touched limits settles in one or two rounds.
MAX_LIMIT_ROUNDS = 4

NO_WRENCHES: Mapping[str, ArrayLike] = {}


@dataclass(frozen=True, slots=True)
class RobotState:
    """State of the simulated robot, joints in model order.

    Parameters
    ----------
    time
        s since the start
    q, v
        (nv,), rad and rad/s (m and m/s for prismatic joints)
    tau
        (nv,), the torque that the motors applied in the last step, N m (N)
    clamped
        whether the commanded torque exceeded an effort limit in the last step
    """

    time: float
    q: Array
    v: Array
    tau: Array
    clamped: bool


class RobotSimulator:
    """A robot that obeys joint torques and external wrenches; time advances only by `step`. It starts at rest.

    Parameters
    ----------
    robot
        to be simulated
    time_step
        s
    q0
        (nv,), posture at the start; None: the robot's home

    Raises
    ------
    ValueError
        for a time step outside (0, 0.01] or a q0 that is not finite or outside the limits
    """

    def __init__(self, robot: RobotModel, time_step: float = 0.001, q0: ArrayLike | None = None) -> None:
        if not 0.0 < time_step <= 0.01:
            raise ValueError(f"time_step must be above 0 and at most 0.01 s, got {time_step}")
        self.robot = robot
        self.time_step = float(time_step)
        self._model = pin.Model(robot.pinocchio)  # a copy, since its armature changes at every step
        self._armature = self._model.armature  # a view into the copy
        self._dynamics = self._model.createData()
        self._kinematics = robot.create_data()
        self._rotor_inertia = robot.pinocchio.armature.copy()
        self._stop_stiffness = robot.effort_limits / STOP_DEPTH
        self._stop_damping = self._stop_stiffness * STOP_TIME
        self._speed_damping = robot.effort_limits / (SPEED_OVERSHOOT * robot.velocity_limits)
        self._nowhere = np.zeros(robot.nv)
        self._frame_ids: dict[str, int] = {}
        self.reset(q0)

    def reset(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> RobotState:
        """Go back to time zero.

        Parameters
        ----------
        q
            shape (nv,), rad or m; home if not given
        v
            shape (nv,), rad/s or m/s; zero if not given

        Returns
        -------
        RobotState
            the state then

        Raises
        ------
        ValueError
            for wrong shapes, and positions outside the limits
        """
        zero = np.zeros(self.robot.nv)
        q = self._checked(self.robot.home if q is None else q, "q")
        v = self._checked(zero if v is None else v, "v")
        outside = (q < self.robot.lower_limits) | (q > self.robot.upper_limits)
        if outside.any():
            names = [self.robot.joint_names[i] for i in np.flatnonzero(outside)]
            raise ValueError(f"q is outside the position limits of {names}: {q[outside]}")
        self.state = RobotState(0.0, q.copy(), v.copy(), zero, False)
        return self.state

    def step(self, tau: ArrayLike, wrenches: Mapping[str, ArrayLike] = NO_WRENCHES) -> RobotState:
        """Advance by one time step and return the new state.

        Torques beyond the effort limits are clamped, and the state says so.

        Parameters
        ----------
        tau
            (nv,), commanded torque
        wrenches
            frame of the URDF -> (6,), force in N at the frame's origin and torque in N m, in base axes

        Returns
        -------
        RobotState
            after the step

        Raises
        ------
        ValueError
            for wrong shapes, values that are not finite and unknown frames; the state then stays as it was
        """
        robot, q, v, dt = self.robot, self.state.q, self.state.v, self.time_step
        command = self._checked(tau, "tau")
        applied = np.minimum(np.maximum(command, -robot.effort_limits), robot.effort_limits)
        force = applied + self._generalised(wrenches) if wrenches else applied
        friction = robot.viscous_friction + robot.coulomb_friction / (np.abs(v) + STICTION_SPEED)
        acceleration = self._solve(friction, 0.0, force)
        v_new = v + dt * acceleration
        v_new = self._within_limits(q, v, v_new, friction, force)
        self.state = RobotState(self.state.time + dt, q + dt * v_new, v_new, applied, bool((applied != command).any()))
        return self.state

    def _solve(self, damping: Array, stiffness: Array | float, force: Array) -> Array:
        """Acceleration (nv,) under `force - (damping + dt stiffness) v_new`."""
        q, v, dt = self.state.q, self.state.v, self.time_step
        resistance = damping + dt * stiffness
        self._armature[:] = self._rotor_inertia + dt * resistance
        return pin.aba(self._model, self._dynamics, q, v, force - resistance * v)

    def _within_limits(self, q: Array, v: Array, v_new: Array, friction: Array, force: Array) -> Array:
        """Velocity (nv,) after the step, with the stops and speed limits that v_new would violate."""
        robot, dt = self.robot, self.time_step
        lower, upper, fastest = robot.lower_limits, robot.upper_limits, robot.velocity_limits
        # +1 or -1: the stop that is touched, and the direction in which the speed limit is
        touched = racing = self._nowhere
        for _ in range(MAX_LIMIT_ROUNDS):
            q_new = q + dt * v_new
            side = np.where(touched, touched, np.subtract(q_new > upper, q_new < lower, dtype=float))
            direction = np.where(racing, racing, np.subtract(v_new > fastest, v_new < -fastest, dtype=float))
            if np.array_equal(side, touched) and np.array_equal(direction, racing):
                break
            touched, racing = side, direction
            # a stop brakes a joint that comes, it does not hold one that leaves
            brake = np.where(touched * v_new > 0.0, self._stop_damping, 0.0)
            stiffness = np.where(touched, self._stop_stiffness, 0.0)
            # a joint that touches nothing may have no stops
            depth = np.where(touched, q - np.where(touched > 0.0, upper, lower), 0.0)
            drag = np.where(racing, self._speed_damping, 0.0)
            limiting = drag * racing * fastest - stiffness * depth
            v_new = v + dt * self._solve(friction + brake + drag, stiffness, force + limiting)
        return v_new

    def _generalised(self, wrenches: Mapping[str, ArrayLike]) -> Array:
        """Joint torques J^T F (nv,) of wrenches at frames."""
        self._kinematics.update(self.state.q)
        force = np.zeros(self.robot.nv)
        for frame, wrench in wrenches.items():
            values = self._checked(wrench, f"the wrench at {frame!r}", 6)
            force += self._kinematics.frame_jacobian(self._frame_id(frame)).T @ values
        return force

    def _frame_id(self, frame: str) -> int:
        if frame not in self._frame_ids:
            self._frame_ids[frame] = self.robot.frame_id(frame)
        return self._frame_ids[frame]

    def _checked(self, values: ArrayLike, name: str, length: int | None = None) -> Array:
        length = self.robot.nv if length is None else length
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (length,):
            raise ValueError(f"{name} has shape {array.shape}, expected ({length},)")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} has values that are not finite: {array}")
        return array
