# SPDX-License-Identifier: Apache-2.0
"""`KinematicTask`: which part of which point matters, and what it is seen from; `KinematicState`: robot and objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.kernels_rotation import inverse_left_jacobian, quaternion_difference
from tpgmm_core.geometry.quaternion import rotation_matrix
from tpgmm_core.kinematics import inverse
from tpgmm_core.kinematics.chains import Kinematics

_PARTS = ("position", "orientation", "pose")


@dataclass(frozen=True, slots=True)
class KinematicTask:
    """The part of a point of the robot that matters.

    Parameters
    ----------
    point
        name of the point
    part
        its position (m), its orientation, as the rotation vector (rad) about the fixed axes from the orientation that
        it is seen from, or both in this order
    relative_to
        the object that it is seen from, in the object's axes; the world where None. Another point of the robot is an
        object too, one that moves with the joints: so tasks can describe what two hands hold between them. In the
        world, rotation vectors jump at a turn by pi: an orientation far from that of the world's axes is better seen
        from an object, which may be one that never moves
    """

    point: str
    part: Literal["position", "orientation", "pose"] = "position"
    relative_to: str | None = None

    def __post_init__(self) -> None:
        if self.part not in _PARTS:
            raise ValueError(f"the part of a task is one of {_PARTS}, got {self.part!r}")


KinematicTasks = tuple[KinematicTask, ...]


class View(NamedTuple):
    """Tasks at one step, one below the other, m numbers in all.

    Parameters
    ----------
    J
        (m, n), with xdot = J qdot, about the world's axes
    A
        (m, m), axes of the objects that the tasks are relative to: A^O of Eq. (9)
    offset
        (m,), b^O - x of Eq. (9), from the points to the objects
    """

    J: Array
    A: Array
    offset: Array


class KinematicState:
    """Where the robot and the objects are at one step; it computes once what several frames of this step share.

    Parameters
    ----------
    kinematics
        the robot; it is moved to q
    q
        (n,), configuration of the step before, q_{t-1}
    objects
        name → Frame of a position (m, m) or of a pose (7, 7) (`Frame.from_pose`)
    threshold
        of the damping, see `inverse.THRESHOLD`
    stride
        length of the step, in units of `moving.STEP`: steps of joints are seen divided by it
    """

    def __init__(
        self,
        kinematics: Kinematics,
        q: Array,
        objects: Mapping[str, Frame] | None = None,
        threshold: float = inverse.THRESHOLD,
        stride: float = 1.0,
    ) -> None:
        kinematics.update(q)
        self.q = q
        self.threshold = threshold
        self.stride = stride
        self._kinematics = kinematics
        self._objects = objects or {}
        self._single: dict[KinematicTask, View] = {}
        self._null_spaces: dict[KinematicTasks, Array] = {}

    def view(self, tasks: KinematicTasks) -> View:
        """The tasks as they are now.

        Parameters
        ----------
        tasks
            what is looked at

        Returns
        -------
        View
            the tasks, one below the other

        Raises
        ------
        ValueError
            for unknown points, and objects that are not known
        """
        views = [self._view(task) for task in tasks]
        if len(views) == 1:
            return views[0]
        J, offset = (np.concatenate([view[i] for view in views]) for i in (0, 2))
        A = np.zeros((len(offset), len(offset)))
        row = 0
        for view in views:
            end = row + len(view.offset)
            A[row:end, row:end] = view.A
            row = end
        return View(J, A, offset)

    def null_space(self, tasks: KinematicTasks) -> Array:
        """Projection N (n, n) on motions that the tasks do not see, wherever their objects are."""
        N = self._null_spaces.get(tasks)
        if N is None:
            J = np.concatenate([self._jacobian(task) for task in tasks])
            N = self._null_spaces[tasks] = inverse.null_space(J, self.threshold)
        return N

    def _jacobian(self, task: KinematicTask) -> Array:
        """Jacobian (m, n) of a task: velocity, angular velocity, or both, about the world's axes."""
        J: Array = self._kinematics.jacobian(task.point)
        if task.relative_to is not None and task.relative_to in self._kinematics.points:
            J = J - self._carried(task.point, task.relative_to)
        if task.part != "position" and len(J) != 6:
            raise ValueError(f"point {task.point!r} has a position only, the task asks for its {task.part}")
        m = len(J) if len(J) < 6 else 3
        rows = {"position": slice(0, m), "orientation": slice(3, 6), "pose": slice(0, 6)}[task.part]
        return np.array(J[rows], order="C")

    def _carried(self, point: str, observer: str) -> Array:
        """The motion of a point if it were fixed to another one, as a Jacobian; in the plane points do not turn."""
        J = np.array(self._kinematics.jacobian(observer))
        if len(J) == 6:
            lever = self._kinematics.place(point)[:3] - self._kinematics.place(observer)[:3]
            J[:3] -= np.cross(lever, J[3:], axisb=0, axisc=0)  # v + w x lever
        return J

    def _view(self, task: KinematicTask) -> View:
        view = self._single.get(task)
        if view is None:
            view = self._single[task] = self._worked_out(task)
        return view

    def _worked_out(self, task: KinematicTask) -> View:
        J, place = self._jacobian(task), self._kinematics.place(task.point)
        m = len(place) if len(place) < 7 else 3
        A, b, target = self._object(task, m, len(place))
        if task.part == "position":
            return View(J, A, b - place[:m])
        turned = np.array(quaternion_difference(*place[3:], *target))
        rate = np.empty((3, 3))  # rate of the rotation vector, for a unit angular velocity
        inverse_left_jacobian(turned[0], turned[1], turned[2], rate)
        J[-3:] = rate @ J[-3:]
        if task.part == "orientation":
            return View(J, A, -turned)
        both = np.zeros((6, 6))
        both[:3, :3] = both[3:, 3:] = A
        return View(J, both, np.concatenate([b - place[:3], -turned]))

    def _object(self, task: KinematicTask, m: int, dim: int) -> tuple[Array, Array, Array]:
        """Axes (m, m), position (m,) and quaternion (4,) of what the task is relative to."""
        if task.relative_to is None:
            return np.eye(m), np.zeros(m), np.array([0.0, 0.0, 0.0, 1.0])
        if task.relative_to in self._kinematics.points:
            place = self._kinematics.place(task.relative_to)
            if dim < 7:
                return np.eye(m), place, np.array([0.0, 0.0, 0.0, 1.0])
            return rotation_matrix(place[3:]), place[:3], place[3:]
        frame = self._objects.get(task.relative_to)
        if frame is None:
            raise ValueError(f"object {task.relative_to!r} is not known; known are {sorted(self._objects)}")
        if frame.A.shape not in ((m, m), (dim, dim)) or (frame.A.shape == (m, m) and task.part != "position"):
            raise ValueError(
                f"object {task.relative_to!r} is a frame of a position ({m}, {m}), or of a pose (7, 7) in space, as "
                f"the {task.part} of {task.point!r} asks for; got A of shape {frame.A.shape}"
            )
        target = frame.A[3:, 6] if frame.A.shape == (7, 7) else np.array([0.0, 0.0, 0.0, 1.0])  # L(q) (0, 0, 0, 1) = q
        return frame.A[:m, :m], frame.b[:m], target


def compile_kernels() -> None:
    """Run all compiled functions of states and frames, so that no later step waits for the compiler."""
    inverse.null_space(np.eye(1), inverse.THRESHOLD)
    quaternion_difference(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    inverse_left_jacobian(0.0, 0.0, 0.0, np.empty((3, 3)))
