# SPDX-License-Identifier: Apache-2.0
"""What is suspicious in a robot file, although it can be used; and the workspace of the robot's end points."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.control.impedance import ImpedanceConfig
from tpgmm_core.robot.bodies import bodies
from tpgmm_core.robot.model import RobotModel

#: A home nearer to a position limit than this share of the range is too close to hold the robot there.
NEAR_LIMIT = 0.03
#: Share of a joint's effort that may be needed to carry the robot at home: the rest is for motion.
MUCH_EFFORT = 0.7
#: Smallest singular value of an end point's Jacobian with which it moves freely, m; turns count by a length.
HARDLY = 0.03
#: Gravity differs by less from place to place, m/s^2.
ON_EARTH = 0.05
#: Largest error that friction alone may cause, rad or m.
STUCK = 0.1
#: No joint of an arm is more than two turns from its zero, rad.
MOST_TURN = 4.0 * np.pi
#: Square root of inertia over mass of the largest bodies of arms, m; kg mm^2 and g mm^2 are far beyond.
LARGEST_GYRATION = 3.0
#: No end point is farther from the base than this, m.
FARTHEST_M = 20.0


def workspace(robot: RobotModel, endpoint: str, postures: int = 3000, random_state: int = 0) -> Array:
    """Box around the positions that an end point has in random postures.

    The joints of the end point's group take postures within their limits, the others are at home.

    Parameters
    ----------
    robot
        the robot
    endpoint
        a name of the robot file
    postures
        number of random postures
    random_state
        seed

    Returns
    -------
    Array
        its corners (2, 3), m, in the base frame
    """
    rng, data, q = np.random.default_rng(random_state), robot.create_data(), robot.home.copy()
    joints = robot.indices(robot.endpoints[endpoint].joints)
    lower, upper = robot.lower_limits[joints], robot.upper_limits[joints]
    # an endless joint has been everywhere after one turn
    lower, upper = np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)
    positions = np.empty((postures, 3))
    for i in range(postures):
        q[joints] = rng.uniform(lower, upper)
        data.update(q)
        positions[i] = data.pose(endpoint)[:3]
    return np.array([positions.min(axis=0), positions.max(axis=0)])


def suspicions(robot: RobotModel) -> list[str]:
    """What the author of a robot file should check, in words; empty when nothing is suspicious."""
    return [*_of_joints(robot), *_of_bodies(robot), *_of_groups(robot), *_of_endpoints(robot), *_of_base(robot)]


def _of_joints(robot: RobotModel) -> Iterator[str]:
    data, home = robot.create_data(), robot.home
    carried = np.abs(data.gravity(home)) / robot.effort_limits
    felt = 1.0 / np.diag(np.linalg.inv(data.mass_matrix(home)))
    stuck = robot.coulomb_friction / (felt * ImpedanceConfig().max_stiffness)
    for i, joint in enumerate(robot.joint_names):
        room = min(home[i] - robot.lower_limits[i], robot.upper_limits[i] - home[i])
        if room < NEAR_LIMIT * (robot.upper_limits[i] - robot.lower_limits[i]):
            unit = robot.unit(joint, "position")
            yield f"home of {joint} is {room:.3g} {unit} from its limit; choose one farther from the limits"
        if robot.unit(joint, "position") == "rad" and _is_many_turns(robot.lower_limits[i], robot.upper_limits[i]):
            yield (
                f"{joint} may move from {robot.lower_limits[i]:.4g} to {robot.upper_limits[i]:.4g} rad, which is many "
                "turns: are the limits in degrees?"
            )
        if carried[i] > MUCH_EFFORT:
            yield f"{joint} needs {carried[i]:.0%} of its effort limit to hold the robot at home; check the masses"
        if stuck[i] > STUCK:
            yield (
                f"{joint} moves so little ({felt[i]:.2g} {robot.unit(joint, 'inertia')}) that its friction holds an "
                f"error of {stuck[i]:.2g} {robot.unit(joint, 'position')}: "
                f"give the inertia of its motor, as the joint feels it: armature: {{{joint}: {{inertia: ...}}}}"
            )
    without = [joint for joint, friction in zip(robot.joint_names, robot.coulomb_friction, strict=True) if not friction]
    if without:
        yield (
            f"no friction is given for {listed(without, 40)}: a movement that works in the simulator may get stuck "
            "on the robot"
        )


def _is_many_turns(lower: float, upper: float) -> bool:
    finite = [abs(limit) for limit in (lower, upper) if np.isfinite(limit)]
    return max(finite, default=0.0) > MOST_TURN


def _of_bodies(robot: RobotModel) -> Iterator[str]:
    for body in bodies(robot.pinocchio):
        if body.is_a_point:
            yield f"{body}: too small for a mass of {body.mass:.3g} kg; correct <inertia> in the URDF"
        elif float(body.principal[2]) > LARGEST_GYRATION**2 * body.mass:
            yield f"{body}: too large for a mass of {body.mass:.3g} kg; is <inertia> in kg m^2?"
        elif not body.has_the_shape_of_a_body:
            yield f"{body}, one of which is larger than the sum of the others, which is impossible; correct <inertia>"
    moved = {joint for joints in robot.joint_groups.values() for joint in joints}
    for name, mimic in robot.mimics.items():
        if mimic.leader in moved and name not in robot.joint_names:
            yield f"{name} mimics {mimic.leader}, but is not simulated: it stays at its home position"


def _of_groups(robot: RobotModel) -> Iterator[str]:
    grouped = {joint for joints in robot.joint_groups.values() for joint in joints}
    if others := [joint for joint in robot.joint_names if joint not in grouped]:
        yield (
            f"{listed(others, 40)}: in no joint group, so they are held at their positions; if something else drives "
            "them, lock them (locked: ...)"
        )


def _of_endpoints(robot: RobotModel) -> Iterator[str]:
    data, length = robot.create_data(), ImpedanceConfig().characteristic_length
    data.update(robot.home)
    for name, end in robot.endpoints.items():
        group = robot.joint_groups[end.joints]
        frame = robot.pinocchio.frames[robot.endpoint_frame_ids[name]]
        movers = [robot.joint_names[i - 1] for i in robot.pinocchio.supports[frame.parentJoint] if i > 0]
        if idle := [joint for joint in group if joint not in movers]:
            yield f"end point {name}: its group has joints that do not move it: {listed(idle)}"
        if foreign := [joint for joint in movers if joint not in group]:
            yield (
                f"end point {name}: it is also moved by {listed(foreign)}, which are outside its group and are held "
                "still"
            )
        if (away := float(np.linalg.norm(data.pose(name)[:3]))) > FARTHEST_M:
            yield f"end point {name}: at home it is {away:.4g} m from the base; are the lengths in the URDF in m?"
        if len(group) < 6:
            yield f"end point {name}: {len(group)} joints cannot reach every pose; 6 or more can"
            continue
        J = data.jacobian(name)[:, robot.indices(end.joints)] * np.repeat([1.0, length], 3)[:, None]
        least = np.linalg.svd(J, compute_uv=False)[-1]
        if least < HARDLY:
            yield (
                f"end point {name}: at home it is close to a singularity ({least:.2g} m/rad); choose a home with a "
                "bent arm"
            )


def _of_base(robot: RobotModel) -> Iterator[str]:
    gravity = robot.world_to_base.rotation @ robot.pinocchio.gravity.linear
    if np.allclose(gravity, [0.0, 0.0, -9.81], atol=ON_EARTH):
        return
    x, y, z = gravity
    size = float(np.linalg.norm(gravity))
    if abs(size - 9.81) > ON_EARTH:
        yield (
            f"gravity is {size:.4g} m/s^2, and 9.81 on Earth: the torques that hold the robot will be wrong by that; "
            "is it in another unit?"
        )
    if np.hypot(x, y) > ON_EARTH or z > 0.0:
        yield (
            f"gravity is {x:.2f}, {y:.2f}, {z:.2f} m/s^2 in the base frame, not along -z; check that the robot is "
            "mounted like this"
        )
