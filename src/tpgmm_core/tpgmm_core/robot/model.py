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
from tpgmm_core.robot.data import RobotData
from tpgmm_core.robot.description import Endpoint, RobotDescription, RobotFileError
from tpgmm_core.robot.fit import check_inertia, check_mimics
from tpgmm_core.robot.joint_values import JointValues, unit_of
from tpgmm_core.robot.urdf import read_urdf
from tpgmm_core.robot.urdf_tree import Mimic


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
    urdf
        path of the URDF
    links
        names of its links
    link_parents
        link -> the link that it stands on, and whether the joint between them is fixed; not of the root
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
        self.urdf = description.urdf
        self.links = tuple(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY)
        self.link_parents: Mapping[str, tuple[str, bool]] = {
            link: (parent, urdf.tree.joints[joint].get("type") == "fixed")
            for link, (joint, parent) in urdf.tree.parents.items()
        }
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
        joints = JointValues(description, model, self.mimics)
        joints.check_names()
        self.effort_limits = joints.limits("effort", model.effortLimit)
        self.velocity_limits = joints.limits("velocity", model.velocityLimit)
        endless = np.array([name in urdf.endless for name in self.joint_names], dtype=bool)
        self.lower_limits = joints.limits("lower", np.where(endless, -np.inf, model.lowerPositionLimit))
        self.upper_limits = joints.limits("upper", np.where(endless, np.inf, model.upperPositionLimit))
        self._endless = np.flatnonzero(np.isinf(self.upper_limits - self.lower_limits))
        self.torque_rates = joints.limits("torque_rate", np.full(model.nv, np.inf))
        self.viscous_friction = joints.spread(model.damping, description.friction, "viscous")
        self.coulomb_friction = joints.spread(model.friction, description.friction, "coulomb")
        model.armature = joints.spread(model.armature, description.armature, "inertia")
        self.home = self.ordered(tuple(description.home), tuple(description.home.values()))
        joints.check_ranges(self.lower_limits, self.upper_limits, self.home, self.torque_rates)
        joints.check_not_negative("friction", self.viscous_friction, self.coulomb_friction)
        joints.check_not_negative("armature", model.armature)
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
        return RobotData(self.pinocchio, self.endpoint_frame_ids, self.world_to_base)

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
        return unit_of(self.pinocchio, self._index[joint], quantity)

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

    def joints_above(self, frame: str) -> tuple[str, ...]:
        """Names of the joints that move a frame of the URDF, from the base on. Raises ValueError for an unknown one."""
        model = self.pinocchio
        return tuple(model.names[i] for i in model.supports[model.frames[self.frame_id(frame)].parentJoint] if i)

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
