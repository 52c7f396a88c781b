# SPDX-License-Identifier: Apache-2.0
"""Whether a robot file and the mechanisms and masses of its URDF fit each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.robot.bodies import bodies
from tpgmm_core.robot.description import RobotDescription, RobotFileError
from tpgmm_core.robot.urdf_tree import UrdfTree

#: A joint that moves less than this (kg m^2 or kg) moves nothing, and its acceleration is meaningless.
LEAST_INERTIA = 1e-9


def check_mimics(description: RobotDescription, tree: UrdfTree) -> None:
    """Check that the robot file does not use joints that mimic others as if they had motors.

    Nobody commands such joints, which is wrong where they move an end point together with their leader.

    Raises
    ------
    RobotFileError
        for the first use of one
    """
    for name, end in description.endpoints.items():
        above = [joint for joint in tree.joints_above(end.frame) if not _is_held(joint, tree, description.locked)]
        for joint in [*description.joint_groups[end.joints], *above]:
            if joint in tree.mimics:
                raise RobotFileError(
                    f"{description.path}: the end point {shown(name)} is moved by {shown(joint)}, which has no motor "
                    f"but mimics {shown(tree.mimics[joint].leader)}; such joints are not supported in an arm"
                )
    groups = [joint for joints in description.joint_groups.values() for joint in joints]
    for key in ("joint_groups", "limits", "friction", "armature"):
        names = groups if key == "joint_groups" else getattr(description, key)
        if mimics := [joint for joint in names if joint in tree.mimics and joint not in description.home]:
            raise RobotFileError(
                f"{description.path}: {key} names {listed(mimics)}, which has no motor but mimics "
                f"{shown(tree.mimics[mimics[0]].leader)}: leave it out (it then follows that joint), or name it in "
                "home too"
            )


def _is_held(joint: str, tree: UrdfTree, locked: Mapping[str, float]) -> bool:
    """Whether a joint stands still, by the robot file or since it mimics one that does."""
    while joint not in locked and joint in tree.mimics:
        joint = tree.mimics[joint].leader
    return joint in locked or tree.joints[joint].get("type") == "fixed"


def check_inertia(description: RobotDescription, model: pin.Model, home: Array) -> None:
    """Check the bodies of a robot.

    Raises
    ------
    RobotFileError
        for bodies that are not possible, and for joints of which no torque can be computed
    """
    urdf, parts = description.urdf.name, list(bodies(model))
    for body in parts:
        if not body.is_possible:
            raise RobotFileError(
                f"{description.path}: {body}, none of which can be negative; correct <inertia> of these links in {urdf}"
            )
    inertia = np.diag(pin.crba(model, model.createData(), home))
    weightless = [body for body, value in zip(parts, inertia, strict=True) if value < LEAST_INERTIA]
    if not weightless:
        return
    names = listed(body.joint for body in weightless)
    points = [body for body in weightless if body.is_a_point]
    if points:
        raise RobotFileError(
            f"{description.path}: the joints {names} move no inertia: {listed(points[0].links, 4)} has a mass of "
            f"{points[0].mass:g} kg, but an <inertia> of zeros; correct it in {urdf}, or give the inertia of the "
            "motor: "
            f"armature: {{{points[0].joint}: {{inertia: ...}}}}"
        )
    raise RobotFileError(
        f"{description.path}: the joints {names} move no mass, so no torque can be computed; add <inertial> elements "
        "to "
        f"{urdf}"
    )
