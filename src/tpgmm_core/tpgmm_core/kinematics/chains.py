# SPDX-License-Identifier: Apache-2.0
"""`Kinematics`: what frames need of a robot, and planar robots. `kinematics.urdf` serves any URDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array


class Kinematics(Protocol):
    """Positions or poses of named points of a robot, and how the joints move them."""

    @property
    def n_joints(self) -> int:
        """Length n of configurations q, rad or m."""

    @property
    def points(self) -> Sequence[str]:
        """Names of the points."""

    def update(self, q: Array) -> None:
        """Move the robot to the configuration q (n,)."""

    def place(self, point: str) -> Array:
        """Position (2,) in the plane, m; or pose (7,) in space [x, y, z, qx, qy, qz, qw]."""

    def jacobian(self, point: str) -> Array:
        """Jacobian of a point: (2, n) in the plane; (6, n) in space, linear, then angular about the fixed axes."""


class PlanarRobot:
    """Links that turn in a plane, as a tree: every joint turns all that follows it.

    Parameters
    ----------
    lengths
        (n,) of the links, m; joint i turns link i
    points
        name → the joints from the base to that point, in order
    base_angle
        direction of the first link at q = 0, rad; about the axis out of the plane, zero along x

    Raises
    ------
    ValueError
        for lengths that are not positive, and points without joints, or with unknown ones
    """

    def __init__(self, lengths: Sequence[float], points: Mapping[str, Sequence[int]], base_angle: float = 0.0) -> None:
        self.lengths: Array = np.array(lengths, dtype=float)
        n = len(self.lengths)
        if self.lengths.ndim != 1 or n == 0 or not np.all(np.isfinite(self.lengths) & (self.lengths > 0.0)):
            raise ValueError(f"a planar robot has links of positive length, got {lengths!r}")
        self._chains: dict[str, NDArray[np.intp]] = {}
        for name, joints in points.items():
            if not joints or not all(0 <= j < n for j in joints) or len(set(joints)) != len(joints):
                raise ValueError(f"point {name!r} lies behind some of the joints 0 to {n - 1}, got {list(joints)}")
            self._chains[name] = np.array(joints, dtype=np.intp)
        self.base_angle = base_angle
        self.update(np.zeros(n))

    @property
    def n_joints(self) -> int:
        """Number of links, each with its joint."""
        return len(self.lengths)

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the points, as given."""
        return tuple(self._chains)

    def update(self, q: Array) -> None:
        """Move to a configuration.

        Parameters
        ----------
        q
            shape (n,), rad

        Raises
        ------
        ValueError
            for another shape
        """
        self._q = np.array(q, dtype=float)
        if self._q.shape != self.lengths.shape:
            raise ValueError(f"the robot has {self.n_joints} joints, got q of shape {self._q.shape}")

    def way_to(self, point: str) -> Array:
        """Positions (m + 1, 2) from the base to the point, one at the end of each link, for drawing."""
        return np.concatenate([np.zeros((1, 2)), np.cumsum(self._links(self._chain(point)), axis=0)])

    def place(self, point: str) -> Array:
        """Position (2,) of a point, m."""
        return np.asarray(self._links(self._chain(point)).sum(axis=0))

    def jacobian(self, point: str) -> Array:
        """Jacobian (2, n) of a point, m/rad; zero for joints that do not move it."""
        chain = self._chain(point)
        # a joint turns its own link and those that follow: the way from the joint to the point, turned by 90 degrees
        ways = np.cumsum(self._links(chain)[::-1], axis=0)[::-1]
        J = np.zeros((2, self.n_joints))
        J[0, chain], J[1, chain] = -ways[:, 1], ways[:, 0]
        return J

    def _links(self, chain: NDArray[np.intp]) -> Array:
        angles = self.base_angle + np.cumsum(self._q[chain])
        return self.lengths[chain, None] * np.column_stack([np.cos(angles), np.sin(angles)])

    def _chain(self, point: str) -> NDArray[np.intp]:
        if point not in self._chains:
            raise ValueError(f"unknown point {point!r}; the robot has {list(self._chains)}")
        return self._chains[point]


def planar_arm(lengths: Sequence[float]) -> PlanarRobot:
    """Make one arm; its points are "hand", and "joint1", ... at the ends of the other links."""
    n = len(lengths)
    inner = {f"joint{i}": range(i) for i in range(1, n)}
    return PlanarRobot(lengths, {**inner, "hand": range(n)})


def planar_bimanual(torso: float = 1.0, upper: float = 1.0, fore: float = 1.0) -> PlanarRobot:
    """Make the robot of Fig. 6: a torso that turns about the base, upright at q = 0, and two arms of two joints each.

    Joints: torso, left shoulder, left elbow, right shoulder, right elbow. Points: "left" and "right" hand.

    Parameters
    ----------
    torso, upper, fore
        lengths of the links, m

    Returns
    -------
    PlanarRobot
        the robot
    """
    lengths = [torso, upper, fore, upper, fore]
    return PlanarRobot(lengths, {"left": (0, 1, 2), "right": (0, 3, 4)}, base_angle=0.5 * np.pi)
