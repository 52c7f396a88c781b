# SPDX-License-Identifier: Apache-2.0
"""The contracts of interfaces of robots: what breaks them, in words, each as "kind: details"."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions

#: Where joints are told to be may be this far from where the last trajectory led, rad.
JUMP = 0.05
#: The same of a hand, m and rad, and how fast it may go on, m/s and rad/s.
HAND_JUMP, HAND_SPEED = (0.005, 0.05), (0.5, 2.0)
#: Stiffnesses that crisp_controllers takes are at most this, N/m and N m/rad.
MAX_STIFFNESS = 5000.0
#: Stamps may be this far from the robot's clock, s.
CLOCK = 0.2


def broken_by_trajectory(robot: RobotModel, order: Sequence[str], message: JointTrajectory, here: Array) -> list[str]:
    """What a joint_trajectory_controller would refuse, and what no robot should be told.

    `order` are the joints of the controller; `here` (n,) is where it is told to be at this time.
    """
    n, joints, found = len(order), robot.indices(order), []
    if list(message.joint_names) != list(order):
        return [f"joints: {list(message.joint_names)}, not {list(order)}"]
    if message.header.stamp.sec or message.header.stamp.nanosec:
        found.append("stamp: of another time than now")
    if not message.points or any(len(p.positions) != n or len(p.velocities) != n for p in message.points):
        return [*found, "points: without positions and velocities of all joints"]
    q, v = (np.array([getattr(p, name) for p in message.points]) for name in ("positions", "velocities"))
    times = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])
    if not (np.diff(times, prepend=0.0) > 0.0).all():
        found.append(f"times: do not increase: {times}")
    if v[-1].any():
        found.append(f"end: it moves: {v[-1]}")
    if (q < robot.lower_limits[joints]).any() or (q > robot.upper_limits[joints]).any():
        found.append(f"positions: outside the limits: {q}")
    if (np.abs(v) > robot.velocity_limits[joints]).any():
        found.append(f"velocities: above the limits: {v}")
    if np.abs(q[0] - here).max() > JUMP + float((np.abs(v[0]) * times[0]).max()):
        found.append(f"jump: from {json.dumps(here.tolist())} to {json.dumps(q[0].tolist())}")
    return found


def broken_by_target(message: PoseStamped, frame: str, last: Array, now_ns: int, since: float) -> list[str]:
    """What a Cartesian controller with crisp's topics should not be told.

    `frame` is the base of the controller, `last` (7,) its last target, `since` s ago, or, before the first, where the
    hand is.
    """
    found, pose = [], conversions.pose_to_array(message.pose)
    if message.header.frame_id != frame:
        found.append(f"frame: {message.header.frame_id!r}, not {frame!r}")
    if abs(age := 1e-9 * (now_ns - conversions.time_to_ns(message.header.stamp))) > CLOCK:
        found.append(f"stamp: {age:.3f} s old")
    if not np.isfinite(pose).all() or abs(np.linalg.norm(pose[3:]) - 1.0) > 1e-6:
        return [*found, f"pose: no position with a unit quaternion: {pose}"]
    way, turn = pose_error(pose, last)
    possible = np.array(HAND_JUMP) + since * np.array(HAND_SPEED)
    if way > possible[0] or turn > possible[1]:
        found.append(f"jump: {1e3 * way:.0f} mm and {np.degrees(turn):.0f} deg from the target before")
    return found


def broken_by_stiffness(message: Float64MultiArray) -> list[str]:
    """What is no stiffness of a hand."""
    values = np.array(message.data)
    if values.shape != (6,) or not np.isfinite(values).all():
        return [f"stiffness: {len(values)} numbers {values}, not six"]
    if (values < 0.0).any() or (values > MAX_STIFFNESS).any():
        return [f"stiffness: outside 0 to {MAX_STIFFNESS:g}: {values}"]
    return []


def broken_by_torques(
    robot: RobotModel, stamps_ns: Nanoseconds, torques: Array, silence: float, period: float
) -> list[str]:
    """What a robot that takes torques would stop for.

    Of the states that `torques` (T, nv) answer with `stamps_ns` (T,): limits, how fast a torque changes where the robot
    says how fast it may, and pauses longer than `silence`, s. A robot judges changes by its own `period`, s, wherever
    the stamps of its states lie.
    """
    found = []
    if not np.isfinite(torques).all():
        found.append("torques: not finite")
    above = (np.abs(torques) > robot.effort_limits + 1e-9).any(axis=1)
    found += [f"effort: {tau} above {robot.effort_limits}" for tau in torques[above]]
    # Of a state that is answered again, by a newer reference, the robot applies the last answer
    last = np.diff(stamps_ns, append=np.iinfo(np.int64).max) > 0
    stamps_ns, torques = stamps_ns[last], torques[last]
    time = 1e-9 * np.diff(stamps_ns)
    change = np.abs(np.diff(torques, axis=0))
    # of states that were lost on the way, one answers for all: limits hold between those that it knows
    too_fast = (change > robot.torque_rates * np.maximum(time, period)[:, None] + 1e-6).any(axis=1)
    found += [f"rate: {c} N m in {1e3 * t:.1f} ms" for c, t in zip(change[too_fast], time[too_fast], strict=True)]
    found += [f"silence: {1e3 * t:.0f} ms without torques" for t in time[time > silence]]
    return found
