# SPDX-License-Identifier: Apache-2.0
"""`RobotModel`: a URDF and a robot file, and its kinematics and dynamics through Pinocchio.

As in Pinocchio the model is constant and the scratch memory is separate: `RobotModel` may be shared, every loop
makes its own `RobotData`. Joint vectors (nv,) are in the order of `joint_names`; messages are brought into
that order by name.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.robot.description import Endpoint, RobotDescription, RobotFileError
from tpgmm_core.robot.fit import check_inertia, check_mimics
from tpgmm_core.robot.urdf import read_urdf
from tpgmm_core.robot.urdf_tree import Mimic

# No joint of an arm has more (N m or N; rad/s or m/s): URDFs hold larger numbers where the limit was not known.
CREDIBLE_EFFORT = 1000.0
CREDIBLE_VELOCITY = 100.0
#: Units of joints that turn, and of those that slide.
UNITS = {
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "effort": ("N m", "N"),
    "inertia": ("kg m^2", "kg"),
}
AXES = pin.LOCAL_WORLD_ALIGNED


class RobotModel:
    """A robot with a fixed base and joints of one degree of freedom each (nq = nv); locked joints are not part of it.

    Parameters
    ----------
    description
        the robot file

    Attributes
    ----------
    pinocchio
        the Pinocchio model, with the limits of the robot file; do not change it
    joint_names, joint_units
        (nv,) names in model order, and "rad" or "m"
    base_frame
        name of the frame in whose axes poses, Jacobians and wrenches are expressed
    endpoints
        name -> Endpoint(frame, joints)
    joint_groups
        name -> joint names
    effort_limits, velocity_limits
        (nv,), N m and N; rad/s and m/s
    torque_rates
        (nv,), N m/s and N/s, largest changes of torques that the robot accepts; infinite where none is given
    lower_limits, upper_limits
        (nv,), rad and m; infinite for joints that may turn for ever
    viscous_friction, coulomb_friction
        (nv,), N m s/rad and N m (N s/m and N for prismatic joints)
    home
        (nv,) posture, rad and m
    mimics
        joint -> what it mimics; those that home does not name are not in the model, their mechanism determines where
        they are

    Raises
    ------
    RobotFileError
        where the robot file and the URDF do not fit each other
    """

    def __init__(self, description: RobotDescription) -> None:
        try:
            urdf = read_urdf(description.urdf, description.locked, description.home)
        except RobotFileError as error:
            raise RobotFileError(f"{description.path}: {error}") from error
        model = urdf.model
        self.pinocchio = model
        self.nv: int = model.nv
        self.joint_names: tuple[str, ...] = tuple(model.names[1:])
        self.joint_units = tuple("m" if "P" in joint.shortname() else "rad" for joint in model.joints.tolist()[1:])
        self._index = {name: i for i, name in enumerate(self.joint_names)}
        self.base_frame = description.base_frame
        self.endpoints: Mapping[str, Endpoint] = dict(description.endpoints)
        self.joint_groups: Mapping[str, tuple[str, ...]] = dict(description.joint_groups)
        self._orders: dict[tuple[str, ...], NDArray[np.intp]] = {}

        self.mimics: Mapping[str, Mimic] = urdf.tree.mimics
        check_mimics(description, urdf.tree)
        self._check_names(description)
        self.effort_limits = self._limits(description, "effort", model.effortLimit)
        self.velocity_limits = self._limits(description, "velocity", model.velocityLimit)
        endless = np.array([name in urdf.endless for name in self.joint_names], dtype=bool)
        self.lower_limits = self._limits(description, "lower", np.where(endless, -np.inf, model.lowerPositionLimit))
        self.upper_limits = self._limits(description, "upper", np.where(endless, np.inf, model.upperPositionLimit))
        self._endless = np.flatnonzero(np.isinf(self.upper_limits - self.lower_limits))
        self.torque_rates = self._limits(description, "torque_rate", np.full(model.nv, np.inf))
        self.viscous_friction = self._spread(model.damping, description.friction, "viscous")
        self.coulomb_friction = self._spread(model.friction, description.friction, "coulomb")
        model.armature = self._spread(model.armature, description.armature, "inertia")
        self.home = self.ordered(tuple(description.home), tuple(description.home.values()))
        self._check_values(description)
        check_inertia(description, model, self.home)
        model.effortLimit, model.velocityLimit = self.effort_limits, self.velocity_limits
        model.lowerPositionLimit, model.upperPositionLimit = self.lower_limits, self.upper_limits

        self.endpoint_frame_ids = {name: self.frame_id(end.frame) for name, end in self.endpoints.items()}
        base = model.frames[self.frame_id(self.base_frame)]
        if base.parentJoint != 0:
            raise RobotFileError(f"{description.path}: base_frame {self.base_frame!r} moves with a joint")
        self.world_to_base: pin.SE3 = base.placement.inverse()
        if description.gravity is not None:
            model.gravity.linear = base.placement.rotation @ np.array(description.gravity)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> RobotModel:
        """Read a robot file (see `tpgmm_core.robot.description`) and the URDF that it names.

        Parameters
        ----------
        path
            of the robot file

        Returns
        -------
        RobotModel
            with the limits of both files

        Raises
        ------
        RobotFileError
            for a file that cannot be used, with the reason
        """
        return cls(RobotDescription.from_file(path))

    def create_data(self) -> RobotData:
        """Scratch memory for one loop."""
        return RobotData(self)

    def unit(self, joint: str, quantity: str) -> str:
        """Unit of a quantity of a joint; it depends on whether the joint turns or slides.

        Parameters
        ----------
        joint
            its name
        quantity
            "position", "velocity", "effort" or "inertia"

        Returns
        -------
        str
            such as "rad" or "m"
        """
        is_prismatic = self.pinocchio.joints[self._index[joint] + 1].shortname().startswith("JointModelP")
        return UNITS[quantity][is_prismatic]

    def indices(self, joints: str | Sequence[str]) -> NDArray[np.intp]:
        """Indices in joint vectors of a group, or of joints by name.

        Parameters
        ----------
        joints
            a group of the robot file, or names of joints

        Returns
        -------
        NDArray[np.intp]
            in the order of the group, or of `joints`

        Raises
        ------
        ValueError
            for unknown names
        """
        names = self.joint_groups.get(joints, (joints,)) if isinstance(joints, str) else joints
        unknown = [name for name in names if name not in self._index]
        if unknown:
            known = f"joints {listed(self.joint_names, 40)} and groups {listed(self.joint_groups)}"
            raise ValueError(f"unknown joints {listed(unknown)}; known are {known}")
        return np.array([self._index[name] for name in names], dtype=np.intp)

    def frame_id(self, frame: str) -> int:
        """Pinocchio's index of a frame of the URDF, a link or else a joint.

        Parameters
        ----------
        frame
            its name

        Returns
        -------
        int
            the index

        Raises
        ------
        ValueError
            for an unknown name
        """
        if not self.pinocchio.existFrame(frame):
            bodies = [f.name for f in self.pinocchio.frames if f.type == pin.FrameType.BODY]
            raise ValueError(f"the URDF has no frame {shown(frame)}; its links are {listed(bodies, 60)}")
        # a link and a joint may have the same name
        link = self.pinocchio.existFrame(frame, pin.FrameType.BODY)
        return int(self.pinocchio.getFrameId(frame, *((pin.FrameType.BODY,) if link else ())))

    def ordered(self, names: Sequence[str], values: ArrayLike) -> Array:
        """Values (nv,) in model order from names and values in any order, as in a JointState.

        Parameters
        ----------
        names
            of all joints
        values
            one for each name

        Returns
        -------
        Array
            shape (nv,)

        Raises
        ------
        ValueError
            when a joint is missing, unknown or named twice, or the lengths differ
        """
        key = tuple(names)
        order = self._orders.get(key)
        if order is None:
            order = self._orders[key] = self._order(key)
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (self.nv,):
            raise ValueError(f"got {len(key)} joint names but values of shape {array.shape}")
        return array[order]

    def unwound(self, q: Array, near: Array) -> Array:
        """Positions with those of endless joints at the turn that is nearest to a reference.

        Many drivers wrap such angles to -pi..pi; control by differences of angles must not see the jump.

        Parameters
        ----------
        q
            shape (nv,), rad or m
        near
            shape (nv,), the reference

        Returns
        -------
        Array
            shape (nv,)
        """
        if len(self._endless) == 0:
            return q
        turns = np.round((near[self._endless] - q[self._endless]) / (2.0 * np.pi))
        q = q.copy()
        q[self._endless] += 2.0 * np.pi * turns
        return q

    def _order(self, names: tuple[str, ...]) -> NDArray[np.intp]:
        missing = [name for name in self.joint_names if name not in names]
        unknown = [name for name in names if name not in self._index]
        if missing or unknown or len(names) != self.nv:
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(
                f"joint names do not fit the robot: missing {listed(missing)}; unknown {listed(unknown)}; "
                f"twice {listed(twice)}"
            )
        return np.array([names.index(name) for name in self.joint_names], dtype=np.intp)

    def _check_names(self, description: RobotDescription) -> None:
        groups = [joint for joints in self.joint_groups.values() for joint in joints]
        for key, names in (
            ("joint_groups", groups),
            ("limits", list(description.limits)),
            ("friction", list(description.friction)),
            ("armature", list(description.armature)),
            ("home", list(description.home)),
        ):
            unknown = sorted({name for name in names if name not in self._index})
            if unknown:
                raise RobotFileError(
                    f"{description.path}: {key} names the unknown joints {listed(unknown)}; "
                    f"the URDF has {listed(self.joint_names, 40)}"
                )
        missing = [name for name in self.joint_names if name not in description.home]
        if missing:
            raise RobotFileError(
                f"{description.path}: home lacks the joints {listed(missing, 40)}; give their positions, or lock "
                f"those that are not commanded here: locked: {{{missing[0]}: POSITION}}"
            )
        frames = [self.base_frame, *(end.frame for end in self.endpoints.values())]
        absent = [frame for frame in frames if not self.pinocchio.existFrame(frame)]
        if absent:
            raise RobotFileError(f"{description.path}: the URDF {description.urdf.name} has no frames {listed(absent)}")

    def _spread(self, default: ArrayLike, entries: Mapping[str, Mapping[str, float]], word: str) -> Array:
        values = np.array(default, dtype=np.float64)
        for joint, entry in entries.items():
            values[self._index[joint]] = entry.get(word, values[self._index[joint]])
        return values

    def _limits(self, description: RobotDescription, word: str, urdf: ArrayLike) -> Array:
        values = self._spread(urdf, description.limits, word)
        if word in ("effort", "velocity"):
            bound = CREDIBLE_EFFORT if word == "effort" else CREDIBLE_VELOCITY
            for joint, value in zip(self.joint_names, values, strict=True):
                if not 0.0 < value <= bound:
                    raise RobotFileError(
                        f"{description.path}: {word} limit {value:g} of {joint!r} is not credible (expected "
                        f"above 0, up to {bound:g} {self.unit(joint, word)}); give the real one: limits: {{{joint}: "
                        f"{{{word}: ...}}}}, or take a joint that has no motor out of the model: locked: {{{joint}: "
                        f"POSITION}}{self._more_to_say(joint, word, values, bound)}"
                    )
        return values

    def _more_to_say(self, first: str, word: str, values: Array, bound: float) -> str:
        """Words about whether a joint mimics another, and about other joints with the same problem."""
        leader = ""
        if first in self.mimics:
            leader = f". It mimics {self.mimics[first].leader}: left out of home, it stands where its leader puts it"
        wrong = ~((values > 0.0) & (values <= bound))
        others = [joint for joint, bad in zip(self.joint_names, wrong, strict=True) if bad and joint != first]
        return leader + (f". So are the {word} limits of {listed(others, 40)}" if others else "")

    def _check_values(self, description: RobotDescription) -> None:
        for i, joint in enumerate(self.joint_names):
            lower, upper, home = self.lower_limits[i], self.upper_limits[i], self.home[i]
            if not lower < upper:
                raise RobotFileError(
                    f"{description.path}: {joint!r} may move from {lower:g} to {upper:g} "
                    f"{self.unit(joint, 'position')}, an empty range; give the "
                    f"real limits: limits: {{{joint}: {{lower: ..., upper: ...}}}}"
                )
            if not lower <= home <= upper:
                raise RobotFileError(
                    f"{description.path}: home of {joint!r} is {home:g}, outside {lower:g} to {upper:g} "
                    f"{self.unit(joint, 'position')}"
                )
            if not self.torque_rates[i] > 0.0:
                raise RobotFileError(
                    f"{description.path}: torque_rate of {joint!r} is {self.torque_rates[i]:g} N m/s; expected one "
                    "above 0, or none where the maker gives none"
                )
            if self.viscous_friction[i] < 0.0 or self.coulomb_friction[i] < 0.0:
                raise RobotFileError(f"{description.path}: friction of {joint!r} must not be negative")
            if self.pinocchio.armature[i] < 0.0:
                raise RobotFileError(f"{description.path}: armature of {joint!r} must not be negative")


class RobotData:
    """Kinematics and dynamics at one state; call `update` first. Not for two threads at once."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot = robot
        self._model = robot.pinocchio
        # Apart, since the dynamics algorithms overwrite velocities and accelerations of the kinematics
        self._data = self._model.createData()
        self._dynamics = self._model.createData()
        self._frame_ids = robot.endpoint_frame_ids
        self._zero = np.zeros(robot.nv)
        rotation = robot.world_to_base.rotation
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
        return pin.SE3ToXYZQUAT(self.robot.world_to_base.act(self._data.oMf[frame_id]))

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
