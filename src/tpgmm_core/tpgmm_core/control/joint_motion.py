# SPDX-License-Identifier: Apache-2.0
"""`JointMotion`: positions and velocities of joints that follow aims, for robots that take positions, not torques.

Each step solves, for the velocities v of the joints,

    min  sum_i |S_i^-1 (x_i - J_i v)|^2 + |v - v_0|^2 / d^2    within bounds of v

where S_i S_i^T is the covariance of an aim, x_i its velocity and `tracking_rate` times what is missing, and d the
`joint_deviation`; v_0 is zero, or leads joints that the aims leave free to where they are measured. So what matters
little gives way where joints are at their limits, and among several aims: the least squares of the paper's products of
Gaussians, over velocities.

The bounds hold for any sequence of time steps: a velocity is one from which the joint can be brought to rest before
its position limit, with others that stop together with it, and within `max_acceleration` of the last one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import Lag
from tpgmm_core.control.motion_aims import Aim
from tpgmm_core.robot.model import RobotModel

#: A longer time step is a pause: joints go on as after this one, s.
MAX_STEP = 0.1
#: Joints may begin this far outside their position limits, as measured ones are; they only move inwards then.
OUTSIDE = 0.02
#: An aim is missed that is farther away than this many standard deviations, and than these, m and rad.
MISSED, MISSED_DISTANCE, MISSED_ANGLE = 3.0, 0.01, 0.05
#: Directions that aims move by so much less than others are free, 1.
SINGULAR = 1e-2
#: The velocity is at a bound that is nearer, rad/s (m/s).
AT_BOUND = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionConfig(Settings):
    """How joints move."""

    speed_share: float = setting(0.4, 0.01, 1.0, "Share of the joints' speed limits that is used, 1")
    max_acceleration: float = setting(5.0, 0.1, 200.0, "Largest acceleration of a joint, rad/s^2 (m/s^2)")
    tracking_rate: float = setting(4.0, 0.1, 50.0, "Rate at which the distance to the reference is reduced, 1/s")
    approach_speed: float = setting(
        0.25, 0.001, 5.0, "Largest speed at which a hand reduces this distance, along each axis of its covariance, m/s"
    )
    approach_turn: float = setting(1.0, 0.01, 20.0, "The same for rotations, rad/s")
    joint_deviation: float = setting(
        1.0,
        1e-3,
        1e3,
        "Speed of a joint that costs as much as missing the reference by one standard deviation per second, rad/s",
    )


@dataclass(frozen=True, slots=True)
class JointStep:
    """What joints do.

    Parameters
    ----------
    q, v
        (n,), positions and velocities of the joints that move
    lags
        how far each aim is away, for those that are missed
    limits
        which limits act, in words, such as "speed of elbow_joint"
    """

    q: Array
    v: Array
    lags: tuple[Lag, ...] = field(default=())
    limits: tuple[str, ...] = field(default=())

    @property
    def at_rest(self) -> bool:
        """Whether no joint moves."""
        return bool((np.abs(self.v) < AT_BOUND).all())


class JointMotion:
    """See the module. `q` and `v` are those of all joints, (nv,); only `joints` move by themselves.

    Parameters
    ----------
    robot
        with its limits
    joints
        places of those that move, in the order in which their positions are wanted
    config
        how they move

    Raises
    ------
    ValueError
        no joints, one named twice, or one without a speed limit
    """

    def __init__(
        self, robot: RobotModel, joints: Sequence[int] | NDArray[np.intp], config: MotionConfig | None = None
    ) -> None:
        self.robot, self.joints = robot, np.array(joints, dtype=np.intp)
        self.names = tuple(robot.joint_names[i] for i in self.joints)
        if not len(self.joints) or len(set(self.names)) != len(self.names):
            raise ValueError(f"expected joints that move, each once; got {listed(self.names, 40)}")
        endless = [name for name, limit in zip(self.names, self._limits(), strict=True) if not 0.0 < limit < np.inf]
        if endless:
            raise ValueError(f"joints without a speed limit: {listed(endless)}; add `limits` to the robot file")
        self._data = robot.create_data()
        self.configure(config or MotionConfig())
        self.q, self.v = robot.home.copy(), np.zeros(robot.nv)

    def configure(self, config: MotionConfig) -> None:
        """Use other parameters, also while it moves."""
        self.config = config
        self._fastest = config.speed_share * self._limits()
        # Joints stop together, in this time at most, by half of their velocity times it
        self._stop_time = 2.0 * float(self._fastest.max()) / config.max_acceleration

    def start(self, q: Array) -> None:
        """Begin at rest.

        Parameters
        ----------
        q
            (nv,), measured positions

        Raises
        ------
        ValueError
            they are not finite, have a wrong shape, or joints are outside their position limits
        """
        q = np.array(q, dtype=np.float64)
        if q.shape != (self.robot.nv,) or not np.isfinite(q).all():
            raise ValueError(f"measured positions are {q}; expected {self.robot.nv} finite numbers")
        here, lower, upper = q[self.joints], *self._range()
        out = (here < lower - OUTSIDE) | (here > upper + OUTSIDE)
        if out.any():
            at = ", ".join(
                f"{self.names[i]} at {here[i]:.3g} of {lower[i]:.3g} to {upper[i]:.3g}" for i in np.flatnonzero(out)
            )
            raise ValueError(f"measured positions are outside the joint limits: {at}; move the robot inside first")
        self.q, self.v = q, np.zeros(self.robot.nv)

    def step(self, aims: Sequence[Aim], dt: float, others: Array | None = None, by_pose: bool = False) -> JointStep:
        """Move on for a time step.

        Parameters
        ----------
        aims
            of end points or joints; with none the joints slow down and stay
        dt
            s, positive; of a longer one than `MAX_STEP` only that much counts
        others
            (nv,), measured positions, of which those of joints that do not move by themselves are used
        by_pose
            the robot chooses its joints: where the aims leave a choice, the measured ones are followed

        Returns
        -------
        JointStep
            positions, velocities, and what limits did

        Raises
        ------
        ValueError
            for a time step that is not positive
        """
        if not (np.isfinite(dt) and dt > 0.0):
            raise ValueError(f"the time step is {dt} s, expected more than 0; check that the clock runs")
        dt = min(dt, MAX_STEP)
        pull = np.zeros(len(self.joints))
        if others is not None:
            q = np.array(others, dtype=np.float64)
            if by_pose:
                pull = self.config.tracking_rate * (q - self.q)[self.joints]
            q[self.joints] = self.q[self.joints]
            self.q = q
        low, high = self._bounds(dt)
        wanted = self._wanted(aims, pull) if aims else None
        v = np.clip(np.zeros_like(low), low, high) if wanted is None else _least_squares(*wanted, low, high)
        limits = () if wanted is None else self._named(v, low, high, dt)
        self.q[self.joints] += dt * v
        self.v[:] = 0.0
        self.v[self.joints] = v
        return JointStep(self.q[self.joints], v, self._lags(aims), limits)

    def stop_point(self) -> tuple[Array, float]:
        """Where all joints come to rest together, (n,), and in what time, s; within the limits of positions."""
        v = self.v[self.joints]
        time = float(np.abs(v).max()) / self.config.max_acceleration
        return self.q[self.joints] + 0.5 * time * v, time

    def pose(self, endpoint: str) -> Array:
        """Pose (7,) of an end point, in base axes."""
        self._data.update(self.q, self.v)
        return self._data.pose(endpoint)

    def twist(self, endpoint: str) -> Array:
        """Velocity (6,) of an end point, in base axes: linear, then angular."""
        self._data.update(self.q, self.v)
        return self._data.twist(endpoint)

    # -- how a step works ---------------------------------------------------------------------------------------------

    def _limits(self) -> Array:
        return self.robot.velocity_limits[self.joints]

    def _range(self) -> tuple[Array, Array]:
        return self.robot.lower_limits[self.joints], self.robot.upper_limits[self.joints]

    def _bounds(self, dt: float) -> tuple[Array, Array]:
        """Bounds of the velocities.

        After a step of v the room to a limit is at least v T / 2, for T the longest time to stop. From there v less
        the largest change of a step leaves as much, since v <= a T / 2: the three intervals always have a velocity in
        common, however long the next step is.
        """
        here, v, (lower, upper) = self.q[self.joints], self.v[self.joints], self._range()
        change, time = self.config.max_acceleration * dt, dt + 0.5 * self._stop_time
        up = np.minimum(self._fastest, np.maximum(upper - here, 0.0) / time)
        down = -np.minimum(self._fastest, np.maximum(here - lower, 0.0) / time)
        # where the speed was lowered while it moved, it slows down as fast as it may
        return np.minimum(np.maximum(down, v - change), v + change), np.maximum(np.minimum(up, v + change), v - change)

    def _wanted(self, aims: Sequence[Aim], pull: Array) -> tuple[Array, Array]:
        """A and b of |A v - b|^2; `pull` (n,) is the velocity of the joints where the aims leave a choice."""
        config, n = self.config, len(self.joints)
        self._data.update(self.q)
        if pull.any():
            J = np.vstack([aim.jacobian(self._data, self.robot.nv)[:, self.joints] for aim in aims])
            pull = pull - np.linalg.pinv(J, rcond=SINGULAR) @ (J @ pull)
        blocks, rights = [np.eye(n) / config.joint_deviation], [pull / config.joint_deviation]
        for aim in aims:
            back = config.tracking_rate * aim.missing(self._data, self.q)
            if aim.endpoint:
                back[:3] = _cut(back[:3], aim.spread[:3], config.approach_speed)
                back[3:] = _cut(back[3:], aim.spread[3:], config.approach_turn)
            J = aim.jacobian(self._data, self.robot.nv)[:, self.joints]
            rows = np.linalg.solve(aim.spread, np.column_stack([J, aim.velocity + back]))
            blocks.append(rows[:, :-1])
            rights.append(rows[:, -1])
        return np.vstack(blocks), np.concatenate(rights)

    def _lags(self, aims: Sequence[Aim]) -> tuple[Lag, ...]:
        if not aims:
            return ()
        self._data.update(self.q)
        missed = []
        for aim in aims:
            missing = aim.missing(self._data, self.q)
            lag = aim.lag(missing, self.robot.joint_names)
            if np.linalg.norm(np.linalg.solve(aim.spread, missing)) > MISSED and (
                lag.distance > MISSED_DISTANCE or lag.angle > MISSED_ANGLE
            ):
                missed.append(lag)
        return tuple(missed)

    def _named(self, v: Array, low: Array, high: Array, dt: float) -> tuple[str, ...]:
        """The limits that velocities are at."""
        here, (lower, upper) = self.q[self.joints], self._range()
        named = []
        for i in np.flatnonzero((v <= low + AT_BOUND) | (v >= high - AT_BOUND)):
            room = upper[i] - here[i] if v[i] >= high[i] - AT_BOUND else here[i] - lower[i]
            if room < self._fastest[i] * (dt + 0.5 * self._stop_time):
                what = "position"
            else:
                what = "speed" if abs(v[i]) > self._fastest[i] - AT_BOUND else "acceleration"
            named.append(f"{what} of {self.names[i]}")
        return tuple(named)


def _cut(x: Array, spread: Array, largest: float) -> Array:
    """A vector cut to a length along each axis of the covariance, so that what matters little slows nothing else."""
    axes = np.linalg.eigh(spread @ spread.T)[1]
    return axes @ np.clip(axes.T @ x, -largest, largest)


def _least_squares(A: Array, b: Array, low: Array, high: Array) -> Array:
    free: Array = np.linalg.lstsq(A, b, rcond=None)[0]
    if ((free >= low) & (free <= high)).all():
        return free
    # the solver wants room between the bounds
    solved: Array = lsq_linear(A, b, (low, np.maximum(high, low + 1e-9)), method="bvls").x
    return np.clip(solved, low, high)
