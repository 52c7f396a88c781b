# SPDX-License-Identifier: Apache-2.0
"""Whether parts of a robot meet: the collision geometry of its URDF, in convex hulls, by Pinocchio and Coal.

Meshes are read from installed packages alone: a robot file from elsewhere opens no files of its own choice. Parts that
touch at home, or belong to joints next to each other, always do, and are not looked at.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_core.robot.description import PACKAGE_SCHEME, RobotDescription
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.urdf_tree import UrdfTree, read_tree

CLOSE_M = 0.005
"""Parts that are nearer meet: hulls and models are not more exact."""


@dataclass(frozen=True, slots=True)
class Meeting:
    """Two links that come too close, at which row of the joints, and how far they are apart, m (negative: within)."""

    links: tuple[str, str]
    at: int
    distance: float


class SelfCollision:
    """The shapes of a robot.

    Parameters
    ----------
    robot
        as its robot file says
    robot_file
        that file: it names the URDF

    Attributes
    ----------
    problem
        why it cannot be known whether parts meet; else empty
    """

    def __init__(self, robot: RobotModel, robot_file: str | os.PathLike[str]) -> None:
        self._robot, self.problem = robot, ""
        self._geometry = pin.GeometryModel()
        try:
            tree = read_tree(RobotDescription.from_file(robot_file).urdf)
            self.problem = _problem(tree)
            if not self.problem:
                self._geometry = _shapes(robot, tree)
        except (ValueError, RuntimeError) as error:  # RuntimeError: what C++ throws
            self.problem = f"its shapes cannot be read: {one_line(error, 200)}"
        if not self.problem and not len(self._geometry.collisionPairs):
            self.problem = "its URDF has no shapes of links that could meet"

    def first(self, q: Array, stride: int = 1) -> Meeting | None:
        """The first meeting along joints.

        Parameters
        ----------
        q
            (T, nv)
        stride
            every so many rows are looked at, and the last one

        Returns
        -------
        Meeting | None
            None where no parts meet, and where that cannot be known
        """
        if self.problem:
            return None
        data, shapes = self._robot.pinocchio.createData(), self._geometry.createData()
        for i in sorted({*range(0, len(q), stride), len(q) - 1}):
            pin.computeDistances(self._robot.pinocchio, data, self._geometry, shapes, q[i])
            away = np.array([result.min_distance for result in shapes.distanceResults])
            k = int(np.argmin(away))
            if away[k] < CLOSE_M:
                return Meeting(self._links(k), i, float(away[k]))
        return None

    def _links(self, pair: int) -> tuple[str, str]:
        chosen = self._geometry.collisionPairs[pair]
        names = [
            self._robot.pinocchio.frames[self._geometry.geometryObjects[k].parentFrame].name
            for k in (chosen.first, chosen.second)
        ]
        return names[0], names[1]


def _shares() -> list[str]:
    """Folders that hold packages' data, as `resolve_urdf` knows them."""
    prefixes = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    places = [*(Path(entry, "cmeel.prefix", "share") for entry in sys.path), *(Path(p, "share") for p in prefixes)]
    return [str(place) for place in places if place.is_dir()]


def _problem(tree: UrdfTree) -> str:
    """Why the shapes of a URDF are not read; else empty."""
    for mesh in tree.root.iterfind("./link/collision/geometry/mesh"):
        name = mesh.get("filename") or ""
        path = Path(name.removeprefix(PACKAGE_SCHEME))
        if not name.startswith(PACKAGE_SCHEME) or path.is_absolute() or ".." in path.parts:
            return f"its URDF takes the mesh {one_line(name, 80)} from no installed package"
        if not any(Path(share, path).is_file() for share in _shares()):
            return f"the mesh {one_line(name, 80)} is not installed"
    return ""


def _shapes(robot: RobotModel, tree: UrdfTree) -> pin.GeometryModel:
    """Collision shapes as convex hulls, and the pairs of them that may meet."""
    model, xml = robot.pinocchio, ElementTree.tostring(tree.root, encoding="unicode")
    geometry = pin.buildGeomFromUrdfString(model, xml, pin.GeometryType.COLLISION, package_dirs=_shares())
    for shape in geometry.geometryObjects:
        if hasattr(shape.geometry, "buildConvexRepresentation"):
            shape.geometry.buildConvexRepresentation(True)
            shape.geometry = shape.geometry.convex
    parents = [shape.parentJoint for shape in geometry.geometryObjects]
    for i in range(len(parents)):
        for j in range(i + 1, len(parents)):
            a, b = parents[i], parents[j]
            if a != b and a != _moving_parent(model, b) and b != _moving_parent(model, a):
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    _without_touching(robot, geometry)
    return geometry


def _moving_parent(model: pin.Model, joint: int) -> int:
    return int(model.parents[joint])


def _without_touching(robot: RobotModel, geometry: pin.GeometryModel) -> None:
    """Leave out pairs that touch at home."""
    data, shapes = robot.pinocchio.createData(), geometry.createData()
    pin.computeDistances(robot.pinocchio, data, geometry, shapes, robot.home)
    touching = [k for k, result in enumerate(shapes.distanceResults) if result.min_distance < CLOSE_M]
    pairs = [(geometry.collisionPairs[k].first, geometry.collisionPairs[k].second) for k in touching]
    for one, other in pairs:  # not the pairs themselves, which move up when one is removed
        geometry.removeCollisionPair(pin.CollisionPair(one, other))
